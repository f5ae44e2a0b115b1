"""The Lyapunov matrix of the saturated law in closed form, and how V = x'P x changes while a command is held.

Per axis the double integrator has the state (p, pdot), A = [[0, 1], [0, 0]], B = (0, 1), and with a 2x2 block P the
controller applies v = -k B'P x with a gain k. Every matrix of the three axes is the Kronecker product of its block
with the 3x3 identity. A block is that of P for x in (m, m/s); periods are in s, rates in 1/s, gains dimensionless.
"""

from __future__ import annotations

import math
import operator

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import refusal, require_positive
from flatsat_ros.certificate.enclosures import Numbers, decimal

# of integers, so that what is computed of fractions is exact
_A = np.array([[0, 1], [0, 0]])
_B = np.array([[0], [1]])

# Pieces of the hold interval in the between-samples check: enough for a tight certificate to verify.
_PIECES = 8


def closed_form_block(rate: float) -> FloatArray:
    """Return the block P(alpha) for which the nominal condition Q A' + A Q - 2 B B' + alpha Q <= 0 is tight.

    P = [[alpha^3/2, alpha^2/2], [alpha^2/2, alpha]]; along the loop V' = -alpha V + 2 (1 - k) |B'P xi|^2 exactly.

    Args:
        rate: alpha, 1/s.

    Returns:
        (2, 2), V = x'P x with position in m and velocity in m/s.

    Raises:
        FlatsatError: rate is not a finite number above 0.
    """
    a = decimal(require_positive("rate (alpha)", rate, "1/s"))
    return np.array([[float(a**3 / 2), float(a**2 / 2)], [float(a**2 / 2), float(a)]])


def decay_matrix(block: Numbers, rate: Numbers) -> Numbers:
    """Return A'P + P A - 2 P B B'P + alpha P (2, 2); of fractions it is exact.

    Args:
        block: P (2, 2) of one axis.
        rate: alpha, 1/s.
    """
    return _A.T @ block + block @ _A - 2 * block @ _B @ _B.T @ block + rate * block


def decay_residual(block: FloatArray, rate: float) -> float:
    """Return the largest eigenvalue of A'P + P A - 2 P B B'P + alpha P, relative to alpha P; V' <= -alpha V if <= 0.

    This is the paper's condition Q A' + A Q - 2 B B' <= -alpha Q, multiplied by P from both sides.

    Args:
        block: P (2, 2) of one axis.
        rate: alpha, 1/s.
    """
    return largest_relative_eigenvalue(decay_matrix(block, rate), rate * block)


def feedback_slope(metric: FloatArray, block: FloatArray) -> float:
    """Return the largest |B'P x|^2 of one axis per unit of x'P x, or of z'W z; metric is P or W."""
    feedback = np.zeros(len(metric))
    feedback[:2] = block[1]
    return float(feedback @ np.linalg.solve(metric, feedback))


def decay_rate(block: FloatArray, gain: float) -> float:
    """Return the largest r with V' <= -r V, 1/s, in continuous time and for every applied gain of at least `gain`.

    For the closed form and a gain kappa <= 1 it is alpha (2 kappa - 1).

    Args:
        block: P (2, 2) of one axis.
        gain: the smallest applied gain.
    """
    growth = _A.T @ block + block @ _A - 2.0 * gain * block @ _B @ _B.T @ block
    return -largest_relative_eigenvalue(growth, block)


def hold_transition(block: FloatArray, period: float, gain: float) -> FloatArray:
    """Return the (2, 2) transition matrix over one period with v = -k B'P x held constant.

    Args:
        block: P (2, 2) of one axis.
        period: h, s.
        gain: applied gain k.
    """
    state = np.array([[1.0, period], [0.0, 1.0]])
    command = np.array([[period**2 / 2.0], [period]])
    return np.asarray(state - gain * command @ (_B.T @ block))


def hold_contraction(block: FloatArray, period: float, gain: float) -> float:
    """Return the largest V(x+)/V(x) over one period with the command held constant (zero-order hold), gain k.

    The ratio is convex in k, so over an interval of gains the larger of the two end values bounds it.

    Args:
        block: P (2, 2) of one axis.
        period: h, s.
        gain: applied gain k.
    """
    step = hold_transition(block, period, gain)
    return largest_relative_eigenvalue(step.T @ block @ step, block)


def hold_growth(block: FloatArray, period: float, gain: float) -> float:
    """Return an upper bound of the largest relative growth of V, (V(t) - V(0))/(t/h V(0)), for 0 < t <= period.

    With the command held, V(t) - V(0) is x' S(t) x with a matrix polynomial S(t) of degree 4 and S(0) = 0. S(t)/t is
    written in the Bernstein basis of each piece of [0, h]; its coefficients' largest eigenvalue bounds it on the piece.
    At most 0 proves that V grows nowhere within the period; at the gain limit the bound is tight at t = h.

    Args:
        block: P (2, 2) of one axis.
        period: h, s.
        gain: applied gain k.
    """
    return largest_relative_eigenvalue(np.array(hold_matrices(hold_powers(block, period, gain))), block)


def hold_powers(block: Numbers, period: Numbers, gain: Numbers) -> Numbers:
    """Return the coefficients (4, 2, 2) of S(t) h/t, a polynomial in t over an eighth of h; exact of fractions.

    The arguments are those of `hold_growth`.
    """
    a, b = _A, gain * _B @ (_B.T @ block)
    # x(t) = (I + t M1 + t^2 M2) x(0)
    m1, m2 = a - b, -a @ b / 2
    powers = [
        m1.T @ block + block @ m1,
        m2.T @ block + m1.T @ block @ m1 + block @ m2,
        m2.T @ block @ m1 + m1.T @ block @ m2,
        m2.T @ block @ m2,
    ]
    piece = period / _PIECES
    return np.array([period * power * piece**order for order, power in enumerate(powers)])


def hold_matrices(powers: Numbers) -> list[Numbers]:
    """Return matrices (2, 2), the Bernstein coefficients of all pieces: if none is above 0, V grows nowhere.

    Args:
        powers: (4, 2, 2) of `hold_powers`, or integers that are all the same number of times as large.
    """
    return [each for start in range(_PIECES) for each in bernstein_coefficients(powers, start, start + 1)]


def bernstein_coefficients(powers: FloatArray, start: float, end: float) -> FloatArray:
    """Return the Bernstein coefficients on [start, end] of the polynomial sum_i powers[i] t^i.

    The polynomial's values on the interval lie in the convex hull of the coefficients. Of integers, in an array of
    objects, they are integers, too: a multiple of what they stand for.

    Args:
        powers: (n + 1, ...) coefficients of t^0, t^1, ..., t^n.
        start: left end of the interval.
        end: right end of the interval.

    Returns:
        (n + 1, ...).
    """
    degree, multiple, ratio = len(powers) - 1, 1, operator.truediv
    if powers.dtype == object:
        multiple, ratio = math.lcm(*(math.comb(degree, j) for j in range(degree + 1))), operator.floordiv
    shifted = [
        sum(math.comb(i, j) * start ** (i - j) * powers[i] for i in range(j, degree + 1)) * (end - start) ** j
        for j in range(degree + 1)
    ]
    return np.array(
        [
            sum(ratio(multiple * math.comb(i, j), math.comb(degree, j)) * shifted[j] for j in range(i + 1))
            for i in range(degree + 1)
        ]
    )


def hold_gain_interval(rate: float, period: float) -> tuple[float, float]:
    """Return the gains (k-, k+) between which V does not increase under a zero-order hold, at and between samples.

    Exact for the closed-form block and for any gain that varies from sample to sample: with s = alpha h,
    k+- = [2 + s/2 +- sqrt(4 - 2 s)] / [2 s (1 + s/16)]. A shorter hold has a wider interval, so what holds at the
    sample holds between samples too (docs/mathematics.md).

    Args:
        rate: alpha, 1/s.
        period: h, s.

    Returns:
        (k-, k+), dimensionless.

    Raises:
        FlatsatError: alpha h is too large for any gain of at least 1.
    """
    s = require_positive("rate (alpha)", rate, "1/s") * require_positive("period (h)", period, "s")
    if s >= 2.0:
        valid = f"below 2 (for this rate a period below {2.0 / rate:.6g} s), or V grows whatever the gain"
        raise refusal("rate * period", s, "", valid)
    root = math.sqrt(4.0 - 2.0 * s)
    scale = 2.0 * s * (1.0 + s / 16.0)
    upper = (2.0 + s / 2.0 + root) / scale
    if upper < 1.0:
        raise refusal("rate * period", s, "", f"smaller: the gain cap would be {upper:.6g}, below the smallest gain 1")
    # (2 + s/2)^2 - (4 - 2 s) = 4 s (1 + s/16): the small root without cancellation
    return 2.0 / (2.0 + s / 2.0 + root), upper


def largest_relative_eigenvalue(matrix: FloatArray, metric: FloatArray) -> float:
    """Return the largest x'M x / x'P x over all x, of all matrices if there are several; infinity where it overflows.

    Args:
        matrix: M (..., n, n), symmetric.
        metric: P (n, n), symmetric and positive definite.
    """
    factor = np.linalg.inv(np.linalg.cholesky(metric))
    scaled = factor @ matrix @ factor.T
    return float(np.linalg.eigvalsh(scaled)[..., -1].max()) if np.isfinite(scaled).all() else math.inf
