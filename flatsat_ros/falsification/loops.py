"""What campaigns and studies of closed loops have in common: the integration of continuous time, and the worst wind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.robust import Robust


def runge_kutta(slope: Callable[[int, FloatArray], FloatArray], y: FloatArray, step: float) -> FloatArray:
    """Return the state one step of Runge and Kutta's method of fourth order later.

    Args:
        slope: y' given the time, in half steps from now (0, 1 or 2), and y.
        y: state, any shape.
        step: s.
    """
    k1 = slope(0, y)
    k2 = slope(1, y + step / 2.0 * k1)
    k3 = slope(1, y + step / 2.0 * k2)
    k4 = slope(2, y + step * k3)
    return np.asarray(y + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


def disturbance_matrix(robust: Robust) -> FloatArray:
    """Return E (6, 6) of xi' = A xi + B v + E w, diagonal: the drift in m/s, then the push in m/s^2."""
    return np.diag(np.concatenate([robust.drift[[0, 0, 1]], robust.push[[0, 0, 1]]]))


def unit(w: FloatArray) -> FloatArray:
    """Return the vectors (..., n) with length 1; 0 stays 0."""
    length = np.linalg.norm(w, axis=-1, keepdims=True)
    return np.asarray(w / np.where(length > 0.0, length, 1.0))


def worst_disturbance(gradient: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return the w with w'w <= 1 that raises V most: along E'P xi, since V' contains 2 xi'P E w.

    Args:
        gradient: (N, 6) xi'P.
        matrix: E (6, 6), or what takes its place over a period.

    Returns:
        (N, 6).
    """
    return unit(gradient @ matrix)
