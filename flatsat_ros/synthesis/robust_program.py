"""The paper's semidefinite program of its Proposition 3, with a line search over the rate beta."""

from __future__ import annotations

import math
from collections.abc import Callable

import cvxpy as cp
import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.synthesis.solver import UnsolvedError, solve

_A = np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(3))
_B = np.kron([[0.0], [1.0]], np.eye(3))

# The steps in which an allowed rate is looked for, and the share of the first at which the search ends.
_STEP, _END = 1.2, 1e-6

# To this the rate is looked for, and to this it must be known, relatively.
_RESOLUTION, TOLERANCE = 1e-7, 1e-5

# Smaller amounts, in the units of `missing`, the solver does not tell from 0.
_ACCURACY = 1e-8

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def line_search(box: FloatArray, drift: FloatArray, push: FloatArray) -> float:
    """Return the largest beta, 1/s, that the semidefinite program allows.

    Raises:
        UnsolvedError: the solver failed, or does not tell the largest beta to `TOLERANCE`, or the search came upon
            none that is allowed.
    """

    def amount(rate: float) -> float:
        return missing(rate, box, drift, push)

    too_large = rate = start = 1.01 * float(box.max()) ** 2  # without disturbance P22 = beta
    before, found = math.inf, amount(start)
    while found > 0.0:
        if found > before:  # what is allowed, if anything, is narrower than two steps
            rate, too_large = _allowed_between(amount, rate, _STEP**2 * rate)
            break
        if rate < _END * start:
            raise UnsolvedError("the line search found no rate (beta) that the box program allows")
        too_large, rate = rate, rate / _STEP
        before, found = found, amount(rate)
    while too_large - rate > _RESOLUTION * rate:
        middle = (rate + too_large) / 2.0
        rate, too_large = (middle, too_large) if amount(middle) <= 0.0 else (rate, middle)
    if amount((1.0 + TOLERANCE) * rate) < _ACCURACY:
        raise UnsolvedError("the box program fails by next to nothing for rates (beta) larger than it allows")
    return rate


def _allowed_between(amount: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Return a rate with an amount <= 0 and one above it with more, on the way to the least amount by golden section.

    Args:
        amount: by which the robust condition fails at a rate.
        low: a rate, 1/s, with more than the least amount.
        high: likewise.

    Raises:
        UnsolvedError: the least amount is above 0.
    """
    inner = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
    found = [amount(rate) for rate in inner]
    while high - low > _RESOLUTION * low:
        for rate, each in zip(reversed(inner), reversed(found), strict=True):
            if each <= 0.0:
                return rate, high
        if found[0] < found[1]:
            high = inner[1]
            inner = [high - _GOLDEN * (high - low), inner[0]]
            found = [amount(inner[0]), found[0]]
        else:
            low = inner[0]
            inner = [inner[1], low + _GOLDEN * (high - low)]
            found = [found[1], amount(inner[1])]
    raise UnsolvedError("the line search found no rate (beta) that the box program allows")


def missing(rate: float, box: FloatArray, drift: FloatArray, push: FloatArray) -> float:
    """Return by how much the robust condition fails at least for a Q that meets the box conditions; <= 0 if feasible.

    The program always has a solution, so that its feasibility is read off an optimum and not off a solver's status.

    Raises:
        UnsolvedError: the solver did not report an optimum.
    """
    units = _units(rate)
    scaled, residual = _program(rate, drift, push, units)
    amount = cp.Variable()
    conditions = [residual << amount * np.eye(6)]
    for i, width in enumerate(box[[0, 0, 1]]):
        row = _B[:, [i]].T @ units / width
        conditions.append(cp.bmat([[np.eye(1), row], [row.T, scaled]]) >> 0)
    solve("box", cp.Problem(cp.Minimize(amount), conditions))
    return float(amount.value)


def largest_spread(rate: float, drift: FloatArray, push: FloatArray) -> FloatArray:
    """Return the largest Q (6, 6) that meets the robust condition.

    A solver is as exact as the largest directions of Q are, relatively, and others may be a thousandth of those: it is
    solved once more in coordinates in which the first answer is the identity.

    Raises:
        UnsolvedError: the solver did not report an optimum.
    """
    units = _units(rate)
    for _ in range(2):
        scaled, residual = _program(rate, drift, push, units)
        solve("robust", cp.Problem(cp.Maximize(cp.trace(scaled)), [residual << 0, scaled >> 0]))
        inverse_units = np.linalg.inv(units)
        Q = np.asarray(inverse_units @ scaled.value @ inverse_units.T, dtype=np.float64)
        try:
            units = np.linalg.inv(np.linalg.cholesky(Q))
        except np.linalg.LinAlgError as error:
            raise UnsolvedError("the solver's Q of the robust program is not positive definite") from error
    return Q


def _units(rate: float) -> FloatArray:
    """Return the scaling (6, 6) of the state after which Q has entries of order 1 where the disturbance is small."""
    return np.asarray(np.kron(np.diag([rate**1.5, rate**0.5]), np.eye(3)), dtype=np.float64)


def _program(rate: float, drift: FloatArray, push: FloatArray, units: FloatArray) -> tuple[cp.Variable, cp.Expression]:
    """Return Q and the left side of the robust condition over beta, for the state in other units (6, 6)."""
    inverse_units = np.linalg.inv(units)
    scaled = cp.Variable((6, 6), symmetric=True)
    Q = inverse_units @ scaled @ inverse_units.T
    shake = np.diag(np.concatenate([drift[[0, 0, 1]], push[[0, 0, 1]]]) ** 2)
    condition = Q @ _A.T + _A @ Q - 2.0 * _B @ _B.T + rate * Q + shake / rate
    return scaled, units @ condition @ units.T / rate
