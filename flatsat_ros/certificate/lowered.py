"""Claims that fail by no more than rounding, lowered until they hold exactly for the decimals that are written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.inequalities import ideal_margins

# A claim, whether a smaller figure claims less, and a part of the names of the inequalities that depend on it.
_CLAIMS = (
    ("ball", True, "the ball |v|^2 <= rho"),
    ("rate", True, "A'P + P A"),
    ("level", True, "<= eps implies"),
    ("gain_min", False, "does not grow during a period at gain_min"),
    ("gain_max", True, "does not grow during a period at gain_max"),
)

# Shares by which claims are lowered, one after the other: rounding, and no more.
_SHARES = 2.0 ** np.arange(-52.0, -32.0)


def lowered(certificate: Certificate) -> tuple[Certificate, dict[str, float]]:
    """Return the certificate with claims that hold exactly, and the share by which each lowered claim was lowered.

    If a claim fails by more than rounding, the certificate is returned as it is.

    Args:
        certificate: of which nothing is proved yet.
    """
    candidate, shares = certificate, dict[str, float]()
    for share in _SHARES.tolist():
        with np.errstate(all="ignore"):
            margins = ideal_margins(candidate)
        failing = [
            claim
            for claim, _, text in _CLAIMS
            if any(text in name and not margin >= 0.0 for name, margin in margins.items())
        ]
        if not failing:
            return candidate, shares
        shares |= dict.fromkeys(failing, share)
        factors = {
            claim: 1.0 - shares[claim] if smaller else 1.0 + shares[claim]
            for claim, smaller, _ in _CLAIMS
            if claim in shares
        }
        changes = {claim: getattr(certificate, claim) * factor for claim, factor in factors.items()}
        candidate = replace(certificate, **changes)
    return certificate, {}
