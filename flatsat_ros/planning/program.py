"""Conic programs handed to Clarabel as they are, and the limits of a B-spline reference as such constraints.

The unknowns are control points and T^4, with T the factor by which knots are stretched. Then everything is convex at
once: with s <= T^2, u <= T^3 and t <= T as further unknowns, which three quadratic cones bound by T^4,

    |F_h| cos eps <= F_3 sin eps + s (g sin eps - m),   |F + s g e3| <= s (T_max - m),   |V| <= t V_max,
    |A| <= s A_max,   |J| <= u J_max,   |S| <= T^4 S_max

where V, A, J, S are the Bezier control points of the derivatives at T = 1, linear in the spline's control points, and F
those of f T^2 (`plans.bounds`). That is A where no drag and lead are known; else parts of it depend on T otherwise,

    F = (1 + drag lead) A + drag T V + lead J / T

and there T is replaced by a value near it, the pace: where a solution has just this T it keeps all limits, and so would
any other with a shorter one. The shortest duration is the minimum of a linear function.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import clarabel
import numpy as np
from scipy import sparse

from flatsat_ros.base.arrays import FloatArray, IntArray
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.curve import DEGREE, ORDER, bezier_weights, elevation, local_knots

# Limits are tightened, so that rounding control points to nanometres breaks none: by _RESERVE, m/s^2, in acceleration,
# and to the share _SHARE otherwise.
_RESERVE = 1e-4
_SHARE = 1.0 - 1e-3

_STEP = 1e-6  # relative change of a leg, for differences that stand for derivatives

ORDERS = 5  # position to snap
UNKNOWNS = 4  # T^4, s, u, t
FOURTH, SQUARE, CUBE, FIRST = range(-UNKNOWNS, 0)

_SOLVED = clarabel.SolverStatus.Solved
_ANSWERS = _SOLVED, clarabel.SolverStatus.PrimalInfeasible  # what leaves nothing to be tried
# Clarabel's largest share of the way to the border of a cone, one after the other until it comes to its own tolerance
_STEP_SHARES = 0.99, 0.9, 0.8

_FIRST_SPAN = np.zeros(1, dtype=np.int64)

Affine = tuple[sparse.csr_matrix, FloatArray]  # of all unknowns: matrix (K, n) and constant (K,)


class Minimum(NamedTuple):
    """What the solver finds.

    Attributes:
        x: (n,) the best that it has found.
        is_least: it came to its own tolerance; otherwise x keeps what is asked less exactly, and may not be the best.
    """

    x: FloatArray
    is_least: bool


class Program:
    """Minimise (x'P x)/2 + q'x over affine functions of x in cones."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._blocks: list[sparse.csr_matrix] = []
        self._constants: list[FloatArray] = []
        self._cones: list[object] = []

    def vanish(self, value: Affine) -> None:
        """Ask for 0."""
        self._add(*value, [clarabel.ZeroConeT(len(value[1]))])

    def be_positive(self, value: Affine) -> None:
        """Ask for at least 0."""
        self._add(*value, [clarabel.NonnegativeConeT(len(value[1]))])

    def bound_norms(self, head: Affine, *parts: Affine) -> None:
        """Ask that each entry of the head bounds the norm of the vector of the parts' entries."""
        count, width = len(head[1]), len(parts) + 1
        rows = np.arange(count * width).reshape(width, count).T.ravel()
        matrix = sparse.vstack([head[0], *(part[0] for part in parts)], format="csr")[rows]
        constant = np.concatenate([head[1], *(part[1] for part in parts)])[rows]
        self._add(matrix, constant, [clarabel.SecondOrderConeT(width)] * count)

    def _add(self, matrix: sparse.csr_matrix, constant: FloatArray, cones: Sequence[object]) -> None:
        self._blocks.append(matrix)
        self._constants.append(constant)
        self._cones.extend(cones)

    def placed(self, matrix: sparse.csr_matrix, column: int) -> sparse.csr_matrix:
        """Return a matrix of the unknowns from `column` on as one of all unknowns."""
        return _placed(matrix, column, self.size)

    def minimised(self, linear: FloatArray, quadratic: sparse.csc_matrix | None = None) -> Minimum | None:
        """Return the best x, or None if there is none or the solver finds none.

        Args:
            linear: q (n,).
            quadratic: P (n, n), the upper triangle; 0 by default.
        """
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.direct_solve_method = "qdldl"  # no kernel of linear algebra that differs between machines
        quadratic = sparse.csc_matrix((self.size, self.size)) if quadratic is None else quadratic
        matrix = -sparse.vstack(self._blocks, format="csc")
        constants, almost = np.concatenate(self._constants), None
        for settings.max_step_fraction in _STEP_SHARES:
            solution = clarabel.DefaultSolver(quadratic, linear, matrix, constants, self._cones, settings).solve()
            if solution.status in _ANSWERS:
                return Minimum(np.asarray(solution.x), True) if solution.status == _SOLVED else None
            if solution.status == clarabel.SolverStatus.AlmostSolved:
                almost = almost or Minimum(np.asarray(solution.x), False)
        return almost


def bezier_matrices(knots: FloatArray, *, closed: bool = False) -> list[sparse.csr_matrix]:
    """Return the matrices from control points (n) to Bezier points of position to snap, span by span.

    Args:
        knots: (M + 1,) s.
        closed: whether the spline is, with n = M control points; otherwise it is clamped, with n = M + 5.

    Returns:
        Of the k-th derivative (M (6 - k), n).
    """
    count = len(knots) - 1
    size = control_points(count, closed=closed)
    weights = bezier_weights(local_knots(knots, closed=closed), knots[:-1], knots[1:])
    found = []
    for order in range(ORDERS):
        if order > 0:
            weights = (ORDER - order) * np.diff(weights, axis=1) / np.diff(knots)[:, np.newaxis, np.newaxis]
        rows = np.repeat(np.arange(count * (ORDER - order)), ORDER)
        columns = np.arange(count)[:, np.newaxis, np.newaxis] + np.zeros((1, ORDER - order, 1), int) + np.arange(ORDER)
        shape = (count * (ORDER - order), size)
        found.append(sparse.csr_matrix((weights.ravel(), (rows, columns.ravel() % size)), shape=shape))
    return found


def control_points(spans: int, *, closed: bool) -> int:
    """Return the number of control points of a spline."""
    return spans if closed else spans + DEGREE


class Derivatives:
    """Bezier points of a reference and of its derivatives as affine functions of control points and of T^4.

    Attributes:
        count: control points n; the unknowns are their x, their y, their z, then T^4, s, u, t.
        size: number of unknowns.
        spans: M.
        pace: what stands for T where a derivative is asked for with another power of it.
    """

    def __init__(self, knots: FloatArray, *, closed: bool = False) -> None:
        self.count = control_points(len(knots) - 1, closed=closed)
        self.size = 3 * self.count + UNKNOWNS
        self.spans = len(knots) - 1
        self.pace = 1.0
        self._matrices = bezier_matrices(knots, closed=closed)

    def axes(self, order: int, power: int | None = None) -> list[Affine]:
        """Return x, y and z of the Bezier points of a derivative, times a power of T; by default its order."""
        matrix = self._matrices[order] * self.pace ** ((order if power is None else power) - order)
        zeros = np.zeros(matrix.shape[0])
        return [(_placed(matrix, axis * self.count, self.size), zeros) for axis in range(3)]

    def distinct(self, order: int) -> IntArray:
        """Return the numbers of the Bezier points of a derivative without the last of a span that is the next's first.

        Derivatives up to the snap are continuous.
        """
        each = ORDER - order
        rows = np.arange(self.spans * each)
        return np.flatnonzero((rows % each < each - 1) | (rows == rows[-1]))

    def power(self, exponent: int, factor: float, spans: IntArray = _FIRST_SPAN, constant: float = 0.0) -> Affine:
        """Return factor times a power of T, from 1 to 4, or less, plus a constant, in a row for each of some spans."""
        rows = len(spans)
        column = sparse.csr_matrix(np.full((rows, 1), factor))
        place = self.size + (FIRST, SQUARE, CUBE, FOURTH)[exponent - 1]
        return _placed(column, place, self.size), np.full(rows, constant)

    def couple(self, program: Program) -> None:
        """Ask that s^2 <= T^4, u^2 <= T^4 s and t^2 <= s."""
        fourth, square, unit = self.power(4, 1.0), self.power(2, 1.0), self.power(4, 0.0, constant=1.0)
        for exponent, a, b in ((2, fourth, unit), (3, fourth, square), (1, square, unit)):
            program.bound_norms(plus(a, b), plus(a, times(-1.0, b)), self.power(exponent, 2.0))

    def points(self, solution: FloatArray) -> FloatArray:
        """Return the control points (n, 3) among the unknowns."""
        return np.asarray(solution[: 3 * self.count].reshape(3, self.count).T)


class Retimed(Derivatives):
    """The same, linear in control points and in the durations of the legs, near given ones; T is 1.

    The unknowns are the control points' x, y, z, then the legs. Both sides of a limit of a k-th derivative are
    multiplied by (h / h0)^k of its leg: what is on the left depends little on the legs then, and what is on the right
    is at least its linear part, so that steps break limits by little.
    """

    def __init__(self, points: FloatArray, legs: FloatArray, spans: int, *, closed: bool = False) -> None:
        """Linearise.

        Args:
            points: (n, 3) m, near which the limits are linearised.
            legs: (L,) s, likewise.
            spans: of a leg.
            closed: whether the spline is.
        """
        super().__init__(_knots(legs, spans), closed=closed)
        self.size = 3 * self.count + len(legs)
        self._legs, self._each = legs, spans
        # of derivatives by the legs, and, divided by the leg, of those of each leg's own points
        self._slopes = [np.zeros((matrix.shape[0], 3, len(legs))) for matrix in self._matrices]
        self._own = [np.zeros_like(slopes) for slopes in self._slopes]
        for leg, duration in enumerate(legs):
            step = np.zeros(len(legs))
            step[leg] = _STEP * duration
            moved = bezier_matrices(_knots(legs + step, spans), closed=closed)
            for order, (before, after) in enumerate(zip(self._matrices, moved, strict=True)):
                own = slice(leg * spans * (ORDER - order), (leg + 1) * spans * (ORDER - order))
                self._slopes[order][:, :, leg] = (after - before) @ points / step[leg]
                self._own[order][own, :, leg] = (before[own] @ points) / duration

    def axes(self, order: int, power: int | None = None) -> list[Affine]:
        """Return x, y and z of the Bezier points of a derivative, times a power of h / h0; by default its order."""
        found, exponent = [], order if power is None else power
        for axis, (matrix, constant) in enumerate(super().axes(order)):
            slopes = self._slopes[order][:, axis] + exponent * self._own[order][:, axis]
            slopes = np.where(np.abs(slopes) > 1e-9, slopes, 0.0)  # a leg matters to few spans
            moved = _placed(sparse.csr_matrix(slopes), 3 * self.count, self.size)
            found.append((matrix + moved, constant - slopes @ self._legs))
        return found

    def power(self, exponent: int, factor: float, spans: IntArray = _FIRST_SPAN, constant: float = 0.0) -> Affine:
        """Return factor times (h / h0)^exponent, or less, plus a constant, in a row for each of some spans."""
        rows, own = len(spans), spans // self._each
        slopes = exponent * factor / self._legs[own]
        column = sparse.csr_matrix((slopes, (np.arange(rows), 3 * self.count + own)), shape=(rows, self.size))
        return column, np.full(rows, (1.0 - exponent) * factor + constant)

    def couple(self, program: Program) -> None:
        """Ask for nothing: T is 1."""

    def legs(self) -> sparse.csr_matrix:
        """Return the matrix (L, size) that takes the legs from the unknowns."""
        return _placed(sparse.identity(len(self._legs), format="csr"), 3 * self.count, self.size)


def keep_limits(program: Program, reference: Derivatives, limits: InputSet, bounds: Bounds) -> None:
    """Ask a program for all limits of one reference, up to a reserve for rounding.

    What a bound of accelerations implies is not asked for again, nor is a point twice: that halves the time.
    """
    reference.couple(program)
    power = reference.power

    def points(order: int) -> tuple[list[Affine], IntArray]:
        rows = reference.distinct(order)
        return [(matrix[rows], constant[rows]) for matrix, constant in reference.axes(order)], rows // (ORDER - order)

    room, margin, gravity = bounds.room(limits), bounds.margin + _RESERVE, limits.gravity
    (x, y, z), spans = asked_points(reference, bounds)
    most = math.inf if bounds.acceleration_max is None or len(bounds.asked) > 1 else _SHARE * bounds.acceleration_max
    sine, cosine = math.sin(limits.tilt_max), math.cos(limits.tilt_max)
    if most > gravity * sine - margin:
        tilt = plus(times(sine, z), power(2, gravity * sine - margin, spans))
        program.bound_norms(tilt, times(cosine, x), times(cosine, y))
    if most > room.thrust_max - margin - gravity:
        lifted = plus(z, power(2, gravity, spans))
        program.bound_norms(power(2, room.thrust_max - margin, spans), x, y, lifted)
    if most > gravity - room.thrust_min - margin and room.thrust_min + margin > margin / sine:  # below the cone's tip
        program.be_positive(plus(z, power(2, gravity - room.thrust_min - margin, spans)))
    for order, bound in (
        (1, bounds.speed_max), (2, bounds.acceleration_max), (3, bounds.jerk_max), (4, bounds.snap_max),
    ):  # fmt: skip
        if bound is not None:
            axes, spans = points(order)
            program.bound_norms(power(order, _SHARE * bound, spans), *axes)
    for axis, low, high in zip(points(0)[0], bounds.lower, bounds.upper, strict=True):
        program.be_positive((axis[0], axis[1] - low))
        program.be_positive((-axis[0], high - axis[1]))


def asked_points(reference: Derivatives, bounds: Bounds) -> tuple[list[Affine], IntArray]:
    """Return x, y and z of the distinct control points of f, times T^2, and the spans that they are of."""
    lowest = min(bounds.asked)
    rows = reference.distinct(lowest)
    total: list[Affine] = []
    for order, factors in bounds.asked.items():
        matrix = sparse.kron(sparse.identity(reference.spans), raising(order, lowest), format="csr")[rows]
        parts = [
            (float(factor) * (matrix @ own), float(factor) * (matrix @ constant))
            for factor, (own, constant) in zip(factors, reference.axes(order, 2), strict=True)
        ]
        total = parts if not total else [plus(a, b) for a, b in zip(total, parts, strict=True)]
    return total, rows // (ORDER - lowest)


def raising(order: int, lower: int) -> FloatArray:
    """Return the matrix from Bezier points of a derivative to as many as a derivative of lower order has."""
    raised, divisor = elevation(DEGREE - order, DEGREE - lower)
    return np.asarray(raised / divisor, dtype=np.float64)


def _knots(legs: FloatArray, spans: int) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.repeat(legs / spans, spans))])


def plus(a: Affine, b: Affine) -> Affine:
    """Return the sum."""
    return a[0] + b[0], a[1] + b[1]


def times(factor: float, a: Affine) -> Affine:
    """Return the product with a number."""
    return factor * a[0], factor * a[1]


def _placed(matrix: sparse.csr_matrix, column: int, size: int) -> sparse.csr_matrix:
    """Return a matrix with its columns from `column` on, of `size` columns."""
    return sparse.csr_matrix((matrix.data, matrix.indices + column, matrix.indptr), shape=(matrix.shape[0], size))
