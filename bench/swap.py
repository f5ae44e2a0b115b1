"""The swap at 50 Hz by the certificate that the demo flies and by one without a flight section, in the same air."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.demo.scenario import PAPER_WAYPOINTS, POSE_NOISE, VEHICLE, gentle_swap
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

PRESENT = "cf21_50hz"
AIR = {"still air": Wind(), "wind of 1 m/s with gusts": Wind(mean=(1.0, 0.0, 0.0), gust=0.2)}
RATIO_TARGET = 0.6
_CLIMB, _HEIGHT = 15.0, 1.0  # s, m


class Swap(NamedTuple):
    """One flight of three drones, the worst of them, over the swap.

    Attributes:
        rms: m.
        furthest: largest distances to the reference, horizontal and vertical, m.
        tube: largest that the certificate claims, m; NaN for none.
        guaranteed: smallest share of the time.
    """

    rms: float
    furthest: tuple[float, float]
    tube: tuple[float, float]
    guaranteed: float


def swaps(air: Wind) -> tuple[Swap, Swap]:
    """Return the flights with the certificate without a flight section, and with the default one."""
    default = load_certificate(DEFAULT_CERTIFICATE)
    count = len(PAPER_WAYPOINTS)
    paths = [gentle_swap(default, PAPER_WAYPOINTS, index, count) for index in range(count)]
    vehicle = load_vehicle(VEHICLE)
    return swap(load_certificate(PRESENT), vehicle, vehicle, paths, air), swap(default, vehicle, vehicle, paths, air)


def swap(
    certificate: Certificate, vehicle: VehicleProfile, drone: VehicleProfile, paths: list[Trajectory], air: Wind
) -> Swap:
    """Return the flight of drones that the controller takes for a vehicle."""
    count = len(paths)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, count)
    fleet = SimulatedFleet(
        drone, count, start=PAPER_WAYPOINTS * (1.0, 1.0, 0.0), wind=air, capture=MotionCapture(noise=POSE_NOISE),
        command_delay=LINK_DELAY, seed=1,
    )  # fmt: skip
    errors, claimed = [], []

    def observe(_now: float, _samples: list[Sample], tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        errors.append(fleet.bodies.position - tick.reference[:, :3])
        claimed.append(tick.assessment.guaranteed & (tick.mode == Mode.FLY))

    now = fly(pilot, fleet, vehicle, 1.0)
    for index in range(count):
        pilot.take_off(index, _HEIGHT)
    now = fly(pilot, fleet, vehicle, _CLIMB, start=now)
    for index, path in enumerate(paths):
        pilot.set_reference(index, path.shifted(now))
    fly(pilot, fleet, vehicle, now + float(paths[0].times[-1]), observe, start=now)
    away = np.array(errors)
    sides, upright = np.hypot(away[..., 0], away[..., 1]), np.abs(away[..., 2])
    tube = pilot.certificate.flight
    return Swap(
        rms=float(np.sqrt((away**2).sum(axis=2).mean(axis=0)).max()),
        furthest=(float(sides.max()), float(upright.max())),
        tube=(np.nan, np.nan) if tube is None else (tube.horizontal.tube.position, tube.vertical.tube.position),
        guaranteed=float(np.array(claimed).mean(axis=0).min()),
    )
