"""Arrays of which each entry is known to lie in an interval: midpoint and radius, rounded outwards.

After S. M. Rump, whatever order sums are taken in, on whatever kernel, with fused multiplications or without: of inner
products of length k

    |fl(A B) - A B| <= (k u / (1 - k u)) |A| |B| + k eta,       u = 2^-53, eta below 1e-300

because every product and every sum on the way to an entry is wrong by at most the share u of its size. Radii are sums
of products of numbers that are not negative; computed in floating point they are too small by at most the share u per
operation, for which they are enlarged. So nothing depends on how the processor rounds, as long as it is to the nearest.
docs/mathematics.md has the argument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Context, Decimal
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# Share by which one operation on numbers of double precision is wrong at most.
ROUNDING = 2.0**-53

# Sums and products of up to 2^16 operations on numbers that are not negative, times this, are not below the truth.
UP = 1.0 + 2.0**-36

# Above all that underflow can take from a sum.
TINY = 1e-290

# Order of the series of the exponential, of matrices whose rows add up to at most _SMALL.
_ORDER, _SMALL = 14, 0.125

# Above the rest of that series: (1/8)^15 / 15! / (1 - 1/8) < 1e-25.
_REST = 1e-25

# What is a float, an array of floats, or an enclosure of such.
Numbers = Any


class Enclosure:
    """An array of numbers, each within a radius of its midpoint; leading axes are those of a batch.

    Attributes:
        mid: midpoints.
        rad: radii, at least 0, of the shape of `mid`.
    """

    __array_ufunc__ = None  # so that numpy leaves operations with its arrays to this class

    def __init__(self, mid: FloatArray, rad: FloatArray | None = None) -> None:
        self.mid = mid
        self.rad = np.zeros_like(mid) if rad is None else rad

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return self.mid.shape

    @property
    def size(self) -> FloatArray:
        """Bounds of the absolute values."""
        return np.asarray((np.abs(self.mid) + self.rad) * UP)

    def __getitem__(self, index: Any) -> Enclosure:
        return Enclosure(self.mid[index], self.rad[index])

    def __neg__(self) -> Enclosure:
        return Enclosure(-self.mid, self.rad)

    def __add__(self, other: Numbers) -> Enclosure:
        other = enclosed(other)
        mid = self.mid + other.mid
        return Enclosure(mid, (self.rad + other.rad + ROUNDING * np.abs(mid)) * UP + TINY)

    __radd__ = __add__

    def __sub__(self, other: Numbers) -> Enclosure:
        return self + -enclosed(other)

    def __rsub__(self, other: Numbers) -> Enclosure:
        return enclosed(other) + -self

    def __mul__(self, other: Numbers) -> Enclosure:
        other = enclosed(other)
        mid = self.mid * other.mid
        rad = np.abs(self.mid) * other.rad + self.rad * (np.abs(other.mid) + other.rad) + ROUNDING * np.abs(mid)
        return Enclosure(mid, rad * UP + TINY)

    __rmul__ = __mul__

    def __truediv__(self, other: int) -> Enclosure:
        mid = self.mid / other
        return Enclosure(mid, (self.rad / other + ROUNDING * np.abs(mid)) * UP + TINY)

    def __matmul__(self, other: Numbers) -> Enclosure:
        return _product(self, enclosed(other))

    def __rmatmul__(self, other: Numbers) -> Enclosure:
        return _product(enclosed(other), self)


def _product(left: Enclosure, right: Enclosure) -> Enclosure:
    size = np.abs(right.mid)
    rad = np.abs(left.mid) @ (right.rad + rounding(left.shape[-1]) * size) + left.rad @ (size + right.rad)
    return Enclosure(left.mid @ right.mid, rad * UP + TINY)


def rounding(count: int) -> float:
    """Return a bound of the error of inner products of a length, as a share of the sum of their absolute products."""
    return (count + 2) * ROUNDING


@lru_cache(maxsize=4096)
def decimal(value: float) -> Fraction:
    """Return the shortest decimal that is read as this float: the number that a file says."""
    return Fraction(repr(float(value)))


def upper(value: Fraction) -> float:
    """Return a float that is not below a number of at least 0."""
    return float(value) * UP + TINY


def exponential_above(exponent: Fraction) -> float:
    """Return a float that is hardly above e^x and not below it."""
    context = Context(prec=30)
    power = context.exp(context.divide(Decimal(exponent.numerator), Decimal(exponent.denominator)))
    return upper(Fraction(power))


def sine(angle: Fraction) -> Fraction:
    """Return a close lower bound of the sine of an angle between 0 and pi/2: its series up to a negative term."""
    term, total = angle, angle
    for order in range(2, 2 * _ORDER, 2):
        term = -term * angle * angle / (order * (order + 1))
        total += term
    return total if term < 0 else total - term


def enclosed(value: Numbers) -> Enclosure:
    """Return an enclosure of numbers: floats exactly, fractions as the nearest float with its error."""
    if isinstance(value, Enclosure):
        return value
    if isinstance(value, Fraction):
        value = [value]
        return enclosed_fractions(value)[0]
    return Enclosure(np.asarray(value, dtype=np.float64))


def enclosed_fractions(values: Sequence[Any]) -> Enclosure:
    """Return an enclosure of fractions in nested lists."""
    mid = np.array(values, dtype=object).astype(np.float64)
    return Enclosure(mid, ROUNDING * np.abs(mid) * UP + TINY)


def concatenate(parts: Sequence[Numbers], axis: int) -> Numbers:
    """Join arrays, or enclosures and arrays, along a negative axis; leading axes are broadcast."""
    if not any(isinstance(part, Enclosure) for part in parts):
        return np.concatenate([np.asarray(part) for part in parts], axis=axis)
    whole = [enclosed(part) for part in parts]
    lead = np.broadcast_shapes(*(part.shape[:-2] for part in whole))

    def broadcast(arrays: list[FloatArray]) -> FloatArray:
        return np.concatenate([np.broadcast_to(part, lead + part.shape[-2:]) for part in arrays], axis=axis)

    return Enclosure(broadcast([part.mid for part in whole]), broadcast([part.rad for part in whole]))


def joined(*parts: Enclosure) -> Enclosure:
    """Join enclosures of the same leading axes along the last axis."""
    return Enclosure(np.concatenate([part.mid for part in parts], -1), np.concatenate([part.rad for part in parts], -1))


def filled(shape: tuple[int, ...], entries: Mapping[Any, Numbers]) -> Numbers:
    """Return an array of zeros but for some entries, each a number or a batch of numbers."""
    if not any(isinstance(value, Enclosure) for value in entries.values()):
        array = np.zeros(shape)
        for index, value in entries.items():
            array[index] = value
        return array
    lead = np.broadcast_shapes(*(enclosed(value).shape for value in entries.values()))
    mid, rad = np.zeros((*lead, *shape)), np.zeros((*lead, *shape))
    for index, value in entries.items():
        number, place = enclosed(value), np.ravel_multi_index(index, shape)
        for array, values in ((mid, number.mid), (rad, number.rad)):
            array.reshape(*lead, -1)[..., place] = values
    return Enclosure(mid, rad)


def exponential(matrix: Numbers) -> Numbers:
    """Return e^M of small square matrices, by its series and squaring."""
    whole = enclosed(matrix)
    largest, halvings = float((whole.size.sum(axis=-1) * UP).max()), 0
    while largest > _SMALL:
        largest, halvings = largest / 2.0, halvings + 1
    scale = 2.0**-halvings
    step = Enclosure(whole.mid * scale, whole.rad * scale + TINY) if isinstance(matrix, Enclosure) else matrix * scale
    unit = np.eye(whole.shape[-1])
    result: Numbers = unit + step / _ORDER
    for order in range(_ORDER - 1, 0, -1):
        result = unit + (step @ result) / order
    if isinstance(result, Enclosure):
        result = Enclosure(result.mid, result.rad + _REST)
    for _ in range(halvings):
        result = result @ result
    return result
