"""A plan that is made without a planner: two drones change places, and a third one passes aside."""

from __future__ import annotations

import numpy as np

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube

NAMES = ("cf1", "cf2", "cf3")
_SPAN = 1_300_000  # us


def detour(start: list[float], goal: list[float], aside: list[float]) -> Curve:
    """From rest to rest in 7.8 s, with a detour."""
    a, b = np.array(start), np.array(goal)
    middle = [a + share * (b - a) + np.array(aside) for share in (0.25, 0.5, 0.75)]
    return Curve.rounded(range(0, 6 * _SPAN + 1, _SPAN), np.array([a] * 4 + middle + [b] * 4))


def swap_plan(tube: float = 0.1) -> Plan:
    """Return the plan, for the certificate paper_experiment."""
    curves = (
        detour([0.0, 0.0, 1.0], [1.5, 0.0, 1.0], [0.0, -0.5, 0.0]),
        detour([1.5, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.5, 0.0]),
        detour([0.0, 1.2, 1.0], [1.5, 1.2, 1.4], [0.0, 0.2, 0.0]),
    )
    certificate = load_certificate("paper_experiment")
    made = Plan.of(
        [PlannedDrone(name, curve, 0.1, Tube(tube)) for name, curve in zip(NAMES, curves, strict=True)],
        name="swap", certificate=certificate.name, limits=certificate.limits,
        bounds=Bounds(1.0, 2.0, 12.0, np.array([-1.0, -2.0, 0.5]), np.array([3.0, 3.0, 2.0])),
    )  # fmt: skip
    made.verify()
    return made
