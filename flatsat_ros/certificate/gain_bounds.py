"""Bounds that the adaptive gain gamma never exceeds, under the continuous and under the sampled law.

V(0) and V_inf are values of the Lyapunov function, gamma and mu those of `flatsat_ros.law.gain.Tuning`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.errors import require_positive
from flatsat_ros.certificate.lyapunov import hold_contraction


def settling_time_bound(lyapunov_0: float, threshold: float, rate: float) -> float:
    """Return the time t_inf, s, by which V is at most V_inf: ln(V(0)/V_inf)/alpha, 0 if it is already (paper, eq. 26).

    Args:
        lyapunov_0: V(0), at least 0.
        threshold: V_inf, above 0.
        rate: alpha, 1/s, above 0.

    Raises:
        FlatsatError: threshold or rate is not a finite number above 0.
    """
    require_positive("threshold (V_inf)", threshold, "")
    return max(0.0, math.log(max(lyapunov_0, threshold) / threshold)) / require_positive("rate (alpha)", rate, "1/s")


def continuous_gain_bound(
    gain_0: float, adaptation_rate: float, lyapunov_0: float, threshold: float, rate: float
) -> float:
    """Return a bound of gamma for all time under the continuous law, from V(0) in the invariant set.

    gamma_0 + mu [ (V(0)/alpha)(1 - exp(-alpha t_inf)) - V_inf t_inf ]: the paper's eq. 25 with the sign of its V_inf
    term corrected.

    Args:
        gain_0: gamma_0, at least 1.
        adaptation_rate: mu, 1/s.
        lyapunov_0: V(0).
        threshold: V_inf, above 0.
        rate: alpha, 1/s, above 0.
    """
    settling = settling_time_bound(lyapunov_0, threshold, rate)
    area = lyapunov_0 / rate * -math.expm1(-rate * settling) - threshold * settling
    return gain_0 + adaptation_rate * max(0.0, area)


def sampled_gain_bound(
    gain_0: float, adaptation_rate: float, lyapunov_0: float, threshold: float, block: ArrayLike, period: float
) -> float:
    """Return a bound of gamma for all time under the sampled law (zero-order hold, forward Euler); inf: none found.

    While gamma <= G every step contracts V at least by q(G), the worst over applied gains in [1, G], so
    gamma <= gamma_0 + mu h sum_j max(0, q^j V(0) - V_inf) as long as that sum stays below G. The smallest such G found
    by iterating upward from gamma_0 is a bound by induction over the steps. Holds where applied gains are at least 1,
    that is on the invariant set.

    Args:
        gain_0: gamma_0, at least 1.
        adaptation_rate: mu, 1/s.
        lyapunov_0: V(0).
        threshold: V_inf, above 0.
        block: P (2, 2) of each axis.
        period: h, s.
    """
    block = np.asarray(block, dtype=np.float64)
    slowest = hold_contraction(block, period, 1.0)
    bound = gain_0
    for _ in range(1000):
        contraction = max(slowest, hold_contraction(block, period, bound))
        if contraction >= 1.0:
            break
        count = 0 if lyapunov_0 <= threshold else math.ceil(math.log(threshold / lyapunov_0) / math.log(contraction))
        excess = np.maximum(lyapunov_0 * contraction ** np.arange(count) - threshold, 0.0)
        following = gain_0 + adaptation_rate * period * float(excess.sum())
        if following <= bound * (1.0 + 1e-12):
            return following
        bound = following
    return math.inf
