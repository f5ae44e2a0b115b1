"""Coordinates in which loops fade mode by mode, so that of what is left of them little is counted twice.

What is proved in them is true whatever they are: they are floats, and their inverse is enclosed. How well they sort
the modes only decides how close bounds are.
"""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import TINY, UP, Enclosure

# Modes of which less than this is left from period to period need no coordinates of their own.
_SLOW = 0.9


def modes_of(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return coordinates of loops z+ = A z, and what from period to period is left of the mode that fades last.

    Args:
        A: (N, n, n).

    Returns:
        (N, n, n) columns: real and imaginary parts of the slow modes, and an orthonormal basis of what has no part of
        any of them; and (N,) largest absolute eigenvalues. Where numbers overflow, the coordinates are what they were.
    """
    try:
        sizes, right = _sorted(A)
        slow = (sizes > _SLOW)[:, None]
        _, left = _sorted(A.swapaxes(1, 2))
        rest = np.linalg.svd(np.where(slow, left, 0.0).swapaxes(1, 2))[2].swapaxes(1, 2)
    except np.linalg.LinAlgError:
        return np.zeros_like(A) + np.eye(A.shape[-1]), np.ones(len(A))
    return np.where(slow, right, rest), sizes[:, 0]


def _sorted(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return absolute eigenvalues (N, n), the largest first, and the real and imaginary parts of their vectors."""
    values, vectors = np.linalg.eig(A)
    order = np.argsort(-np.abs(values), axis=1, kind="stable")
    values, vectors = np.take_along_axis(values, order, 1), np.take_along_axis(vectors, order[:, None], 2)
    return np.abs(values), np.where(values.imag[:, None] < 0.0, vectors.imag, vectors.real)


def inverse(matrices: FloatArray) -> Enclosure:
    """Return enclosures of the inverses of matrices (N, n, n); infinitely wide ones if it is not shown that they exist.

    With R = 1 - M G of norm r < 1 the inverse of G is M + R M + R^2 M + ..., where M is what is computed.
    """
    mid: FloatArray = np.asarray(np.linalg.pinv(np.nan_to_num(matrices, posinf=0.0, neginf=0.0)), dtype=np.float64)
    wrong = (np.eye(matrices.shape[-1]) - Enclosure(mid) @ matrices).size
    norm = wrong.sum(axis=-1).max(axis=-1)[:, None, None] * UP
    rest = norm * norm / (1.0 - norm) * np.abs(mid).max(axis=-2, keepdims=True)
    return Enclosure(mid, np.where(norm < 0.5, (wrong @ np.abs(mid) + rest) * UP + TINY, np.inf))
