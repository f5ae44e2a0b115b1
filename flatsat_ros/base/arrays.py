"""Arrays: their types, and the check that every public function makes of what it is given."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flatsat_ros.base.errors import FlatsatError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def float_array(name: str, value: ArrayLike, width: int | None = None) -> FloatArray:
    """Return value as an array of floats, as `finite_array` does, but take entries that are not finite."""
    array = np.asarray(value, dtype=np.float64)
    if width is not None and (array.ndim == 0 or array.shape[-1] != width):
        raise FlatsatError(f"{name} has shape {array.shape}: valid is (..., {width})")
    return array


def finite_array(name: str, value: ArrayLike, width: int | None = None) -> FloatArray:
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
    if np.count_nonzero(finite) < finite.size:  # a third of the cost of all() on small arrays
        raise FlatsatError(f"{name} contains {array[~finite].flat[0]}: every entry must be a finite number")
    return array
