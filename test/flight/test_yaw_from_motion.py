"""Flights by positions alone: whatever the true yaw is, a drone flies to its goal or lands near, and never away."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np
import pytest

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy, YawSource
from flatsat_ros.flight.supervisor import Mode
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.faults import FaultyLink, without_orientation
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

CERTIFICATE, VEHICLE = load_certificate("cf21_50hz"), load_vehicle("cf21")
YAWS = np.array([0.0, 1.0, -1.0, -2.0, 3.0])  # true ones, rad
TURNED = np.abs(YAWS) > 1.2  # so that learning it little by little would be too late
WRONG = np.abs(YAWS) > 0.7  # too far from 0 for that to be assumed
WAY = np.array([1.0, 0.8, 1.0])


class Flight:
    """Drones far apart rise by a metre and fly to goals, seen by positions alone, each with another yaw."""

    def __init__(self, source: YawSource, yaws: tuple[float, ...] = tuple(YAWS), gust: float = 0.0) -> None:
        policy = Policy(yaw_source=source, disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
        count = len(yaws)
        self.starts = np.array([[0.0, 4.0 * n, 0.0] for n in range(count)])
        room: dict[str, Any] = {"wind": Wind(gust=gust), "capture": MotionCapture(noise=5e-4)}
        self.fleet = SimulatedFleet(VEHICLE, count, start=self.starts, yaw=yaws, seed=1, **room)
        self.pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, count)
        self.off = np.zeros(count)  # farthest from the straight ways to the goals, m
        self.corrected = np.zeros(count, dtype=bool)
        self.told = np.zeros(count)  # by how much its motion is said to be turned, rad
        link = FaultyLink(self.fleet)
        link.poses.append(without_orientation())
        time = fly(self.pilot, link, VEHICLE, 1.0, self._look)
        for index in range(count):
            self.pilot.take_off(index, 1.0)
        time = fly(self.pilot, link, VEHICLE, 8.0, self._look, start=time)
        for index in np.flatnonzero(self.pilot.mode == Mode.FLY):
            self.pilot.set_goal(int(index), self.starts[index] + WAY)
        fly(self.pilot, link, VEHICLE, 14.0, self._look, start=time)
        self.missed = np.linalg.norm(self.fleet.bodies.position - self.starts - WAY, axis=1)

    def _look(self, _now: float, _samples: object, tick: Tick, _sent: object) -> None:
        for report in tick.reports:
            self.corrected[report.drone] |= "its yaw is corrected" in report.text
            if found := re.match(r"its motion is turned by (-?\d+) deg", report.text):
                self.told[report.drone] = np.radians(float(found[1]))
        place = (self.fleet.bodies.position - self.starts)[:, :2]
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


def test_with_an_assumed_yaw_that_is_wrong_drones_are_told_of_and_come_down_near() -> None:
    flight = flown(YawSource.ASSUMED)
    assert (flight.off < 0.8).all()
    assert not flight.pilot.estimator.yaw.any()
    assert (flight.fleet.bodies.grounded == WRONG).all()
    assert flight.told[WRONG] == pytest.approx(YAWS[WRONG], abs=0.3)
    assert (flight.missed[~WRONG] < 0.05).all()


def test_with_an_assumed_yaw_that_is_nearly_right_drones_fly_on_in_gusts() -> None:
    flight = flown(YawSource.ASSUMED, (0.0, 0.2, -0.2), gust=0.4)
    assert not flight.told.any()
    assert (flight.pilot.mode == Mode.FLY).all()
    assert (flight.missed < 0.2).all()
