"""Many drones on a circle fly to the places opposite, by a plan that is made for the demo and proved."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.demo.record import PLAN
from flatsat_ros.demo.scenario import Scenario, default_certificate, planned_flight, require_wind
from flatsat_ros.flight.separation import DOWNWASH
from flatsat_ros.planning.mission import Asked, Mission
from flatsat_ros.planning.planner import Round, finished
from flatsat_ros.plans.tubes import promise

ROBOTS_MAX = 64
SECONDS = 5.0  # in which the first plan is improved; for 64 drones that is found within one
_PATIENCE = 60.0  # s, without any plan
_APART = 0.75  # m, between neighbours: both bodies and both tubes are 0.5 m
_RADIUS, _HEIGHT = 1.0, 1.0  # m, of the circle at least, and above the floor
_ROOM, _LOW, _HIGH = 0.5, 0.4, 2.0  # m, around the circle, and between which heights


def exchange(folder: Path, count: int, wind: float = 0.0, progress: Callable[[Round], None] | None = None) -> Scenario:
    """Plan how drones exchange their places across a circle; return the flight of that plan.

    Args:
        folder: where the plan is written.
        count: number of drones.
        wind: m/s, along x.
        progress: is told each plan that is found, the last of which is flown.

    Raises:
        FlatsatError: there are too many drones, or no plan is found in time.
    """
    if not 1 <= count <= ROBOTS_MAX:
        raise refusal("--robots", count, "", f"from 1 to {ROBOTS_MAX}")
    from flatsat_ros.planning.improvement import rounds  # scipy and the solver take a while to import

    certificate, _ = default_certificate()
    require_wind(certificate, wind)
    mission, ends = mission_of(certificate, count), [time.monotonic() + _PATIENCE]
    found: list[Round] = []
    for proved in rounds(mission, lambda: time.monotonic() > ends[-1]):
        if not found:
            ends.append(time.monotonic() + SECONDS)
        found.append(proved)
        if progress is not None:
            progress(proved)
    finished(mission, found[-1]).save(folder / PLAN)
    return planned_flight(folder / PLAN, wind)


def mission_of(certificate: Certificate, count: int) -> Mission:
    """Return what is asked of the drones: to go from their places on a circle to those opposite.

    Raises:
        FlatsatError: the certificate has no flight section, which proves tubes.
    """
    if certificate.flight is None:
        raise FlatsatError(f"certificate {certificate.name!r} has no flight section, which proves tubes")
    radius = max(_RADIUS, _APART / (2.0 * math.sin(math.pi / count))) if count > 1 else _RADIUS
    angles = 2.0 * np.pi * np.arange(count) / count
    places = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    drones = tuple(
        Asked(f"cf{i}", np.array([[x, y, _HEIGHT], [-x, -y, _HEIGHT]])) for i, (x, y) in enumerate(places.tolist(), 1)
    )
    side = radius + _ROOM
    bounds, tube = promise(certificate, [-side, -side, _LOW], [side, side, _HIGH], downwash=DOWNWASH)
    return Mission(
        f"exchange_{count}", drones, certificate.name, certificate.limits, bounds, tube, downwash=DOWNWASH
    )  # fmt: skip
