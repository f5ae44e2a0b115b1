"""Inequalities between numbers and symmetric matrices, decided in rational arithmetic.

The figures of a certificate are the decimals that are written in its file, so that what holds of them is no matter of
rounding. Matrices are numpy arrays of fractions. The printed figure of an inequality is a float; its sign is exact.
"""

from __future__ import annotations

import math
from decimal import Context, Decimal
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flatsat_ros.certificate.enclosures import decimal, sine
from flatsat_ros.law.input_set import InputSet

# A matrix of fractions.
Rationals = NDArray[np.object_]

# The relative slack that is printed for an inequality that fails by less than a float can show.
_UNSEEN = 2.0**-60

# Rows from which on pivots have too many digits: the matrix is rounded first, to so many bits, to the safe side.
_MANY, _BITS = 9, 128

# Digits of the exponential, and places after the point of its bounds.
_DIGITS, _PLACES = 40, 10**36


def rationals(values: ArrayLike) -> Rationals:
    """Return the shortest decimals that are read as these floats, exactly, in an array of the same shape."""
    array = np.asarray(values, dtype=np.float64)
    exact = np.empty(array.shape, dtype=object)
    for place in np.ndindex(array.shape):
        exact[place] = decimal(float(array[place]))
    return exact


def product(*matrices: Rationals) -> Rationals:
    """Return the product of matrices of fractions, computed with integers, which is many times faster."""
    whole, denominator = integers(matrices[0])
    for matrix in matrices[1:]:
        other, scale = integers(matrix)
        whole, denominator = whole @ other, denominator * scale
    return np.asarray(whole * Fraction(1, denominator))


def integers(matrix: Rationals) -> tuple[Rationals, int]:
    """Return a matrix of fractions as integers and their common denominator."""
    entries = [Fraction(entry) for entry in matrix.ravel().tolist()]
    denominator = math.lcm(*(entry.denominator for entry in entries))
    whole = np.empty(len(entries), dtype=object)
    whole[:] = [entry.numerator * (denominator // entry.denominator) for entry in entries]
    return whole.reshape(matrix.shape), denominator


def semidefinite(matrix: Rationals) -> bool:
    """Tell whether x'M x >= 0 for all x: whether no pivot of the symmetric elimination is negative.

    For large matrices the answer is yes only where it holds with a relative margin of about 2^-100.
    """
    if any(entry < 0 for entry in np.diagonal(matrix)):
        return False
    if len(matrix) == 2:  # most are
        return bool(matrix[0, 0] * matrix[1, 1] >= matrix[0, 1] ** 2)
    whole = _coarse(matrix) if len(matrix) >= _MANY else integers(matrix)[0]
    before = 1  # E. H. Bareiss: with the pivot before, all quotients are integers
    while len(whole):
        pivot, row = whole[0, 0], whole[0, 1:]
        whole = whole[1:, 1:]
        if pivot < 0 or (pivot == 0 and any(row)):
            return False
        if pivot > 0:
            whole = (whole * pivot - np.outer(row, row)) // before
            before = pivot
    return True


def _coarse(matrix: Rationals) -> Rationals:
    """Return integers of _BITS bits whose matrix is a lower bound of this one, after scaling rows and columns alike."""
    count, rows = len(matrix), matrix.tolist()
    halves = [math.frexp(float(row[i]))[1] // 2 if row[i] > 0 else 0 for i, row in enumerate(rows)]
    whole = np.empty(matrix.shape, dtype=object)
    for i, j in np.ndindex(matrix.shape):
        whole[i, j] = round(rows[i][j] * Fraction(2) ** (_BITS - halves[i] - halves[j]))
    # entries are wrong by 1/2 at most, so that x'x n/2 is above what they are wrong by
    return np.asarray(whole - count * np.eye(count, dtype=int))


def signed(slack: float, holds: bool) -> float:
    """Return the slack of an inequality as computed, with the sign that is exact."""
    return max(0.0, slack) if holds else min(slack, -_UNSEEN)


def spare(value: Fraction, most: Fraction) -> float:
    """Return by how much, relatively, a value is below a bound; below 0 exactly if it is above."""
    return signed(float(1 - value / most), value <= most)


def definite(matrix: Rationals, share: Fraction) -> bool:
    """Tell whether all eigenvalues are at least a share of the largest sum of absolute values of a row."""
    largest = max(sum(abs(entry) for entry in row) for row in matrix)
    return largest > 0 and semidefinite(matrix - share * largest * np.eye(len(matrix), dtype=int))


def decaying(time: Fraction) -> tuple[Fraction, Fraction]:
    """Return a lower and an upper bound of e^-x, x >= 0."""
    context = Context(prec=_DIGITS)
    power = Fraction(context.exp(-context.divide(Decimal(time.numerator), Decimal(time.denominator))))
    # the quotient is wrong by 1e-40 x, e^-x by x e^-x 1e-40 < 1e-39 and its own rounding
    middle = math.floor(power * _PLACES)
    return Fraction(max(middle - 1, 0), _PLACES), Fraction(min(middle + 2, _PLACES), _PLACES)


def inner_radius(limits: InputSet) -> Fraction:
    """Return `limits.inner_radius`, rounded down."""
    gravity = decimal(limits.gravity)
    lift = decimal(limits.thrust_max) - gravity
    return min(gravity * sine(decimal(limits.tilt_max)), lift, gravity - decimal(limits.thrust_min))
