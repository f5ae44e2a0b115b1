"""References: they meet their points, their derivatives belong together, and their margin is a true bound."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.interpolate import BSpline, make_interp_spline

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.references import References
from flatsat_ros.flight.trajectory import Trajectory, evaluate
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))

vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
points = st.lists(st.tuples(st.floats(0.2, 3.0), vectors, vectors, vectors), min_size=1, max_size=5)

Points = list[tuple[float, tuple[float, ...], tuple[float, ...], tuple[float, ...]]]


def through(rows: Points, start: float = 0.0) -> Trajectory:
    """A trajectory through points given with their spans; the last one is at rest."""
    spans, p, v, a = (np.array(column) for column in zip(*rows, strict=True))
    v[-1], a[-1] = 0.0, 0.0
    return Trajectory.through(start + np.cumsum(spans), p, v, a)


def spline(times: np.ndarray) -> BSpline:
    """A closed smooth path through way-points that begins and ends at rest."""
    corners = np.array([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0], [0.0, -0.6, 1.0]])
    rest = [(1, np.zeros(3)), (2, np.zeros(3))]
    return make_interp_spline(times, corners, k=5, bc_type=(rest, rest))


@given(rows=points, start=st.floats(-100.0, 100.0))
def test_the_path_meets_every_point_with_its_velocity_and_acceleration(rows: Points, start: float) -> None:
    trajectory = through(rows, start)
    for i, (_, p, v, a) in enumerate(rows):
        last = i == len(rows) - 1
        expected = np.concatenate([p, np.zeros(6)]) if last else np.concatenate([p, v, a])
        np.testing.assert_allclose(trajectory.sample(float(trajectory.times[i])), expected, rtol=0.0, atol=1e-9)
        if 0 < i < len(rows):
            before = trajectory.sample(float(np.nextafter(trajectory.times[i], -np.inf)))
            np.testing.assert_allclose(before, expected, rtol=0.0, atol=1e-6)


@given(rows=points, share=st.floats(0.001, 0.999))
def test_velocity_and_acceleration_are_the_derivatives_of_the_position(rows: Points, share: float) -> None:
    assume(len(rows) > 1)
    trajectory, step = through(rows), 1e-4
    t = float(trajectory.times[0] + share * (trajectory.times[-1] - trajectory.times[0]))
    assume(np.abs(trajectory.times - t).min() > 2.0 * step)
    before, here, after = (trajectory.sample(t + offset) for offset in (-step, 0.0, step))
    # what a central difference leaves out: step^2 / 6 times two derivatives more, largest at the end of a segment
    spans = np.diff(trajectory.times)[:, np.newaxis, np.newaxis]
    sizes = (
        np.abs(trajectory.coefficients[:, :6])
        * spans ** np.arange(6.0).reshape(1, 6, 1)
        * [[1], [1], [2], [6], [24], [120]]
    )
    slack = step**2 / 6.0 * float((sizes / spans**4).sum(axis=1).max() + (sizes / spans**3).sum(axis=1).max())
    np.testing.assert_allclose((after[:6] - before[:6]) / (2.0 * step), here[3:], rtol=0.0, atol=1e-6 + slack)


@pytest.mark.parametrize("leg", [1.0, 4.0])
def test_a_quintic_spline_sampled_at_its_knots_comes_back_exactly(leg: float) -> None:
    path = spline(leg * np.arange(4.0))
    knots = np.unique(path.t)
    trajectory = Trajectory.through(knots, *(path(knots, order) for order in range(3)))
    for t in np.linspace(knots[0], knots[-1], 301)[:-1]:
        expected = np.concatenate([path(t), path(t, 1), path(t, 2)])
        np.testing.assert_allclose(trajectory.sample(float(t)), expected, rtol=0.0, atol=1e-9 / leg**2)


@given(rows=points, start=st.floats(-10.0, 10.0))
def test_before_the_start_and_after_the_end_the_drone_rests(rows: Points, start: float) -> None:
    trajectory = through(rows, start)
    before, after = trajectory.sample(float(trajectory.times[0]) - 5.0), trajectory.sample(1e9)
    np.testing.assert_allclose(before, np.concatenate([rows[0][1], np.zeros(6)]))
    np.testing.assert_allclose(after, np.concatenate([rows[-1][1], np.zeros(6)]), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(trajectory.end, rows[-1][1], rtol=0.0, atol=1e-9)


@given(rows=points, offset=st.floats(-50.0, 50.0), t=st.floats(-1.0, 20.0))
def test_a_shifted_path_is_the_same_path_later(rows: Points, offset: float, t: float) -> None:
    trajectory = through(rows)
    # nearly on a point, the rounding of t + offset may choose the other segment
    assume(np.abs(trajectory.times - t).min() > 1e-6)
    np.testing.assert_allclose(trajectory.shifted(offset).sample(t + offset), trajectory.sample(t), atol=1e-9)


@given(rows=points)
def test_the_margin_is_below_the_margin_anywhere_on_the_path_and_not_far_below(rows: Points) -> None:
    trajectory = through(rows)
    margin, when, _ = trajectory.margin(LIMITS)
    within = np.linspace(0.0, 1.0, 65)
    flown = [
        float(LIMITS.margin(evaluate(np.tile(segment, (65, 1, 1)), within * span)[:, 6:]).min())
        for segment, span in zip(trajectory.coefficients, np.diff(trajectory.times), strict=False)
    ]
    smallest = min([LIMITS.inner_radius, *flown])  # at rest before and after
    swing = float(LIMITS.margin(np.zeros(3))) - smallest
    assert smallest - 0.25 * swing - 1e-9 <= margin <= smallest + 1e-9
    assert trajectory.times[0] <= when <= trajectory.times[-1]


def test_a_path_without_margin_is_refused_with_its_time() -> None:
    path = spline(np.arange(4.0))
    fast = Trajectory.through(np.unique(path.t), *(path(np.unique(path.t), order) for order in range(3)))
    with pytest.raises(FlatsatError, match=r"at t = .*must be above 0: fly it slower"):
        fast.require_margin(LIMITS)
    path = spline(4.0 * np.arange(4.0))
    slow = Trajectory.through(np.unique(path.t), *(path(np.unique(path.t), order) for order in range(3)))
    slow.require_margin(LIMITS)


def test_a_set_point_has_the_whole_inner_ball_as_margin() -> None:
    assert Trajectory.hold([1.0, 2.0, 3.0]).margin(LIMITS)[0] == pytest.approx(LIMITS.inner_radius)
    np.testing.assert_array_equal(Trajectory.hold([1.0, 2.0, 3.0], 0.5).sample(1.7e9), [1, 2, 3, 0, 0, 0, 0, 0, 0])


ZERO = np.zeros((2, 3))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([0.0, 0.0], ZERO, ZERO, ZERO), r"times\[1\] = 0.0 s: must be above the time before it, 0.0 s"),
        (([1.0, 0.5], ZERO, ZERO, ZERO), "must be above the time before it"),
        (([0.0], ZERO, ZERO, ZERO), r"must be \(M,\) and three times \(M, 3\)"),
        (([], np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))), "M >= 1"),
        (([0.0, 1.0], ZERO, ZERO[:1], ZERO), "three times"),
        (([0.0, 1.0], np.zeros((2, 2)), ZERO, ZERO), "shape of positions = "),
        (([0.0, math.nan], ZERO, ZERO, ZERO), "an entry of times = nan"),
        (([0.0, 1.0], ZERO, ZERO + math.inf, ZERO), "an entry of velocities = inf"),
        (([0.0, 1.0], ZERO, ZERO + 0.1, ZERO), "velocity of the last point = .* m/s: must be .*, at rest"),
        (([0.0, 1.0], ZERO, ZERO, ZERO + 0.1), "acceleration of the last point = .* m/s.2: must be .*, at rest"),
        (([0.0, 1.0], ZERO, ZERO, ZERO, math.nan), "yaw = nan"),
    ],
)
def test_points_that_make_no_trajectory_are_refused(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(FlatsatError, match=text):
        Trajectory.through(*arguments)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_spans_too_short_for_floats_are_refused_before_flight() -> None:
    absurd = Trajectory.through([0.0, 1e-80], [[0.0] * 3, [1.0] * 3], ZERO, ZERO)
    with pytest.raises(FlatsatError, match="an entry of v = nan"):
        absurd.require_margin(LIMITS)


@given(
    plans=st.lists(st.tuples(points, st.floats(-5.0, 5.0)), min_size=1, max_size=4),
    times=st.lists(st.floats(-10.0, 20.0), min_size=1, max_size=12),
)
def test_all_drones_together_are_sampled_like_each_alone_in_any_order_of_times(
    plans: list[tuple[Points, float]], times: list[float]
) -> None:
    trajectories = [through(rows, start) for rows, start in plans]
    references = References(len(plans), 1.0)
    for i, trajectory in enumerate(trajectories):
        references.assign(i, trajectory, 1.0)
    for t in times:
        expected = [trajectory.sample(t) for trajectory in trajectories]
        np.testing.assert_allclose(references.sample(t), expected, rtol=1e-12, atol=1e-12)


def test_a_new_reference_is_in_force_at_once_and_without_one_all_is_zero() -> None:
    references = References(2, 1.0)
    assert not references.sample(5.0).any()
    references.assign(1, Trajectory.hold([1.0, 2.0, 3.0], 0.7), 1.0)
    np.testing.assert_array_equal(references.sample(5.0), [[0] * 9, [1, 2, 3, 0, 0, 0, 0, 0, 0]])
    references.assign(1, Trajectory.hold([4.0, 2.0, 3.0]), 1.0)
    assert references.sample(5.0)[1, 0] == 4.0
    assert references.yaw.tolist() == [0.0, 0.0]


def test_a_reference_is_at_rest_for_good_as_a_set_point_and_after_the_end_only() -> None:
    references = References(2, 1.0)
    rest = np.zeros((2, 3))
    path = Trajectory.through([1.0, 2.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], rest, rest)
    references.assign(0, path, 0.3)
    references.assign(1, Trajectory.hold([0.0, 0.0, 1.0]), 1.0)
    for t, expected in [(-1.0, False), (0.5, False), (1.5, False), (2.0, True), (9.0, True), (0.5, False)]:
        sample = references.sample(t)
        assert references.at_rest.tolist() == [expected, True]
        assert references.margin.tolist() == [1.0 if expected else 0.3, 1.0], "what lies behind needs no margin"
        np.testing.assert_allclose(sample[0], path.sample(t), atol=1e-12)
