"""References of one spline space through way-points at given knots: all of them smooth, each given by few parameters.

A reference is a fixed part, the one of least jerk through its way-points, plus modes: shapes that are 0 at the
way-points, ordered by how much jerk they cost. In these coordinates a search is well conditioned.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import eigh, null_space

from flatsat_ros.base.arrays import FloatArray, IntArray
from flatsat_ros.planning.program import bezier_matrices, control_points
from flatsat_ros.plans.curve import AT_REST, ORDER

# integrals over [0, 1] of products of the Bernstein polynomials of degree 2
_SQUARES = np.array([[6.0, 3.0, 1.0], [3.0, 4.0, 3.0], [1.0, 3.0, 6.0]]) / 30.0


@dataclass(frozen=True, eq=False)
class Shapes:
    """The references with given spans and way-points at some of their ends.

    Attributes:
        lengths: (M,) of the spans, in a unit of time that the user chooses.
        passed: (W,) numbers of the knots where way-points are passed; 0 and M are the first and the last.
        closed: whether the references begin again where they end, instead of resting at both ends.
    """

    lengths: IntArray
    passed: IntArray
    closed: bool = False

    @cached_property
    def knots(self) -> FloatArray:
        """(M + 1,) from 0 to 1."""
        whole = np.concatenate([[0], np.cumsum(self.lengths)])
        return np.asarray(whole / whole[-1])

    @property
    def count(self) -> int:
        """Number of control points."""
        return control_points(len(self.lengths), closed=self.closed)

    @cached_property
    def bezier(self) -> list[FloatArray]:
        """Matrices from control points to the Bezier points of position to snap, for a duration of 1."""
        return [matrix.toarray() for matrix in bezier_matrices(self.knots, closed=self.closed)]

    @cached_property
    def jerk(self) -> FloatArray:
        """(n, n) quadratic form of control points: the integral of the squared jerk."""
        spans = self.bezier[3].reshape(len(self.lengths), 3, self.count)
        widths = np.diff(self.knots)[:, np.newaxis, np.newaxis]
        return np.asarray((widths * (spans.transpose(0, 2, 1) @ _SQUARES @ spans)).sum(axis=0))

    @cached_property
    def pinned(self) -> FloatArray:
        """(P, n) what way-points fix: four control points at each end, and the positions in between.

        P = 8 + W - 2; of closed references it is W - 1, the positions at all way-points but the last.
        """
        if self.closed:
            return self.bezier[0][self.passed[:-1] * ORDER]
        ends = np.eye(self.count)
        inner = self.bezier[0][self.passed[1:-1] * ORDER]
        return np.concatenate([ends[:AT_REST], inner, ends[-AT_REST:]])

    @cached_property
    def _spread(self) -> FloatArray:
        """(P, W) which way-point each row of `pinned` belongs to."""
        if self.closed:
            return np.eye(len(self.passed))[:-1]
        first, last = np.zeros((2, AT_REST, len(self.passed)))
        first[:, 0], last[:, -1] = 1.0, 1.0
        return np.concatenate([first, np.eye(len(self.passed))[1:-1], last])

    def targets(self, waypoints: FloatArray) -> FloatArray:
        """Return what `pinned` times the control points must be, for way-points (W, d)."""
        return np.asarray(self._spread @ waypoints)

    @cached_property
    def fixed(self) -> FloatArray:
        """(n, W) control points of the reference of least jerk, as a linear function of the way-points."""
        rows = len(self.pinned)
        system = np.block([[self.jerk, self.pinned.T], [self.pinned, np.zeros((rows, rows))]])
        right = np.concatenate([np.zeros((self.count, len(self.passed))), self._spread])
        scale = np.abs(self.jerk).max()
        system[: self.count, : self.count] /= scale
        return np.asarray(np.linalg.solve(system, right)[: self.count])

    @cached_property
    def modes(self) -> FloatArray:
        """(n, F) control points of each mode, of equal cost in jerk; the first moves the reference by up to 1 m."""
        free = null_space(self.pinned)
        costs, vectors = eigh(free.T @ self.jerk @ free)
        modes = free @ (vectors / np.sqrt(costs))
        modes *= np.where(modes.sum(axis=0) < 0.0, -1.0, 1.0)
        return np.asarray(modes / np.abs(self.bezier[0] @ modes[:, 0]).max())
