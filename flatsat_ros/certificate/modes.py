"""Modal coordinates of loops, in which bounds of what remains of a state are closest.

What is proved in these coordinates is true for any coordinates: they are floats, and their inverse is enclosed. How
well they separate the modes only decides how close the bounds are.
"""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import TINY, UP, Enclosure

# Modes with smaller absolute eigenvalues need no coordinates of their own.
_SLOW = 0.9


def modes_of(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return modal coordinates of loops z+ = A z, and the absolute eigenvalues of the slowest modes.

    Args:
        A: (N, n, n).

    Returns:
        (N, n, n) columns: real and imaginary parts of the eigenvectors of slow modes, and an orthonormal basis of the
        subspace of the other modes; and (N,) largest absolute eigenvalues. Where numbers overflow: unit matrix and 1.
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
    """Return enclosures of the inverses of matrices (N, n, n); infinitely wide ones where no inverse is shown to exist.

    With R = 1 - M G of norm r < 1 the inverse of G is M + R M + R^2 M + ..., where M is what is computed.
    """
    mid: FloatArray = np.asarray(np.linalg.pinv(np.nan_to_num(matrices, posinf=0.0, neginf=0.0)), dtype=np.float64)
    wrong = (np.eye(matrices.shape[-1]) - Enclosure(mid) @ matrices).size
    norm = wrong.sum(axis=-1).max(axis=-1)[:, None, None] * UP
    rest = norm * norm / (1.0 - norm) * np.abs(mid).max(axis=-2, keepdims=True)
    return Enclosure(mid, np.where(norm < 0.5, (wrong @ np.abs(mid) + rest) * UP + TINY, np.inf))
