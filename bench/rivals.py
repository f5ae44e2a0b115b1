"""The same saturation by solvers: max lambda with base + lambda v in V_c and lambda <= cap, one conic program a drone.

    |base + lambda v + g e3| <= T_max,   |base_h + lambda v_h| <= tan(eps_max) (base_3 + lambda v_3 + g)

Each rival is set up once and then only given new data, the cheapest way of using it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import clarabel
import cvxpy as cp
import numpy as np
import osqp
from scipy import sparse

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.law.input_set import InputSet

SIDES = 16


class OneByOne(ABC):
    """A way of saturating one drone after the other."""

    name: str

    @abstractmethod
    def factor(self, base: FloatArray, v: FloatArray, cap: float) -> float:
        """Return lambda of one drone: base and v are (3,), m/s^2."""

    def solve(self, base: FloatArray, v: FloatArray, cap: FloatArray) -> FloatArray:
        """Return lambda (N,) of N drones: base and v are (N, 3), m/s^2, cap is (N,)."""
        return np.array([self.factor(*drone) for drone in zip(base, v, cap.tolist(), strict=True)])


class CvxpyEach(OneByOne):
    """cvxpy and Clarabel: one parametrised problem (DPP), compiled once, solved for each drone."""

    name = "cvxpy + Clarabel"

    def __init__(self, limits: InputSet) -> None:
        self._factor = cp.Variable()
        self._base, self._v, self._cap = cp.Parameter(3), cp.Parameter(3), cp.Parameter(nonneg=True)
        up = self._base + self._factor * self._v + np.array([0.0, 0.0, limits.gravity])
        self._problem = cp.Problem(
            cp.Maximize(self._factor),
            [
                self._factor <= self._cap,
                cp.norm(up) <= limits.thrust_max,
                cp.norm(up[:2]) <= math.tan(limits.tilt_max) * up[2],
            ],
        )

    def factor(self, base: FloatArray, v: FloatArray, cap: float) -> float:
        """Return lambda of one drone."""
        self._base.value, self._v.value, self._cap.value = base, v, cap
        self._problem.solve(solver=cp.CLARABEL)
        return float(self._factor.value)


class CvxpyAtOnce:
    """cvxpy and Clarabel: the drones of a batch side by side in one parametrised problem, compiled once."""

    name = "cvxpy, one problem"

    def __init__(self, limits: InputSet, count: int) -> None:
        self._factors = cp.Variable((count, 1))
        self._base, self._v = cp.Parameter((count, 3)), cp.Parameter((count, 3))
        self._cap = cp.Parameter((count, 1), nonneg=True)
        up = self._base + cp.multiply(self._factors @ np.ones((1, 3)), self._v) + np.array([[0.0, 0.0, limits.gravity]])
        self._problem = cp.Problem(
            cp.Maximize(cp.sum(self._factors)),
            [
                self._factors <= self._cap,
                cp.norm(up, axis=1) <= limits.thrust_max,
                cp.norm(up[:, :2], axis=1) <= math.tan(limits.tilt_max) * up[:, 2],
            ],
        )

    def solve(self, base: FloatArray, v: FloatArray, cap: FloatArray) -> FloatArray:
        """Return lambda (N,) of N drones: base and v are (N, 3), m/s^2, cap is (N,)."""
        self._base.value, self._v.value, self._cap.value = base, v, cap[:, np.newaxis]
        self._problem.solve(solver=cp.CLARABEL)
        return np.asarray(self._factors.value)[:, 0]


class RawClarabel(OneByOne):
    """Clarabel without cvxpy: one solver object, its data updated for each drone."""

    name = "raw Clarabel"

    def __init__(self, limits: InputSet) -> None:
        self._thrust, self._slope, self._g = limits.thrust_max, math.tan(limits.tilt_max), limits.gravity
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.presolve_enable = False  # would forbid updates
        cones = [clarabel.NonnegativeConeT(1), clarabel.SecondOrderConeT(4), clarabel.SecondOrderConeT(3)]
        column, bound = self._data(np.zeros(3), np.ones(3), 1.0)
        matrix = sparse.csc_matrix((column, np.arange(8), [0, 8]), shape=(8, 1))
        self._solver = clarabel.DefaultSolver(
            sparse.csc_matrix((1, 1)), np.array([-1.0]), matrix, bound, cones, settings
        )

    def _data(self, base: FloatArray, v: FloatArray, cap: float) -> tuple[FloatArray, FloatArray]:
        """Return A (8,) and b (8,) of b - A lambda in the cones."""
        (p1, p2, p3), (v1, v2, v3) = base.tolist(), v.tolist()
        slope, up = self._slope, p3 + self._g
        return (
            np.array([1.0, 0.0, -v1, -v2, -v3, -slope * v3, -v1, -v2]),
            np.array([cap, self._thrust, p1, p2, up, slope * up, p1, p2]),
        )

    def factor(self, base: FloatArray, v: FloatArray, cap: float) -> float:
        """Return lambda of one drone."""
        column, bound = self._data(base, v, cap)
        self._solver.update(A=column, b=bound)
        return float(self._solver.solve().x[0])


class Osqp16(OneByOne):
    """OSQP with a polytope around V_c: 16 half-spaces touch the cone, one touches the sphere, at its top.

    A point of it has |v_h| <= tan(eps) (v_3 + g) / cos(pi/16), a tilt of at most eps', and v_3 + g <= T_max, a thrust
    of at most T_max / cos(eps'): it lies in `around`, the input set with these limits, which bounds the approximation.
    """

    name = f"OSQP, {SIDES} sides"

    def __init__(self, limits: InputSet) -> None:
        self._thrust, self._slope, self._g = limits.thrust_max, math.tan(limits.tilt_max), limits.gravity
        angles = 2.0 * np.pi / SIDES * np.arange(SIDES)
        self._normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        tilt = math.atan(self._slope / math.cos(math.pi / SIDES))
        self.around = InputSet(limits.thrust_max / math.cos(tilt), tilt, limits.gravity)
        column, bound = self._data(np.zeros(3), np.array([1.0, 2.0, 3.0]), 1.0)
        matrix = sparse.csc_matrix((column, np.arange(len(column)), [0, len(column)]), shape=(len(column), 1))
        self._solver = osqp.OSQP()
        self._solver.setup(
            P=sparse.csc_matrix((1, 1)),
            q=np.array([-1.0]),
            A=matrix,
            l=np.full(len(column), -np.inf),
            u=bound,
            verbose=False,
            eps_abs=1e-6,
            eps_rel=1e-6,
        )

    def _data(self, base: FloatArray, v: FloatArray, cap: float) -> tuple[FloatArray, FloatArray]:
        """Return A (18,) and b (18,) of A lambda <= b."""
        return (
            np.concatenate([[1.0], self._normals @ v[:2] - self._slope * v[2], [v[2]]]),
            np.concatenate([
                [cap],
                self._slope * (base[2] + self._g) - self._normals @ base[:2],
                [self._thrust - self._g - base[2]],
            ]),
        )  # fmt: skip

    def factor(self, base: FloatArray, v: FloatArray, cap: float) -> float:
        """Return lambda of one drone."""
        column, bound = self._data(base, v, cap)
        self._solver.update(Ax=column, u=bound)
        return float(self._solver.solve().x[0])
