"""One drone's reference as a B-spline of degree 5 or 7 in whole nanometres and microseconds.

It is clamped, from rest to rest, or closed: one lap, whose knots and control points repeat, so that no derivative up to
the snap can jump where it begins again.

Inner knots of degree 5 count once, so that position to snap are continuous, and those of degree 7 four times: there the
snap jumps from polynomial to polynomial, as at rest, within its bound. Integers
leave nothing to rounding: what is said about a curve is said about exactly these numbers. On every interval between
knots the curve is a polynomial, and so are its derivatives; their Bezier control points, whose convex hull holds them,
are rational combinations of the spline's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray, IntArray
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.flight.trajectory import SIZE, Trajectory

DEGREE = 5
ORDER = DEGREE + 1  # control points of one span
DEGREES = (DEGREE, 7)
AT_REST = 4  # equal control points at an end: velocity, acceleration and jerk are 0 there

NANOMETRE = Fraction(1, 10**9)  # m
MICROSECOND = Fraction(1, 10**6)  # s
UNIT = 2**30  # of a metre, and of a m/s, ...: fixed-point numbers of the proofs

FARTHEST = 500 * 10**9  # nm: differences of positions times directions of 20 bits fit 64 bits
_LONGEST = 3600 * 10**6  # us
_NAMES = ("position", "velocity", "acceleration", "jerk", "snap")

Exact = NDArray[np.object_]  # of Python integers or fractions


@dataclass(frozen=True)
class Curve:
    """A reference from rest to rest, which stands still before its start and after its end; or one lap of a closed one.

    Attributes:
        knots: distinct ones, us, increasing from 0; the curve has one span fewer.
        points: (spans + 5) control points (x, y, z), nm, world frame, for degree 7 (4 spans + 4); the first four are
            equal, and the last four. Of a closed curve (spans).
        degree: 5; or 7, of references that come from elsewhere.
        closed: whether knots and control points go on from the beginning after the end.

    Raises:
        FlatsatError: the knots do not increase from 0, the number of control points is another, one lies farther than
            500 m from the origin, or the curve does neither begin and end at rest nor is closed.
    """

    knots: tuple[int, ...]
    points: tuple[tuple[int, int, int], ...]
    degree: int = DEGREE
    closed: bool = False

    def __post_init__(self) -> None:
        knots, points = self.knots, self.points
        increasing = len(knots) > 1 and knots[0] == 0 and all(a < b for a, b in itertools.pairwise(knots))
        require(increasing, "knots", knots, "us", "two or more, increasing from 0")
        require(knots[-1] <= _LONGEST, "the last knot", knots[-1], "us", f"at most {_LONGEST} us, an hour")
        require(self.degree in DEGREES, "degree", self.degree, "", " or ".join(map(str, DEGREES)))
        more = 0 if self.closed else self.degree + 1 - self._step
        count = self._step * (len(knots) - 1) + more
        spans = f"{count}, {more} more than {'the' if self.degree == DEGREE else 'four times the'} spans"
        if self.closed:
            require(self.degree == DEGREE, "degree of a closed curve", self.degree, "", str(DEGREE))
            require(count >= ORDER, "number of spans of a closed curve", count, "", f"at least {ORDER}")
        require(len(points) == count, "number of control points", len(points), "", spans)
        farthest = max(abs(value) for point in points for value in point)
        require(farthest <= FARTHEST, "a coordinate", farthest, "nm", f"at most {FARTHEST} nm from 0")
        for end, ends in (("first", points[:AT_REST]), ("last", points[-AT_REST:])):
            if len(set(ends)) > 1 and not self.closed:
                raise FlatsatError(f"the {end} {AT_REST} control points differ: must be equal, the curve's rest there")

    @classmethod
    def rounded(cls, knots: Sequence[int], points: FloatArray, degree: int = DEGREE, *, closed: bool = False) -> Curve:
        """Return the curve with control points in metres, rounded to nanometres.

        Args:
            knots: us, as the class has them.
            points: (n, 3) m, world frame.
            degree: 5 or 7.
            closed: whether it is one lap that begins again where it ends.
        """
        whole = np.rint(points * 1e9).astype(np.int64).tolist()
        return cls(tuple(knots), tuple((x, y, z) for x, y, z in whole), degree, closed)

    @property
    def _step(self) -> int:
        """How often inner knots count, and how many control points the curve has more for each span."""
        return 1 if self.degree == DEGREE else 4

    @property
    def duration(self) -> float:
        """From the first to the last knot, s."""
        return float(self.knots[-1] * MICROSECOND)

    def bezier(self, order: int = 0, edges: Sequence[int] | None = None) -> tuple[Exact, Exact]:
        """Return the exact Bezier control points of a derivative on each interval.

        Args:
            order: 0 position, 1 velocity, ... 4 snap.
            edges: (E + 1) us, among them all knots; by default the knots.

        Returns:
            Integers (E, degree + 1 - order, 3), and what to divide them by to have m, m/s, ...: integers (E,).
        """
        edges = self.knots if edges is None else edges
        weights, divisors, first = self._weights(edges)
        points = np.array(self.points, dtype=object)
        values = weights @ points[(first[:, np.newaxis] + np.arange(self.degree + 1)) % len(points)]
        for degree in range(self.degree, self.degree - order, -1):
            values = degree * (values[:, 1:] - values[:, :-1])
        lengths = np.array([b - a for a, b in itertools.pairwise(edges)], dtype=object)
        return values * 10 ** (6 * order), divisors * lengths**order * 10**9

    def fixed(self, order: int = 0, edges: Sequence[int] | None = None) -> IntArray:
        """Return `bezier` as fixed-point numbers (E, degree + 1 - order, 3), UNIT for 1 m, m/s, ...: off by up to 1/2.

        The arguments are those of `bezier`.

        Raises:
            FlatsatError: a value is beyond 2^40 of these units; about 1000 m, m/s, ...
        """
        return _fixed(*self.bezier(order, edges), _NAMES[order])

    def fixed_sum(self, factors: Mapping[int, Sequence[Fraction]], name: str) -> IntArray:
        """Return the control points of a sum of derivatives, as `fixed`, of the degree of the lowest of them.

        Args:
            factors: of the derivatives, by their order, along x, y and z.
            name: of the sum, for the error.

        Raises:
            FlatsatError: a value is beyond 2^40 of the units.
        """
        highest, degree = max(factors), self.degree - min(factors)
        whole = math.lcm(*(factor.denominator for each in factors.values() for factor in each))
        lengths = np.diff(np.array(self.knots, dtype=object))
        total, common = np.zeros((len(lengths), degree + 1, 3), dtype=object), np.ones_like(lengths)
        for order, each in factors.items():
            values, divisors = self.bezier(order)
            raised, parts = elevation(self.degree - order, degree)
            weights = np.array([int(factor * whole) for factor in each], dtype=object)
            scale = lengths ** (highest - order)
            total += scale[:, np.newaxis, np.newaxis] * (raised @ values) * weights
            common = scale * divisors * (parts * whole)  # the same for all of them
        return _fixed(total, common, name)

    def trajectory(self, yaw: float = 0.0) -> Trajectory:
        """Return the same polynomials in floats, from time 0 on, with a yaw, rad; one lap if the curve is closed."""
        values, divisors = self.bezier()
        points = (values / divisors[:, np.newaxis, np.newaxis]).astype(np.float64)
        times = np.array(self.knots) / 1e6
        coefficients = np.zeros((len(times) - 1, SIZE, 3))
        for power in range(self.degree + 1):
            leading = math.comb(self.degree, power) * points[:, 0]
            coefficients[:, power] = leading / np.diff(times)[:, np.newaxis] ** power
            points = np.diff(points, axis=1)
        return Trajectory(times, coefficients, yaw)

    def _weights(self, edges: Sequence[int]) -> tuple[Exact, Exact, IntArray]:
        """Return square matrices of integers, what to divide them by (E,), and their first control points (E,)."""
        padded = self.padded
        spans = np.searchsorted(self.knots, edges[:-1], side="right") - 1
        known: dict[tuple[int, ...], int] = {}
        numbers = []
        for span, left, right in zip(spans.tolist(), edges, edges[1:], strict=False):
            if left >= self.knots[-1]:  # it stands at its last control point
                local: tuple[int, ...] = ()
            else:
                first = self._step * span
                local = tuple(knot - left for knot in (*padded[first : first + 2 * self.degree], right))
                scale = math.gcd(*local)
                local = tuple(knot // scale for knot in local)
            numbers.append(known.setdefault(local, len(known)))
        table = [_exact_weights(local, self.degree) for local in known]
        weights = np.array([table[number][0] for number in numbers], dtype=object)
        divisors = np.array([table[number][1] for number in numbers], dtype=object)
        return weights, divisors, self._step * np.minimum(spans, len(self.knots) - 2)

    @property
    def padded(self) -> tuple[int, ...]:
        """All knots as often as they count, us; those at the ends as often as the polynomials depend on them.

        Before and after a lap of a closed curve there are those of the laps beside it.
        """
        first, *inner, last = self.knots
        if self.closed:
            near = self.degree - 1
            return (*(knot - last for knot in self.knots[-1 - near : -1]), *self.knots,
                    *(knot + last for knot in self.knots[1 : 1 + near]))  # fmt: skip
        repeated = [knot for knot in inner for _ in range(self._step)]
        return (*[first] * self.degree, *repeated, *[last] * self.degree)


@lru_cache(maxsize=32)
def elevation(degree: int, higher: int) -> tuple[Exact, int]:
    """Return the matrix from a polynomial's Bezier points to those of the same one as one of a higher degree.

    Returns:
        Integers (higher + 1, degree + 1), and what to divide them by, which depends on the higher degree alone.
    """
    divisor = math.lcm(*(math.comb(higher, i) for i in range(higher + 1)))
    found = np.zeros((higher + 1, degree + 1), dtype=object)
    for i in range(higher + 1):
        for j in range(max(0, i - higher + degree), min(i, degree) + 1):
            weight = math.comb(degree, j) * math.comb(higher - degree, i - j)
            found[i, j] = weight * divisor // math.comb(higher, i)
    return found, divisor


def _fixed(values: Exact, divisors: Exact, name: str) -> IntArray:
    """Return quotients, rounded, as fixed-point numbers; the divisors (E,) are those of values (E, ...)."""
    divisors = divisors[:, np.newaxis, np.newaxis]
    rounded = (2 * UNIT * values + divisors) // (2 * divisors)
    largest = max(map(abs, rounded.ravel()))
    if largest >= 2**40:
        raise refusal(f"{name} of a control point", largest / UNIT, "in SI units", "below 1024")
    return np.asarray(rounded, dtype=np.int64)


def local_knots(knots: FloatArray, *, closed: bool = False) -> FloatArray:
    """Return the ten knots (M, 10) that the polynomial of each span depends on, of the knots (M + 1,).

    Args:
        knots: distinct ones.
        closed: whether they repeat after the last one; otherwise they are clamped.
    """
    near, lap = DEGREE - 1, knots[-1] - knots[0]
    before = knots[-1 - near : -1] - lap if closed else np.repeat(knots[:1], near)
    after = knots[1 : 1 + near] + lap if closed else np.repeat(knots[-1:], near)
    padded = np.concatenate([before, knots, after])
    return np.asarray(padded[np.arange(len(knots) - 1)[:, np.newaxis] + np.arange(2 * DEGREE)])


def bezier_weights(local: Any, left: Any, right: Any) -> Any:
    """Return the matrices that take six control points of a B-spline to Bezier control points on intervals.

    The k-th Bezier point is the polynomial's blossom at (5 - k) times the left end and k times the right end, by de
    Boor's recursion with another argument at each level.

    Args:
        local: (E, 10) knots around the span of each interval; floats or fractions.
        left: (E,) where the interval begins.
        right: (E,) where it ends.

    Returns:
        (E, 6, 6) of the same type.
    """
    degree = local.shape[1] // 2
    order = degree + 1
    ends = np.where(np.arange(1, order) <= degree - np.arange(order)[:, np.newaxis], 0, 1)  # which end
    arguments = np.stack([left, right], axis=-1)[:, ends]
    weights = np.broadcast_to(np.eye(order, dtype=int).astype(local.dtype), (len(local), order, order, order))
    for level in range(1, order):
        low, high = local[:, np.newaxis, level - 1 : degree], local[:, np.newaxis, degree : order + degree - level]
        share = (arguments[:, :, level - 1, np.newaxis] - low) / (high - low)
        weights = weights[:, :, :-1] + share[..., np.newaxis] * (weights[:, :, 1:] - weights[:, :, :-1])
    return weights[:, :, 0]


@lru_cache(maxsize=10_000)  # derivatives and drones share their knots
def _exact_weights(local: tuple[int, ...], degree: int) -> tuple[Exact, int]:
    """Return integers and their common divisor, for knots and the right end, relative to the left end."""
    if not local:
        rest = np.zeros((degree + 1, degree + 1), dtype=object)
        rest[:, -1] = 1
        return rest, 1
    *knots, right = (Fraction(value) for value in local)
    ends = np.array([Fraction(0)], dtype=object), np.array([right], dtype=object)
    weights = bezier_weights(np.array([knots], dtype=object), *ends)[0]
    divisor = math.lcm(*(Fraction(value).denominator for value in weights.ravel()))
    return np.array([[int(value * divisor) for value in row] for row in weights], dtype=object), divisor
