"""Flights by positions alone: whatever the true yaw is, a drone flies to its goal or lands near, and never away."""

from __future__ import annotations

from functools import cache

import numpy as np

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy, YawSource
from flatsat_ros.flight.supervisor import Mode
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.faults import FaultyLink, without_orientation
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

CERTIFICATE, VEHICLE = load_certificate("cf21_50hz"), load_vehicle("cf21")
YAWS = np.array([0.0, 1.0, -2.0, 3.0])  # true ones, rad
TURNED = np.abs(YAWS) > 1.2
STARTS = np.array([[0.0, 4.0 * n, 0.0] for n in range(len(YAWS))])
WAY = np.array([1.0, 0.8, 1.0])


class Flight:
    """Drones far apart rise by a metre and fly to goals, seen by positions alone, each with another yaw."""

    def __init__(self, source: YawSource) -> None:
        policy = Policy(yaw_source=source, disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
        count = len(YAWS)
        self.fleet = SimulatedFleet(VEHICLE, count, start=STARTS, yaw=YAWS, seed=1, capture=MotionCapture(noise=5e-4))
        self.pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, count)
        self.off = np.zeros(count)  # farthest from the straight ways to the goals, m
        self.corrected = np.zeros(count, dtype=bool)
        link = FaultyLink(self.fleet)
        link.poses.append(without_orientation())
        time = fly(self.pilot, link, VEHICLE, 1.0, self._look)
        for index in range(count):
            self.pilot.take_off(index, 1.0)
        time = fly(self.pilot, link, VEHICLE, 8.0, self._look, start=time)
        for index in np.flatnonzero(self.pilot.mode == Mode.FLY):
            self.pilot.set_goal(int(index), STARTS[index] + WAY)
        fly(self.pilot, link, VEHICLE, 14.0, self._look, start=time)
        self.missed = np.linalg.norm(self.fleet.bodies.position - STARTS - WAY, axis=1)

    def _look(self, _now: float, _samples: object, tick: Tick, _sent: object) -> None:
        for report in tick.reports:
            self.corrected[report.drone] |= "its yaw is corrected" in report.text
        place = (self.fleet.bodies.position - STARTS)[:, :2]
        share = np.clip(place @ WAY[:2] / (WAY[:2] @ WAY[:2]), 0.0, 1.0)
        self.off = np.maximum(self.off, np.linalg.norm(place - share[:, np.newaxis] * WAY[:2], axis=1))


flown = cache(Flight)


def test_a_yaw_from_motion_is_learnt_and_drones_reach_their_goals() -> None:
    flight = flown(YawSource.MOTION)
    assert (flight.off < 0.7).all()
    assert (flight.missed < 0.1).all()
    error = np.angle(np.exp(1j * (flight.pilot.estimator.yaw - YAWS)))
    assert (np.abs(error) < 0.15).all()
    assert (flight.corrected == TURNED).all()


def test_with_an_assumed_yaw_drones_reach_their_goals_or_come_down_near() -> None:
    flight = flown(YawSource.ASSUMED)
    assert (flight.off < 1.0).all()
    assert not flight.pilot.estimator.yaw.any()
    assert (flight.fleet.bodies.grounded == TURNED).all()
    assert (flight.missed[~TURNED] < 0.35).all()
