"""The sums of loops' responses in progress, a chunk of 16 periods at a time: see `certificate.answers`."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import UP, Enclosure

# By how much, relatively, the sums of the state are taken to be above what was summed, and rounds to find them.
_SLACK, _ROUNDS = 1e-6, 60


@dataclass(frozen=True)
class Products:
    """Memory for the responses to columns in a chunk; the letters are those of `Running`.

    Attributes:
        raw: (N, 1 + d, p + n, columns) the responses and their derivatives.
        rows: (N, p + n + e, columns) sizes of the responses.
        vertex: (N, V, p, columns) those of their combinations at the vertices.
        bent: (N, d, n, columns) those of the state's derivatives.
    """

    raw: FloatArray
    rows: FloatArray
    vertex: FloatArray
    bent: FloatArray

    @classmethod
    def of(cls, size: tuple[int, ...], columns: int) -> Products:
        """Return memory of a size N, d, V, p, n, e, and so many columns."""
        N, d, V, p, n, e = size
        shapes = (N, 1 + d, p + n), (N, p + n + e), (N, V, p), (N, d, n)
        return cls(*(np.empty((*shape, columns)) for shape in shapes))

    def some(self, count: int) -> Products:
        """Return the memory of the first loops."""
        return Products(*(getattr(self, field.name)[:count] for field in fields(self)))


@dataclass(frozen=True)
class Running:
    """The sums so far, and what they are continued with: arrays with one entry per loop.

    There are b columns with derivatives, f inputs and the k starts, and c columns without; F is the number of factors.
    The rows are p signals with derivatives, the n rows of the unit matrix, and e signals without derivatives.

    Attributes:
        place: (N,) of each loop among those of the batch.
        waiting: (N, F) for which factors its sums are not finished.
        rows: (N, p + n + e, n), C A^i and A^i at the chunk's beginning.
        turns: (N, d, p + n, 2 n), their derivatives, and beside them the rows again.
        rows_size, turns_size: (N, p + n + e, n) and (N, p + n, n), sizes of the rows and, times the reach, of their
            derivatives together.
        rows_sum, turns_sum: (N, F, p + n + e, n) and (N, F, p + n, n), sums of these over the chunks.
        plain, others: (N, F, p + n + e, f) and (N, F, p + n + e, c), sums of the responses' sizes.
        vertex, bent: (N, F, V, p, f) and (N, F, n, f), likewise; those of the state's derivatives, times the reach.
        peaks, vertex_peaks, bent_peaks: (N, p + n + e, 16 k), (N, V, p, 16 k) and (N, n, 16 k), largest ones to
            starts for the last factor, at each period of a chunk.
        moved, moved_others: (N, n, 16 b) and (N, n, 16 c), A^j of the columns, of each the periods of a chunk.
        turned: (N, d, 2 n, 16 b), A^j of the followed columns and, below, their derivatives: times turns derivatives.
        power, slope: (N, n, n) A^j over the whole chunk, and (N, d, 2 n, n) with its derivatives below.
        shares: (N, V, 1 + d) factors of a response and of its derivatives at each vertex.
        reach: (N, d) the largest distance of a vertex.
    """

    place: NDArray[np.intp]
    waiting: NDArray[np.bool_]
    rows: FloatArray
    turns: FloatArray
    rows_size: FloatArray
    turns_size: FloatArray
    rows_sum: FloatArray
    turns_sum: FloatArray
    plain: FloatArray
    others: FloatArray
    vertex: FloatArray
    bent: FloatArray
    peaks: FloatArray
    vertex_peaks: FloatArray
    bent_peaks: FloatArray
    moved: FloatArray
    moved_others: FloatArray
    turned: FloatArray
    power: FloatArray
    slope: FloatArray
    shares: FloatArray
    reach: FloatArray

    def answer(self, which: slice, found: Products) -> None:
        """Write the sizes of the responses to some columns with derivatives, each with its 16 periods, in a chunk."""
        both, (p, columns) = self.turns.shape[2], found.vertex.shape[2:]
        raw = found.raw
        np.matmul(self.rows[:, :both], self.moved[..., which], out=raw[:, 0])
        np.matmul(self.turns, self.turned[..., which], out=raw[:, 1:])
        np.matmul(self.rows[:, both:], self.moved[..., which], out=found.rows[:, both:])
        shape = len(raw), -1, p * columns
        np.matmul(self.shares, raw[:, :, :p].reshape(shape), out=found.vertex.reshape(shape))
        np.abs(raw[:, 0], out=found.rows[:, :both])
        np.abs(found.rows[:, both:], out=found.rows[:, both:])
        np.abs(raw[:, 1:, p:], out=found.bent)
        np.abs(found.vertex, out=found.vertex)

    def together(self, derivatives: FloatArray) -> FloatArray:
        """Add up sizes of derivatives (N, d, n, columns), times their reach."""
        return np.asarray((self.reach[:, :, None, None] * derivatives).sum(axis=1))

    def move(self, scale: FloatArray) -> None:
        """Add the sizes of the rows to their sums, and go on to the rows of the next chunk.

        Args:
            scale: (F,) by which they count for each factor.
        """
        both, n = self.turns.shape[2], self.rows.shape[2]
        for number, weight in enumerate(scale.tolist()):
            self.rows_sum[:, number] += weight * self.rows_size
            self.turns_sum[:, number] += weight * self.turns_size
        turns = self.turns[..., :n]
        turns[:] = self.turns @ self.slope
        self.rows[:] = self.rows @ self.power
        self.turns[..., n:] = self.rows[:, None, :both]
        np.abs(self.rows, out=self.rows_size)
        self.turns_size[:] = self.together(np.abs(turns))

    def without(self, place: int) -> Running:
        """Return the sums without one loop; the last loop takes its place in memory."""
        arrays = [getattr(self, field.name) for field in fields(self)]
        for array in arrays:
            array[place] = array[-1]
        return Running(*(array[:-1] for array in arrays))


def implied(summed: FloatArray, q: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return Y (P, n, columns) with summed + q Y < Y, and for which of the P loops it was found, finite and above 0."""
    bound, going = summed, np.ones(len(summed), dtype=bool)
    for _ in range(_ROUNDS):
        following = (summed + q @ bound) * UP
        going &= ~(following < bound).all(axis=(1, 2))
        if not going.any():
            break
        bound = np.where(going[:, None, None], np.maximum(bound, following) * (1.0 + _SLACK), bound)
    return bound, ~going


def over(values: FloatArray, derivatives: FloatArray) -> FloatArray:
    """Return (N, d, 2 n, m): values (N, n, m) stacked on each of their derivatives (N, d, n, m)."""
    return np.concatenate([np.zeros_like(derivatives) + values[:, None], derivatives], axis=2)


def columns_by_time(columns: Enclosure, count: int) -> Enclosure:
    """Return columns (..., count m), given time after time, in the order column after column."""
    mid, rad = (
        part.reshape(*part.shape[:-1], count, part.shape[-1] // count).swapaxes(-1, -2).reshape(part.shape)
        for part in (columns.mid, columns.rad)
    )
    return Enclosure(mid, rad)
