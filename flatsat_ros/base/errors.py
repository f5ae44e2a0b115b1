"""The one base class of the errors with which this package refuses a value, and the checks that raise it."""

from __future__ import annotations

import math

import numpy as np


class FlatsatError(ValueError):
    """A value that cannot be used; the text names the value, the bound it breaks and what would be valid."""


def require(holds: bool, name: str, value: object, valid: str) -> None:
    """Raise a FlatsatError unless a bound holds: "name is value: valid is ...".

    Args:
        holds: whether the value keeps its bound.
        name: of the value.
        value: as it was given.
        valid: what would have been valid, with its unit.
    """
    if not holds:
        raise FlatsatError(f"{name} is {value}: valid is {valid}")


def require_positive(name: str, value: float, unit: str) -> float:
    """Return value as a float.

    Args:
        name: of the value, for the error.
        value: what must be a finite number above 0.
        unit: of the value, for the error.

    Raises:
        FlatsatError: it is not.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)) or not 0.0 < value < math.inf:
        raise FlatsatError(f"{name} = {value!r} {unit}: must be a finite number above 0")
    return float(value)
