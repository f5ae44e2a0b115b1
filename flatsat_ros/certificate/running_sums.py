"""What is gathered while loops' answers are summed, a chunk of 16 periods at a time: see `certificate.answers`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray


@dataclass(frozen=True)
class Running:
    """What changes while loops are summed, and what is multiplied for it: arrays with one entry per loop.

    The b columns that are followed are f inputs and the k starts; c is the number of the others, F that of the factors.
    Of rows there are p signals that are followed, n of the unit matrix and e signals that are not.

    Attributes:
        place: (N,) of each loop among those of the batch.
        waiting: (N, F) for which factors it still remembers.
        rows: (N, p + n + e, n), C A^i and A^i at the chunk's beginning.
        turns: (N, d, p + n, 2 n), their derivatives, and beside them the rows again.
        rows_size, turns_size: (N, p + n + e, n) and (N, p + n, n), sizes of the rows and, times the reach, of their
            derivatives together.
        rows_sum, turns_sum: (N, F, p + n + e, n) and (N, F, p + n, n), sums of these over the chunks.
        plain, others: (N, p + n + e, f, F) and (N, p + n + e, c, F), sums of the answers' sizes.
        vertex, bent: (N, V, p, f, F) and (N, n, f, F), likewise; those of the state's derivatives, times the reach.
        peaks, vertex_peaks, bent_peaks: (N, p + n + e, 16 k), (N, V, p, 16 k) and (N, n, 16 k), largest ones to
            starts for the last factor, at each period of a chunk.
        moved, moved_others: (N, n, 16 b) and (N, n, 16 c), A^j of the columns, of each the periods of a chunk.
        turned: (N, d, 2 n, 16 b), A^j of the followed columns and, below, their derivatives: times turns derivatives.
        power, slope: (N, n, n) A^j over the whole chunk, and (N, d, 2 n, n) with its derivatives below.
        shares: (N, V, 1 + d) combinations of an answer and its derivatives at the vertices.
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

    def answer(self, which: slice, values: FloatArray, vertex: FloatArray, alone: FloatArray) -> None:
        """Write the sizes of what some of the followed columns answer in a chunk.

        Args:
            which: of the columns, each with its 16 periods.
            values: (N, 1 + d, p + n, columns), to write to, the answers and their derivatives.
            vertex: (N, V, p, columns), to write to, the combinations at the vertices.
            alone: (N, e, columns), to write to, the answers of the signals that are not followed.
        """
        both = values.shape[2]
        np.matmul(self.rows[:, :both], self.moved[..., which], out=values[:, 0])
        np.matmul(self.rows[:, both:], self.moved[..., which], out=alone)
        np.abs(alone, out=alone)
        np.matmul(self.turns, self.turned[..., which], out=values[:, 1:])
        np.matmul(self.shares, flat(values[:, :, : vertex.shape[2]], 2), out=flat(vertex, 2))
        np.abs(values, out=values)
        np.abs(vertex, out=vertex)

    def without(self, place: int) -> Running:
        """Return the same without a loop, in whose place in memory the last one goes."""
        arrays = [getattr(self, field.name) for field in fields(self)]
        for array in arrays:
            array[place] = array[-1]
        return Running(*(array[:-1] for array in arrays))


def flat(array: FloatArray, axes: int) -> FloatArray:
    """Return a view of an array in which all axes but so many first ones are one, or all but so many last ones."""
    if axes < 0:
        return array.reshape(math.prod(array.shape[:axes]), *array.shape[axes:])
    return array.reshape(*array.shape[:axes], math.prod(array.shape[axes:]))
