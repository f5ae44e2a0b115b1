"""The saturation factors for tracking: all keep the limits, and their order is what the theory says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.paper.tracking import hull_factor, inner_polytope

LIMITS = InputSet(1.45 * GRAVITY, np.radians(10.0))
COORDINATE = st.floats(-100.0, 100.0).filter(lambda x: abs(x) > 1e-6)
DIRECTION = st.tuples(COORDINATE, COORDINATE, COORDINATE).map(np.array)
VERTICES = np.array([[0.5, 0.0, 0.3], [-0.4, 0.4, 0.0], [-0.3, -0.5, -0.4], [0.1, 0.1, 0.9]])
SIDES = 64


def of_hull(weights: list[float]) -> np.ndarray:
    """A point of the hull of the vertices."""
    share = np.array(weights) + 1e-9
    return np.asarray(share @ VERTICES / share.sum())


WEIGHTS = st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4)


@given(v=DIRECTION, weights=WEIGHTS)
def test_polytope_hull_and_exit_factor_are_ordered_and_keep_the_limits(v: np.ndarray, weights: list[float]) -> None:
    base = of_hull(weights)
    paper = inner_polytope(LIMITS, SIDES).minus(VERTICES).factor(v)
    hull = hull_factor(LIMITS, VERTICES, v)
    exact = LIMITS.exit_factor(base, v)
    assert 0.0 < paper <= hull * (1.0 + 1e-12)
    assert hull <= exact * (1.0 + 1e-9)
    for factor in (paper, hull, exact):
        assert LIMITS.contains(base + factor * v, tolerance=1e-9)


@given(v=DIRECTION)
def test_without_a_reference_the_hull_factor_is_the_reciprocal_gauge(v: np.ndarray) -> None:
    assert hull_factor(LIMITS, np.zeros((1, 3)), v) == pytest.approx(1.0 / LIMITS.gauge(v), rel=1e-12)


def test_the_polytope_fills_the_set_as_its_sides_grow() -> None:
    v = np.random.default_rng(0).normal(size=(2000, 3))
    exact = hull_factor(LIMITS, VERTICES, v)
    lost = []
    for sides in (16, 64, 256):
        paper = inner_polytope(LIMITS, sides).minus(VERTICES).factor(v)
        assert (paper <= exact * (1.0 + 1e-12)).all()
        lost.append(float((1.0 - paper / exact).max()))
    # halving the angle quarters the gap
    assert lost[1] < lost[0] / 8.0
    assert lost[2] < lost[1] / 8.0


@given(v=DIRECTION, tilt=st.floats(0.05, 1.3), thrust=st.floats(1.2, 3.0), floor=st.floats(0.0, 0.8))
def test_the_polytope_lies_inside_the_set(v: np.ndarray, tilt: float, thrust: float, floor: float) -> None:
    limits = InputSet(thrust * GRAVITY, tilt, GRAVITY, floor * GRAVITY)
    assert limits.contains(inner_polytope(limits, 48).factor(v) * v, tolerance=1e-9)


def test_what_leaves_nothing_over_is_refused() -> None:
    with pytest.raises(FlatsatError, match="sides = 2: must be at least 3"):
        inner_polytope(LIMITS, 2)
    with pytest.raises(FlatsatError, match="must be above 0"):
        inner_polytope(LIMITS, SIDES).minus([[1.8, 0.0, 0.0]])
    with pytest.raises(FlatsatError, match="must be inside the input set"):
        hull_factor(LIMITS, [[3.0, 0.0, 0.0]], [1.0, 0.0, 0.0])
