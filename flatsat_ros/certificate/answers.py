"""Sums of absolute values of a stable loop's answers, and of answers moved by their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# Periods that are summed in one go.
_CHUNK = 16

# A loop has forgotten once so little is left of every state, relatively.
_FORGOTTEN = 1e-12

# Periods after which a loop that still remembers is given up.
_PERIODS_MAX = 20_000


@dataclass(frozen=True)
class Answers:
    """Bounds of what signals C z answer to inputs, z+ = A z + B w, and to starts z(0), the columns of Z.

    Attributes:
        sums: (p, m) sum_i |C A^i B|.
        peaks: (p, k) max_i |C A^i Z|.
        vertex_sums: (V, p, f) the first f sums, with each term moved by its derivative in the direction of a vertex.
        vertex_peaks: (V, p, k) likewise.
    """

    sums: FloatArray
    peaks: FloatArray
    vertex_sums: FloatArray
    vertex_peaks: FloatArray

    @property
    def finite(self) -> bool:
        """Whether the loop is stable."""
        return bool(np.isfinite(self.sums).all())


def answers(
    A: FloatArray,
    B: FloatArray,
    starts: FloatArray,
    signals: FloatArray,
    steps: FloatArray,
    kicks: FloatArray,
    followed: int,
    vertices: FloatArray,
) -> Answers:
    """Return bounds of a loop's answers, exact but for what it has not forgotten at the end, and never below.

    Args:
        A: (n, n).
        B: (n, m).
        starts: (n, k) Z.
        signals: (p, n) rows C.
        steps: (d, n, n) derivatives of A by each parameter.
        kicks: (d, n, f) those of the first columns of B.
        followed: f, how many columns of B are followed to first order; starts are.
        vertices: (V, d) points of the parameters.

    Returns:
        The bounds, infinite where A is not stable.
    """
    n, p, q, m = len(A), len(signals), len(steps), B.shape[1]
    columns = np.concatenate([B, starts], axis=1)
    bending = np.concatenate([B[:, :followed], starts], axis=1)
    kicks = np.concatenate([kicks, np.zeros((q, n, starts.shape[1]))], axis=2)
    bends = [*range(followed), *range(m, columns.shape[1])]
    powers, slopes = [np.eye(n)], [np.zeros((q, n, n))]
    for _ in range(_CHUNK):
        slopes.append(slopes[-1] @ A + powers[-1] @ steps)
        powers.append(powers[-1] @ A)
    moved = np.concatenate([power @ columns for power in powers[:-1]], axis=1)
    turned = np.concatenate(
        [slope @ bending + power @ kicks for power, slope in zip(powers[:-1], slopes[:-1], strict=True)], axis=2
    )
    moved_bending = np.concatenate([power @ bending for power in powers[:-1]], axis=1)
    reach = np.abs(vertices).max(axis=0)
    size = sum(_norm(power) for power in powers[:-1])
    bent = sum(float(reach @ np.abs(slope).sum(axis=2).max(axis=1)) for slope in slopes[:-1])

    # rows C A^i and their derivatives; and all of A^i itself, to see what is forgotten
    rows, turns, spin = np.concatenate([signals, np.eye(n)]), np.zeros((q, p, n)), np.zeros((q, n, n))
    plain, vertex = _Gathered((p,), columns.shape[1], m), _Gathered((len(vertices), p), len(bends), followed)
    weight = np.zeros(p)
    for _ in range(_PERIODS_MAX // _CHUNK):
        values = rows[:-n] @ moved
        plain.add(values)
        bent_values = values.reshape(p, _CHUNK, -1)[:, :, bends].reshape(p, -1)
        vertex.add(bent_values + np.tensordot(vertices, turns @ moved_bending + rows[:p] @ turned, axes=1))
        weight += np.abs(rows[:-n]).sum(axis=1) * ((1 + q) * size + bent)
        weight += size * np.tensordot(reach, np.abs(turns).sum(axis=2), axes=1)
        turns = turns @ powers[-1] + rows[:p] @ slopes[-1]
        spin = spin @ powers[-1] + rows[-n:] @ slopes[-1]
        rows = rows @ powers[-1]
        left = float((np.abs(rows[-n:]).sum(axis=1) + np.tensordot(reach, np.abs(spin).sum(axis=2), axes=1)).max())
        if left < _FORGOTTEN:
            biggest = np.abs(columns).max(axis=0)
            biggest[bends] += np.tensordot(reach, np.abs(kicks).max(axis=1), axes=1)
            rest = np.outer(weight, biggest) * left / (1.0 - left)
            return Answers(*plain.with_rest(rest), *vertex.with_rest(rest[:, bends]))
        if not left < 1e12:
            break
    sizes = (plain.shape, m), (plain.shape, starts.shape[1]), (vertex.shape, followed), (vertex.shape, starts.shape[1])
    infinite = (np.full((*shape, k), np.inf) for shape, k in sizes)
    return Answers(*infinite)


class _Gathered:
    """Sums of the first columns and peaks of the others."""

    def __init__(self, shape: tuple[int, ...], columns: int, summed: int) -> None:
        self.shape = shape
        self._summed = summed
        self._values = np.zeros((*shape, columns))

    def add(self, values: FloatArray) -> None:
        """Take in values (..., periods x columns)."""
        sizes = np.abs(values).reshape(*self.shape, _CHUNK, -1)
        self._values[..., : self._summed] += sizes[..., : self._summed].sum(axis=-2)
        peaks = sizes[..., self._summed :].max(axis=-2)
        np.maximum(self._values[..., self._summed :], peaks, out=self._values[..., self._summed :])

    def with_rest(self, rest: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return sums and peaks with what the rest of time may add to either."""
        total = self._values + rest
        return total[..., : self._summed], total[..., self._summed :]


def _norm(matrix: FloatArray) -> float:
    """Return the largest sum of absolute values of a row."""
    return float(np.abs(matrix).sum(axis=1).max())
