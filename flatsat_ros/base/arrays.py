"""Arrays: their types, and the check that every public function makes of what it is given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.errors import refusal, require

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def float_array(name: str, value: object, width: int | None = None) -> FloatArray:
    """Return value as an array of floats, as `finite_array` does, but take entries that are not finite."""
    try:
        array = np.asarray(value)
    except ValueError as error:  # rows of different lengths
        raise refusal(name, value, "", "an array of numbers") from error
    if array.dtype != np.float64:
        require(array.dtype.kind in "fiub", name, value, "", "an array of numbers")
        array = array.astype(np.float64)
    if width is not None and (array.ndim == 0 or array.shape[-1] != width):
        raise refusal(f"shape of {name}", array.shape, "", f"(..., {width})")
    return array


def finite_array(name: str, value: object, width: int | None = None) -> FloatArray:
    """Return value as an array of floats, each of them finite.

    Args:
        name: of the value, for the error.
        value: any shape or, with `width`, (..., width).
        width: required length of the last axis.

    Raises:
        FlatsatError: the shape is wrong or an entry is not finite.
    """
    array = float_array(name, value, width)
    finite = np.isfinite(array)
    if not all_of(finite):
        raise refusal(f"an entry of {name}", array[~finite].flat[0], "", "a finite number")
    return array


def any_of(holds: BoolArray) -> bool:
    """Tell whether any entry of booleans is true, in a tenth of the time of `any` where there are few."""
    return 1 in holds.tobytes()


def all_of(holds: BoolArray) -> bool:
    """Tell whether every entry of booleans is true, see `any_of`."""
    return 0 not in holds.tobytes()


def require_each(holds: BoolArray, name: str, values: FloatArray, unit: str, valid: str) -> None:
    """Refuse the first entry whose bound does not hold.

    Args:
        holds: whether each entry keeps its bound, of the shape of the values.
        name: of the value, for the error.
        values: as they were given, any shape.
        unit: of the values, for the error.
        valid: what would have been valid, after "must be".

    Raises:
        FlatsatError: there is one.
    """
    if not holds.all():
        raise refusal(name, values[~holds][0], unit, valid)
