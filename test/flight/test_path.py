"""Paths to rest: they begin in the motion that is, keep the limits that they are given, and end at the goal."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.flight.path import path_to
from flatsat_ros.flight.path_limits import PathLimits, ReferenceBox
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
BOUNDS = PathLimits.within(LIMITS, 1.0)
GENTLE = replace(BOUNDS, jerk=0.87, acceleration=0.87)  # as a certificate assumes
BOX = ReferenceBox(np.array([-150.0, -150.0, 0.0]), np.array([150.0, 150.0, 10.0]))
AT_REST = np.zeros((4, 3))

places = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(0.0, 5.0)).map(np.array)
far = st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(0.0, 10.0)).map(np.array)
shares = st.floats(0.0, 1.0)


def resting(place: np.ndarray) -> np.ndarray:
    motion = AT_REST.copy()
    motion[0] = place
    return motion


@given(start=places, goal=far)
def test_from_rest_a_path_leads_straight_to_the_goal_within_every_limit(start: np.ndarray, goal: np.ndarray) -> None:
    path = path_to(resting(start), goal, 3.0, BOUNDS, BOX)
    np.testing.assert_allclose(path.end, goal, atol=1e-9)
    samples = np.array([path.sample(t) for t in np.linspace(3.0, path.times[-1], 200)])
    np.testing.assert_allclose(samples[0], [*start, 0, 0, 0, 0, 0, 0], atol=1e-12)
    assert np.linalg.norm(samples[:, 3:5], axis=1).max() <= BOUNDS.speed + 1e-9
    assert np.abs(samples[:, 5]).max() <= BOUNDS.speed + 1e-9
    assert np.linalg.norm(samples[:, 6:8], axis=1).max() <= BOUNDS.horizontal.most + 1e-9
    assert np.abs(samples[:, 8]).max() <= BOUNDS.vertical.most + 1e-9
    assert max(np.abs(path.jerk(float(t))).max() for t in np.linspace(3.0, path.times[-1], 200)) <= BOUNDS.jerk + 1e-9
    # at least half of the input set is left to the law; the margin that is computed is a lower bound of what is
    margin = float(LIMITS.margin(samples[:, 6:]).min())
    assert margin >= 0.5 * LIMITS.inner_radius - 1e-9
    assert 0.0 < path.require_margin(LIMITS) <= margin + 1e-9
    # both parts stay between where they begin and where they end
    low, high = np.minimum(start, goal) - 1e-9, np.maximum(start, goal) + 1e-9
    assert ((samples[:, :3] >= low) & (samples[:, :3] <= high)).all()


@given(first=places, second=places, when=shares)
@settings(max_examples=60)
def test_a_path_that_replaces_another_begins_in_its_motion_with_the_same_jerk(
    first: np.ndarray, second: np.ndarray, when: float
) -> None:
    before = path_to(resting(np.array([0.0, 0.0, 1.0])), first, 0.0, BOUNDS, BOX)
    t = when * float(before.times[-1])
    motion = np.concatenate([before.sample(t).reshape(3, 3), before.jerk(t)[np.newaxis]])
    after = path_to(motion, second, t, BOUNDS, BOX)
    np.testing.assert_allclose(after.sample(t), before.sample(t), atol=1e-9)
    np.testing.assert_allclose(after.end, second, atol=1e-6)
    if after.times.size > 1:
        np.testing.assert_allclose(after.jerk(t), before.jerk(t), atol=1e-6)
    assert after.require_margin(LIMITS) > 0.0
    # continuous jerk at every joint
    for joint in after.times[1:-1]:
        left, right = (after.jerk(float(joint) + side) for side in (-1e-9, 1e-9))
        np.testing.assert_allclose(left, right, atol=1e-5)


@given(goal=places, when=shares)
@settings(max_examples=60)
def test_braking_comes_to_rest_without_turning_back(goal: np.ndarray, when: float) -> None:
    before = path_to(resting(np.array([0.0, 0.0, 2.0])), goal, 0.0, BOUNDS, BOX)
    t = when * float(before.times[-1])
    motion = np.concatenate([before.sample(t).reshape(3, 3), before.jerk(t)[np.newaxis]])
    assume(np.linalg.norm(motion[1]) > 0.05)
    path = path_to(motion, np.full(3, np.nan), t, BOUNDS, BOX)
    speeds = [float(np.linalg.norm(path.sample(s)[3:6])) for s in np.linspace(t, path.times[-1], 100)]
    assert speeds[-1] < 1e-9
    assert max(speeds) <= 1.25 * max(float(np.linalg.norm(motion[1])), 0.2) + 0.3
    assert np.linalg.norm(path.end - motion[0]) < 4.0


def test_a_waiting_path_climbs_only() -> None:
    path = path_to(resting(np.array([1.0, 1.0, 0.0])), np.array([3.0, 3.0, 1.0]), 0.0, BOUNDS, BOX, wait=True)
    np.testing.assert_allclose(path.end, [1.0, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("thrust", [1.05, 1.2, 1.45, 2.0])
@pytest.mark.parametrize("tilt", [5.0, 10.0, 30.0])
def test_the_limits_leave_half_of_the_inner_radius_in_every_direction(thrust: float, tilt: float) -> None:
    limits = InputSet(thrust * GRAVITY, math.radians(tilt))
    bounds = PathLimits.within(limits, 1.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 32)
    for upward in (-bounds.vertical.most, 0.0, bounds.vertical.most):
        across = bounds.horizontal.most * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        v = np.column_stack([across, np.full(32, upward)])
        assert limits.margin(v).min() >= 0.5 * limits.inner_radius - 1e-9


@example(height=0.03125, sinking=0.1875, pushed=0.5, goal=1.0)  # 8 s of braking, 2.6 m up
@given(height=st.floats(0.02, 1.0), sinking=st.floats(0.0, 0.5), pushed=st.floats(-0.8, 0.8), goal=st.floats(0.5, 1.5))
def test_too_near_to_the_floor_to_brake_in_time_makes_no_detour(
    height: float, sinking: float, pushed: float, goal: float
) -> None:
    motion = resting(np.array([0.0, 0.0, height]))
    motion[1, 2], motion[2, 2] = -sinking, pushed
    path = path_to(motion, np.array([0.0, 0.5, goal]), 0.0, BOUNDS, BOX)
    heights = [path.sample(t)[2] for t in np.linspace(0.0, path.times[-1], 300)]
    assert max(heights) <= max(goal, height) + 0.4


@given(goal=places, velocity=st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3))
@settings(max_examples=60)
def test_no_path_takes_longer_than_braking_and_setting_out_from_rest(goal: np.ndarray, velocity: list[float]) -> None:
    motion = resting(np.array([0.0, 0.0, 2.0]))
    motion[1] = velocity
    braking = path_to(motion, np.full(3, np.nan), 0.0, BOUNDS, BOX)
    onward = path_to(resting(braking.end), goal, 0.0, BOUNDS, BOX)
    path = path_to(motion, goal, 0.0, BOUNDS, BOX)
    assert path.times[-1] <= braking.times[-1] + onward.times[-1] + 1e-9


@given(goal=places, velocity=st.lists(st.floats(-0.5, 0.5), min_size=2, max_size=2))
@settings(max_examples=60)
def test_no_turn_is_much_wider_than_braking(goal: np.ndarray, velocity: list[float]) -> None:
    motion = resting(np.array([0.0, 0.0, 2.0]))
    motion[1, :2] = velocity
    widths = []
    for end in (np.full(3, np.nan), goal):
        path = path_to(motion, end, 0.0, GENTLE, BOX)
        way = np.array([path.sample(t)[:2] for t in np.linspace(0.0, path.times[-1], 300)])
        share = np.clip(way @ goal[:2] / max(float(goal[:2] @ goal[:2]), 1e-9), 0.0, 1.0)
        widths.append(np.linalg.norm(way - share[:, np.newaxis] * goal[:2], axis=1).max())
    assert widths[1] <= widths[0] + 0.1 + 0.01


def test_who_sinks_turns_round_after_the_way_that_braking_takes() -> None:
    motion = resting(np.array([0.0, 0.0, 0.8]))
    motion[1, 2] = -0.48
    lowest = [
        min(path.sample(t)[2] for t in np.linspace(0.0, path.times[-1], 300))
        for goal in (math.nan, 1.0)
        for path in [path_to(motion, np.array([0.0, 0.0, goal]), 0.0, BOUNDS, BOX)]
    ]
    assert lowest[1] == pytest.approx(lowest[0], abs=1e-3)
