"""How near drones come to each other: references from now on, exactly enough, and measured places at one moment.

The air below a drone is blown down, and a drone that flies into it loses lift over several of its own lengths; beside
it there is nothing like that. So heights count by half, 1/DOWNWASH, in the distance of two drones in the air,

    d = |(dx, dy, dz / 2)|,

which must not fall below the separation: an ellipsoid that is twice as high as it is wide (an ellipsoid for this reason
is the model of Preiss, Hoenig, Ayanian and Sukhatme, Downwash-Aware Trajectory Planning for Large Quadrotor Teams,
IROS 2017). A drone that stands is not blown about: distances from it count as they are.

The difference of two references is a polynomial on each stretch between their times. It is nowhere farther from its
chord than its Bernstein control points are from those of the chord. What the chord is away from the origin, minus that,
is a lower bound of d on the stretch; stretches on which it does not decide are halved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.trajectory import SIZE, Trajectory

DOWNWASH = 2.0
IN_THE_AIR = np.array([1.0, 1.0, 1.0 / DOWNWASH])
STANDING = np.ones(3)

# the distance found is at most this much, m, below the true one
TOLERANCE = 0.005
_HALVINGS = 40

_DEGREE = SIZE - 1
_POWERS = np.arange(SIZE)
_CHOOSE = np.array([[math.comb(i, j) for j in range(SIZE)] for i in range(SIZE)], dtype=float)
_EXPONENTS = np.maximum(_POWERS[:, np.newaxis] - _POWERS, 0)
# from coefficients of powers of [0, 1] to control points, and from those to the ones of either half
_CONTROL = _CHOOSE / _CHOOSE[_DEGREE]
_LEFT = _CHOOSE * 0.5 ** _POWERS[:, np.newaxis]
_RIGHT = _LEFT[::-1, ::-1]
_SHARES = _POWERS[:, np.newaxis] / _DEGREE
_TINY = 1e-300


class PreparedTrajectory:
    """A trajectory prepared for distances: rest before its start, its segments, rest after its end.

    Attributes:
        times: (M,) s, between those.
        low, high: (M + 1, 3) m, a box around each.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        """Prepare a trajectory."""
        self.times = times = trajectory.times
        rest = np.zeros((2, SIZE, 3))
        rest[0, 0], rest[1, 0] = trajectory.coefficients[0, 0], trajectory.end
        moving = trajectory.coefficients[: times.size - 1]
        self._coefficients = np.concatenate([rest[:1], moving, rest[1:]])
        self._origin = np.concatenate([times[:1], times])
        points = _control(self._coefficients, np.zeros(times.size + 1), np.diff(self._origin, append=times[-1]))
        self.low, self.high = points.min(axis=1), points.max(axis=1)

    @property
    def end(self) -> FloatArray:
        """Where it rests in the end, (3,) m."""
        return np.asarray(self.low[-1])

    def at(self, time: float) -> FloatArray:
        """Return the place (3,), m, at a time, s."""
        now = np.array([time])
        return np.asarray(self.control(self.segments(now), now, now)[0, 0])

    def segments(self, times: FloatArray) -> np.ndarray:
        """Return the number of what begins or goes on at times, s."""
        return np.searchsorted(self.times, times, side="right")

    def control(self, segments: np.ndarray, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return the control points (K, 8, 3), m, of segments between times, s."""
        return _control(self._coefficients[segments], begins - self._origin[segments], ends - begins)


def _control(coefficients: FloatArray, begins: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return the control points (K, 8, d) of polynomials (K, 8, d) between begins and begins + lengths, (K,) s."""
    shift = _CHOOSE * begins[:, np.newaxis, np.newaxis] ** _EXPONENTS
    powers = shift.transpose(0, 2, 1) @ coefficients
    return np.asarray(_CONTROL @ (powers * (lengths[:, np.newaxis] ** _POWERS)[..., np.newaxis]))


def closest_approaches(
    own: PreparedTrajectory,
    others: Sequence[PreparedTrajectory],
    scales: FloatArray,
    enough: FloatArray,
    now: float,
    until: float = math.inf,
) -> tuple[FloatArray, FloatArray]:
    """Return how near one reference comes to K others, and when.

    Args:
        own: the one.
        others: the K others.
        scales: (K, 3) by how much each axis counts.
        enough: (K,) m; larger distances need not be told apart.
        now: s, from when on.
        until: s, until when.

    Returns:
        (K,) m, at most the true least distance, and at least that or `enough`, whichever is less, minus TOLERANCE; (K,)
        s, when it is so near, if it is nearer than enough.
    """
    count = len(others)
    best, when = np.full(count, math.inf), np.full(count, float(now))
    found = [_stretches(own, other, scales[i], float(enough[i]), now, until) for i, other in enumerate(others)]
    pair = np.repeat(np.arange(count), [len(points) for points, _, _ in found])
    points = np.concatenate([points for points, _, _ in found]) if found else np.zeros((0, SIZE, 3))
    begin = np.concatenate([begins for _, begins, _ in found]) if found else np.zeros(0)
    length = np.concatenate([lengths for _, _, lengths in found]) if found else np.zeros(0)
    for _ in range(_HALVINGS):
        if not pair.size:
            break
        at_ends = np.sqrt((points[:, [0, -1]] ** 2).sum(axis=2))
        last = at_ends[:, 1] < at_ends[:, 0]
        value = np.where(last, at_ends[:, 1], at_ends[:, 0])
        order = np.argsort(-value)  # of those written to the same place, the last and least stays
        least, at = np.full(count, math.inf), when.copy()
        least[pair[order]] = value[order]
        at[pair[order]] = (begin + np.where(last, length, 0.0))[order]
        when = np.where(least < best, at, when)
        best = np.minimum(best, least)

        going_on = _lower_bound(points) < np.minimum(best, enough)[pair] - TOLERANCE
        pair, points, begin, length = pair[going_on], points[going_on], begin[going_on], length[going_on] / 2.0
        points = np.concatenate([_LEFT @ points, _RIGHT @ points])
        pair, begin, length = np.tile(pair, 2), np.concatenate([begin, begin + length]), np.tile(length, 2)
    return np.maximum(np.minimum(best, enough) - TOLERANCE, 0.0), when


def _stretches(
    own: PreparedTrajectory, other: PreparedTrajectory, scale: FloatArray, enough: float, now: float, until: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the difference of two references on the stretches where their boxes are near.

    Returns:
        Control points (K, 8, 3), m, begins (K,) and lengths (K,), s.
    """
    times = np.concatenate([own.times, other.times])
    edges = np.unique(np.concatenate([[now], times[(times > now) & (times < until)]]))
    begins, ends = edges, np.append(edges[1:], until if math.isfinite(until) else edges[-1])
    mine, theirs = own.segments(begins), other.segments(begins)
    gap = np.maximum(own.low[mine] - other.high[theirs], other.low[theirs] - own.high[mine])
    near = ((np.maximum(gap, 0.0) * scale) ** 2).sum(axis=1) < enough**2
    mine, theirs, begins, ends = mine[near], theirs[near], begins[near], ends[near]
    return (own.control(mine, begins, ends) - other.control(theirs, begins, ends)) * scale, begins, ends - begins


def _lower_bound(points: FloatArray) -> FloatArray:
    """Return a lower bound (K,) of the distance from the origin of polynomials with control points (K, 8, 3)."""
    first, way = points[:, 0], points[:, -1] - points[:, 0]
    share = np.clip(-(first * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), _TINY), 0.0, 1.0)
    nearest = first + share[:, np.newaxis] * way
    off = points - (first[:, np.newaxis] + _SHARES * way[:, np.newaxis])
    return np.asarray(np.sqrt((nearest * nearest).sum(axis=1)) - np.sqrt((off * off).sum(axis=2)).max(axis=1))


def near_pairs(places: FloatArray, aloft: np.ndarray, limit: float) -> tuple[list[tuple[int, int, float]], float]:
    """Return who is nearer to whom than a limit, and the least distance of any two.

    Args:
        places: (N, 3) m.
        aloft: (N,) who is in the air; others do not count.
        limit: m.

    Returns:
        Pairs with their distances, m, and the least distance, m, infinite for fewer than two in the air.
    """
    flying = np.flatnonzero(aloft)
    if flying.size < 2:
        return [], math.inf
    scaled = places[flying] * IN_THE_AIR
    products = scaled @ scaled.T
    square = products.diagonal()
    apart = square[:, np.newaxis] + square - 2.0 * products
    apart.ravel()[:: flying.size + 1] = math.inf
    least = math.sqrt(max(float(apart.min()), 0.0))
    if least >= limit:
        return [], least
    near = np.argwhere(np.triu(apart < limit * limit))
    pairs = [(int(flying[i]), int(flying[j]), math.sqrt(max(float(apart[i, j]), 0.0))) for i, j in near]
    return pairs, least
