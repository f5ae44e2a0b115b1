"""One drone's reference through way-points: the shortest one, and the one of least jerk for given times."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import sparse

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.planning.mission import Asked
from flatsat_ros.planning.program import FOURTH, UNKNOWNS, Derivatives, Program, Retimed, keep_limits
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.curve import AT_REST, ORDER

# Drag is counted with an assumed duration. Up to _PACES programs are solved until the duration that comes out differs
# from that by less than _SAME, relatively; where legs are tried, a difference of _ROUGHLY is enough. _SLOPE is a guess
# of the change of the duration that comes out over that of the assumed one.
_PACES, _SAME, _ROUGHLY, _SLOPE = 12, 1e-4, 1e-2, 0.1

_SPANS, _LEG = 24, 3  # spans of a reference, and the least number of a leg

_STEPS = 30  # at most, of the search for the times of way-points
_ENOUGH = 5e-4  # the search ends where less than this share of the duration can be gained
_SMALLEST = 1e-3  # least relative radius of the trust region in which limits are linearised in the legs' durations


class Shortest(NamedTuple):
    """The shortest reference through way-points.

    Attributes:
        points: (n, 3) control points, m.
        duration: s.
        is_least: no other is shorter, up to the tolerance of the solver, which may stop short of it.
    """

    points: FloatArray
    duration: float
    is_least: bool


def shortest(
    shapes: Shapes, drone: Asked, limits: InputSet, bounds: Bounds, near: float | None = None, same: float = _SAME
) -> Shortest | None:
    """Return control points and the least duration with the knots in the proportions of the shapes.

    It is the best there is in this spline space (up to the reserve for rounding): a convex program where only the
    acceleration is asked of the law, otherwise a short sequence of them, until the duration is that which drag and lead
    are counted with. None if the box leaves no way.

    Args:
        shapes: knots, and where the way-points are passed.
        drone: whose way-points are passed.
        limits: the input set.
        bounds: of the reference.
        near: a duration, s, of the right size.
        same: how near, relatively, that which drag and lead are counted with must be to the duration, of which an
            estimate is returned then.
    """
    scale = _guess(drone.waypoints, bounds) if near is None else near
    known: list[tuple[float, float]] = []  # durations that were counted with, and what came out, s
    for _ in range(_PACES):
        solved = _shortest_at(shapes, drone, limits, bounds, scale)
        if solved is None or len(bounds.asked) == 1:
            return solved
        points, duration, is_least = solved
        known.append((scale, duration))
        slope = _SLOPE
        if len(known) > 1 and known[-1][0] != known[-2][0]:
            (a, out_a), (b, out_b) = known[-2:]
            slope = float(np.clip((out_b - out_a) / (b - a), 0.0, 0.9))
        last, scale = scale, scale + (duration - scale) / (1.0 - slope)
        if abs(duration - last) < same * duration:
            return Shortest(points, scale, is_least)
    return Shortest(points, scale, False)


def _shortest_at(shapes: Shapes, drone: Asked, limits: InputSet, bounds: Bounds, scale: float) -> Shortest | None:
    """Return control points and the least duration where drag and lead are counted with a duration, s."""
    derivatives = Derivatives(shapes.knots * scale, closed=shapes.closed)
    program = Program(derivatives.size)
    keep_limits(program, derivatives, limits, bounds)
    _pass(program, derivatives, shapes, drone)
    linear = np.zeros(derivatives.size)
    linear[FOURTH] = 1.0
    found = program.minimised(linear)
    if found is None:
        return None
    return Shortest(derivatives.points(found.x), scale * float(found.x[FOURTH]) ** 0.25, found.is_least)


def smoothest(shapes: Shapes, drone: Asked, duration: float, limits: InputSet, bounds: Bounds) -> FloatArray | None:
    """Return the control points (n, 3) of least jerk for a duration, s; None if the limits leave none."""
    derivatives = Derivatives(shapes.knots * duration, closed=shapes.closed)
    program = Program(derivatives.size)
    keep_limits(program, derivatives, limits, bounds)
    _pass(program, derivatives, shapes, drone)
    program.vanish(derivatives.power(4, 1.0, constant=-1.0))
    form = shapes.jerk / np.abs(shapes.jerk).max()
    quadratic = sparse.triu(sparse.block_diag([form] * 3 + [sparse.csc_matrix((UNKNOWNS, UNKNOWNS))]), format="csc")
    found = program.minimised(np.zeros(derivatives.size), quadratic)
    return None if found is None else derivatives.points(found.x)


def shortest_legs(
    drone: Asked, limits: InputSet, bounds: Bounds, late: Callable[[], bool], *, closed: bool = False
) -> tuple[FloatArray, Shortest] | None:
    """Return the durations (W - 1,) of the legs for which the whole is shortest, s, and the reference with them.

    The limits are linearised in the legs' durations as well; what comes out is solved again with its proportions, so
    that every accepted step is a reference that keeps the limits.

    Args:
        drone: whose way-points are passed.
        limits: the input set.
        bounds: of the reference.
        late: whether to be content with the best legs so far.
        closed: whether it begins again where it ends, instead of resting at both ends.
    """
    legs = np.sqrt(np.linalg.norm(np.diff(drone.waypoints, axis=0), axis=1) + 0.1)
    found = shortest(shapes_of(legs, closed=closed), drone, limits, bounds)
    if found is None or len(legs) == 1:
        return None if found is None else (legs * (found.duration / legs.sum()), found)
    legs *= found.duration / legs.sum()
    radius = 0.25
    for _ in range(_STEPS):
        if late():
            break
        step = _linear_step(legs, found.points, drone, radius, limits, bounds, closed=closed)
        hoped = 0.0 if step is None else found.duration - float(step.sum())
        if step is not None and hoped < _ENOUGH * found.duration:
            break
        tried = (
            None
            if step is None
            else shortest(shapes_of(step, closed=closed), drone, limits, bounds, float(step.sum()), _ROUGHLY)
        )
        if step is None or tried is None or tried.duration >= found.duration:
            radius /= 3.0
            if radius < _SMALLEST:
                break
        else:
            gain, found = found.duration - tried.duration, tried
            legs = step * (found.duration / step.sum())
            radius = min(0.5, radius * (2.0 if gain > 0.7 * hoped else 0.5 if gain < 0.3 * hoped else 1.0))
    if len(bounds.asked) == 1:
        return legs, found
    exact = shortest(shapes_of(legs, closed=closed), drone, limits, bounds, found.duration)
    return None if exact is None else (legs * (exact.duration / found.duration), exact)


def shapes_of(legs: FloatArray, least: int = _LEG, *, closed: bool = False) -> Shapes:
    """Return shapes whose legs have the same number of spans, equal within a leg.

    Args:
        legs: (L,) durations, s; the spans are rounded up to whole microseconds.
        least: spans of a leg.
        closed: whether the references are.
    """
    spans = spans_of(len(legs), least)
    lengths = np.maximum(1, np.ceil(legs / spans * 1e6 - 1e-3)).astype(np.int64)
    return Shapes(np.repeat(lengths, spans), spans * np.arange(len(legs) + 1), closed)


def spans_of(legs: int, least: int = _LEG) -> int:
    """Return the number of spans of each leg, for a number of legs: with few legs each has more spans."""
    return max(least, _SPANS // legs)


def _guess(waypoints: FloatArray, bounds: Bounds) -> float:
    """Return a duration of the right size, s: the unknown that is minimised is about 1 then."""
    ways = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    return float(np.cbrt(60.0 * np.maximum(ways, 1e-3) / bounds.jerk_max).sum())


def _pass(program: Program, reference: Derivatives, shapes: Shapes, drone: Asked) -> None:
    """Ask that the reference passes the way-points, within their radii, and rests at both ends if it is not closed."""
    inner, radii = np.arange(1, len(drone.waypoints) - 1), drone.allowed
    if shapes.closed:
        inner = np.append(0, inner)
    else:
        ends = sparse.csr_matrix(np.delete(shapes.pinned, np.s_[AT_REST:-AT_REST], axis=0))
        places = np.repeat(drone.waypoints[[0, -1]], AT_REST, axis=0)
        for axis in range(3):
            program.vanish((program.placed(ends, axis * shapes.count), -places[:, axis]))
    missed = []
    for axis, (matrix, constant) in enumerate(reference.axes(0)):
        rows = shapes.passed[inner] * ORDER
        missed.append((matrix[rows], constant[rows] - drone.waypoints[inner, axis]))
    exact, near = np.flatnonzero(radii[inner] == 0.0), np.flatnonzero(radii[inner] > 0.0)
    if exact.size:
        for matrix, constant in missed:
            program.vanish((matrix[exact], constant[exact]))
    if near.size:
        head = (sparse.csr_matrix((len(near), program.size)), radii[inner][near])
        program.bound_norms(head, *((matrix[near], constant[near]) for matrix, constant in missed))


def _linear_step(
    legs: FloatArray,
    points: FloatArray,
    drone: Asked,
    radius: float,
    limits: InputSet,
    bounds: Bounds,
    *,
    closed: bool = False,
) -> FloatArray | None:
    """Return the legs (L,) whose sum is smallest where limits are linear in control points and legs."""
    retimed = Retimed(points, legs, spans_of(len(legs)), closed=closed)
    program = Program(retimed.size)
    keep_limits(program, retimed, limits, bounds)
    _pass(program, retimed, shapes_of(legs, closed=closed), drone)
    durations = retimed.legs()
    program.be_positive((durations, -legs * (1.0 - radius)))
    program.be_positive((-durations, legs * (1.0 + radius)))
    found = program.minimised(np.asarray(durations.sum(axis=0)).ravel())
    return None if found is None else np.asarray(durations @ found.x)
