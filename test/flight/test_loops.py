"""The loop of flight certificates: what is claimed of a flight, and when it is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

VEHICLE = load_vehicle("cf21")
POLICY = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    return load_certificate("cf21_flight_50hz")


@dataclass
class Flown:
    """A flight of one drone: what it was told and where it was, tick by tick."""

    times: FloatArray
    rows: FloatArray
    error: FloatArray  # true position less reference, m
    ticks: list[Tick]

    def column(self, name: str) -> FloatArray:
        return np.asarray(self.rows[:, telemetry.FIELDS.index(name)])

    def from_on(self, time: float) -> np.ndarray:
        return np.asarray((self.times >= time) & (self.column("mode") == Mode.FLY))


class Room:
    """A simulated drone that hovers at 1 m, and its pilot."""

    def __init__(self, certificate: Certificate, policy: Policy = POLICY, delay: float = 0.01, mu: float = 2.0) -> None:
        self.fleet = SimulatedFleet(
            VEHICLE, 1, start=[[0.0, 0.0, 1.0]], flying=True, capture=MotionCapture(noise=5e-4), command_delay=delay
        )
        self.pilot = Pilot(certificate, Tuning(mu, 0.05, 1.0, certificate.gain_max), policy, 1)
        self.times: list[float] = []
        self.rows: list[FloatArray] = []
        self.error: list[FloatArray] = []
        self.ticks: list[Tick] = []
        self.next = 0.0

    def fly(self, until: float) -> Flown:
        self.next = fly(self.pilot, self.fleet, VEHICLE, until, self._note, start=self.next)
        return Flown(np.array(self.times), np.array(self.rows), np.array(self.error), self.ticks)

    def _note(self, now: float, samples: object, tick: Tick, sent: object) -> None:
        self.times.append(now)
        self.rows.append(telemetry.rows(tick)[0])
        self.error.append(self.fleet.poses()[0][0] - tick.reference[0, :3])
        self.ticks.append(tick)


@pytest.fixture(scope="module")
def calm(certificate: Certificate) -> Flown:
    """A goal, another one, and a landing in still air."""
    room = Room(certificate)
    room.fly(0.5)
    room.pilot.set_goal(0, [0.0, 0.0, 1.0])
    room.fly(6.0)
    room.pilot.set_goal(0, [0.8, 0.3, 1.2])
    return room.fly(16.0)


def test_on_the_way_to_a_goal_the_drone_is_in_its_tube_and_the_tube_is_claimed(
    calm: Flown, certificate: Certificate
) -> None:
    late = calm.from_on(3.0)
    assert late.sum() > 600
    assert certificate.flight is not None
    assert np.hypot(*calm.error[late, :2].T).max() < certificate.flight.horizontal.tube.position
    assert np.abs(calm.error[late, 2]).max() < certificate.flight.vertical.tube.position
    assert calm.column("guaranteed")[late].mean() >= 0.95
    assert (calm.column("tube")[late] == certificate.flight.horizontal.tube.position).all()
