"""The certificates that campaigns attack and that take a solver: loops with lag and delay, and robust ones."""

from __future__ import annotations

import math
from collections.abc import Collection

from tqdm import tqdm

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.falsification.campaigns import DISTURBED, Pool
from flatsat_ros.law.input_set import InputSet

# alpha 1/s, h s, tau s, d s, smallest applied gain that is asked for
_LAGS = [
    (1.25, 0.1, 0.1, 0.05, 1.0),
    (1.25, 0.05, 0.08, 0.03, 1.0),
    (1.25, 0.02, 0.08, 0.03, 1.0),
    (1.25, 0.01, 0.08, 0.03, 0.7),
    (0.8, 0.1, 0.05, 0.0, 0.6),
    (2.0, 0.05, 0.0, 0.05, 0.7),
    (1.25, 0.05, 0.05, 0.12, 0.6),
    (0.5, 0.1, 0.15, 0.33, 0.8),
]

# T_max in g, eps_max deg, drift m/s and push m/s^2 of x and y, and of z, h s
_ROBUST = [
    (2.0, 40.0, (math.sqrt(2.0), 0.0), (0.0, 0.0), 0.01),  # the paper's
    (1.45, 10.0, (0.0, 0.0), (0.4, 0.3), 0.05),
    (1.8, 25.0, (0.4, 0.2), (0.3, 0.5), 0.02),
]


def synthesized_for(campaigns: Collection[str]) -> Pool:
    """Compute the certificates that take a solver, as far as the campaigns need them, with progress on stderr.

    Args:
        campaigns: names, see `campaigns.CAMPAIGNS`.

    Returns:
        The certificates of "lag" and of "robust", empty where no campaign needs them.
    """
    lags = _LAGS if "lag" in campaigns else []
    disturbed = _ROBUST if DISTURBED & set(campaigns) else []
    pool: dict[str, list[Certificate]] = {"lag": [], "robust": []}
    if not lags and not disturbed:
        return pool

    from flatsat_ros.synthesis.nominal import synthesize  # cvxpy takes seconds to import
    from flatsat_ros.synthesis.robust_design import synthesize_robust

    limits = InputSet(1.45 * GRAVITY, math.radians(10.0), GRAVITY)
    with tqdm(total=len(lags) + len(disturbed), desc="certificates", leave=False) as bar:
        for rate, period, lag, delay, lowest in lags:
            pool["lag"].append(synthesize(limits, rate, period, "lag", lag=lag, delay=delay, lowest=lowest))
            bar.update()
        for thrust, tilt, drift, push, period in disturbed:
            limits = InputSet(thrust * GRAVITY, math.radians(tilt), GRAVITY)
            pool["robust"].append(synthesize_robust(limits, drift, push, period, "robust"))
            bar.update()
    return pool
