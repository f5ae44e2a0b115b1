"""Certificates made wrong on purpose, after they were verified: campaigns that miss them would prove nothing."""

from __future__ import annotations

from dataclasses import replace

from flatsat_ros.certificate.certificate import Certificate

SABOTAGES = {
    "eps": "the level eps 5 % larger",
    "gain": "gain_max 30 % above the largest constant gain at which the loop is stable",
    "kappa": "gain_min, the smallest kappa of the kappa-sets, 30 % smaller",
    "disturbance": "drift and push 5 % larger than what was allowed for",
}


def sabotaged(kind: str, proven: Certificate) -> Certificate:
    """Return a wrong certificate, which `verify` would refuse; unchanged if it has nothing of that kind.

    Args:
        kind: one of `SABOTAGES`.
        proven: a verified certificate.
    """
    match kind:
        case "eps":
            return replace(proven, level=1.05 * proven.level)
        case "gain":
            from flatsat_ros.synthesis.gain_cap import worst_case  # cvxpy takes seconds to import

            limit = min(worst_case(proven.timing, block, proven.gain_max).constant for block in proven.blocks)
            return replace(proven, gain_max=1.3 * limit)
        case "kappa":
            return replace(proven, gain_min=0.7 * proven.gain_min)
        case _:
            robust = proven.robust
            if robust is None:
                return proven
            return replace(proven, robust=replace(robust, drift=1.05 * robust.drift, push=1.05 * robust.push))
