"""The flight without ROS: which ticks a stretch of it has, and that cutting it changes nothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

CONFIG = Path(__file__).parents[2] / "config"
CERTIFICATE = Certificate.load(CONFIG / "paper_experiment.yaml")
VEHICLE = VehicleProfile.load(CONFIG / "vehicles" / "cf21.yaml")
PERIODS = st.sampled_from([0.1, 0.02, 1.0 / 3.0, 0.07])


class Unseen:
    """A fleet that nobody measures, so that its pilot stays silent: only the clock goes on.

    Attributes:
        count, yaw_mode: as of a fleet.
        time: advanced to, s.
    """

    count = 1
    yaw_mode = YawMode.RATE
    time = 0.0

    def advance_to(self, time: float) -> None:
        assert time >= self.time
        self.time = time

    def measurements(self, _time: float) -> list[Sample]:
        return []


class Flight:
    """One drone, its pilot, and what its ticks have been so far.

    Attributes:
        times: of the ticks, s.
        heights: of the drone at the ticks, m.
        now: time of the next tick, s.
    """

    def __init__(self, fleet: SimulatedFleet | Unseen, period: float = CERTIFICATE.period) -> None:
        certificate = replace(CERTIFICATE, period=period)
        self.pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), Policy(), 1)
        self._fleet = fleet
        self.times: list[float] = []
        self.heights: list[float] = []
        self.now = 0.0

    def fly(self, until: float) -> None:
        self.now = fly(self.pilot, self._fleet, VEHICLE, until, self._observe, start=self.now)

    def _observe(self, now: float, _samples: list[Sample], _tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        assert self._fleet.time == pytest.approx(now, abs=0.002)
        self.times.append(now)
        if isinstance(self._fleet, SimulatedFleet):
            self.heights.append(float(self._fleet.bodies.position[0, 2]))


@given(period=PERIODS, counts=st.lists(st.integers(0, 12), max_size=4))
def test_whole_periods_have_as_many_ticks_whatever_the_rounding(period: float, counts: list[int]) -> None:
    flight = Flight(Unseen(), period)
    for count in counts:
        before = len(flight.times)
        flight.fly(flight.now + count * period)
        assert len(flight.times) - before == count
    np.testing.assert_allclose([*flight.times, flight.now], period * np.arange(sum(counts) + 1), atol=1e-12)


def test_three_periods_of_a_tenth_are_three_ticks_though_they_add_up_to_more() -> None:
    flight = Flight(Unseen(), 0.1)
    assert 0.1 * 3 > 0.3
    flight.fly(0.1 * 3)
    assert len(flight.times) == 3
    flight.fly(0.6)
    assert len(flight.times) == 6


@given(until=st.floats(0.0, 0.8), period=PERIODS)
def test_every_tick_is_before_the_end_and_the_next_one_is_not(until: float, period: float) -> None:
    flight = Flight(Unseen(), period)
    flight.fly(until)
    assert all(time < until for time in flight.times)
    assert flight.now >= until - 1e-6 * period
    assert all(later - earlier == pytest.approx(period) for earlier, later in pairwise([*flight.times, flight.now]))


def test_an_end_that_is_past_has_no_tick() -> None:
    flight = Flight(Unseen())
    flight.fly(1.0)
    flight.fly(0.5)
    assert (len(flight.times), flight.now) == (10, 1.0)


@pytest.mark.parametrize("ends", [[0.1, 0.25, 1.97], [2.0, 2.0]])
def test_how_a_flight_is_cut_into_stretches_changes_nothing(ends: list[float]) -> None:
    whole, cut = (Flight(SimulatedFleet(VEHICLE, 1, capture=MotionCapture(noise=5e-4))) for _ in range(2))
    for flight in (whole, cut):
        flight.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 0.6]))
    for until in (*ends, 4.0):
        cut.fly(until)
    whole.fly(4.0)
    np.testing.assert_allclose(cut.times, whole.times, atol=1e-12)
    np.testing.assert_allclose(cut.heights, whole.heights, atol=1e-9)
    assert whole.heights[-1] > 0.3


def swing(bits: int) -> float:
    """Return how far a drone whose motors take so many bits moves up and down in 2 s of hover that nothing disturbs."""
    certificate = Certificate.from_document(read_yaml(CONFIG / "cf21_adaptive_50hz.yaml"))
    assert certificate.flight is not None
    policy = Policy(disturbance_max=certificate.flight.disturbance, thrust_error_max=0.25)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1)
    vehicle = replace(VEHICLE, motors=replace(VEHICLE.motors, bits=bits))
    fleet, heights = SimulatedFleet(vehicle, 1, capture=MotionCapture(), command_delay=0.028), []
    pilot.arm(0, True)
    start = fly(pilot, fleet, vehicle, 0.5)
    pilot.take_off(0, 0.5)
    start = fly(pilot, fleet, vehicle, 10.0, start=start)
    fly(pilot, fleet, vehicle, 12.0, lambda *_: heights.append(fleet.bodies.position[0, 2]), start=start)
    return float(np.ptp(heights))


def test_the_height_swings_by_the_steps_of_the_motors_alone() -> None:
    """One step of 8 bits is 0.1 m/s^2 of thrust near hover."""
    assert swing(8) > 2e-3
    assert swing(16) < 2e-4
