"""How near drones come to each other, proved for all times with integers.

Distances are in the downwash metric, |(dx, dy, dz / w)|: drones keep apart w times as far along the vertical. On an
interval on which both references are polynomials, their difference lies in the convex hull of its six Bezier control
points D_k, so every direction n proves |D(t)| >= min_k n'D_k / |n| there. Directions come from floating-point numbers;
what they prove is computed in 64-bit integers, with every rounding counted. Where that is not enough, the interval is
halved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from flatsat_ros.base.arrays import FloatArray, IntArray
from flatsat_ros.plans.curve import ORDER, UNIT, Curve

_HALVINGS = 16  # at most, of an interval between knots
_DIRECTION = 2**20  # length of a direction's integers
_STEPS = 12  # of the search for a direction


@dataclass(frozen=True, eq=False)
class Closest:
    """The smallest certified distance of each pair of drones, and when it is.

    Attributes:
        first, second: (P,) numbers of the drones.
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
    count, spans = len(first), len(edges) - 1
    pair = np.repeat(np.arange(count), spans)
    span = np.tile(np.arange(spans), count)
    differences = (points[first] - points[second]).reshape(-1, *points.shape[2:])
    error = 2 * error
    left, width = np.array(edges[:-1], dtype=np.float64)[span], np.diff(edges).astype(np.float64)[span]
    best = np.full(count, np.iinfo(np.int64).max)
    start, end, nearest = np.zeros(count), np.zeros(count), np.full(count, np.inf)
    for halving in range(_HALVINGS + 1):
        bounds = _lower_bounds(differences, error)
        ends = np.minimum(*(np.sqrt((differences[:, k].astype(np.float64) ** 2).sum(axis=1)) for k in (0, -1)))
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
        differences, error = _halved(differences[~done]), error + 3
        left, width, pair = np.concatenate([left, left + width]), np.tile(width, 2), np.tile(pair, 2)
    return Closest(first, second, best, start / 1e6, end / 1e6)


def _stretched(points: IntArray, downwash: Fraction) -> tuple[IntArray, int]:
    """Return the points (..., 3) with heights divided by the downwash, and the largest error of a coordinate."""
    shrunk = points.copy()
    heights = points[..., 2].astype(object) * downwash.denominator // downwash.numerator
    shrunk[..., 2] = heights.astype(np.int64)
    # 1/2 from the rounding to fixed point (divided by the downwash), and less than 1 from this one
    return shrunk, 1 + -(-downwash.denominator // (2 * downwash.numerator))


def _lower_bounds(differences: IntArray, error: int) -> IntArray:
    """Return a bound (C,) of the distance from the origin to each hull of control points (C, 6, 3)."""
    directions = np.rint(_DIRECTION * _toward(differences.astype(np.float64))).astype(np.int64)
    projections = (differences * directions[:, np.newaxis]).sum(axis=2).min(axis=1)
    projections -= error * np.abs(directions).sum(axis=1)
    lengths = np.sqrt((directions * directions).sum(axis=1).astype(np.float64)).astype(np.int64) + 1
    return np.asarray(np.where(projections > 0, projections // lengths, 0))


def _toward(hulls: FloatArray) -> FloatArray:
    """Return directions (C, 3) from the origin to about the nearest point of each hull (C, 6, 3): Gilbert's steps."""
    point = hulls.mean(axis=1)
    rows = np.arange(len(hulls))
    for _ in range(_STEPS):
        corner = hulls[rows, (hulls * point[:, np.newaxis]).sum(axis=2).argmin(axis=1)]
        step = corner - point
        square = np.maximum((step * step).sum(axis=1), 1e-300)
        point = point + np.clip(-(point * step).sum(axis=1) / square, 0.0, 1.0)[:, np.newaxis] * step
    return np.asarray(point / np.maximum(np.sqrt((point * point).sum(axis=1)), 1e-300)[:, np.newaxis])


def _halved(points: IntArray) -> IntArray:
    """Return the control points of all left halves (C, 6, 3), then of all right ones: de Casteljau's, rounded down.

    Each of the five stages is off by less than 1/2 more, 3 in all.
    """
    left, right = np.empty_like(points), np.empty_like(points)
    for stage in range(ORDER):
        left[:, stage], right[:, ORDER - 1 - stage] = points[:, 0], points[:, -1]
        points = (points[:, :-1] + points[:, 1:]) >> 1
    return np.concatenate([left, right])
