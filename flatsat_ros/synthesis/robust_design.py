"""The robust certificate: the largest beta in closed form, checked by the paper's semidefinite program.

Per axis every Q with Q A' + A Q - 2 B B' + beta Q + E E'/beta <= 0 is at most the one for which this is an equality,

    Q = [[(2 q - e2)/beta^2, -q/beta], [-q/beta, q]],   q = 2/beta - m2/beta^2,

with e2 and m2 the axis's entries of E E' at the position and at the velocity, and the box condition P22 <= vbar^2 reads
(2 q - e2)/(q (q - e2)) <= vbar^2. So q must reach the larger root of vbar^2 q^2 - (2 + vbar^2 e2) q + e2, and beta must
lie between the roots of q beta^2 - 2 beta + m2 = 0; without push the smaller one is 0 (docs/mathematics.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

import flatsat_ros
from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.enclosures import decimal
from flatsat_ros.certificate.exact import rationals, semidefinite
from flatsat_ros.certificate.lyapunov import largest_relative_eigenvalue
from flatsat_ros.certificate.robust import Robust, gathered_disturbance, robust_matrix
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.certificate.sets import Sets
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.gain_cap import gain_cap
from flatsat_ros.synthesis.robust_program import TOLERANCE, largest_spread, line_search
from flatsat_ros.synthesis.rounding import round_down, round_up
from flatsat_ros.synthesis.solver import cross_checked, solver_name

# Significant digits of the share p of a period's growth that is the disturbance's.
_SHARE_DIGITS = 4

# Shares by which disturbance and rate are taken larger in P, one after the other: what rounding does to P, and more.
_SHARES = 2.0 ** np.arange(-50.0, -30.0)

# How many times such a share the largest rate gives way, at first.
_SENSITIVITY = 64.0

# A larger gain may raise the level of the smallest certified set by this factor over that of gain 1.
_FLOOR_GROWTH = 1.05

PAPER_PERIOD = 0.01


def synthesize_robust(
    limits: InputSet,
    drift: ArrayLike,
    push: ArrayLike,
    period: float,
    name: str,
    inputs: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Certificate:
    """Compute the certificate of the paper's Proposition 3 for the sampled loop and cross-check it.

    Args:
        limits: V_c.
        drift: (2,) bound on the drift of x and y together and of z, m/s, >= 0; the two share w'w <= 1 with `push`.
        push: (2,) the same for accelerations, m/s^2.
        period: h, s.
        name: what the certificate is called.
        inputs: how the user stated the inputs, for the provenance.
        rate: beta, 1/s, at most the largest; None takes the largest. A smaller one has a larger set.

    Returns:
        A certificate that `verify` accepts.

    Raises:
        FlatsatError: the disturbance is too large for the limits, the period too long for the disturbance, or the
            solver's answer and the closed form differ by more than `TOLERANCE`.
    """
    drift, push = finite_array("drift", drift, 2), finite_array("push", push, 2)
    for quantity, pair, unit in (("drift", drift, "m/s"), ("push", push, "m/s^2")):
        require(
            pair.shape == (2,) and bool((pair >= 0.0).all()), quantity, pair.tolist(), unit, "two numbers of at least 0"
        )
    if not (drift.any() or push.any()):
        raise FlatsatError("drift and push are all 0: a robust certificate needs a disturbance")
    box = largest_box(limits)
    smallest, largest = rate_interval(box, drift, push)
    if rate is not None and not max(smallest, 1e-3) <= rate <= largest:
        interval = f"from {max(smallest, 1e-3):.6g} to {largest:.6g} 1/s for this disturbance"
        raise refusal("rate (beta)", rate, "1/s", interval)
    rate, blocks = _provable(box, drift, push, smallest, largest, rate)
    check = cross_checked(
        "semidefinite programs with a line search over beta",
        lambda: _differences(box, drift, push, rate, largest),
        TOLERANCE,
    )
    timing = Timing(period)
    sets = robust_sets(limits, timing, blocks, drift, push)
    gain_max, floor, share = _sampled(timing, blocks, drift, push, sets.floor)
    certificate = Certificate(
        name=name,
        limits=limits,
        rate=rate,
        block=blocks[0],
        block_vertical=blocks[1],
        ball=round_down(limits.inner_radius**2),
        level=sets.level,
        period=period,
        gain_min=1.0,
        gain_max=gain_max,
        robust=Robust(rate, drift, push, box, floor, share),
        provenance={
            "package": f"flatsat_ros {flatsat_ros.__version__}",
            "method": check["method"],
            "inputs": dict(inputs or {}),
            "solver": solver_name(),
            "cross_check": check["cross_check"],
        },
    )
    certificate.verify()
    return certificate


def synthesize_paper_robust() -> Certificate:
    """Compute the certificate of the paper's robustness study (its Table II)."""
    inputs = {
        "thrust_max": "2 g",
        "tilt_max": "40 deg",
        "drift": "sqrt(2) m/s on x and y, so that the printed disturbance is admissible",
        "source": "arXiv 2308.15177, robustness study, Table II; the paper simulates in continuous time, the period is "
        "ours",
    }
    limits = InputSet(2.0 * GRAVITY, math.radians(40.0), GRAVITY)
    return synthesize_robust(limits, (math.sqrt(2.0), 0.0), (0.0, 0.0), PAPER_PERIOD, "paper_robust", inputs)


def largest_box(limits: InputSet) -> FloatArray:
    """Return vbar (2,), of x and y, and of z: the largest box in V_c, no wider than the ball of r_in, rounded down."""
    widths = np.minimum(limits.inner_box[[0, 2]], limits.inner_radius)
    return np.array([round_down(float(width)) for width in widths])


def closed_form_blocks(rate: float, drift: FloatArray, push: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the blocks of P = Q^-1, of x and y and of z, for which the robust condition is an equality.

    Raises:
        FlatsatError: there is no positive definite Q for this rate (beta).
    """
    blocks, square = [], rate * rate
    for e2, m2 in zip(drift**2, push**2, strict=True):
        q = 2.0 / rate - m2 / square
        if q <= e2:
            raise refusal("rate (beta)", rate, "1/s", f"smaller: no Q exists for the drift {math.sqrt(e2):.6g} m/s")
        # the inverse of Q, whose determinant is q (q - e2) / beta^2
        blocks.append(np.array([[square * q, rate * q], [rate * q, 2.0 * q - e2]]) / (q * (q - e2)))
    return blocks[0], blocks[1]


def _provable(
    box: FloatArray, drift: FloatArray, push: FloatArray, smallest: float, largest: float, rate: float | None
) -> tuple[float, tuple[FloatArray, FloatArray]]:
    """Return beta and the blocks of P of which the decimals satisfy the robust condition, not only before rounding.

    If P is that of beta and E larger by a share s, the left side of the condition is -s (beta Q + E E'/beta).

    Args:
        box: vbar (2,), m/s^2.
        drift: (2,) m/s.
        push: (2,) m/s^2.
        smallest: beta, 1/s.
        largest: beta, 1/s.
        rate: beta, 1/s, that is wanted; None for hardly less than the largest.
    """
    exact = rationals(drift), rationals(push), rationals(box)
    for share in _SHARES.tolist():
        beta = max(smallest, round_down(largest * (1.0 - _SENSITIVITY * share))) if rate is None else rate
        blocks = closed_form_blocks(beta * (1.0 + share), drift * (1.0 + share), push * (1.0 + share))
        if all(
            semidefinite(-robust_matrix(rationals(block), decimal(beta), e, m)) and decimal(block[1, 1]) <= width**2
            for block, e, m, width in zip(blocks, *exact, strict=True)
        ):
            break
    return beta, blocks


def rate_interval(box: FloatArray, drift: FloatArray, push: FloatArray) -> tuple[float, float]:
    """Return the smallest and the largest beta, 1/s, in closed form; the smallest is 0 without push.

    Raises:
        FlatsatError: no beta holds the nominal input in the box against this disturbance.
    """
    low, high = 0.0, math.inf
    for width, e2, m2, axis in zip(box, drift**2, push**2, ("x and y", "z"), strict=True):
        v2 = float(width) ** 2
        q = (2.0 + v2 * e2 + math.sqrt(4.0 + (v2 * e2) ** 2)) / (2.0 * v2)
        if q * m2 > 1.0:
            most = f"at most {math.sqrt(1.0 / q):.6g} m/s^2 with a drift of {math.sqrt(e2):.6g} m/s"
            raise refusal(f"push on {axis}", math.sqrt(m2), "m/s^2", most)
        root = math.sqrt(1.0 - q * m2)
        # the smaller root of q beta^2 - 2 beta + m2, without cancellation
        low, high = max(low, float(m2 / (1.0 + root))), min(high, float((1.0 + root) / q))
    if low > high:
        raise FlatsatError(
            f"push = {push.tolist()} m/s^2 needs a rate (beta) of at least {low:.6g} 1/s, drift = {drift.tolist()} m/s "
            f"one of at most {high:.6g} 1/s: reduce one of them"
        )
    return low, high


def _differences(box: FloatArray, drift: FloatArray, push: FloatArray, rate: float, largest: float) -> dict[str, float]:
    """Find beta and Q with the solver and return how far off they are, relatively."""
    found = line_search(box, drift, push)
    Q = largest_spread(rate, drift, push)
    blocks = closed_form_blocks(rate, drift, push)
    P = np.kron(blocks[0], np.diag([1.0, 1.0, 0.0])) + np.kron(blocks[1], np.diag([0.0, 0.0, 1.0]))
    factor = np.linalg.cholesky(P)
    return {
        "beta": abs(found / largest - 1.0),
        "Q": float(np.abs(np.linalg.eigvalsh(factor.T @ Q @ factor) - 1.0).max()),
    }


def robust_sets(
    limits: InputSet, timing: Timing, blocks: tuple[FloatArray, FloatArray], drift: FloatArray, push: FloatArray
) -> Sets:
    """Return the sets of the certificate with these blocks at gain 1, without proving its gains.

    Raises:
        FlatsatError: the sampled loop has none.
    """
    slope, slope_vertical = (float(block[1, 1]) for block in blocks)
    level = round_down(round_down(limits.inner_radius**2) / max(slope, slope_vertical))
    floor, _ = smallest_floor(timing, blocks, drift, push, (1.0,))
    if not floor <= level:
        valid = (
            f"at most eps = {level:.4g}: choose a shorter period than {timing.period} s, a smaller rate or disturbance"
        )
        raise refusal("level in which the disturbed sampled loop stays", floor, "", valid)
    # a larger gain may lift the floor up to here
    return Sets(limits, *blocks, slope, slope_vertical, level, 1.0, min(level, _FLOOR_GROWTH * floor))


def _sampled(
    timing: Timing, blocks: tuple[FloatArray, FloatArray], drift: FloatArray, push: FloatArray, allowed: float
) -> tuple[float, float, float]:
    """Return the largest gain_max whose floor is as allowed, with floor s and share p."""
    cap = min(gain_cap(timing, block).gain_max for block in blocks)
    low, high = 1.0, 2.0 * cap - 1.0  # the cap itself is tried first
    while high - low > 1e-3 * low:
        middle = (low + high) / 2.0
        if smallest_floor(timing, blocks, drift, push, (1.0, middle))[0] <= allowed:
            low = middle
        else:
            high = middle
        high = min(high, cap)
    low = round_down(low)
    return (low, *smallest_floor(timing, blocks, drift, push, (1.0, low)))


def smallest_floor(
    timing: Timing,
    blocks: tuple[FloatArray, FloatArray],
    drift: FloatArray,
    push: FloatArray,
    gains: tuple[float, ...],
) -> tuple[float, float]:
    """Return the smallest s, and its p, with M Q M'/(1 - p) + D/(p s) <= Q on all axes; s is infinite if there is none.

    The smallest s is flat in p, which is known to the root of the arithmetic's precision: p has few digits, and s is
    computed from those.

    Args:
        timing: of the loop, without lag and delay.
        blocks: P of x and y, and of z.
        drift: (2,) of x and y, and of z, m/s.
        push: (2,) the same, m/s^2.
        gains: at which it must hold.
    """
    cases = []
    for (block, e, m), gain in product(zip(blocks, drift, push, strict=True), gains):
        spread = np.linalg.inv(block)
        step = timing.closed_loop(block, gain)
        cases.append((spread, step @ spread @ step.T, gathered_disturbance(timing, float(e), float(m))))
    slack = min(1.0 - largest_relative_eigenvalue(moved, spread) for spread, moved, _ in cases)
    if slack <= 0.0:
        return math.inf, 0.5

    def floor(share: float) -> float:
        return max(
            largest_relative_eigenvalue(gathered / share, spread - moved / (1.0 - share))
            for spread, moved, gathered in cases
        )

    bounds = (1e-3 * slack, (1.0 - 1e-6) * slack)
    found = minimize_scalar(floor, bounds=bounds, method="bounded", options={"xatol": 1e-9 * slack})
    share = round_down(float(found.x), _SHARE_DIGITS)
    # a little more, so that what is certified does not hang on the last digit
    return round_up(floor(share) * (1.0 + 1e-9)), share
