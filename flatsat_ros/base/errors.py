"""The one base class of everything this package refuses, and the checks that raise it."""

from __future__ import annotations

import math

import numpy as np


class FlatsatError(ValueError):
    """A value that cannot be used; the text names the value, the bound it breaks and what would be valid."""


def require(holds: bool, name: str, value: object, valid: str) -> None:
    """Raise FlatsatError unless the bound holds: "name is value: valid is ..."."""
    if not holds:
        raise FlatsatError(f"{name} is {value}: valid is {valid}")


def require_positive(name: str, value: float, unit: str) -> float:
    """Return value as a float, refusing what is not a finite number above 0."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)) or not 0.0 < value < math.inf:
        raise FlatsatError(f"{name} = {value!r} {unit}: must be a finite number above 0")
    return float(value)
