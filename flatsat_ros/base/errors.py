"""The one base class of the errors with which this package refuses a value, and the checks that raise it."""

from __future__ import annotations

import math
import reprlib

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


def quoted(value: object) -> str:
    """Return a value for an error message: in one line of at most 100 characters, however large the value is."""
    return one_line(_SHORT.repr(value.item() if isinstance(value, np.generic) else value), 100)


def one_line(text: str, length: int = 300) -> str:
    """Return a text without line breaks and control characters, cut to a length."""
    words = " ".join("".join(c if c.isprintable() else " " for c in text[: 4 * length]).split())
    return words if len(words) <= length else words[: length - 3] + "..."


class _Short(reprlib.Repr):
    """The representation of a value, cut to a few entries of each level."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 3, 80, 100

    def repr_int(self, x: int, level: int) -> str:
        return repr(x) if abs(x) < 2**64 else f"an integer of {x.bit_length()} bits"  # the longest have no repr


_SHORT = _Short()
