"""The nominal certificate: in closed form, and computed once more by the paper's semidefinite programs.

Every Q with Q A' + A Q - 2 B B' <= -alpha Q is at most the Q = P^-1 of the closed form (in the order of symmetric
matrices), so that maximising any trace(W Q) with W > 0 must return just that. The largest level eps is the S-procedure
of the paper's eq. 14. Solver and closed form share no arithmetic: what they agree on is not a slip of either.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

import flatsat_ros
from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import require, require_number, require_positive
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.lowered import lowered
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.gain_cap import GainCap, gain_cap
from flatsat_ros.synthesis.rounding import round_down, round_up
from flatsat_ros.synthesis.solver import cross_checked, solve, solver_name

# Largest relative difference between the solver's answer and the closed form; the solver stops at about 1e-8.
TOLERANCE = 1e-6

# Rates, 1/s, far beyond any drone at both ends; in between the arithmetic neither over- nor underflows.
_RATE_RANGE = (1e-3, 1e3)

_A = np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(3))
_B = np.kron([[0.0], [1.0]], np.eye(3))


@dataclass(frozen=True)
class PaperCase:
    """One certificate of arXiv 2308.15177, with T_max = 1.45 g, eps_max = 10 degrees and h = 0.1 s.

    Attributes:
        rate: alpha, 1/s.
        source: where the paper states the figures, and what it leaves open.
    """

    rate: float
    source: str


PAPER = {
    "paper_simulation": PaperCase(
        1.2,
        "arXiv 2308.15177, simulation study of the adaptive gain, Table I; the paper's simulation is in continuous "
        "time, the period is that of its experiment",
    ),
    "paper_experiment": PaperCase(
        1.25,
        "arXiv 2308.15177, section IV with the input limits of Table I; alpha is not printed, it is the one that "
        "gives the printed P and eps",
    ),
}


def synthesize(
    limits: InputSet,
    rate: float,
    period: float,
    name: str,
    inputs: Mapping[str, str] | None = None,
    *,
    lag: float = 0.0,
    delay: float = 0.0,
    lowest: float = 1.0,
    highest: float = math.inf,
) -> Certificate:
    """Compute the certificate of the paper's Proposition 1 for the sampled loop and cross-check it.

    P is the closed form of alpha, rho = r_in^2 with the largest ball around 0 in the input set, eps = rho / alpha. The
    gain interval is in closed form without lag and delay and otherwise the largest that `gain_cap` proves.

    Args:
        limits: the input set V_c.
        rate: alpha, 1/s.
        period: h, s.
        name: what the certificate is called.
        inputs: how the user stated the inputs, for the provenance.
        lag: tau, s, of the achieved acceleration.
        delay: d, s, from the command to its first effect.
        lowest: with lag or delay, gains from here on are asked for, in (0, 1]: the smallest kappa of the kappa-sets.
        highest: cap wanted; one below what can be proved leaves room for larger sets with a lag or a delay.

    Returns:
        A certificate that `verify` accepts.

    Raises:
        FlatsatError: the timing leaves no admissible gain, or the solver's answer and the closed form differ by more
            than `TOLERANCE`.
    """
    rate, period = (
        require_number("rate (alpha)", rate, "1/s", *_RATE_RANGE),
        require_positive("period (h)", period, "s"),
    )
    require(0.0 < lowest <= 1.0, "lowest", lowest, "", "above 0 and at most 1")
    require(highest >= 1.0, "highest", highest, "", "at least 1")
    timing = Timing(period, lag, delay)
    block, ball = closed_form_block(rate), round_down(limits.inner_radius**2)
    if timing.immediate:
        gain_min, gain_max = hold_gain_interval(rate, period)
        cap = GainCap(round_up(gain_min), round_down(min(gain_max, highest)), None, round_up(gain_max))
    else:
        cap = gain_cap(timing, block, lowest, highest)
    check = cross_checked("semidefinite programs", lambda: _differences(block, rate, ball), TOLERANCE)
    certificate = Certificate(
        name=name,
        limits=limits,
        rate=rate,
        block=block,
        ball=ball,
        level=round_down(ball / rate),
        period=period,
        lag=lag,
        delay=delay,
        gain_min=cap.gain_min,
        gain_max=cap.gain_max,
        loop=cap.matrix,
        provenance={
            "package": f"flatsat_ros {flatsat_ros.__version__}",
            "method": check["method"]
            + ("" if timing.immediate else "; W between the Riccati equations of the circle criterion"),
            "inputs": dict(inputs or {}),
            "solver": solver_name(),
            "cross_check": check["cross_check"],
            **({} if timing.immediate else {"gain_limit": cap.limit}),
        },
    )
    certificate, shares = lowered(certificate)
    if shares:
        certificate = replace(certificate, provenance={**certificate.provenance, "lowered_for_rounding": shares})
    certificate.verify()
    return certificate


def synthesize_paper(name: str) -> Certificate:
    """Compute the certificate of the paper with a name: paper_simulation or paper_experiment."""
    case = PAPER[name]
    inputs = {"thrust_max": "1.45 g", "tilt_max": "10 deg", "source": case.source}
    return synthesize(InputSet(1.45 * GRAVITY, math.radians(10.0), GRAVITY), case.rate, 0.1, name, inputs)


def _differences(block: FloatArray, rate: float, ball: float) -> dict[str, float]:
    """Solve both programs and return how far off their answers are from the closed form, relatively."""
    matrix = np.asarray(np.kron(block, np.eye(3)), dtype=np.float64)
    factor = np.linalg.cholesky(matrix)
    inverse = solve_decay(rate)
    return {
        "Q": float(np.abs(np.linalg.eigvalsh(factor.T @ inverse @ factor) - 1.0).max()),
        "eps": abs(solve_level(matrix, rate, ball) * rate / ball - 1.0),
    }


def solve_decay(rate: float) -> FloatArray:
    """Return the largest Q (6, 6) with Q A' + A Q - 2 B B' <= -alpha Q (paper, eq. 15) by semidefinite programming.

    Raises:
        UnsolvedError: the solver did not report an optimum.
    """
    units = _units(rate)
    inverse_units = np.linalg.inv(units)
    scaled = cp.Variable((6, 6), symmetric=True)
    Q = inverse_units @ scaled @ inverse_units
    condition = Q @ _A.T + _A @ Q - 2.0 * _B @ _B.T + rate * Q
    solve("decay", cp.Problem(cp.Maximize(cp.trace(scaled)), [scaled >> 0, units @ condition @ units / rate << 0]))
    return np.asarray(inverse_units @ scaled.value @ inverse_units, dtype=np.float64)


def solve_level(matrix: FloatArray, rate: float, ball: float) -> float:
    """Return the largest eps for which V <= eps implies |B'P xi|^2 <= rho (paper, eq. 14), by semidefinite programming.

    Args:
        matrix: P (6, 6).
        rate: alpha, 1/s; only sets the units in which the solver works.
        ball: rho, m^2/s^4.

    Raises:
        UnsolvedError: the solver did not report an optimum.
    """
    tau, level = cp.Variable(nonneg=True), cp.Variable()
    gradient = matrix @ _B
    inverse_units = np.linalg.inv(_units(rate))
    # the two diagonal blocks of the paper's matrix; level is in units of rho / alpha, tau in units of 1 / alpha
    state = inverse_units @ (matrix - tau / rate * gradient @ gradient.T) @ inverse_units
    solve("level", cp.Problem(cp.Maximize(level), [state >> 0, tau - level >= 0]))
    return float(level.value) * ball / rate


def _units(rate: float) -> FloatArray:
    """Return the scaling (6, 6) of the state after which P and Q have entries of order 1 for every rate."""
    return np.asarray(np.kron(np.diag([rate**1.5, rate**0.5]), np.eye(3)), dtype=np.float64)
