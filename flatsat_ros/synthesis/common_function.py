"""One function z'W z that falls for all gains of an interval, with a set as large as a semidefinite program finds.

Up to its scale every such W lies between two solutions of Riccati equations (Kalman, Yakubovich and Popov), those of
the loop and of its adjoint; they exist up to the limit of the circle criterion. What lies between them is inside of

    minimise trace(P^-1 W_x)   with   M(k)'W M(k) <= W at both ends of the interval,   K'K <= P22 W,

W_x the block of W for (p, v): the starts of a drone that hovers, measured against P. From there Newton's method follows
the central path of this program (Boyd and Vandenberghe, Convex optimization, section 11.3). A point of the path is the
minimum of a smooth strictly convex function, so that every processor finds the same to ten digits or more. A solver
for semidefinite programs stops anywhere within its tolerance of an optimum that is flat: 1e-4 of W apart.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_discrete_are, solve_triangular

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.sampled_loop import Timing

# What W takes away per period at both ends of the sector, in the Riccati equations, where W is of order 1.
_DECREASE = 1e-7

# Share of the adjoint's solution in the start: in its middle the path is short.
_ADJOINT = 0.1

# Where the path ends: nowhere is there a W whose trace is smaller by more than this share of that of P itself.
_GAP = 3e-4

# Newton's decrement at which the next point of the path is aimed for, and at which the last one counts as reached.
_NEAR, _REACHED = 0.3, 1e-6

_MOST_STEPS = 1000  # many times what forty commands in flight take


class BreakdownError(FlatsatError):
    """The arithmetic came to no answer; that says nothing about whether there is one."""


def common_matrix(timing: Timing, block: FloatArray, low: float, high: float, sector: float) -> FloatArray:
    """Return a W (n, n) that falls every period for all gains in [low, high], with |B'P x|^2 < P22 z'W z.

    Args:
        timing: of the loop, with a lag or a delay.
        block: P (2, 2).
        low: the smallest gain.
        high: the largest gain, below `sector`.
        sector: a gain up to which the circle criterion still holds.

    Raises:
        BreakdownError: the Riccati equations or the path have no numerical solution.
    """
    try:
        return _follow_path(timing, block, (low, high), _between_riccati(timing, block, low, sector))
    except np.linalg.LinAlgError as error:
        raise BreakdownError(
            f"the search for a function z'W z broke down for the gains [{low:g}, {high:.6g}] ({error}); this does not "
            "mean that there is none: choose a longer period or a shorter delay"
        ) from error


def _between_riccati(timing: Timing, block: FloatArray, low: float, high: float) -> FloatArray:
    """Return a W (n, n) between the smallest and the largest, in arbitrary scale."""
    size, width = timing.size, np.array([[2.0 / (high - low)]])
    scale = np.sqrt(block[1, 1]) * np.ones(size)  # all but the position by the velocity that it stands for
    scale[0] = np.sqrt(block[0, 0])
    if timing.lag > 0.0:
        scale[2] *= min(timing.lag, 1.0 / block[1, 1])
    scale[2 + (timing.lag > 0.0) :] *= timing.period
    step = scale[:, np.newaxis] * timing.closed_loop(block, low) / scale
    drive, feedback = scale[:, np.newaxis] * timing.transition[1], timing.feedback(block) / scale
    decrease, size_of_drive = _DECREASE * np.eye(size), float(np.linalg.norm(drive))
    smallest = -solve_discrete_are(step, drive, -decrease, width, s=feedback.T)
    adjoint = solve_discrete_are(
        step.T, size_of_drive * feedback.T, -decrease, width, s=drive / size_of_drive
    )  # the drive's size moved to the feedback, or the equation is badly scaled
    largest = np.linalg.inv(-(size_of_drive**2) * adjoint)
    between = (1.0 - _ADJOINT) * smallest + _ADJOINT * largest
    return np.asarray(scale[:, np.newaxis] * (between + between.T) / 2.0 * scale)


def _follow_path(timing: Timing, block: FloatArray, gains: tuple[float, float], start: FloatArray) -> FloatArray:
    """Return the W (n, n) at the end of the central path.

    Args:
        timing: of the loop.
        block: P (2, 2).
        gains: the ends of the interval.
        start: W (n, n) that falls for both gains.
    """
    steps = [timing.closed_loop(block, gain) for gain in gains]
    weight = np.asarray(np.linalg.inv(block), dtype=np.float64)
    row = timing.feedback(block)[0] / math.sqrt(block[1, 1])
    matrix = 2.0 * float(row @ np.linalg.solve(start, row)) * start
    # the trace is 2 for W = P, and 3 n is the number of the barrier's logarithms
    for gap in np.geomspace(1.0, _GAP, 6):
        emphasis, reached = 1.5 * timing.size / gap, _REACHED if gap <= _GAP else _NEAR
        for _ in range(_MOST_STEPS):
            matrix, decrement = _newton_step(matrix, steps, row, weight, emphasis)
            if decrement < reached:
                break
        else:
            raise np.linalg.LinAlgError(f"Newton's method stops short of the gap {gap:g}")
    return matrix


def _newton_step(
    matrix: FloatArray, steps: list[FloatArray], row: FloatArray, weight: FloatArray, emphasis: float
) -> tuple[FloatArray, float]:
    """Return W after a step towards a point of the path, and Newton's decrement before it.

    The point minimises emphasis * trace(weight W_x) - sum over the three conditions of log det. The coordinates are
    those in which W is the identity; S is W - M'W M, or W - row'row, there.
    """
    size = len(matrix)
    root = np.linalg.cholesky(matrix).T
    inverse = np.linalg.inv(root)
    first, second = np.triu_indices(size)
    number = np.arange(len(first))
    basis = np.zeros((len(first), size, size))  # orthonormal, of the symmetric matrices
    basis[number, first, second] = basis[number, second, first] = np.where(first == second, 1.0, math.sqrt(0.5))
    changes = []  # of S along the basis, relative to S
    for step in steps:
        moved = root @ (step - np.eye(size)) @ inverse  # short periods move little: I - M'M would be all rounding
        left = np.linalg.inv(np.linalg.cholesky(-(moved + moved.T + moved.T @ moved)))
        carried = basis @ moved
        changes.append(left @ -(carried + carried.transpose(0, 2, 1) + moved.T @ carried) @ left.T)
    bound = row @ inverse
    left = np.linalg.inv(np.linalg.cholesky(np.eye(size) - np.outer(bound, bound)))
    changes.append(left @ basis @ left.T)
    change = np.stack(changes, axis=1)
    cost = emphasis * np.tensordot(basis, root[:, :2] @ weight @ root[:, :2].T, 2)
    gradient = cost - np.trace(change, axis1=2, axis2=3).sum(axis=1)
    # the curvature is J J' with J the changes: R'R without squaring what is badly conditioned
    weights = np.where(first == second, 1.0, math.sqrt(2.0))  # an entry off the diagonal stands for two
    factor = np.linalg.qr((change[..., first, second] * weights).reshape(len(basis), -1).T, mode="r")
    reduced = solve_triangular(factor, -gradient, trans="T")
    direction, decrement = solve_triangular(factor, reduced), float(np.linalg.norm(reduced))
    length = 1.0 if decrement < 0.25 else _best_length(float(cost @ direction), np.tensordot(direction, change, 1))
    after = root.T @ (np.eye(size) + length * np.tensordot(direction, basis, 1)) @ root
    return np.asarray((after + after.T) / 2.0), decrement


def _best_length(slope: float, changes: FloatArray) -> float:
    """Return the a that minimises slope * a - sum log det(I + a change), by bisection of the derivative."""
    rates = np.linalg.eigvalsh(changes).ravel()
    short, long = 0.0, -1.0 / min(float(rates.min()), -0.01)
    for _ in range(40):
        middle = (short + long) / 2.0
        falls = slope < float((rates / (1.0 + middle * rates)).sum())
        short, long = (middle, long) if falls else (short, middle)
    return short
