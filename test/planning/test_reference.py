"""One drone's reference: the shortest one, and what is known where the solver does not find it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import clarabel
import numpy as np
import pytest
from asked_missions import BOUNDS, DRAGGED, LIMITS, WAY, antipodal, mission
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.planning import Asked, plan, rounds
from flatsat_ros.planning.improvement import bound_of
from flatsat_ros.planning.planner import finished
from flatsat_ros.planning.program import ORDERS, Derivatives, Retimed, bezier_matrices
from flatsat_ros.planning.reference import _linear_step, shapes_of, shortest, shortest_legs, smoothest
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.plans import Bounds, Curve


def test_a_straight_way_takes_what_jerk_alone_allows() -> None:
    # rest to rest with jerk J only: at best T = (32 L / J)^(1/3); a spline with few spans comes near
    shapes = Shapes(np.ones(24, dtype=np.int64), np.array([0, 24]))
    way = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]])
    bounds = replace(BOUNDS, margin=0.01, snap_max=1e4)
    found = shortest(shapes, Asked("cf1", way), LIMITS, bounds)
    assert found is not None
    least = (32 * 0.3 / bounds.jerk_max) ** (1 / 3)
    assert least < found.duration < 1.15 * least


@pytest.mark.parametrize("bounds", [BOUNDS, DRAGGED], ids=["acceleration", "drag"])
def test_the_shortest_duration_is_that_below_which_no_reference_is_found(bounds: Bounds) -> None:
    shapes = shapes_of(np.array([2.0, 2.5, 2.0]))
    found = shortest(shapes, Asked("cf1", WAY), LIMITS, bounds)
    assert found is not None
    duration = found.duration
    smooth = smoothest(shapes, Asked("cf1", WAY), 1.001 * duration, LIMITS, bounds)
    assert smooth is not None
    knots = np.rint(shapes.knots * 1.001e6 * duration).astype(int).tolist()
    slacks = [claim.slack for claim in bounds.claims(Curve.rounded(knots, smooth), LIMITS)]
    assert min(slacks) >= 0.0
    assert smoothest(shapes, Asked("cf1", WAY), 0.995 * duration, LIMITS, bounds) is None


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6))
def test_limits_are_linearised_in_legs_and_control_points_to_first_order(seed: int) -> None:
    random = np.random.default_rng(seed)
    spans, legs = 3, random.uniform(0.5, 2.0, 4)
    points = random.normal(size=(4 * spans + 5, 3))
    moved, longer = 1e-5 * random.normal(size=points.shape), 1e-5 * random.normal(size=4)
    retimed = Retimed(points, legs, spans)
    unknowns = np.concatenate([(points + moved).T.ravel(), legs + longer])
    knots = np.concatenate([[0.0], np.cumsum(np.repeat((legs + longer) / spans, spans))])
    for order, matrix in enumerate(bezier_matrices(knots)):
        own = np.arange(matrix.shape[0]) // (spans * (6 - order))
        exact = ((1.0 + longer / legs)[own] ** order)[:, np.newaxis] * (matrix @ (points + moved))
        linear = np.stack([rows @ unknowns + constant for rows, constant in retimed.axes(order)], axis=1)
        assert linear == pytest.approx(exact, abs=1e-6 * np.abs(exact).max())
        exact *= ((1.0 + longer / legs)[own] ** (2 - order))[:, np.newaxis]
        linear = np.stack([rows @ unknowns + constant for rows, constant in retimed.axes(order, 2)], axis=1)
        assert linear == pytest.approx(exact, abs=1e-6 * np.abs(exact).max())
        if order > 0:
            rows, constant = retimed.power(order, 2.0, np.arange(4 * spans))
            assert rows @ unknowns + constant == pytest.approx(np.repeat(2.0 * (1.0 + longer / legs) ** order, spans))


def test_no_bezier_point_is_left_out_that_is_not_another_spans() -> None:
    random = np.random.default_rng(0)
    derivatives = Derivatives(np.concatenate([[0.0], np.cumsum(random.uniform(0.5, 1.5, 7))]))
    points = random.normal(size=derivatives.count)
    for order in range(ORDERS):
        values = derivatives._matrices[order] @ points
        kept = values[derivatives.distinct(order)]
        assert len(kept) == 7 * (5 - order) + 1
        assert np.abs(values[:, np.newaxis] - kept).min(axis=1).max() < 1e-9 * np.abs(values).max()


def test_what_a_step_of_the_legs_hopes_for_is_about_what_it_gains() -> None:
    way = np.random.default_rng(4).uniform(-1.5, 1.5, (12, 3)) + np.array([0.0, 0.0, 1.5])
    bounds = replace(BOUNDS, upper=np.array([3.0, 3.0, 4.0]))
    drone, legs = Asked("cf1", way), np.sqrt(np.linalg.norm(np.diff(way, axis=0), axis=1) + 0.1)
    first = shortest(shapes_of(legs), drone, LIMITS, bounds)
    assert first is not None
    points, duration = first.points, first.duration
    step = _linear_step(legs * (duration / legs.sum()), points, drone, 0.25, LIMITS, bounds)
    assert step is not None
    second, best = shortest(shapes_of(step), drone, LIMITS, bounds), shortest_legs(drone, LIMITS, bounds, lambda: False)
    assert second is not None
    assert best is not None
    assert duration - second.duration > 0.8 * (duration - step.sum()) > 0.05 * duration
    assert best[1].duration <= second.duration


class StoppingSolver:
    """Clarabel that says of some of its answers, counted from 0, that it stopped short of its tolerance."""

    def __init__(self, status: clarabel.SolverStatus, stops: Callable[[int], bool]) -> None:
        self._status, self._stops, self.calls = status, stops, 0

    def use(self, monkeypatch: pytest.MonkeyPatch) -> None:
        real = clarabel.DefaultSolver

        def solver(*arguments: Any) -> SimpleNamespace:
            return SimpleNamespace(solve=lambda: self._changed(real(*arguments).solve()))

        monkeypatch.setattr(clarabel, "DefaultSolver", solver)

    def _changed(self, solution: clarabel.DefaultSolution) -> SimpleNamespace:
        call, self.calls = self.calls, self.calls + 1
        stops = solution.status == clarabel.SolverStatus.Solved and self._stops(call)
        return SimpleNamespace(x=solution.x, status=self._status if stops else solution.status)


STOPS = [clarabel.SolverStatus.AlmostSolved, clarabel.SolverStatus.NumericalError]


@pytest.mark.parametrize("status", STOPS)
def test_a_solver_that_stops_short_is_tried_again_with_shorter_steps(
    status: clarabel.SolverStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes = shapes_of(np.array([2.0, 2.5, 2.0]))
    before = shortest(shapes, Asked("cf1", WAY), LIMITS, BOUNDS)
    solver = StoppingSolver(status, lambda call: call < 2)
    solver.use(monkeypatch)
    found = shortest(shapes, Asked("cf1", WAY), LIMITS, BOUNDS)
    assert solver.calls == 3
    assert before is not None
    assert found is not None
    assert found.is_least
    assert found.duration == pytest.approx(before.duration, rel=1e-6)


def test_a_plan_is_not_compared_with_a_duration_of_which_the_solver_does_not_say_that_it_is_the_least(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    StoppingSolver(clarabel.SolverStatus.AlmostSolved, lambda call: True).use(monkeypatch)
    for ways in ([WAY.tolist()], antipodal(2)):
        asked = mission(*ways)
        first = next(rounds(asked, lambda: False))
        assert first.bound is None
        found = finished(asked, first)
        assert min(found.verify().values()) >= 0.0
        assert "bound" not in found.provenance
        with pytest.raises(FlatsatError, match=r"the solver finds \d+\.\d\d s, but not that nothing is shorter"):
            bound_of(asked)
    with pytest.raises(FlatsatError, match="no references found that keep the limits"):
        plan(mission(WAY.tolist(), times=np.array([0.0, 1.0, 2.2, 3.2])))
