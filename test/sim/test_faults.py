"""Faults between fleet and pilot: each does what it says to samples and set-points, and none changes nothing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim import faults
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import STEP
from flatsat_ros.sim.faults import FaultyLink
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

CONFIG = Path(__file__).parents[2] / "config"
CERTIFICATE = Certificate.load(CONFIG / "cf21_50hz.yaml")
VEHICLE = VehicleProfile.load(CONFIG / "vehicles" / "cf21.yaml")

COORDINATE = st.floats(-5.0, 5.0)
ANGLE = st.floats(-math.pi, math.pi)


def stream(count: int = 1, seconds: float = 1.0) -> list[Sample]:
    """Samples of drones at 100 Hz, each at its own place."""
    level = np.array([0.0, 0.0, 0.0, 1.0])
    times = [0.01 * number for number in range(round(100 * seconds))]
    return [Sample(time, drone, np.array([drone, 1.0, 2.0]), level) for time in times for drone in range(count)]


def through(fault: faults.PoseFault, samples: list[Sample]) -> list[tuple[float, Sample]]:
    """What arrives, and when, of samples at 100 Hz that are read at 50 Hz, until a second after the last."""
    arrived = []
    for tick in range(50 * round(samples[-1].stamp + 1.0) + 1):
        now = 0.02 * tick
        due = [sample for sample in samples if 2 * tick - 2 < round(100 * sample.stamp) <= 2 * tick]
        arrived += [(now, sample) for sample in fault(now, due)]
    return arrived


def quaternions() -> st.SearchStrategy[np.ndarray]:
    parts = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: float(np.linalg.norm(q)) > 0.1)
    return parts.map(lambda q: np.array(q) / np.linalg.norm(q))


def heading(quaternion: np.ndarray) -> float:
    x, y, z, w = quaternion
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def test_without_faults_the_link_changes_nothing() -> None:
    places = []
    for linked in (False, True):
        fleet = SimulatedFleet(VEHICLE, 2, capture=MotionCapture(noise=5e-4))
        pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), Policy(), 2)
        for index in range(2):
            pilot.set_reference(index, Trajectory.hold([0.5 * index, 0.3, 0.8]))
        fly(pilot, FaultyLink(fleet) if linked else fleet, VEHICLE, 4.0)
        places.append(fleet.bodies.position)
    assert places[0][0, 2] > 0.3
    np.testing.assert_array_equal(places[1], places[0])


def test_what_arrives_is_read_after_the_faults() -> None:
    link = FaultyLink(
        SimulatedFleet(VEHICLE, 1), read=lambda samples: [s._replace(stamp=2.0 * s.stamp) for s in samples]
    )
    link.poses.append(faults.restamped(1.0))
    link.advance_to(0.1)
    np.testing.assert_allclose([sample.stamp for sample in link.measurements(0.1)], 2.0 + 0.02 * np.arange(1, 11))


def test_look_sees_every_step() -> None:
    fleet = SimulatedFleet(VEHICLE, 1)
    times: list[float] = []
    FaultyLink(fleet, lambda: times.append(fleet.time)).advance_to(0.1)
    np.testing.assert_allclose(times, STEP * np.arange(1, 51))


def test_a_pilot_that_was_away_finds_the_newest_ten_poses_of_each_drone() -> None:
    link = FaultyLink(SimulatedFleet(VEHICLE, 2))
    link.advance_to(3.0)
    samples = link.measurements(3.0)
    for drone in range(2):
        stamps = [sample.stamp for sample in samples if sample.drone == drone]
        np.testing.assert_allclose(stamps, 2.91 + 0.01 * np.arange(10))


def test_set_points_that_are_late_arrive_in_their_order_and_not_before() -> None:
    fleet = SimulatedFleet(VEHICLE, 1)
    heard: list[tuple[float, float]] = []
    fleet.command = lambda _index, roll, *_: heard.append((fleet.time, roll))  # type: ignore[method-assign]
    link = FaultyLink(fleet)
    link.commands.append(faults.commands_delayed(0.1, 0))
    for tick in range(10):
        link.advance_to(0.02 * tick)
        link.command(0, float(tick), 0.0, 0.0, 0.0)
    link.advance_to(1.0)
    assert [roll for _, roll in heard] == list(range(10))
    np.testing.assert_allclose([time for time, _ in heard], 0.1 + 0.02 * np.arange(10), atol=STEP)


@given(share=st.floats(0.0, 1.0), seed=st.integers(0, 100))
def test_thinning_loses_its_share(share: float, seed: int) -> None:
    samples = stream(seconds=20.0)
    left = faults.thinned(share, seed)(0.0, samples)
    assert len(left) == pytest.approx((1.0 - share) * len(samples), abs=5.0 * math.sqrt(len(samples)) / 2.0 + 1e-9)
    assert [s.stamp for s in left] == sorted(s.stamp for s in left)


@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0, 50.0])
def test_slowing_keeps_an_even_rate_of_every_drone(rate: float) -> None:
    arrived = through(faults.slowed(rate), stream(count=2, seconds=4.0))
    for drone in range(2):
        stamps = [sample.stamp for _, sample in arrived if sample.drone == drone]
        np.testing.assert_allclose(np.diff(stamps), 1.0 / rate)


@pytest.mark.parametrize("late", [0.1, 0.3])
def test_a_delay_keeps_stamps_and_order(late: float) -> None:
    samples = stream()
    at_once, later = through(faults.delayed(0.0), samples), through(faults.delayed(late), samples)
    assert [sample for _, sample in later] == [sample for _, sample in at_once]
    np.testing.assert_allclose(np.subtract([t for t, _ in later], [t for t, _ in at_once]), late)


def test_jumps_come_once_in_a_period() -> None:
    arrived = through(faults.jumping((0.0, 0.0, 1.0), 0.5), stream(seconds=3.0))
    stamps = [sample.stamp for _, sample in arrived if sample.position[2] == 3.0]
    np.testing.assert_allclose(stamps, 0.5 * np.arange(6))


def test_a_second_source_speaks_in_its_bursts_only() -> None:
    samples = stream(seconds=6.0)
    arrived = through(faults.doubled((1.0, 0.0, 0.0), 0.5, 1.0), samples)
    others = [(time, sample) for time, sample in arrived if sample.position[0] == 1.0]
    assert len(arrived) == len(samples) + len(others)
    assert len(others) == pytest.approx(len(samples) / 3, rel=0.05)
    assert all(math.fmod(time, 1.5) >= 1.0 for time, _ in others)


def test_the_last_pose_is_repeated_with_fresh_stamps() -> None:
    samples = [sample._replace(position=sample.position + sample.stamp) for sample in stream()]
    arrived = [sample for _, sample in through(faults.repeated(), samples)]
    assert [sample.stamp for sample in arrived] == [sample.stamp for sample in samples]
    assert all((sample.position == samples[0].position).all() for sample in arrived)


@given(axis=st.integers(0, 2), place=st.tuples(*[st.floats(-9.0, 9.0)] * 3))
def test_one_coordinate_stands_still_or_has_the_other_sign_and_the_rest_lives(
    axis: int, place: tuple[float, float, float]
) -> None:
    samples = [sample._replace(position=np.array(place) + sample.stamp) for sample in stream()]
    positions = np.array([sample.position for sample in samples])
    frozen, mirrored, vague = (
        np.array([sample.position for _, sample in through(fault, samples)])
        for fault in (faults.frozen(axis), faults.mirrored(axis), faults.frozen(axis, 1, 0.1))
    )
    others = [i for i in range(3) if i != axis]
    for changed in (frozen, mirrored, vague):
        np.testing.assert_array_equal(changed[:, others], positions[:, others])
    np.testing.assert_array_equal(frozen[:, axis], place[axis])
    np.testing.assert_array_equal(mirrored[:, axis], -positions[:, axis])
    assert np.std(vague[:, axis]) == pytest.approx(0.1, rel=0.5)
    rounded = np.array([sample.position for _, sample in through(faults.rounded(0.25), samples)])
    np.testing.assert_array_equal(rounded, 0.25 * np.round(positions / 0.25))


def test_exchanging_twice_changes_nothing() -> None:
    samples = stream(count=3)
    once = faults.exchanged(0, 2)(0.0, samples)
    assert [sample.drone for sample in once[:3]] == [2, 1, 0]
    assert [sample.drone for sample in faults.exchanged(0, 2)(0.0, once)] == [sample.drone for sample in samples]


@given(quaternion=quaternions(), angle=ANGLE)
def test_turning_back_gives_the_orientation_and_turning_a_level_drone_adds_to_its_yaw(
    quaternion: np.ndarray, angle: float
) -> None:
    sample = Sample(0.0, 0, np.zeros(3), quaternion)
    there = faults.turned(angle)(0.0, [sample])
    back = faults.turned(-angle)(0.0, there)
    np.testing.assert_allclose(back[0].quaternion, quaternion, atol=1e-12)
    level = sample._replace(quaternion=np.array([0.0, 0.0, 0.0, 1.0]))
    turned = heading(faults.turned(angle)(0.0, [level])[0].quaternion)
    assert math.remainder(turned - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(first=st.tuples(*[COORDINATE] * 3), second=st.tuples(*[COORDINATE] * 3))
def test_y_up_is_a_rotation_that_shows_heights_as_y(first: tuple[float, ...], second: tuple[float, ...]) -> None:
    level = np.array([0.0, 0.0, 0.0, 1.0])
    a, b = (
        sample.position for sample in faults.y_up()(0.0, [Sample(0.0, 0, np.array(p), level) for p in (first, second)])
    )
    assert a[1] == first[2]
    assert a @ b == pytest.approx(np.dot(first, second), abs=1e-9)
    assert np.cross(a, b)[1] == pytest.approx(np.cross(first, second)[2], abs=1e-9)


def test_a_fault_of_some_drones_leaves_the_others_alone() -> None:
    samples = stream(count=3)
    left = faults.of_drones(faults.lost, 0, 2)(0.0, samples)
    assert left == [sample for sample in samples if sample.drone == 1]


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (faults.without_position(), ([math.nan] * 3, [0.0, 0.0, 0.0, 1.0], 0.5)),
        (faults.without_orientation(), ([0.0, 1.0, 2.0], [math.nan] * 4, 0.5)),
        (faults.zeroed(), ([0.0] * 3, [0.0] * 4, 0.5)),
        (faults.scaled(1000.0), ([0.0, 1e3, 2e3], [0.0, 0.0, 0.0, 1.0], 0.5)),
        (faults.moved((0.0, 0.5, 0.0)), ([0.0, 1.5, 2.0], [0.0, 0.0, 0.0, 1.0], 0.5)),
        (faults.restamped(-0.25), ([0.0, 1.0, 2.0], [0.0, 0.0, 0.0, 1.0], 0.25)),
        (faults.stamped(-7.0), ([0.0, 1.0, 2.0], [0.0, 0.0, 0.0, 1.0], -7.0)),
    ],
)
def test_what_each_sample_becomes(fault: faults.PoseFault, expected: tuple[list[float], list[float], float]) -> None:
    sample = Sample(0.5, 0, np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    (result,) = fault(0.5, [sample])
    position, quaternion, stamp = expected
    np.testing.assert_array_equal(result.position, position)
    np.testing.assert_array_equal(result.quaternion, quaternion)
    assert result.stamp == stamp


def test_faults_of_commands_reach_the_drones_they_are_for() -> None:
    setpoint = WireSetpoint(1.0, 2.0, 3.0, 40000.0)
    assert faults.pitch_negated(0)(0.0, 0, setpoint) == [(0.0, WireSetpoint(1.0, -2.0, 3.0, 40000.0))]
    assert math.isnan(faults.roll_uncontrolled(0)(0.0, 0, setpoint)[0][1].roll)
    assert faults.commands_lost(1.0, 0, 0)(0.0, 0, setpoint) == []
    for fault in (faults.pitch_negated(0), faults.roll_uncontrolled(0), faults.commands_lost(1.0, 0, 0)):
        assert fault(0.0, 1, setpoint) == [(0.0, setpoint)]
