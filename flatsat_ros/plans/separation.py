"""How near drones come to each other and to boxes that stand still, proved for all times with integers.

Distances are in the downwash metric, |(dx, dy, dz / w)|: drones keep apart w times as far along the vertical. On an
interval on which both references are polynomials, their difference lies in the convex hull of its Bezier control
points D_k, so every direction n proves |D(t)| >= min_k n'D_k / |n| there. Directions come from floating-point numbers;
what they prove is computed in 64-bit integers, with every rounding counted. Where that is not enough, the interval is
halved. A box has a direction that proves it likewise, n'(P_k - q) for all points q of the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from flatsat_ros.base.arrays import FloatArray, IntArray
from flatsat_ros.plans.curve import NANOMETRE, UNIT, Curve
from flatsat_ros.plans.obstacles import Box

_HALVINGS = 16  # at most, of an interval between knots
_DIRECTION = 2**20  # length of a direction's integers
_STEPS = 12  # of the search for a direction


@dataclass(frozen=True, eq=False)
class Closest:
    """The smallest certified distance of each pair of drones, and when it is.

    Attributes:
        first, second: (P,) numbers of the drones, or of the drone and the box.
        distance: (P,) UNIT for one metre, in the downwash metric; the pair is never nearer.
        start, end: (P,) s, the interval in which it comes so near, or that could not be proved to be better.
    """

    first: IntArray
    second: IntArray
    distance: IntArray
    start: FloatArray
    end: FloatArray


def pairs_of(count: int) -> tuple[IntArray, IntArray]:
    """Return the two numbers (P,) of each pair of drones."""
    first, second = np.triu_indices(count, 1)
    return first.astype(np.int64), second.astype(np.int64)


def closest(
    curves: Sequence[Curve], downwash: float, goals: IntArray | None = None, tolerance: float = 1e-4
) -> Closest:
    """Return certified distances of all pairs.

    Args:
        curves: one for each drone; all start at the same time, and each stands still after its end.
        downwash: how many times as far drones keep apart along the vertical.
        goals: (P,) UNIT for one metre, distances that would be enough: a pair is not looked at any closer once it is
            known whether it keeps its goal. By default each distance is found up to the tolerance.
        tolerance: m.
    """
    edges = sorted({knot for curve in curves for knot in curve.knots})
    points, error = _stretched(np.stack([curve.fixed(0, edges) for curve in curves]), Fraction(downwash))
    first, second = pairs_of(len(curves))
    origin = np.zeros((len(first), 3), dtype=np.int64)
    return _proved(points[first] - points[second], 2 * error, (origin, origin), edges, first, second, goals, tolerance)


def closest_to_boxes(
    curves: Sequence[Curve],
    boxes: Sequence[Box],
    downwash: float,
    goals: IntArray | None = None,
    tolerance: float = 1e-4,
) -> Closest:
    """Return certified distances of each drone from each box, the second number.

    Args:
        curves: as for `closest`.
        boxes: that stand still.
        downwash: as for `closest`.
        goals: likewise.
        tolerance: m.
    """
    edges = sorted({knot for curve in curves for knot in curve.knots})
    points, error = _stretched(np.stack([curve.fixed(0, edges) for curve in curves]), Fraction(downwash))
    first, second = (side.ravel() for side in np.indices((len(curves), len(boxes))))
    divisors = [Fraction(1), Fraction(1), Fraction(downwash)]
    faces = [
        [[way(value * NANOMETRE * UNIT / by) for value, by in zip(corner, divisors, strict=True)] for corner in corners]
        for way, corners in ((math.floor, [box.lower for box in boxes]), (math.ceil, [box.upper for box in boxes]))
    ]
    lower, upper = (np.array(face, dtype=np.int64).reshape(-1, 3)[second] for face in faces)
    return _proved(points[first], error, (lower, upper), edges, first, second, goals, tolerance)


def _proved(
    points: IntArray,
    error: int,
    boxes: tuple[IntArray, IntArray],
    edges: Sequence[int],
    first: IntArray,
    second: IntArray,
    goals: IntArray | None,
    tolerance: float,
) -> Closest:
    """Return certified distances of polynomials, their control points (P, E, n, 3), from boxes, corners (P, 3) each."""
    count, spans = points.shape[:2]
    pair = np.repeat(np.arange(count), spans)
    span = np.tile(np.arange(spans), count)
    hulls = points.reshape(-1, *points.shape[2:])
    left, width = np.array(edges[:-1], dtype=np.float64)[span], np.diff(edges).astype(np.float64)[span]
    best = np.full(count, np.iinfo(np.int64).max)
    start, end, nearest = np.zeros(count), np.zeros(count), np.full(count, np.inf)
    for halving in range(_HALVINGS + 1):
        corners = (boxes[0][pair], boxes[1][pair])
        bounds = _lower_bounds(hulls, error, corners)
        ends = np.minimum(
            *(np.sqrt((_outside(hulls[:, k].astype(np.float64), corners) ** 2).sum(axis=1)) for k in (0, -1))
        )
        np.minimum.at(nearest, pair, ends)
        target = nearest - tolerance * UNIT if goals is None else goals
        hopeless = np.zeros_like(target, dtype=bool) if goals is None else nearest < goals - error
        done = (bounds >= target[pair]) | hopeless[pair] | (halving == _HALVINGS)
        order = np.flatnonzero(done)[np.argsort(-bounds[done], kind="stable")]  # the smallest of a pair comes last
        order = order[bounds[order] < best[pair[order]]]
        best[pair[order]], start[pair[order]] = bounds[order], left[order]
        end[pair[order]] = left[order] + width[order]
        if done.all():
            break
        left, width, pair = left[~done], width[~done] / 2.0, pair[~done]
        hulls, error = _halved(hulls[~done]), error + hulls.shape[1] // 2
        left, width, pair = np.concatenate([left, left + width]), np.tile(width, 2), np.tile(pair, 2)
    return Closest(first, second, best, start / 1e6, end / 1e6)


def _stretched(points: IntArray, downwash: Fraction) -> tuple[IntArray, int]:
    """Return the points (..., 3) with heights divided by the downwash, and the largest error of a coordinate."""
    shrunk = points.copy()
    heights = points[..., 2].astype(object) * downwash.denominator // downwash.numerator
    shrunk[..., 2] = heights.astype(np.int64)
    # 1/2 from the rounding to fixed point (divided by the downwash), and less than 1 from this one
    return shrunk, 1 + -(-downwash.denominator // (2 * downwash.numerator))


def _lower_bounds(hulls: IntArray, error: int, corners: tuple[IntArray, IntArray]) -> IntArray:
    """Return a bound (C,) of the distance of each hull of control points (C, n, 3) from its box, corners (C, 3)."""
    directions = np.rint(_DIRECTION * _toward(hulls.astype(np.float64), corners)).astype(np.int64)
    projections = (hulls * directions[:, np.newaxis]).sum(axis=2).min(axis=1)
    projections -= (directions * np.where(directions > 0, corners[1], corners[0])).sum(axis=1)
    projections -= error * np.abs(directions).sum(axis=1)
    lengths = np.sqrt((directions * directions).sum(axis=1).astype(np.float64)).astype(np.int64) + 1
    return np.asarray(np.where(projections > 0, projections // lengths, 0))


def _toward(hulls: FloatArray, corners: tuple[IntArray, IntArray]) -> FloatArray:
    """Return directions (C, 3) from boxes to about the nearest point of each hull (C, n, 3): Gilbert's steps."""
    point = hulls.mean(axis=1)
    way = _outside(point, corners)
    rows = np.arange(len(hulls))
    for _ in range(_STEPS):
        corner = hulls[rows, (hulls * way[:, np.newaxis]).sum(axis=2).argmin(axis=1)]
        step = corner - point
        square = np.maximum((step * step).sum(axis=1), 1e-300)
        point = point + np.clip(-(way * step).sum(axis=1) / square, 0.0, 1.0)[:, np.newaxis] * step
        way = _outside(point, corners)
    return np.asarray(way / np.maximum(np.sqrt((way * way).sum(axis=1)), 1e-300)[:, np.newaxis])


def _outside(points: FloatArray, corners: tuple[IntArray, IntArray]) -> FloatArray:
    """Return the ways (C, 3) to points from the nearest points of boxes."""
    return np.asarray(points - np.clip(points, *corners))


def _halved(points: IntArray) -> IntArray:
    """Return the control points of all left halves (C, n, 3), then of all right ones: de Casteljau's, rounded down.

    Each of the n - 1 stages is off by less than 1/2 more, n / 2 in all.
    """
    left, right = np.empty_like(points), np.empty_like(points)
    for stage in range(points.shape[1]):
        left[:, stage], right[:, -1 - stage] = points[:, 0], points[:, -1]
        points = (points[:, :-1] + points[:, 1:]) >> 1
    return np.concatenate([left, right])
