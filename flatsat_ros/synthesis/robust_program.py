"""The paper's semidefinite program of its Proposition 3, with a line search over the rate beta."""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.synthesis.solver import solve

_A = np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(3))
_B = np.kron([[0.0], [1.0]], np.eye(3))


def line_search(box: FloatArray, drift: FloatArray, push: FloatArray) -> float:
    """Return the largest beta, 1/s, that the semidefinite program allows.

    Raises:
        FlatsatError: the solver failed, or no beta is feasible.
    """
    too_large = 1.01 * float(box.max()) ** 2  # without disturbance P22 = beta
    rate = too_large
    while missing(rate, box, drift, push) > 0.0:
        too_large, rate = rate, rate / 1.2
        if rate < 1e-3:
            raise FlatsatError("the semidefinite program is infeasible for every rate (beta) above 1e-3 1/s")
    while too_large - rate > 1e-7 * rate:
        middle = (rate + too_large) / 2.0
        rate, too_large = (middle, too_large) if missing(middle, box, drift, push) <= 0.0 else (rate, middle)
    return rate


def missing(rate: float, box: FloatArray, drift: FloatArray, push: FloatArray) -> float:
    """Return by how much the robust condition fails at least for a Q that meets the box conditions; <= 0 if feasible.

    The program always has a solution, so that its feasibility is read off an optimum and not off a solver's status.

    Raises:
        FlatsatError: the solver did not report an optimum.
    """
    scaled, units, residual = _program(rate, drift, push)
    amount = cp.Variable()
    conditions = [residual << amount * np.eye(6)]
    for i, width in enumerate(box[[0, 0, 1]]):
        row = _B[:, [i]].T @ units / width
        conditions.append(cp.bmat([[np.eye(1), row], [row.T, scaled]]) >> 0)
    solve("box", cp.Problem(cp.Minimize(amount), conditions))
    return float(amount.value)


def largest_spread(rate: float, drift: FloatArray, push: FloatArray) -> FloatArray:
    """Return the largest Q (6, 6) that meets the robust condition.

    Raises:
        FlatsatError: the solver did not report an optimum, or there is none.
    """
    scaled, units, residual = _program(rate, drift, push)
    solve("robust", cp.Problem(cp.Maximize(cp.trace(scaled)), [residual << 0, scaled >> 0]))
    inverse_units = np.linalg.inv(units)
    return np.asarray(inverse_units @ scaled.value @ inverse_units, dtype=np.float64)


def _program(rate: float, drift: FloatArray, push: FloatArray) -> tuple[cp.Variable, FloatArray, cp.Expression]:
    """Return Q and the left side of the robust condition, in units (6, 6) in which both have entries of order 1."""
    units = np.asarray(np.kron(np.diag([rate**1.5, rate**0.5]), np.eye(3)), dtype=np.float64)
    inverse_units = np.linalg.inv(units)
    scaled = cp.Variable((6, 6), symmetric=True)
    Q = inverse_units @ scaled @ inverse_units
    shake = np.diag(np.concatenate([drift[[0, 0, 1]], push[[0, 0, 1]]]) ** 2)
    condition = Q @ _A.T + _A @ Q - 2.0 * _B @ _B.T + rate * Q + shake / rate
    return scaled, units, units @ condition @ units / rate
