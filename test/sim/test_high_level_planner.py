"""Laws and rules of the on-board planner and position controller, without a drone.

Sources are files and functions of crazyflie-firmware, release 2026.08.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyder, polyval
from numpy.testing import assert_allclose

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.sim.high_level import HIGH_LEVEL_PERIOD, HighLevelCommander, polynomial
from flatsat_ros.sim.position_controller import PositionController


def planners(now: int = 0, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> HighLevelCommander:
    """Return one unblocked planner, its drone standing still at a place."""
    planner = HighLevelCommander(1)
    look(planner, now, position)
    return planner


def look(planner: HighLevelCommander, now: int, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Let the planner see where its drone is, and return its goal."""
    planner.update(now, np.zeros(1, dtype=bool), np.array([position]), np.zeros((1, 3)), np.zeros(1))
    return planner.goal[:, 0]


numbers = st.floats(-10.0, 10.0)


@given(numbers, numbers, numbers, numbers, st.floats(0.05, 20.0))
def test_the_polynomial_begins_with_the_motion_given_and_ends_at_rest(
    start: float, rate: float, acceleration: float, end: float, duration: float
) -> None:
    """pptraj.c poly7_nojerk: value and two derivatives at both ends, and no jerk at either."""
    coefficients = polynomial(*(np.array([x]) for x in (start, rate, acceleration, end)), duration)
    assert coefficients.shape == (8, 1)
    for order, (first, last) in enumerate([(start, end), (rate, 0.0), (acceleration, 0.0), (0.0, 0.0)]):
        values = polyval(np.array([0.0, 1.0]), polyder(coefficients[:, 0], order)) / duration**order
        size = (20.0 + duration * 10.0 + duration**2 * 10.0) * 1e-10 / duration**order
        assert_allclose(values, (first, last), rtol=1e-12, atol=size)


@settings(max_examples=30)
@given(st.lists(st.tuples(numbers, numbers, numbers, numbers, st.floats(0.5, 5.0)), min_size=2, max_size=5), st.data())
def test_a_new_goal_under_way_begins_where_the_old_trajectory_is(
    legs: list[tuple[float, float, float, float, float]], data: st.DataObject
) -> None:
    """planner.c plan_go_to: the start is the present point of the trajectory with its velocity and acceleration."""
    planner, now = planners(), 0
    for *place, yaw, duration in legs:
        before = planner.goal[:, 0].copy()
        assert planner.go_to(0, place, yaw, duration, False, now)
        assert_allclose(look(planner, now)[:3], before[:3], atol=1e-9)
        assert math.remainder(planner.goal[3, 0] - before[3], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
        now += 10 * data.draw(st.integers(1, 600))
        look(planner, now)


def test_relative_is_to_the_goal_in_flight_and_to_the_state_when_stopped() -> None:
    """crtp_commander_high_level.c go_to2: plan_go_to with a trajectory, plan_go_to_from the told state without."""
    planner = planners(position=(0.0, 0.0, 1.0))
    planner.go_to(0, (1.0, 0.0, 0.0), 0.0, 1.0, True, 0)
    assert_allclose(look(planner, 1000, (0.7, 0.1, 0.9)), (1.0, 0.0, 1.0, 0.0), atol=1e-12)
    planner.go_to(0, (1.0, 0.0, 0.0), 0.0, 1.0, True, 1000)
    assert_allclose(look(planner, 2000, (1.5, 0.1, 0.9)), (2.0, 0.0, 1.0, 0.0), atol=1e-12)
    planner.stop(0)
    planner.go_to(0, (1.0, 0.0, 0.0), 0.0, 1.0, True, 2000)
    assert_allclose(look(planner, 3000), (2.5, 0.1, 0.9, 0.0), atol=1e-12)


def test_a_second_take_off_or_landing_is_refused() -> None:
    """planner.c plan_takeoff only from TRAJECTORY_STATE_IDLE, plan_land not from TRAJECTORY_STATE_LANDING."""
    planner = planners()
    assert planner.take_off(0, 1.0, 2.0, None, 0)
    assert not planner.take_off(0, 2.0, 2.0, None, 100)
    assert planner.land(0, 0.0, 2.0, None, 3000)
    assert not planner.land(0, 0.0, 2.0, None, 3100)
    assert not planner.take_off(0, 1.0, 2.0, None, 3100)
    look(planner, 5000)
    assert planner.take_off(0, 1.0, 2.0, None, 5000)


def test_take_off_and_landing_are_planned_from_the_last_goal_or_if_stopped_from_the_state() -> None:
    """crtp_commander_high_level.c pos, yaw: the last set-point, or the last state told."""
    planner = planners()
    planner.go_to(0, (1.0, 2.0, 1.0), 0.0, 1.0, False, 0)
    look(planner, 1000, (0.9, 2.1, 1.1))
    planner.land(0, 0.0, 1.0, None, 1000)
    assert_allclose(look(planner, 1500, (0.9, 2.1, 1.1))[:2], (1.0, 2.0), atol=1e-12)
    planner.stop(0)
    look(planner, 1600, (0.8, 2.2, 0.0))
    planner.take_off(0, 1.0, 1.0, None, 1600)
    planner.land(0, 0.0, 1.0, None, 1605)  # before the commander's next turn
    assert_allclose(look(planner, 1610), (0.8, 2.2, 0.0, 0.0), atol=1e-12)


def test_a_stopped_planner_goes_on_with_the_velocity_it_was_told() -> None:
    """crtp_commander_high_level.c go_to2, plan_go_to_from."""
    planner, unblocked = planners(), np.zeros(1, dtype=bool)
    planner.update(0, unblocked, np.zeros((1, 3)), np.array([[1.0, -2.0, 0.5]]), np.zeros(1))
    planner.go_to(0, (0.0, 0.0, 0.0), 0.0, 2.0, True, 0)
    assert_allclose(look(planner, 10), (0.01, -0.02, 0.005, 0.0), rtol=1e-3)


def test_a_turn_under_way_goes_on_slower_by_the_tilt() -> None:
    """pptraj.c poly4d_eval: omega.z is the yaw rate times the upward part of the thrust's direction."""
    planner = planners()
    planner.go_to(0, (20.0, 0.0, 0.0), 1.0, 2.0, False, 0)
    before, now, after = (look(planner, t).copy() for t in (499, 500, 501))
    acceleration = (before[0] - 2.0 * now[0] + after[0]) / 0.001**2
    planner.go_to(0, (20.0, 0.0, 0.0), 1.0, 50.0, False, 500)
    slower = (look(planner, 501)[3] - now[3]) / (after[3] - before[3]) * 2.0
    assert acceleration > 5.0
    assert slower == pytest.approx(GRAVITY / math.hypot(acceleration, GRAVITY), rel=0.01)


def test_a_blocked_planner_refuses_everything() -> None:
    """crtp_commander_high_level.c isBlocked: EBUSY."""
    planner = HighLevelCommander(1)
    assert not planner.take_off(0, 1.0, 2.0, None, 0)
    assert not planner.land(0, 1.0, 2.0, None, 0)
    assert not planner.go_to(0, (0.0, 0.0, 1.0), 0.0, 2.0, False, 0)


def test_a_duration_of_zero_is_a_jump() -> None:
    """pptraj.c poly7_nojerk, T <= 0."""
    planner = planners()
    planner.go_to(0, (1.0, 2.0, 3.0), 0.5, 0.0, False, 0)
    assert_allclose(look(planner, HIGH_LEVEL_PERIOD), (1.0, 2.0, 3.0, 0.5), atol=1e-12)


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 36000.0)),
        ((0.1, 0.0, 0.0), (0.0, 25.0 * 0.2 + 1.0 * 0.002, 36000.0)),  # 2 1/s, 25 deg per m/s, 1 deg/m
        ((0.0, 0.1, 0.0), (-25.0 * 0.2 - 1.0 * 0.002, 0.0, 36000.0)),
        ((0.0, 0.0, 0.1), (0.0, 0.0, 36000.0 + 25.0 * 200.5 + 15.0 * 2.005)),  # and 0.5 1/s^2 over 10 ms
        ((-9.0, 9.0, 9.0), (-20.0, -20.0, 36000.0 + 27500.0 + 165.0)),  # 20 deg, 1.1 m/s
        ((0.0, 0.0, -9.0), (0.0, 0.0, 20000.0)),
    ],
)
def test_the_position_controller_is_that_of_the_firmware(
    error: tuple[float, float, float], expected: tuple[float, float, float]
) -> None:
    """position_controller_pid.c, platform_defaults_cf2.h: its first answer to a position error, deg and PWM.

    Fresh is as good as new: pid.c pidReset.
    """
    for yaw in (0.0, math.pi / 2):  # along the heading
        cos, sin = math.cos(yaw), math.sin(yaw)
        goal = np.array([[cos * error[0] - sin * error[1]], [sin * error[0] + cos * error[1]], [error[2]]])
        still, fresh = np.zeros((3, 1)), np.ones(1, dtype=bool)
        controller = PositionController(1, 36000.0)
        controller.control(still + 1.0, still, still, np.zeros(1), fresh)
        answer = controller.control(goal, still, still, np.array([yaw]), fresh)
        roll, pitch, thrust = (value[0] for value in answer)
        assert_allclose((np.rad2deg(roll), np.rad2deg(pitch), thrust), expected, rtol=1e-12, atol=1e-9)
