"""How large the gain may become in the loop that really runs.

One function z'W z for all gains in [k-, k+] exists exactly if the loop satisfies the circle criterion for that sector:
a frequency sweep says where to stop looking and a semidefinite program finds W just below. What counts is neither, but
the inequality that `Timing.contraction` evaluates for the W at hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate import lyapunov
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.synthesis.solver import SolverError, solve

# W must fall by this share each period, at the ends of the gain interval, before it counts as a proof.
MARGIN = 1e-9

# The search for the cap ends when it is known this well, relatively.
_RESOLUTION = 2e-3

# Slack that the program is asked for, in units in which W and the command are of order 1.
_SLACK = 1e-7

# Least eigenvalue of W in the same units: without it W may be so flat that its inequalities drown in rounding.
_LEAST = 1e-3

_GAIN_LIMIT = 1e6  # beyond every cap that a usable period leaves

_LONGEST_RUN = 60


@dataclass(frozen=True, eq=False)
class GainCap:
    """What is proved about the gains of one axis.

    Attributes:
        gain_min, gain_max: V or, with a lag or a delay, W does not grow for applied gains in between.
        matrix: W (n, n), scaled to |B'P x|^2 <= P22 z'W z; None without lag and delay, where P serves.
        limit: no quadratic function serves all gains up to here, whoever looks for it.
        failures: how often the solver failed on the way; each may have cost a larger cap.
    """

    gain_min: float
    gain_max: float
    matrix: FloatArray | None
    limit: float
    failures: int


@dataclass(frozen=True)
class WorstCase:
    """Where the loop is known to fail, for comparison with the cap.

    Attributes:
        constant: the largest constant gain, up from 1, at which the loop is stable (spectral radius below 1).
        switching: the smallest gain found at which it is unstable to alternate between it, for `high` periods, and the
            gain 1, for `low` periods; at most 60 each.
        high, low: those periods; low is 0 if no alternation is worse than a constant gain.
    """

    constant: float
    switching: float
    high: int
    low: int


def gain_cap(timing: Timing, block: FloatArray, lowest: float = 1.0, highest: float = math.inf) -> GainCap:
    """Return the largest gain interval that can be proved.

    Args:
        timing: of the loop.
        block: P (2, 2).
        lowest: with a lag or a delay, gains from here on are asked for; in (0, 1]. The smaller it is, the farther the
            kappa-sets reach and the lower is the cap.
        highest: do not look for more; a lower cap leaves room for larger sets.

    Raises:
        FlatsatError: not even the gain 1 can be proved; with the solver's failure as reason, if that was it.
    """
    if timing.immediate:
        return _hold_cap(timing, block, highest)
    limit = circle_limit(timing, block, lowest)
    failures = 0

    def prove(gain: float) -> FloatArray | None:
        nonlocal failures
        try:
            return common_matrix(timing, block, lowest, gain)
        except SolverError:
            failures += 1
        except FlatsatError:
            pass
        return None

    proven, matrix, top = 1.0, None, min(limit, highest)
    gain = min(limit * (1.0 - _RESOLUTION), highest)
    while True:
        found = prove(gain)
        if found is None:
            top = gain
        else:
            proven, matrix = gain, found
        if top - proven <= _RESOLUTION * top:
            break
        gain = (proven + top) / 2.0
    if matrix is None:
        raise FlatsatError(
            f"no function z'W z was found even for the gains [{lowest:g}, {top:.4g}]"
            + (" because the solver failed; this does not mean that there is none" if failures else "")
        )
    return GainCap(lowest, proven, matrix, limit, failures)


def _hold_cap(timing: Timing, block: FloatArray, highest: float) -> GainCap:
    """Return the gains for which V grows neither at nor between samples, by bisection to rounding."""

    def holds(gain: float) -> bool:
        return lyapunov.hold_growth(block, timing.period, gain) <= 0.0

    if not holds(1.0):
        raise FlatsatError(
            f"with the command held for {timing.period} s V grows at gain 1 already: choose a shorter period or a "
            "smaller rate"
        )
    limit = _boundary(holds, 1.0, _GAIN_LIMIT)
    return GainCap(_boundary(holds, 1.0, 0.0), min(limit, highest), None, limit, 0)


def _boundary(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return the last gain on the way from inside, where it holds, to outside, to 1e-12 of it."""
    while abs(outside - inside) > 1e-12 * max(inside, outside):
        middle = math.sqrt(inside * outside) if min(inside, outside) > 0.0 else (inside + outside) / 2.0
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def common_matrix(timing: Timing, block: FloatArray, low: float, high: float) -> FloatArray:
    """Return a W (n, n) that falls every period for all gains in [low, high], with as many starts as possible.

    The starts are those of a drone that hovers: W's block of (p, v), measured against P, is minimised under
    |B'P x|^2 <= P22 z'W z.

    Raises:
        SolverError: the solver failed, or its answer does not stand the check.
        InfeasibleError: there is none.
    """
    units = np.diag([math.sqrt(block[0, 0]), math.sqrt(block[1, 1])] + [block[1, 1] ** -0.5] * (timing.size - 2))
    inverse_units = np.linalg.inv(units)
    pace = min(1.0, float(block[1, 1]) * timing.period)  # how much of W a period may take away
    slope, feedback = float(block[1, 1]), timing.feedback(block) @ inverse_units
    scaled = cp.Variable((timing.size, timing.size), symmetric=True)
    conditions = [
        cp.bmat([[scaled, feedback.T / math.sqrt(slope)], [feedback / math.sqrt(slope), np.eye(1)]]) >> 0,
        scaled >> _LEAST * np.eye(timing.size),
    ]
    for gain in (low, high):
        step = units @ timing.closed_loop(block, gain) @ inverse_units
        conditions.append((scaled - step.T @ scaled @ step) / pace >> _SLACK * np.eye(timing.size))
    metric = np.linalg.inv(inverse_units[:2, :2] @ block @ inverse_units[:2, :2])
    solve("loop", cp.Problem(cp.Minimize(cp.trace(metric @ scaled[:2, :2])), conditions))
    matrix = units @ scaled.value @ units
    matrix = (matrix + matrix.T) / 2.0
    row = timing.feedback(block)[0]
    if np.linalg.eigvalsh(matrix)[0] > 0.0:
        matrix *= float(row @ np.linalg.solve(matrix, row)) / slope * (1.0 + 1e-12)
        if max(timing.contraction(matrix, block, gain) for gain in (low, high)) <= 1.0 - MARGIN:
            return np.asarray(matrix, dtype=np.float64)
    raise SolverError(f"the solver's W does not fall for all gains in [{low:g}, {high:g}]")


def circle_limit(timing: Timing, block: FloatArray, lowest: float = 1.0) -> float:
    """Return the supremum of gains k+ for which some z'W z falls for all gains in [lowest, k+].

    With H(z) = K (z I - M(lowest))^-1 G the sector [0, k+ - lowest] satisfies the circle criterion as long as
    1 + (k+ - lowest) Re H > 0 all around the unit circle.

    Raises:
        FlatsatError: the loop is unstable at the lowest gain, or at 1.
    """
    for gain in (lowest, 1.0):
        radius = _radius(timing.closed_loop(block, gain))
        if radius >= 1.0:
            raise FlatsatError(
                f"the loop is unstable at gain {gain:g} already (spectral radius {radius:.4g}, must be below 1): "
                "choose a smaller rate, or a shorter period, lag or delay"
            )
    step, (_, G) = timing.closed_loop(block, lowest), timing.transition
    feedback = timing.feedback(block)

    def most_negative(angles: FloatArray) -> tuple[float, int]:
        shifted = np.exp(1j * angles)[:, np.newaxis, np.newaxis] * np.eye(timing.size) - step
        # numpy before 2.0 takes a right-hand side with one dimension less for a stack of vectors
        resolvent = np.linalg.solve(shifted, G[np.newaxis])
        values = -(feedback @ resolvent).real[:, 0, 0]
        worst = int(values.argmax())
        return float(values[worst]), worst

    angles = np.geomspace(1e-6, math.pi, 4001)
    for _ in range(4):
        value, worst = most_negative(angles)
        angles = np.linspace(angles[max(worst - 1, 0)], angles[min(worst + 1, len(angles) - 1)], 101)
    limit = lowest + 1.0 / value if value > 0.0 else math.inf
    if limit <= 1.0:
        raise FlatsatError(
            f"with gains from {lowest:g} on the cap would be {limit:.4g}: must be above 1; ask for fewer gains below "
            "1, or choose a smaller rate, or a shorter period, lag or delay"
        )
    return limit


def worst_case(timing: Timing, block: FloatArray, cap: float) -> WorstCase:
    """Return where constant and switched gains are known to destabilise the loop.

    Args:
        timing: of the loop.
        block: P (2, 2).
        cap: the proved gain_max, from which the search goes up.
    """

    def steady(gain: float) -> bool:
        return _radius(timing.closed_loop(block, gain)) < 1.0

    gain = 1.0
    while steady(gain * 1.01) and gain < _GAIN_LIMIT:
        gain *= 1.01
    constant = _boundary(steady, gain, gain * 1.01)
    calm, rough = cap, constant * (1.0 + 1e-9)
    runs = (1, 0)
    while rough - calm > 1e-4 * rough:
        middle = (calm + rough) / 2.0
        found = _worst_alternation(timing.closed_loop(block, 1.0), timing.closed_loop(block, middle))
        if found is None:
            calm = middle
        else:
            rough, runs = middle, found
    return WorstCase(constant, rough, *runs)


def _worst_alternation(low: FloatArray, high: FloatArray) -> tuple[int, int] | None:
    """Return the runs (of high, of low) whose alternation grows fastest; None if none grows."""
    lows, highs = (
        np.array([np.linalg.matrix_power(step, run) for run in range(1, _LONGEST_RUN + 1)]) for step in (low, high)
    )
    radii = np.abs(np.linalg.eigvals(highs[:, np.newaxis] @ lows)).max(axis=-1)
    length = np.arange(1, _LONGEST_RUN + 1)
    growth = radii ** (1.0 / np.add.outer(length, length))
    worst = np.unravel_index(int(growth.argmax()), growth.shape)
    return (int(worst[0]) + 1, int(worst[1]) + 1) if growth[worst] > 1.0 + 1e-9 else None


def _radius(step: FloatArray) -> float:
    return float(np.abs(np.linalg.eigvals(step)).max())
