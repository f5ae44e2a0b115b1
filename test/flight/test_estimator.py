"""The estimator: it converges, uses what it knows, and survives what real motion capture does."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from flatsat_ros.flight import estimator as model
from flatsat_ros.flight.estimator import PREDICTION_MAX, Estimator

LEVEL = (0.0, 0.0, 0.0, 1.0)

Path = Callable[[float], np.ndarray]


def turning(t: float) -> np.ndarray:
    """Position on a circle of 0.5 m at 0.5 m/s, 1 m above the ground."""
    return np.array([0.5 * math.cos(t), 0.5 * math.sin(t), 1.0])


def turning_velocity(t: float) -> np.ndarray:
    return np.array([-0.5 * math.sin(t), 0.5 * math.cos(t), 0.0])


def watch(
    estimator: Estimator, path: Path, start: float, end: float, rate: float = 100.0, noise: float = 0.0
) -> np.random.Generator:
    """Feed positions of drone 0 from start to end, s."""
    random = np.random.default_rng(1)
    for t in np.arange(start, end, 1.0 / rate):
        position = path(t) + noise * random.normal(size=3)
        estimator.measure(0, float(t), tuple(position), LEVEL, float(t))
    return random


def velocity_error(estimator: Estimator, velocity: Path, t: float) -> float:
    return float(np.linalg.norm(estimator.estimate(t)[0, 3:6] - velocity(t)))


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0, 240.0])
def test_position_and_velocity_converge_to_a_moving_drone(rate: float) -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 4.0, rate, 3e-4)
    newest = float(estimator.newest[0])
    assert np.linalg.norm(estimator.estimate(newest)[0, :3] - turning(newest)) < 3e-3
    assert velocity_error(estimator, turning_velocity, newest) < 0.1
    assert estimator.usable(newest, 0.3).all()


def test_nothing_is_usable_before_the_velocity_is_known() -> None:
    estimator = Estimator(1)
    assert not estimator.usable(0.0, 1e9).any()
    assert not estimator.estimate(0.0).any()
    estimator.measure(0, 1.0, (1.0, 2.0, 3.0), LEVEL, 1.0)
    assert estimator.estimate(1.0)[0, :6].tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]
    assert not estimator.usable(1.0, 0.3).any()


def test_a_stale_estimate_is_not_usable() -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 1.0)
    assert estimator.usable(1.2, 0.3).all()
    assert not estimator.usable(1.3, 0.3).any()
    assert estimator.usable(1.45, PREDICTION_MAX).all()
    assert not estimator.usable(1.55, PREDICTION_MAX).any(), "the prediction ends after half a second"


def test_a_constant_disturbance_is_learned() -> None:
    estimator = Estimator(1)
    watch(estimator, lambda t: np.array([0.25 * t * t, 0.0, 1.0]), 0.0, 3.0, noise=3e-4)
    assert velocity_error(estimator, lambda t: np.array([0.5 * t, 0.0, 0.0]), 3.0) < 0.05


def accelerated(known: bool) -> float:
    """Velocity error of a drone that is pushed back and forth, measured at 10 Hz, with the push known or not."""
    estimator, x, v, worst = Estimator(1), 0.0, 0.0, 0.0
    for n in range(60):
        t, a = 0.1 * n, 2.0 * (-1.0) ** (n // 5)
        estimator.measure(0, t, (x, 0.0, 1.0), LEVEL, t)
        if n > 20:
            worst = max(worst, abs(float(estimator.estimate(t)[0, 3]) - v))
        estimator.command(t, np.array([[a if known else 0.0, 0.0, 0.0]]))
        x, v = x + 0.1 * v + 0.005 * a, v + 0.1 * a
    return worst


def test_the_known_command_improves_the_velocity() -> None:
    assert accelerated(known=True) < 1e-6
    assert accelerated(known=False) > 0.1


def test_the_estimate_is_the_kalman_filters() -> None:
    """Against the textbook's matrix form, discretised by van Loan's exponential, with commands between measurements."""
    random, filtered = np.random.default_rng(3), Estimator(1)
    system, intensity = np.eye(3, k=1), np.diag([0.0, model._ACCELERATION_NOISE, model._DISTURBANCE_NOISE])
    mean, now, command = np.zeros((3, 3)), 0.0, np.zeros(3)
    covariance = np.diag([model._POSITION_NOISE, model._START_VELOCITY, model._START_DISTURBANCE]) ** 2
    filtered.measure(0, 0.0, (0.0, 0.0, 0.0), LEVEL, 0.0)
    for n in range(60):
        dt = float(random.choice([0.00013, 0.01, 0.1]))
        now += dt
        exponential = expm(np.block([[-system, intensity], [np.zeros((3, 3)), system.T]]) * dt)
        transition = exponential[3:, 3:].T
        covariance = transition @ covariance @ transition.T + transition @ exponential[:3, 3:]
        mean = transition @ mean + np.outer([dt**2 / 2.0, dt, 0.0], command)
        if n % 3 == 0:
            position = mean[0] + 0.02 * random.normal(size=3)
            gain = covariance[:, 0] / (covariance[0, 0] + model._POSITION_NOISE**2)
            mean = mean + np.outer(gain, position - mean[0])
            covariance = covariance - np.outer(gain, covariance[0])
            assert filtered.measure(0, now, tuple(position), LEVEL, now)
        np.testing.assert_allclose(filtered.estimate(now)[0, :6], mean[:2].ravel(), rtol=1e-7, atol=1e-9)
        command = random.normal(size=3)
        filtered.command(now, command[np.newaxis])


def test_between_measurements_the_state_moves_as_commanded() -> None:
    estimator = Estimator(1)
    for n in range(200):
        estimator.command(0.01 * n, np.array([[0.0, 0.0, 0.0]]))
        estimator.measure(0, 0.01 * n, (0.0, 0.0, 1.0), LEVEL, 0.01 * n)
    estimator.command(2.0, np.array([[1.0, 0.0, 0.0]]))
    estimator.command(2.1, np.array([[-2.0, 0.0, 0.5]]))
    # newest measurement at 1.99 s; 0.1 s at 1 m/s^2, then 0.05 s at -2 and 0.5 m/s^2
    x = 0.005 + 0.1 * 0.05 - 0.0025
    expected = [x, 0.0, 1.0 + 0.5 * 0.05**2 / 2.0, 0.0, 0.0, 0.025]
    np.testing.assert_allclose(estimator.estimate(2.15)[0, :6], expected, rtol=0.0, atol=1e-9)


def test_bursts_a_tenth_of_a_millisecond_apart_do_not_upset_the_velocity() -> None:
    estimator, random = Estimator(1), np.random.default_rng(2)
    worst = 0.0
    for n in range(400):
        for late in (0.0, 0.00013, 0.00026):
            t = 0.02 * n + late
            estimator.measure(0, t, tuple(turning(t) + 3e-4 * random.normal(size=3)), LEVEL, t)
        if n > 100:
            worst = max(worst, velocity_error(estimator, turning_velocity, 0.02 * n + 0.00026))
    assert worst < 0.08
    assert estimator.rejected[0] == 0


def test_a_short_gap_is_bridged_by_a_single_position() -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 2.0)
    assert estimator.measure(0, 2.25, tuple(turning(2.25)), LEVEL, 2.25)
    assert estimator.usable(2.25, 0.3).all()
    assert velocity_error(estimator, turning_velocity, 2.25) < 0.06


@pytest.mark.parametrize("gap", [0.6, 15.0])
def test_after_a_long_gap_the_velocity_is_learned_anew(gap: float) -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 2.0)
    back = 2.0 + gap
    estimator.measure(0, back, tuple(turning(back)), LEVEL, back)
    assert not estimator.usable(back, 0.3).any(), "one position says nothing about the velocity"
    np.testing.assert_allclose(estimator.estimate(back)[0, :6], [*turning(back), 0.0, 0.0, 0.0])
    watch(estimator, turning, back + 0.01, back + 0.5)
    assert estimator.usable(back + 0.5, 0.3).all()
    assert velocity_error(estimator, turning_velocity, back + 0.5) < 0.1
    assert estimator.rejected[0] == 0


@pytest.mark.parametrize("stamp", [0.98, 0.99, math.nan, -math.inf, math.inf, 1.2])
def test_duplicates_and_stamps_of_the_past_or_future_change_nothing(stamp: float) -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 0.995)
    before = estimator.estimate(1.0)
    assert not estimator.measure(0, stamp, (9.0, 9.0, 9.0), (0.0, 0.0, 1.0, 0.0), 1.0)
    np.testing.assert_array_equal(estimator.estimate(1.0), before)
    assert estimator.rejected.tolist() == [1]
    assert estimator.yaw[0] == 0.0
    assert estimator.newest[0] == pytest.approx(0.99)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 2e4])
@pytest.mark.parametrize("axis", range(3))
def test_positions_that_cannot_be_are_refused(bad: float, axis: int) -> None:
    estimator, position = Estimator(1), [0.0, 0.0, 1.0]
    position[axis] = bad
    assert not estimator.measure(0, 1.0, position, LEVEL, 1.0)
    assert estimator.rejected.tolist() == [1]
    assert not estimator.estimate(1.0).any()


@pytest.mark.parametrize(
    "quaternion",
    [(math.nan,) * 4, (0.0, 0.0, 0.0, math.nan), (0.0,) * 4, (0.0, 0.0, 5.0, 5.0), (math.inf, 0.0, 0.0, 1.0)],
)
def test_an_invalid_orientation_leaves_the_yaw_and_keeps_the_position(quaternion: tuple[float, ...]) -> None:
    estimator = Estimator(1)
    estimator.measure(0, 0.0, (0.0, 0.0, 1.0), (0.0, 0.0, math.sin(0.3), math.cos(0.3)), 0.0)
    assert estimator.measure(0, 0.01, (0.5, 0.0, 1.0), quaternion, 0.01) is False  # a jump of half a metre
    assert estimator.measure(0, 0.02, (0.001, 0.0, 1.0), quaternion, 0.02)
    assert estimator.yaw[0] == pytest.approx(0.6)
    assert estimator.newest[0] == 0.02


@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.0, 1.0), roll=st.floats(-1.0, 1.0), norm=st.floats(0.95, 1.05))
def test_the_yaw_is_the_zyx_euler_angle_of_the_quaternion(yaw: float, pitch: float, roll: float, norm: float) -> None:
    cy, sy, cp, sp, cr, sr = (f(a / 2.0) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    quaternion = (
        norm * (sr * cp * cy - cr * sp * sy),
        norm * (cr * sp * cy + sr * cp * sy),
        norm * (cr * cp * sy - sr * sp * cy),
        norm * (cr * cp * cy + sr * sp * sy),
    )
    estimator = Estimator(1)
    estimator.measure(0, 0.0, (0.0, 0.0, 0.0), quaternion, 0.0)
    assert estimator.yaw[0] == pytest.approx(yaw, abs=1e-12)


def test_a_single_jump_is_rejected_and_a_lasting_one_is_believed() -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 1.0)
    away = tuple(turning(1.0) + (2.0, 0.0, 0.0))
    assert not estimator.measure(0, 1.0, away, LEVEL, 1.0)
    assert velocity_error(estimator, turning_velocity, 1.0) < 0.05
    watch(estimator, turning, 1.01, 1.095)
    assert estimator.rejected[0] == 1
    accepted = [estimator.measure(0, 1.1 + 0.01 * n, away, LEVEL, 1.1 + 0.01 * n) for n in range(5)]
    assert accepted == [False, False, False, False, True]
    np.testing.assert_allclose(estimator.estimate(1.14)[0, :3], away, atol=1e-3)
    assert not estimator.usable(1.14, 0.3).any(), "where it is says nothing about how fast it flies"


def aloft(estimator: Estimator, t: float) -> None:
    """Tell the estimator that drone 0 is steered in the air at t, s."""
    estimator.command(t, np.zeros((1, 3)), np.ones(1, dtype=bool), np.ones(1, dtype=bool))


def texts(estimator: Estimator) -> str:
    return "; ".join(text for _, text in estimator.complaints())


@pytest.mark.parametrize("away", [(3.0, 0.0, 0.0), (0.0, 0.0, -0.8), (1000.0, 0.0, 1000.0)])
def test_in_the_air_poses_that_jump_far_are_not_followed_until_they_are_back_or_the_drone_is_down(
    away: tuple[float, float, float],
) -> None:
    here = np.array([0.0, 0.0, 1.0])
    for back in (0.4, 2.0):
        estimator = Estimator(1)
        watch(estimator, lambda _: here, 0.0, 1.0)
        aloft(estimator, 1.0)
        steps = np.arange(1.0, 1.0 + back, 0.01)
        assert not any(estimator.measure(0, t, tuple(here + away), LEVEL, t) for t in steps)
        assert "in flight, more than any motion: not flown to" in texts(estimator)
        assert estimator.measure(0, 1.0 + back, tuple(here), LEVEL, 1.0 + back) is (back < 1.0)
        estimator.command(4.0, np.zeros((1, 3)), np.zeros(1, dtype=bool), np.zeros(1, dtype=bool))
        assert estimator.measure(0, 4.0, tuple(here + away), LEVEL, 4.0), "on the ground it is where they say"


def test_in_the_air_a_small_shift_of_all_poses_is_followed_and_told() -> None:
    estimator = Estimator(1)
    watch(estimator, lambda _: np.array([0.0, 0.0, 1.0]), 0.0, 1.0)
    aloft(estimator, 1.0)
    shifted = [estimator.measure(0, 1.0 + 0.01 * n, (0.3, 0.0, 1.0), LEVEL, 1.0 + 0.01 * n) for n in range(5)]
    assert shifted == [False, False, False, False, True]
    assert "stay there: they are followed" in texts(estimator)


def test_a_moving_drone_is_never_twice_in_the_same_place() -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 1.0)
    aloft(estimator, 1.0)
    stays = tuple(turning(0.99))
    assert not any(estimator.measure(0, t, stays, LEVEL, t) for t in np.arange(1.0, 1.3, 0.01))
    assert velocity_error(estimator, turning_velocity, 1.0) < 0.1, "repeated poses do not bring it to rest"
    # nor once it is held level for that
    estimator.command(1.1, np.zeros((1, 3)), np.zeros(1, dtype=bool), np.ones(1, dtype=bool))
    assert not any(estimator.measure(0, t, stays, LEVEL, t) for t in np.arange(1.1, 1.45, 0.01))
    assert not estimator.usable(1.45, 0.3).any()
    assert estimator.measure(0, 1.45, tuple(turning(1.45)), LEVEL, 1.45), "another one may be its own"
    # on the ground they are true
    estimator.command(1.5, np.zeros((1, 3)), np.zeros(1, dtype=bool), np.zeros(1, dtype=bool))
    assert estimator.measure(0, 1.5, tuple(turning(1.45)), LEVEL, 1.5)


@pytest.mark.parametrize(("behind", "shown"), [(1.7e9, "1.7e+09"), (5.0, "5.00"), (0.6, "0.60")])
@pytest.mark.parametrize("after", [0.0, 1.0])
def test_stamps_of_another_clock_are_told_with_how_far_they_are_behind(behind: float, shown: str, after: float) -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, after)
    for t in np.arange(after, after + 0.1, 0.01):
        estimator.measure(0, t - behind, tuple(turning(t)), LEVEL, t)
    told = estimator.complaints()
    assert [text for _, text in told] == [f"pose stamps {shown} s behind the clock: set the clocks alike"]
    assert not estimator.usable(after + 0.1, 0.05).any()


@pytest.mark.parametrize(("age", "told"), [(0.1, False), (0.2, True), (0.3, True)])
def test_poses_that_always_come_late_are_told_with_their_age(age: float, told: bool) -> None:
    estimator = Estimator(1)
    for t in np.arange(0.0, 2.0, 0.01):
        estimator.measure(0, t, tuple(turning(t)), LEVEL, t + age)
    assert texts(estimator) == (
        f"poses {age:.2f} s old when they arrive: they come late, or clocks differ" if told else ""
    )


def test_now_and_then_a_late_pose_is_not_told() -> None:
    estimator = Estimator(1)
    for n in range(200):
        estimator.measure(0, 0.01 * n, tuple(turning(0.01 * n)), LEVEL, 0.01 * n + (0.25 if n % 20 == 0 else 0.0))
    assert texts(estimator) == ""


def test_an_invalid_orientation_is_told_once_and_its_age_is_known() -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 0.0, 1.0)
    for t in np.arange(1.0, 2.0, 0.01):
        estimator.measure(0, t, tuple(turning(t)), (math.nan,) * 4, t)
    assert texts(estimator) == "poses without a valid orientation: its yaw is not seen"
    assert estimator.oriented[0] == pytest.approx(0.99)
    assert estimator.newest[0] == pytest.approx(1.99)


def about_z(yaw: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))


@given(turn=st.floats(1.01, math.pi), side=st.sampled_from([-1.0, 1.0]), gap=st.floats(0.004, 0.6))
@settings(max_examples=20)
def test_in_the_air_an_orientation_that_turns_at_once_leaves_the_yaw_until_it_is_back(
    turn: float, side: float, gap: float
) -> None:
    for aloft in (True, False):
        estimator = Estimator(1)
        estimator.command(0.0, np.zeros((1, 3)), aloft=np.array([aloft]))
        yaws, seen = [0.3, 0.3 + side * turn, 0.3 + side * turn, 0.35], []
        for n, yaw in enumerate(yaws):
            assert estimator.measure(0, gap * n, (0.0, 0.0, 1.0 + 0.001 * n), about_z(yaw), gap * n), "a position"
            seen.append(float(estimator.yaw[0]))
        kept = math.remainder(yaws[1], 2.0 * math.pi)
        assert seen == pytest.approx([0.3, 0.3, 0.3, 0.35] if aloft else [0.3, kept, kept, 0.35])
        told = texts(estimator)
        assert told == (
            f"poses that turn by {math.degrees(side * turn):.0f} deg at once in flight: its yaw is kept as it was"
            if aloft
            else ""
        )


@given(rate=st.floats(-2.0, 2.0), period=st.floats(0.004, 0.3))
@settings(max_examples=20)
def test_in_the_air_a_drone_may_turn(rate: float, period: float) -> None:
    estimator = Estimator(1)
    estimator.command(0.0, np.zeros((1, 3)), aloft=np.array([True]))
    for n in range(20):
        estimator.measure(0, period * n, (0.0, 0.0, 1.0 + 0.001 * n), about_z(rate * period * n), period * n)
        assert math.cos(float(estimator.yaw[0]) - rate * period * n) == pytest.approx(1.0)


def test_a_restart_forgets_everything_but_the_counters() -> None:
    estimator = Estimator(1)
    watch(estimator, turning, 100.0, 101.0)
    estimator.command(101.0, np.ones((1, 3)))
    estimator.restart()
    assert not estimator.usable(101.0, 0.3).any()
    # the clock was set back: earlier stamps are new
    assert estimator.measure(0, 5.0, (1.0, 1.0, 1.0), LEVEL, 5.0)
    assert estimator.estimate(5.0)[0, :6].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]


streams = st.lists(
    st.tuples(
        st.integers(0, 2),
        st.floats(-0.1, 1.0),
        st.tuples(*[st.one_of(st.floats(-2.0, 2.0), st.floats())] * 3),
        st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    ),
    max_size=30,
)


@given(streams)
def test_no_stream_of_poses_makes_an_estimate_that_is_not_finite(
    stream: list[tuple[int, float, tuple[float, ...], tuple[float, ...]]],
) -> None:
    estimator, now = Estimator(3), 0.0
    for index, dt, position, push in stream:
        now = now + max(dt, 0.0)
        estimator.measure(index, now + min(dt, 0.0), position, (*position, 1.0), now)
        estimator.command(now, np.tile(push, (3, 1)))
        assert np.isfinite(estimator.estimate(now + 0.05)).all()
        assert np.isfinite(estimator.yaw).all()
        assert not estimator.usable(now, 0.3)[now - estimator.newest > 0.3].any()


@given(streams)
def test_all_drones_together_are_estimated_like_each_alone(
    stream: list[tuple[int, float, tuple[float, ...], tuple[float, ...]]],
) -> None:
    together, alone, now = Estimator(3), [Estimator(1) for _ in range(3)], 0.0
    for index, dt, position, push in stream:
        now += abs(dt)
        if abs(position[0]) > 400.0:
            continue
        position = (position[0] + 1000.0 * index, *position[1:])  # no drone where another one could be
        assert together.measure(index, now, position, LEVEL, now) == alone[index].measure(0, now, position, LEVEL, now)
        pushes = np.outer([1.0, -1.0, 0.5], push)
        together.command(now, pushes)
        for i in range(3):
            alone[i].command(now, pushes[i : i + 1])
    expected = [single.estimate(now + 0.07)[0, :6] for single in alone]
    np.testing.assert_allclose(together.estimate(now + 0.07)[:, :6], expected, rtol=1e-12, atol=1e-12)
