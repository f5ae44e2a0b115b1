"""Decimal figures on the safe side, so that a certificate is the same file whatever the processor computed it.

Linear algebra differs in its last digits from one processor to the next. A figure that is rounded to fewer digits than
those, before anything is proved about it, does not, and neither does what is computed from it.
"""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# Significant digits of a figure that a certificate states.
DIGITS = 11

# Digits of a matrix's entry, relative to the root of the product of the two entries on the diagonal.
MATRIX_DIGITS = 8

# Digits that every processor agrees on: what differs from a decimal figure beyond them is that figure.
_COMMON_DIGITS = 14


def round_down(value: float, digits: int = DIGITS) -> float:
    """Return the largest number of so many significant digits that is at most `value`; both are positive."""
    return _rounded(value, digits, ROUND_FLOOR)


def round_up(value: float, digits: int = DIGITS) -> float:
    """Return the smallest number of so many significant digits that is at least `value`; both are positive."""
    return _rounded(value, digits, ROUND_CEILING)


def _rounded(value: float, digits: int, rounding: str) -> float:
    common = Context(prec=_COMMON_DIGITS, rounding=ROUND_HALF_EVEN).create_decimal_from_float(value)
    return float(Context(prec=digits, rounding=rounding).create_decimal(common))


def round_matrix(matrix: FloatArray) -> FloatArray:
    """Return a positive definite matrix with decimal entries; nothing is proved about it yet.

    Args:
        matrix: (n, n), symmetric and positive definite.
    """
    scale = np.sqrt(np.diag(matrix))
    rounded = np.empty_like(matrix)
    for (i, j), entry in np.ndenumerate(matrix):
        places = MATRIX_DIGITS - 1 - math.floor(math.log10(scale[i] * scale[j]))
        rounded[i, j] = round(float(entry), places)
    return rounded
