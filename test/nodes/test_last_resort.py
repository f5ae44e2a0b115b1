"""The last resort: from whatever flight it begins, the drone comes down level and not too fast."""

from __future__ import annotations

import numpy as np
import pytest

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.nodes.last_resort import LastResort
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import Sample

pytestmark = pytest.mark.in_process

HOVER = 40000.0  # PWM


def setpoint(thrust: float, yaw: float = 0.0) -> WireSetpoint:
    return WireSetpoint(roll=7.0, pitch=-7.0, yaw=yaw, thrust=thrust)


class Clock:
    """Shows what the test wants, s."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def resort(clock: Clock) -> LastResort:
    return LastResort([HOVER, HOVER], keeps_yaw=False, clock=clock)


def flown(resort: LastResort, clock: Clock, thrust: float, seconds: float = 10.0) -> None:
    """Let drone 0 be sent a thrust at 100 Hz."""
    for _ in range(round(seconds / 0.01)):
        clock.now += 0.01
        resort.note(0, setpoint(thrust, 30.0))


def told(resort: LastResort, clock: Clock, *times: float, index: int = 0) -> list[WireSetpoint | None]:
    """Let a drone go down; return what it is told after these times, s."""
    resort.begin(index)
    begin, said = clock.now, []
    for elapsed in times:
        clock.now = begin + elapsed
        said.append(resort.setpoint(index))
    return said


def test_a_drone_in_flight_is_told_level_and_sinking_then_zero_then_nothing(resort: LastResort, clock: Clock) -> None:
    flown(resort, clock, 42000.0)
    assert resort.setpoint(0) is None
    said = told(resort, clock, *np.arange(0.0, 20.0, 0.1).tolist())
    thrusts = [s.thrust for s in said if s is not None]
    assert thrusts[0] == pytest.approx(0.93 * 42000.0, rel=1e-3)
    assert (np.diff(thrusts) <= 0.0).all()
    assert thrusts.count(0.0) == pytest.approx(25, abs=1)
    assert len(thrusts) == pytest.approx(145, abs=1)
    assert said[len(thrusts) :] == [None] * (200 - len(thrusts))
    assert all(s[:3] == (0.0, 0.0, 0.0) for s in said if s is not None)


def test_it_goes_by_the_mean_and_begins_at_the_profiles_hover(resort: LastResort, clock: Clock) -> None:
    flown(resort, clock, 60000.0, seconds=0.1)
    (first,) = told(resort, clock, 0.0)
    assert first is not None
    assert 0.93 * HOVER < first.thrust < 0.93 * 1.05 * HOVER


def test_nothing_is_told_to_a_drone_that_was_sent_nothing(resort: LastResort, clock: Clock) -> None:
    flown(resort, clock, 42000.0)
    assert told(resort, clock, 0.0, 1.0, index=1) == [None, None]
    assert told(resort, clock, 0.0, 1.0) == [None, None], "long ago"


def test_a_drone_whose_motors_rest_is_kept_from_being_locked(resort: LastResort, clock: Clock) -> None:
    flown(resort, clock, 0.0)
    assert [s and s.thrust for s in told(resort, clock, 0.0, 1.0, 2.4, 2.6)] == [0.0, 0.0, 0.0, None]


def test_it_begins_once(resort: LastResort, clock: Clock) -> None:
    flown(resort, clock, 42000.0)
    begin = clock.now
    told(resort, clock, 5.0)
    resort.begin(0)
    assert resort.since == [begin, None]


def test_an_angle_of_yaw_is_kept_and_a_rate_is_not(clock: Clock) -> None:
    keeping = LastResort([HOVER], keeps_yaw=True, clock=clock)
    flown(keeping, clock, 42000.0)
    (last,) = told(keeping, clock, 0.0)
    assert last is not None
    assert last.yaw == 30.0


@pytest.mark.parametrize(("height", "bound"), [(1.0, 1.1), (3.0, 1.7)])
@pytest.mark.parametrize("flight", ["hover", "climb", "far"])
def test_the_drone_comes_down_softly_whatever_it_did(height: float, bound: float, flight: str, clock: Clock) -> None:
    certificate, vehicle, scales = load_certificate("cf21_50hz"), load_vehicle("cf21"), [0.9, 1.0, 1.1]
    fleet = SimulatedFleet(vehicle, 3, start=[[0.0, 2.0 * i, 0.0] for i in range(3)], thrust_scale=scales)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), Policy(disturbance_max=0.8), 3)
    resort = LastResort([float(vehicle.pwm_from_thrust(GRAVITY))] * 3, keeps_yaw=False, clock=clock)

    def note(now: float, _: list[Sample], __: Tick, sent: dict[int, WireSetpoint]) -> None:
        clock.now = now
        for index, each in sent.items():
            resort.note(index, each)

    now = fly(pilot, fleet, vehicle, 1.0, note)
    for index in range(3):
        pilot.set_reference(index, Trajectory.hold([0.0, 2.0 * index, height]))
    if flight == "climb":
        while fleet.bodies.position[1, 2] < 0.7 * height:
            now = fly(pilot, fleet, vehicle, now + certificate.period, note, now)
    else:
        now = fly(pilot, fleet, vehicle, 8.0, note, now)
    if flight == "far":
        for index in range(3):
            pilot.set_reference(index, Trajectory.hold([3.0, 2.0 * index, height]))
        now = fly(pilot, fleet, vehicle, 9.0, note, now)

    speeds, begin = np.zeros(3), now
    clock.now = now
    for index in range(3):
        resort.begin(index)
    while not fleet.bodies.grounded.all():
        assert now < begin + 13.0
        for index in range(3):
            last = resort.setpoint(index)
            if last is not None:
                fleet.command(index, *last)
        speeds = np.where(fleet.bodies.grounded, speeds, -fleet.bodies.velocity[:, 2])
        now += 0.01
        clock.now = now
        fleet.advance_to(now)
    assert speeds.max() <= bound
