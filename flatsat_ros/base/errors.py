"""The one base class of the errors with which this package refuses a value, and the checks that raise it."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Callable, Iterable
from typing import TypeGuard

import numpy as np

# Of every number in SI units. What physics gives lies far inside; beyond, squares and quotients of a few of them leave
# the range of floating-point numbers.
SMALLEST, LARGEST = 1e-12, 1e12


class FlatsatError(ValueError):
    """A value that cannot be used; the text names the value, the bound it breaks and what would be valid.

    It is one line and, where it is about a value, reads "name = value unit: must be ...".
    """


def refusal(name: str, value: object, unit: str, valid: str) -> FlatsatError:
    """Return the refusal of a value: "name = value unit: must be valid".

    Args:
        name: of the value, of any length: parts of it may be what somebody wrote.
        value: as it was given, of any length.
        unit: of the value; empty for none.
        valid: what would have been valid, after "must be".
    """
    return FlatsatError(f"{one_line(name, 150)} = {quoted(value)}{' ' if unit else ''}{unit}: must be {valid}")


def nearest_name(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return "; the nearest is X", for the end of a refusal: X is the known name most like a word. Empty for none.

    Args:
        word: that is not known.
        known: names.
        cutoff: how alike they must be, from 0 to 1, as `difflib` measures it.
    """
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)
    return f"; the nearest is {near[0]}" if near else ""


def require(holds: bool, name: str, value: object, unit: str, valid: str) -> None:
    """Refuse a value unless its bound holds; the arguments are those of `refusal`.

    Raises:
        FlatsatError: it does not.
    """
    if not holds:
        raise refusal(name, value, unit, valid)


def require_number(name: str, value: object, unit: str, least: float = -LARGEST, most: float = LARGEST) -> float:
    """Return a value as a float.

    Args:
        name: of the value, for the error.
        value: what must be a number, not a boolean, from least to most.
        unit: of the value, for the error.
        least: smallest valid value.
        most: largest valid value.

    Raises:
        FlatsatError: it is not.
    """
    if not _is_number(value) or not least <= value <= most:
        raise refusal(name, value, unit, f"a number from {least:g} to {most:g}")
    return float(value)


def require_positive(name: str, value: object, unit: str) -> float:
    """Return a value as a float, refusing what is not a number from SMALLEST to LARGEST.

    Args:
        name: of the value, for the error.
        value: what must be a number above 0, not a boolean.
        unit: of the value, for the error.

    Raises:
        FlatsatError: it is not.
    """
    if not _is_number(value) or not SMALLEST <= value <= LARGEST:
        raise refusal(name, value, unit, f"a number above 0, from {SMALLEST:g} to {LARGEST:g}")
    return float(value)


def require_not_negative(name: str, value: object, unit: str) -> float:
    """Return a value as a float, refusing what is not a number from 0 to LARGEST.

    The arguments are those of `require_positive`.

    Raises:
        FlatsatError: it is not.
    """
    return require_number(name, value, unit, 0.0)


def require_zero_or_positive(name: str, value: object, unit: str) -> float:
    """Return a value as a float, refusing what is neither 0 nor a number from SMALLEST to LARGEST.

    The arguments are those of `require_positive`.

    Raises:
        FlatsatError: it is not.
    """
    if not _is_number(value) or not (value == 0.0 or SMALLEST <= value <= LARGEST):
        raise refusal(name, value, unit, f"0, or a number from {SMALLEST:g} to {LARGEST:g}")
    return float(value)


def require_fields(owner: object, check: Callable[[str, object, str], float], **units: str) -> None:
    """Check fields of a frozen dataclass, and keep them as floats.

    Args:
        owner: the object.
        check: such as `require_positive`.
        units: the unit of each field, by its name.

    Raises:
        FlatsatError: one is refused.
    """
    for name, unit in units.items():
        object.__setattr__(owner, name, check(name, getattr(owner, name), unit))


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def quoted(value: object) -> str:
    """Return a value for an error message: in one line of at most 100 characters, however large the value is."""
    return one_line(_SHORT.repr(value.item() if isinstance(value, np.generic) else value), 100)


def reason_of(error: Exception) -> str:
    """Return what went wrong, in one line; of an OSError the file, then the reason."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


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
