"""The input set, checked against 60-digit decimal arithmetic that shares nothing with the code under test."""

from __future__ import annotations

import decimal
import itertools
import math
from collections.abc import Callable
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.law.input_set import InputSet

PAPER = InputSet(1.45 * GRAVITY, math.radians(10.0))
DIGITS = decimal.Context(prec=60, Emin=-100000, Emax=100000)

Vector = tuple[float, float, float]

sets = st.builds(
    lambda thrust, tilt, least: InputSet(thrust * GRAVITY, tilt, GRAVITY, least * GRAVITY),
    st.floats(1.01, 3.0),
    st.floats(0.02, 1.5),
    st.sampled_from([0.0, 0.0, 0.3]),
)
directions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 3)
    .filter(lambda v: math.hypot(*v) > 1e-3)
    .map(lambda v: tuple(entry / max(map(abs, v)) for entry in v))
)
magnitudes = st.floats(-2.0, 3.0).map(lambda exponent: 10.0**exponent)


def decimal_tangent(angle: float) -> Decimal:
    """Return tan of a float, to 60 digits, from the exponential series."""
    sine, cosine, term = Decimal(0), Decimal(0), Decimal(1)
    for order in range(80):
        if order % 2:
            sine += term * (1 if order % 4 == 1 else -1)
        else:
            cosine += term * (1 if order % 4 == 0 else -1)
        term = term * Decimal(angle) / (order + 1)
    return sine / cosine


def largest_factor(limits: InputSet, base: Vector, v: Vector) -> Decimal:
    """The largest t with base + t v in the set, by bisection of its definition."""
    with decimal.localcontext(DIGITS):
        g, slope = Decimal(limits.gravity), decimal_tangent(limits.tilt_max)
        thrust_max, thrust_min = Decimal(limits.thrust_max), Decimal(limits.thrust_min)
        p, d = [Decimal(x) for x in base], [Decimal(x) for x in v]
        low, high = Decimal(0), 100 * thrust_max / max(abs(x) for x in d)
        for _ in range(130):
            t = (low + high) / 2
            x, y, up = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2] + g
            sphere = x * x + y * y + up * up <= thrust_max * thrust_max
            cone = up >= thrust_min and x * x + y * y <= slope * slope * up * up
            low, high = (t, high) if sphere and cone else (low, t)
        return low


@given(limits=sets, v=directions, magnitude=magnitudes)
def test_saturation_stays_in_the_set_and_is_maximal(limits: InputSet, v: Vector, magnitude: float) -> None:
    v = tuple(magnitude * entry for entry in v)
    factor = min(Decimal(1), largest_factor(limits, (0.0, 0.0, 0.0), v))
    expected = [float(factor * Decimal(entry)) for entry in v]
    saturated = limits.saturate(v)
    np.testing.assert_allclose(saturated, expected, rtol=1e-12, atol=0.0)
    assert largest_factor(limits, (0.0, 0.0, 0.0), tuple(saturated)) >= 1 - Decimal("1e-12")


@given(limits=sets, v=directions, exponent=st.integers(-300, 300))
def test_the_gauge_is_accurate_from_1e_minus_300_to_1e300(limits: InputSet, v: Vector, exponent: int) -> None:
    v = tuple(entry * 10.0**exponent for entry in v)
    assume(all(entry == 0.0 or abs(entry) > 1e-305 for entry in v))
    exact = 1 / largest_factor(limits, (0.0, 0.0, 0.0), v)
    assert abs(Decimal(float(limits.gauge(v))) / exact - 1) < Decimal("1e-12")
    if exponent > 10:
        assert float(limits.gauge(limits.saturate(v))) == pytest.approx(1.0, rel=1e-12)


def test_tiny_and_huge_vectors_survive() -> None:
    tiny, huge = 5e-324, 1.7e308
    np.testing.assert_array_equal(PAPER.saturate((tiny, 0.0, -tiny)), (tiny, 0.0, -tiny))
    assert PAPER.saturate((huge, huge, huge)) == pytest.approx(PAPER.saturate((1e3, 1e3, 1e3)), rel=1e-12)
    assert float(PAPER.exit_factor((0.0, 0.0, 1.0), (tiny, tiny, 0.0))) == math.inf
    assert PAPER.gauge((0.0, 0.0, 0.0)) == 0.0
    assert PAPER.exit_factor((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)) == math.inf


@given(limits=sets, base=directions, depth=st.floats(0.0, 0.9), v=directions, magnitude=magnitudes)
def test_the_exit_from_a_base_is_where_the_set_ends(
    limits: InputSet, base: Vector, depth: float, v: Vector, magnitude: float
) -> None:
    base = tuple(depth * np.array(base) / float(limits.gauge(base)))
    v = tuple(magnitude * entry for entry in v)
    exact = largest_factor(limits, base, v)
    assert abs(Decimal(float(limits.exit_factor(base, v))) / exact - 1) < Decimal("1e-12")


@given(
    limits=sets,
    base=directions,
    depth=st.floats(0.0, 0.9),
    v=directions,
    exponent=st.sampled_from([0] * 8 + [-300, -9, 9, 300]),
    most=st.floats(0.0, 3.0),
)
def test_the_reach_ends_at_the_exit_or_at_what_is_asked_for(
    limits: InputSet, base: Vector, depth: float, v: Vector, exponent: int, most: float
) -> None:
    start = depth * np.array(base) / float(limits.gauge(base))
    direction = np.array(v) / float(limits.gauge(v)) * 10.0**exponent
    exit_factor = limits.exit_factor(start, direction)
    reach = limits.reach_of_finite(start, direction, np.array(most))
    assert reach == pytest.approx(np.minimum(most, exit_factor), rel=1e-12)


@given(limits=sets, v=directions, exponent=st.integers(-300, 300))
def test_the_exit_from_zero_is_the_reciprocal_of_the_gauge(limits: InputSet, v: Vector, exponent: int) -> None:
    v = tuple(entry * 10.0**exponent for entry in v)
    assert limits.exit_factor((0.0, 0.0, 0.0), v) * limits.gauge(v) == pytest.approx(1.0, rel=1e-12)


@given(limits=sets, edge=directions, inside=directions, depth=st.floats(0.0, 0.9))
def test_from_the_boundary_one_may_go_inward_but_not_outward(
    limits: InputSet, edge: Vector, inside: Vector, depth: float
) -> None:
    base = limits.saturate(np.multiply(1e3, edge))
    assume(base[2] + GRAVITY > 1e-3)  # the apex has a test of its own
    target = depth * np.array(inside) / limits.gauge(inside)
    assert limits.exit_factor(base, target - base) >= 1.0 - 1e-9
    assert limits.exit_factor(base, base - target) <= 1e-6


def test_at_the_apex_only_the_cone_of_directions_is_open() -> None:
    apex, slope = (0.0, 0.0, -GRAVITY), math.tan(PAPER.tilt_max)
    assert PAPER.exit_factor(apex, (0.0, 0.0, 1.0)) == pytest.approx(PAPER.thrust_max, rel=1e-12)
    ruling = (0.999999 * slope, 0.0, 1.0)
    assert PAPER.exit_factor(apex, ruling) == pytest.approx(PAPER.thrust_max / math.hypot(*ruling), rel=1e-12)
    for outward in ((1.000001 * slope, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, -1.0, -1.0)):
        assert PAPER.exit_factor(apex, outward) == 0.0


@pytest.mark.parametrize("base", [(0.0, 0.0, -10.0), (5.0, 0.0, 0.0), (0.0, 0.0, 5.0)])
def test_a_base_outside_the_set_is_refused(base: Vector) -> None:
    with pytest.raises(FlatsatError, match=r"base = .* m/s\^2: must be inside the input set, it is"):
        PAPER.exit_factor(base, (1.0, 0.0, 0.0))


@given(limits=sets, v=directions, depth=st.floats(1e-6, 0.999), other=directions)
def test_the_margin_is_the_distance_to_the_boundary(limits: InputSet, v: Vector, depth: float, other: Vector) -> None:
    point = depth * np.array(v) / limits.gauge(v)
    margin = float(limits.margin(point))
    assert margin > 0.0
    from_center, away = point + (0.0, 0.0, GRAVITY), math.hypot(point[0], point[1])
    outward = point[:2] / away if away > 1e-9 else np.array([1.0, 0.0])
    cone_normal = np.append(math.cos(limits.tilt_max) * outward, -math.sin(limits.tilt_max))
    normals = np.array([from_center / np.linalg.norm(from_center), cone_normal, (0.0, 0.0, -1.0)])
    # the boundary's three parts are met at the end of their own normals, the nearest of them at the margin
    assert limits.exit_factor(point, normals).min() == pytest.approx(margin, rel=1e-8)
    assert limits.exit_factor(point, np.array(other) / np.linalg.norm(other)) >= margin * (1.0 - 1e-9)


def test_the_margin_is_negative_outside() -> None:
    assert (PAPER.margin([(0.0, 0.0, -9.9), (3.0, 0.0, 0.0), (0.0, 0.0, 4.5)]) < 0.0).all()


@given(limits=sets)
def test_the_inner_ball_is_the_largest(limits: InputSet) -> None:
    assert limits.inner_radius == pytest.approx(float(limits.margin((0.0, 0.0, 0.0))), rel=1e-12)


@given(limits=sets)
def test_the_inner_box_fits_and_no_box_of_a_fine_search_is_larger(limits: InputSet) -> None:
    width, other_width, height = limits.inner_box
    assert width == other_width
    corners = np.array(list(itertools.product((-1, 1), repeat=3))) * limits.inner_box
    assert limits.contains(corners).all()
    z = np.linspace(0.0, min(GRAVITY - limits.thrust_min, limits.thrust_max - GRAVITY), 20001)[1:]
    lower = math.tan(limits.tilt_max) * (GRAVITY - z)
    upper = np.sqrt(np.maximum(limits.thrust_max**2 - (GRAVITY + z) ** 2, 0.0))
    volumes = 4.0 * np.minimum(lower, upper) ** 2 * z
    assert 8.0 * width**2 * height >= volumes.max() * (1.0 - 1e-12)
    assert 8.0 * width**2 * height <= volumes.max() * (1.0 + 1e-3)


def test_the_papers_box_comes_out() -> None:
    box = InputSet(2.0 * GRAVITY, math.radians(40.0)).inner_box
    assert box == pytest.approx([3.880398, 3.880398, 3.27], abs=1e-6)


@given(limits=sets, rows=st.lists(st.tuples(directions, directions, magnitudes), min_size=1, max_size=5))
def test_batch_equals_loop(limits: InputSet, rows: list[tuple[Vector, Vector, float]]) -> None:
    v = np.array([row[0] for row in rows]) * np.array([[row[2]] for row in rows])
    base = limits.saturate([row[1] for row in rows]) * 0.5
    for function in (limits.gauge, limits.saturate, limits.contains, limits.margin):
        np.testing.assert_array_equal(function(v), [function(row) for row in v])
    np.testing.assert_array_equal(
        limits.exit_factor(base, v), [limits.exit_factor(a, b) for a, b in zip(base, v, strict=True)]
    )


def test_a_least_thrust_is_one_more_half_space() -> None:
    limits = InputSet(1.45 * GRAVITY, math.radians(10.0), GRAVITY, 0.3 * GRAVITY)
    assert limits.saturate((0.0, 0.0, -30.0)) == pytest.approx([0.0, 0.0, -0.7 * GRAVITY])
    assert PAPER.saturate((0.0, 0.0, -30.0)) == pytest.approx([0.0, 0.0, -GRAVITY])
    assert InputSet(14.0, 1.2, GRAVITY, 9.8).inner_radius == pytest.approx(0.01)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "function",
    [
        PAPER.gauge,
        PAPER.contains,
        PAPER.saturate,
        PAPER.margin,
        lambda v: PAPER.exit_factor(v, (1.0, 0.0, 0.0)),
        lambda v: PAPER.exit_factor((0.0, 0.0, 0.0), v),
    ],
)
def test_what_is_not_finite_or_of_the_wrong_shape_is_refused(function: Callable[..., object], bad: float) -> None:
    with pytest.raises(FlatsatError, match=f"an entry of .* = {bad}: must be"):
        function([(0.0, 0.0, 0.0), (0.0, bad, 1.0)])
    with pytest.raises(FlatsatError, match="shape"):
        function((1.0, 2.0))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((GRAVITY, 0.2), "thrust_max = 9.81 m/s.2: must be above gravity = 9.81 m/s.2, or it cannot hover"),
        ((14.0, 0.0), "tilt_max = 0.0 rad"),
        ((14.0, math.pi / 2), "tilt_max = 1.570796326.* rad: must be from 1e-12 to below pi/2 rad, which is 90 deg"),
        ((14.0, -0.1), "tilt_max"),
        ((14.0, 0.2, 0.0), "gravity"),
        ((14.0, 0.2, GRAVITY, GRAVITY), "thrust_min"),
        ((14.0, 0.2, GRAVITY, -1.0), "thrust_min"),
        ((math.nan, 0.2), "thrust_max"),
        ((math.inf, 0.2), "thrust_max"),
        ((14.0, "0.2"), "tilt_max = '0.2'"),
        ((14.0, True), "tilt_max = True"),
        ((14.0, None), "tilt_max = None"),
    ],
)
def test_limits_that_cannot_hover_are_refused(arguments: tuple[float, ...], text: str) -> None:
    with pytest.raises(FlatsatError, match=text):
        InputSet(*arguments)
