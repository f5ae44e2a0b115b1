"""How large the gain may become in the loop that really runs.

One function z'W z for all gains in [k-, k+] exists exactly if the loop satisfies the circle criterion for that sector:
a frequency sweep finds the limit, and just below it `common_function` finds W. What counts is neither, but the
inequality that `Timing.contraction` evaluates for the W at hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate import lyapunov
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.synthesis.common_function import BreakdownError, common_matrix
from flatsat_ros.synthesis.rounding import round_down, round_matrix, round_up

# The cap as a share of the circle criterion's limit: at the limit itself the sets are smaller and nothing is left over.
_SHARE = 0.998

# Where in the sector, from the lowest gain to the limit, the search for W begins.
_START = 0.9998

# W must fall by this share each period, at the ends of the gain interval: a hundred times what rounding does.
MARGIN = 1e-12

_GAIN_LIMIT = 1e6  # beyond every cap that a usable period leaves

_LONGEST_RUN = 60


@dataclass(frozen=True, eq=False)
class GainCap:
    """What is proved about the gains of one axis.

    Attributes:
        gain_min, gain_max: V or, with a lag or a delay, W does not grow for applied gains in between.
        matrix: W (n, n), scaled to |B'P x|^2 <= P22 z'W z; None without lag and delay, where P serves.
        limit: no quadratic function serves all gains up to here, whoever looks for it.
    """

    gain_min: float
    gain_max: float
    matrix: FloatArray | None
    limit: float


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
        FlatsatError: not even the gain 1 can be proved.
        BreakdownError: the arithmetic came to no answer, or its answer does not stand the check.
    """
    if timing.immediate:
        return _hold_cap(timing, block, highest)
    limit = circle_limit(timing, block, lowest)
    cap = round_down(min(_SHARE * limit, highest))
    if cap < 1.0:
        raise FlatsatError(
            f"with gains from {lowest:g} on the cap would be {cap:.4g}: must be at least 1; ask for fewer gains below "
            "1, or choose a smaller rate, or a shorter period, lag or delay"
        )
    matrix = round_matrix(common_matrix(timing, block, lowest, cap, lowest + _START * (limit - lowest)))
    row = timing.feedback(block)[0]
    matrix *= round_up(float(row @ np.linalg.solve(matrix, row)) / float(block[1, 1]))
    for gain in (lowest, cap):
        try:
            left = 1.0 - timing.contraction(matrix, block, gain)
        except np.linalg.LinAlgError:  # not positive definite
            left = -math.inf
        if not left >= MARGIN:
            raise BreakdownError(
                f"the W found for the gains from {lowest:g} to {cap:.6g} falls by {left:.3g} per period at gain "
                f"{gain:.6g}: must be at least {MARGIN:.0e}, which does not mean that there is none"
            )
    return GainCap(lowest, cap, matrix, round_up(limit))


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
    return GainCap(round_up(_boundary(holds, 1.0, 0.0)), round_down(min(limit, highest)), None, round_up(limit))


def _boundary(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """Return the last gain on the way from inside, where it holds, to outside, to 1e-12 of it."""
    while abs(outside - inside) > 1e-12 * max(inside, outside):
        middle = math.sqrt(inside * outside) if min(inside, outside) > 0.0 else (inside + outside) / 2.0
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


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
    return lowest + 1.0 / value  # above 0: a command moves nothing at once, so that H has the mean 0 on the circle


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
