"""Rounds that end in references proved to keep what is asked, shorter and shorter.

One drone: the durations of its legs are optimised, then the smoothest reference of that duration is taken. Many drones:
the slowest one alone gives a bound that no plan undercuts; the search begins above it, and what it finds counts only
when the exact proof succeeds. From there the duration is brought toward the bound as far as proofs go.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.planning.mission import Mission
from flatsat_ros.planning.planner import Round
from flatsat_ros.planning.proof import broken_limit, retimed
from flatsat_ros.planning.reference import Shortest, shapes_of, shortest, shortest_legs, smoothest, spans_of
from flatsat_ros.planning.search import Search, Swarm
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.plans import Curve

_LEG = 8  # least number of spans of a leg in a swarm: it needs room for detours
_UNITS = 64  # durations of legs are whole numbers of units, of which each span of the longest leg has this many
_SLOWEST = 3  # number of drones with the longest ways whose own shortest references bound the duration

_LONGER = (1.2, 1.35, 1.5, 1.8, 2.2, 3.0)  # the durations that are tried first, over the bound
_BEGINNINGS = ((0.05, 0, 0.0), (0.0, 1, 0.0), (0.15, 2, 0.0), (0.05, 3, 0.0))  # swirl, seed and spread
_AROUND = ((0.0, 0, 0.0), (0.0, 1, 0.3), (0.0, 2, 0.5), (0.0, 3, 0.65))  # likewise, where there are obstacles
_STAGES = 4  # number of stages of growing penalties
_STEPS, _MORE_STEPS = 120, 400  # most steps of a stage's descent
# the starts of searches for shorter durations: swirl and seed, or None for the best references so far; and their steps
_TRIES = (((0.05, 0), _MORE_STEPS), (None, _MORE_STEPS), ((0.2, 0), _MORE_STEPS), ((0.1, 1), _MORE_STEPS))
_SHORTEST = 1.002  # least duration that is tried, over the bound: the penalty needs room beside the limits
_ENOUGH = 0.002  # least step of the duration, over the bound, that is worth a round
_RELAXED = (1.0005, 1.001, 1.003, 1.01, 1.03)  # durations over the shortest one, with room for a smooth reference


def rounds(mission: Mission, late: Callable[[], bool]) -> Iterator[Round]:
    """Yield proved references, each set shorter than the one before.

    Args:
        mission: what is asked.
        late: whether to stop improving.

    Raises:
        FlatsatError: what is asked cannot be planned.
    """
    if mission.is_given:
        yield retimed(mission)
    elif mission.times is not None:
        yield _timed(mission, late)
    elif len(mission.drones) == 1 and not mission.obstacles:
        yield _alone(mission, late)
    else:
        yield from _together(mission, late)


def _alone(mission: Mission, late: Callable[[], bool]) -> Round:
    """Return the shortest reference of one drone, as smooth as that duration allows."""
    (drone,) = mission.drones
    found = shortest_legs(drone, mission.limits, mission.bounds, late, closed=mission.is_closed)
    if found is None:
        raise _no_way(drone.name, mission)
    legs, best = found
    for factor in _RELAXED:
        shapes = shapes_of(factor * legs, closed=mission.is_closed)
        points = smoothest(shapes, drone, float(shapes.lengths.sum()) / 1e6, mission.limits, mission.bounds)
        if points is not None:
            curves = (_curve(shapes, points, 1),)
            if broken_limit(mission, curves) is None:
                return Round(curves, curves[0].duration, _told(best))
    raise _no_way(drone.name, mission)


def _timed(mission: Mission, late: Callable[[], bool]) -> Round:
    """Return references that pass the way-points at the given times."""
    assert mission.times is not None
    legs = np.diff(mission.times)
    alone = len(mission.drones) == 1 and not mission.obstacles
    closed = mission.is_closed
    shapes = shapes_of(legs, closed=closed) if alone else shapes_of(legs, _LEG, closed=closed)
    duration = float(shapes.lengths.sum()) / 1e6
    if alone:
        points = smoothest(shapes, mission.drones[0], duration, mission.limits, mission.bounds)
        curves = None if points is None else (_curve(shapes, points, 1),)
        broken = "the solver finds none" if curves is None else broken_limit(mission, curves)
        if curves is not None and broken is None:
            return Round(curves, duration)
        _require_long_enough(mission, shapes, duration)
    else:
        search = Search(_swarm(mission, shapes))
        for number, beginning in enumerate(_beginnings(mission, math.inf)):
            found, _, broken = _settled(mission, search, search.begin(*beginning), 1, late, _MORE_STEPS)
            if found is not None:
                return Round(found, duration)
            if number == 0:  # it takes a while to know, and is not needed where all is well
                _require_long_enough(mission, shapes, duration)
    raise FlatsatError(
        f"way-points at these times: no references found that keep the limits; last was broken: {broken}"
    )


def _require_long_enough(mission: Mission, shapes: Shapes, duration: float) -> None:
    """Refuse given times that are too short for a drone alone.

    Raises:
        FlatsatError: they are; the text says how many times as long they must be.
    """
    for drone in mission.drones:
        own = shortest(shapes, drone, mission.limits, mission.bounds)
        if own is None:
            raise _no_way(drone.name, mission)
        if own.duration > duration and own.is_least:
            factor = math.ceil(1e3 * _RELAXED[0] * own.duration / duration) / 1e3
            try:
                broken = broken_limit(mission, (_curve(shapes, shapes.fixed @ drone.waypoints, 1),))
            except FlatsatError as error:  # so much that it is nowhere near what can be proved
                broken = f"all of them: {error}"
            raise FlatsatError(
                f"times of way-points of {drone.name}: must be at least {factor:.3f} times as long; the smoothest "
                f"reference through them breaks {broken or 'nothing, but there is a better one'}"
            )


def _together(mission: Mission, late: Callable[[], bool]) -> Iterator[Round]:
    """Yield references of a swarm that are shorter and shorter."""
    shapes = _shapes(mission)
    longest = _longest(mission, shapes)
    bound, told = longest.duration, _told(longest)
    search = Search(_swarm(mission, shapes))
    total = int(shapes.lengths.sum())

    def unit_of(duration: float) -> int:
        return math.ceil(duration * 1e6 / total)

    broken: str | None = None
    for factor, beginning in ((each, begun) for each in _LONGER for begun in _beginnings(mission, each)):
        found, modes, newly = _settled(mission, search, search.begin(*beginning), unit_of(factor * bound), late)
        broken = newly or broken
        if found is not None:
            break
        if late():
            raise FlatsatError(
                f"no plan found in the given time, with durations up to {factor * bound:.4g} s, {factor:g} times that "
                f"of the slowest drone alone: {broken}"
            )
    else:
        raise FlatsatError(
            f"no plan found in up to {_LONGER[-1]:g} times the {bound:.4g} s of the slowest drone alone: {broken}"
        )
    yield Round(found, found[0].duration, told)
    high = found[0].duration
    for fresh, steps in _TRIES:
        low, share = _SHORTEST * bound, 0.1
        while high - low > _ENOUGH * bound and not late():
            unit = unit_of(low + share * (high - low))
            if unit * total / 1e6 >= high:
                break
            start = modes if fresh is None else search.begin(*fresh)
            shorter, tried, _ = _settled(mission, search, start, unit, late, steps)
            if shorter is None:
                low, share = unit * total / 1e6, 0.5
            else:
                modes, high = tried, shorter[0].duration
                yield Round(shorter, high, told)


def bound_of(mission: Mission) -> float:
    """Return a duration, s, below which there is no plan with knots in these proportions.

    Raises:
        FlatsatError: a drone alone has no reference, or the solver does not find the shortest.
    """
    if mission.is_given:
        raise FlatsatError("polynomials are only slowed down: larger bounds make no plan shorter")
    if len(mission.drones) > 1 or mission.obstacles:
        longest = _longest(mission, _shapes(mission))
    else:
        (drone,) = mission.drones
        found = shortest_legs(drone, mission.limits, mission.bounds, lambda: False, closed=mission.is_closed)
        if found is None:
            raise _no_way(drone.name, mission)
        longest = found[1]
    bound = _told(longest)
    if bound is None:
        raise FlatsatError(f"the solver finds {longest.duration:.2f} s, but not that nothing is shorter")
    return bound


def _told(found: Shortest) -> float | None:
    """Return the duration, s, below which there is no reference, as far as that is known."""
    return found.duration if found.is_least else None


def _shapes(mission: Mission) -> Shapes:
    """Return the shapes of a swarm's references: the longest way of a leg decides on its share of the duration."""
    proportions = np.sqrt(_ways(mission).max(axis=0) + 0.1)
    count = len(proportions)
    units = np.maximum(1, np.rint(_UNITS * proportions / proportions.max())).astype(np.int64)
    spans = spans_of(count, _LEG)
    lengths = np.repeat(units if count > 1 else units // units, spans)
    return Shapes(lengths, spans * np.arange(count + 1), mission.is_closed)


def _ways(mission: Mission) -> FloatArray:
    """Return the lengths (N, L) of the legs, m."""
    return np.asarray(np.linalg.norm(np.diff(mission.waypoints, axis=1), axis=2))


def _settled(
    mission: Mission, search: Search, modes: FloatArray, unit: int, late: Callable[[], bool], steps: int = _STEPS
) -> tuple[tuple[Curve, ...] | None, FloatArray, str | None]:
    """Search with growing penalties until the proof succeeds: curves or None, their modes, what is broken at last."""
    shapes = search.swarm.shapes
    duration = float(shapes.lengths.sum()) * unit / 1e6
    broken: str | None = None
    for stage in range(_STAGES):
        if late():
            break
        modes, seems_kept = search.settle(modes, duration, stage, steps)
        if not seems_kept and stage + 1 < _STAGES:
            continue
        curves = tuple(_curve(shapes, points, unit) for points in search.points(modes))
        broken = broken_limit(mission, curves)
        if broken is None:
            return curves, modes, None
    if broken is None:  # the time was up
        curves = tuple(_curve(shapes, points, unit) for points in search.points(modes))
        broken = broken_limit(mission, curves)
        if broken is None:
            return curves, modes, None
    return None, modes, broken


def _beginnings(mission: Mission, factor: float) -> Sequence[tuple[float, int, float]]:
    """Return what a search begins from: swirl, seed and spread, for a duration of so many times the bound."""
    if not mission.obstacles:
        return _BEGINNINGS
    return [each for each in _AROUND if each[2] == 0.0 or 0.9 / (1.0 - each[2]) < factor]


def _swarm(mission: Mission, shapes: Shapes) -> Swarm:
    return Swarm(
        shapes, mission.waypoints, mission.distances, mission.downwash, mission.limits, mission.bounds,
        np.array([box.corners for box in mission.obstacles]).reshape(-1, 2, 3), mission.reaches,
    )  # fmt: skip


def _longest(mission: Mission, shapes: Shapes) -> Shortest:
    """Return the longest of the shortest references of drones alone: no plan with these shapes is shorter."""
    longest: Shortest | None = None
    for number in np.argsort(-_ways(mission).max(axis=1), kind="stable")[:_SLOWEST].tolist():
        drone = mission.drones[number]
        near = None if longest is None else longest.duration
        found = shortest(shapes, drone, mission.limits, mission.bounds, near)
        if found is None:
            raise _no_way(drone.name, mission)
        if longest is None or found.duration > longest.duration:
            longest = found
    assert longest is not None
    return longest


def _no_way(name: str, mission: Mission) -> FlatsatError:
    lower, upper = mission.bounds.lower.tolist(), mission.bounds.upper.tolist()
    return FlatsatError(f"way-points of {name}: found no reference through them in the box from {lower} to {upper} m")


def _curve(shapes: Shapes, points: FloatArray, unit: int) -> Curve:
    """Return the curve whose spans last `unit` us times the shapes' lengths."""
    return Curve.rounded([0, *(unit * np.cumsum(shapes.lengths)).tolist()], points, closed=shapes.closed)
