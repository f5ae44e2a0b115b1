"""The polynomials that paths are made of, and the trajectory of several axes that are made apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.trajectory import SIZE, Trajectory

# Bernstein polynomials of degree n at this many times of a segment: limits are looked at there
NODES = np.linspace(0.0, 1.0, 17)
BERNSTEIN = [
    np.array([math.comb(n, i) * NODES**i * (1.0 - NODES) ** (n - i) for i in range(n + 1)]).T for n in range(7)
]


class Part(NamedTuple):
    """A piecewise polynomial of some axes that begins at 0 s: ends of its segments (M,), coefficients (M, 8, d)."""

    ends: FloatArray
    coefficients: FloatArray


def at_nodes(points: FloatArray) -> FloatArray:
    """Return the values (K, nodes, d) of polynomials of degree n with control points (K, n + 1, d)."""
    return np.asarray(BERNSTEIN[points.shape[1] - 1] @ points)


def constant(place: FloatArray) -> FloatArray:
    """Return (1, 8, d) coefficients of a place."""
    coefficients = np.zeros((1, SIZE, place.size))
    coefficients[0, 0] = place
    return coefficients


def integrated(velocity: FloatArray, place: FloatArray) -> FloatArray:
    """Return the coefficients (8, d) of the position whose velocity has the coefficients (6, d), from a place on."""
    position = np.zeros((SIZE, place.size))
    position[0] = place
    position[1:7] = velocity / np.arange(1.0, 7.0)[:, np.newaxis]
    return position


def derived(coefficients: FloatArray) -> FloatArray:
    """Return the coefficients (8, d) of the derivative of a polynomial (8, d)."""
    derivative = np.zeros_like(coefficients)
    derivative[:-1] = coefficients[1:] * np.arange(1.0, SIZE)[:, np.newaxis]
    return derivative


def value(coefficients: FloatArray, t: float) -> FloatArray:
    """Return the value (d,) of a polynomial (8, d) at t."""
    return np.asarray(np.power(t, np.arange(SIZE)) @ coefficients)


def _moved(coefficients: FloatArray, t: float) -> FloatArray:
    """Return the coefficients (8, d) of the same polynomial (8, d) with its origin at t."""
    shift = np.array([[math.comb(i, j) * t ** (i - j) if i >= j else 0.0 for i in range(SIZE)] for j in range(SIZE)])
    return np.asarray(shift @ coefficients)


def of_all_axes(parts: Sequence[Part], start: float, yaw: float) -> Trajectory:
    """Return the trajectory whose axes are those of the parts, in their order."""
    ends = np.unique(np.concatenate([part.ends for part in parts]))
    begins = np.concatenate([[0.0], ends[:-1]]) if ends.size else np.zeros(0)
    if not ends.size:
        return Trajectory(np.array([start]), np.concatenate([part.coefficients for part in parts], axis=2), yaw)
    segments = []
    for begin in begins:
        columns = []
        for part in parts:
            index = int(np.searchsorted(part.ends, begin, side="right"))
            origin = float(part.ends[index - 1]) if index else 0.0
            columns.append(_moved(part.coefficients[index], float(begin) - origin))
        segments.append(np.concatenate(columns, axis=1))
    return Trajectory(start + np.concatenate([[0.0], ends]), np.array(segments), yaw)
