"""How much of a flight the tube is claimed, for every packaged profile with its own flight certificates at 50 Hz.

    .venv/bin/python bench/shares.py

Three drones of the identified simulation in still air, with noise and link of the demo and default parameters, take
off. In one flight they go half a metre aside and back, and swap places; in another they fly through way-points, each of
five legs as slow as the certificate wants it. The share is that of the time from two seconds after lift-off on.
"""

from __future__ import annotations

import os
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.demo.scenario import PAPER_WAYPOINTS, POSE_NOISE, gentle_swap, gentle_tour
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

PROFILES = ("cf21", "cf21_plus", "cf2x_2025", "thrust_kit", "brushless")
TARGET = 0.95
_LIFTED, _LATER = 0.02, 2.0  # m above the floor, and s after that from which on the claim counts
_CLIMB, _ASIDE = 9.0, 6.0  # s
# from where each drone hovers, m
_TOUR = np.array([[0, 0, 0], [0.5, 0.2, 0.2], [0.3, 0.6, 0.0], [-0.2, 0.4, 0.3], [-0.3, 0, 0.1], [0, 0, 0]])


class Flown(NamedTuple):
    """The smallest share of three drones, and the largest distances to the reference, horizontal and vertical, m."""

    share: float
    furthest: tuple[float, float]


def flown(name: str, profile: str, touring: bool) -> Flown:
    """Fly once, through way-points or to set-points and in a swap."""
    certificate, vehicle, count = load_certificate(name), load_vehicle(profile), len(PAPER_WAYPOINTS)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, count)
    fleet = SimulatedFleet(
        vehicle, count, start=PAPER_WAYPOINTS * (1.0, 1.0, 0.0), capture=MotionCapture(noise=POSE_NOISE),
        command_delay=LINK_DELAY, seed=1,
    )  # fmt: skip
    lifted, claimed, errors = np.full(count, np.inf), [], []

    def observe(now: float, _samples: object, tick: Tick, _sent: object) -> None:
        height = fleet.bodies.position[:, 2]
        lifted[:] = np.where((height > _LIFTED) & np.isinf(lifted), now, lifted)
        counts = (tick.mode == Mode.FLY) & (now >= lifted + _LATER)
        claimed.append(np.where(counts, tick.assessment.guaranteed, np.nan))
        errors.append(np.where(counts[:, np.newaxis], fleet.bodies.position - tick.reference[:, :3], np.nan))

    now = fly(pilot, fleet, vehicle, 1.0)
    for index in range(count):
        fleet.firmware.request_arming(index, True)
        pilot.take_off(index, 1.0)
    now = fly(pilot, fleet, vehicle, now + _CLIMB, observe, start=now)
    for aside in () if touring else (0.5, 0.0):
        for index in range(count):
            pilot.set_goal(index, PAPER_WAYPOINTS[index] * (1.0, 1.0, 0.0) + (0.0, aside, 1.0))
        now = fly(pilot, fleet, vehicle, now + _ASIDE, observe, start=now)
    if touring:
        paths = [gentle_tour(certificate, place + _TOUR) for place in PAPER_WAYPOINTS]
    else:
        paths = [gentle_swap(certificate, PAPER_WAYPOINTS, index, count) for index in range(count)]
    for index, path in enumerate(paths):
        pilot.set_reference(index, path.shifted(now))
    fly(pilot, fleet, vehicle, now + float(paths[0].times[-1]), observe, start=now)
    away = np.array(errors)
    sideways = float(np.nanmax(np.linalg.norm(away[..., :2], axis=2)))
    return Flown(float(np.nanmean(claimed, axis=0).min()), (sideways, float(np.nanmax(np.abs(away[..., 2])))))


def main() -> None:
    """Print a line a certificate."""
    for profile in PROFILES:
        for kind in ("adaptive", "tight"):
            for touring in (False, True):
                share, furthest = flown(f"{profile}_{kind}_50hz", profile, touring)
                sizes = ", ".join(f"{100.0 * size:.2f}" for size in furthest)
                what = "way-points" if touring else "set-points and swap"
                print(f"{profile}_{kind}_50hz, {what}: claimed {share:.3f}, furthest {sizes} cm", flush=True)


if __name__ == "__main__":
    main()
