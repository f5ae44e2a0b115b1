"""Sums of absolute values of stable loops' answers, and of answers moved by their derivatives, never below the truth.

Rows C A^i are computed in floating point, a chunk of periods at a time. What each chunk is wrong by, and what is left
of the rows where the sum ends, is a row too: of it the answer is at most its absolute value times Y, the sums of
absolute values of the state itself, and Y obeys the same inequality, Y <= (what was summed) + q Y with a small q.
docs/mathematics.md has the proof.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import TINY, UP, Enclosure, rounding

# Periods that are summed in one go.
_CHUNK = 16

# A loop has forgotten once so little of the state's sums can be left, relatively.
_FORGOTTEN = 1e-4

# Periods after which a loop that still remembers is given up.
_PERIODS_MAX = 20_000

# Loops that are summed side by side: as many as fit into a processor's cache.
_BATCH = 8

# By how much, relatively, the sums of the state are taken to be above what was summed, and rounds to find them.
_SLACK, _ROUNDS = 1e-6, 60


@dataclass(frozen=True)
class Answers:
    """Bounds of what signals C z answer to inputs, z+ = A z + B w, and to starts z(0), the columns of Z.

    Infinite where the loop is not stable. N is the number of loops.

    Attributes:
        sums: (N, p, m) sum_i |C A^i B|.
        peaks: (N, p, k) max_i |C A^i Z|.
        vertex_sums: (N, V, p, f) the first f sums, with each term moved by its derivative in the direction of a vertex.
        vertex_peaks: (N, V, p, k) likewise.
    """

    sums: FloatArray
    peaks: FloatArray
    vertex_sums: FloatArray
    vertex_peaks: FloatArray


def answers(
    A: Enclosure,
    B: Enclosure,
    starts: FloatArray,
    signals: Enclosure,
    steps: Enclosure,
    kicks: Enclosure,
    vertices: FloatArray,
) -> Answers:
    """Return bounds of what loops answer, hardly above what they do answer.

    Args:
        A: (N, n, n).
        B: (N, n, m).
        starts: (n, k) Z, exact.
        signals: (N, p, n) rows C.
        steps: (N, d, n, n) derivatives of A by each parameter.
        kicks: (N, d, n, f) those of the first f columns of B, which are followed to first order; starts are, too.
        vertices: (N, V, d) points of the parameters.
    """
    count, moving = len(A.mid), vertices.any(axis=(0, 1))  # the other parameters are what they are in the middle
    steps, kicks, vertices = steps[:, moving], kicks[:, moving], vertices[..., moving]
    parts = [slice(i, i + _BATCH) for i in range(0, count, _BATCH)]
    found = [_Sums(A[s], B[s], starts, signals[s], steps[s], kicks[s], vertices[s]).all() for s in parts]
    return Answers(*(np.concatenate([np.asarray(getattr(part, name)) for part in found]) for name in _NAMES))


_NAMES = ("sums", "peaks", "vertex_sums", "vertex_peaks")


@dataclass(frozen=True)
class _Running:
    """What changes while loops are summed, and what is multiplied for it: arrays with one entry per loop.

    Columns of a chunk are those of its periods side by side: first of f inputs that are followed, then of the k starts,
    W in all; X of the other inputs.

    Attributes:
        place: (N,) of each loop among those of the batch.
        rows, turns: (N, p + n, n) and (N, d, p + n, n), C A^i and A^i at the chunk's beginning; their derivatives.
        rows_sum, turns_sum: (N, p + n, n), sums of their sizes over the chunks; the derivatives' times the reach.
        plain, others: (N, p + n, W) and (N, p + n, X), gathered answers.
        vertex, bent: (N, V, p, W) and (N, 1, n, W), likewise; those of the state's derivatives, times the reach.
        moved, moved_others: (N, n, W) and (N, n, X), A^j of the columns.
        turned: (N, d, 2 n, W) what derivatives of rows and, below, rows are multiplied with for the derivatives.
        power, slope: (N, n, n) and (N, d, n, n), A^j over the whole chunk.
        shares: (N, V, 1 + d) combinations of an answer and its derivatives at the vertices.
        reach: (N, 1, d) the largest distance of a vertex.
    """

    place: NDArray[np.intp]
    rows: FloatArray
    turns: FloatArray
    rows_sum: FloatArray
    turns_sum: FloatArray
    plain: FloatArray
    others: FloatArray
    vertex: FloatArray
    bent: FloatArray
    moved: FloatArray
    turned: FloatArray
    moved_others: FloatArray
    power: FloatArray
    slope: FloatArray
    shares: FloatArray
    reach: FloatArray

    def without(self, place: int) -> _Running:
        """Return the same without a loop, in whose place in memory the last one goes."""
        arrays = [getattr(self, field.name) for field in fields(self)]
        for array in arrays:
            array[place] = array[-1]
        return _Running(*(array[:-1] for array in arrays))


class _Sums:
    """The sums of a few loops."""

    def __init__(
        self,
        A: Enclosure,
        B: Enclosure,
        starts: FloatArray,
        signals: Enclosure,
        steps: Enclosure,
        kicks: Enclosure,
        vertices: FloatArray,
    ) -> None:
        N, n, m = B.shape
        self.shape = N, n, m, starts.shape[1], kicks.shape[3]
        d, f, k = kicks.shape[1], kicks.shape[3], starts.shape[1]
        first = Enclosure(np.zeros((N, n, k)) + starts)
        columns = _joined(B, first)
        followed = _joined(B[..., :f], first)
        kicks = _joined(kicks, Enclosure(np.zeros((N, d, n, k))))
        power, slope = Enclosure(np.broadcast_to(np.eye(n), (N, n, n))), Enclosure(np.zeros((N, d, n, n)))
        moved, turned = [], []
        for _ in range(_CHUNK):
            moved.append(power @ columns)
            turned.append(slope @ followed[:, None] + power[:, None] @ kicks)
            power, slope = power @ A, slope @ A[:, None] + power[:, None] @ steps
        self.moved = _joined(*(part[..., :f] for part in moved), *(part[..., m:] for part in moved))
        self.others = _joined(*(part[..., f:m] for part in moved))
        self.turned = _joined(*(part[..., :f] for part in turned), *(part[..., f:] for part in turned))
        self.power, self.slope, self.signals = power, slope, signals
        # combinations of a term's own value and its derivatives
        self.shares = np.concatenate([np.ones((*vertices.shape[:2], 1)), vertices], axis=2)
        self.reach = np.abs(vertices).max(axis=1)

    def _beginning(self) -> _Running:
        """Return rows of the first chunk, and nothing gathered."""
        N, n, m, k, f = self.shape
        p, d, V = self.signals.shape[1], self.reach.shape[1], self.shares.shape[1]
        every = np.broadcast_to(np.eye(n), (N, n, n))
        return _Running(
            place=np.arange(N),
            rows=np.concatenate([self.signals.mid, every], axis=1),
            turns=np.zeros((N, d, p + n, n)),
            rows_sum=np.zeros((N, p + n, n)),
            turns_sum=np.zeros((N, p + n, n)),
            plain=np.zeros((N, p + n, _CHUNK * (f + k))),
            others=np.zeros((N, p + n, _CHUNK * (m - f))),
            vertex=np.zeros((N, V, p, _CHUNK * (f + k))),
            bent=np.zeros((N, 1, n, _CHUNK * (f + k))),
            moved=self.moved.mid.copy(),
            turned=np.concatenate([np.zeros_like(self.turned.mid) + self.moved.mid[:, None], self.turned.mid], axis=2),
            moved_others=self.others.mid.copy(),
            power=self.power.mid.copy(),
            slope=self.slope.mid.copy(),
            shares=self.shares.copy(),
            reach=self.reach[:, None].copy(),
        )

    def all(self) -> Answers:
        """Sum up."""
        N, n, m, k, f = self.shape
        p, d, V = self.signals.shape[1], self.reach.shape[1], self.shares.shape[1]
        results = [np.full(shape, np.inf) for shape in ((N, p, m + k), (N, V, p, f + k))]
        now, summed = self._beginning(), _CHUNK * f
        # products go to memory that is there: to be given some would take longer than to multiply
        memory = [np.empty((N, 1 + d, p + n, summed + _CHUNK * k))]
        memory += [np.empty_like(array) for array in (now.others, now.vertex, now.bent)]
        for _ in range(_PERIODS_MAX // _CHUNK):
            count = len(now.place)
            if not count:
                break
            values, others, vertex, bent = (array[:count] for array in memory)
            np.matmul(now.rows, now.moved, out=values[:, 0])
            both = np.concatenate([now.turns, np.broadcast_to(now.rows[:, None], now.turns.shape)], axis=3)
            np.matmul(both, now.turned, out=values[:, 1:])
            np.matmul(now.rows, now.moved_others, out=others)
            np.matmul(now.shares, _flat(values[:, :, :p]), out=_flat(vertex))
            np.abs(values, out=values)
            np.matmul(now.reach, _flat(values[:, 1:, p:]), out=_flat(bent))
            _gather(now.plain, values[:, 0], summed)
            _gather(now.others, np.abs(others, out=others), others.shape[-1])
            _gather(now.vertex, np.abs(vertex, out=vertex), summed)
            _gather(now.bent, bent, summed)

            reach = now.reach[:, 0, :, None, None]
            now.rows_sum[:] += np.abs(now.rows)
            now.turns_sum[:] += (reach * np.abs(now.turns)).sum(axis=1)
            now.turns[:] = now.turns @ now.power[:, None] + now.rows[:, None] @ now.slope
            now.rows[:] = now.rows @ now.power
            left = np.abs(now.rows) + (reach * np.abs(now.turns)).sum(axis=1)
            sizes = now.plain[:, p:].sum(axis=-1) + now.others[:, p:].sum(axis=-1) + now.bent[:, 0].sum(axis=-1)
            with np.errstate(all="ignore"):
                remembered = ((left[:, p:] @ sizes[..., None])[..., 0] / sizes).max(axis=1)
            for place in np.flatnonzero((remembered < _FORGOTTEN) | ~(remembered < 1e12))[::-1]:
                if remembered[place] < 1.0:
                    self._finish(now, int(place), left[place], results)
                now = now.without(place)
        plain, vertex = results
        order = [*range(f), *range(f + k, m + k)]
        return Answers(plain[..., order], plain[..., f : f + k], vertex[..., :f], vertex[..., f:])

    def _finish(self, now: _Running, place: int, left: FloatArray, results: list[FloatArray]) -> None:
        """Add what rounding and the rest of time may add, for one loop.

        Args:
            now: what was gathered.
            place: of the loop in it.
            left: (p + n, n) bound of the rows that are left and of their derivatives, times their reach.
            results: to write to.
        """
        _, n, _, k, f = self.shape
        i = int(now.place[place])
        p, b = self.signals.shape[1], f + k
        reach, share = self.reach[i], rounding(n + len(self.reach[i]) + 4)

        def wrong(value: Enclosure) -> FloatArray:
            """By how much products with it are wrong, per unit of the other factor."""
            return np.asarray(value.rad + share * np.abs(value.mid))

        weight, turned = now.rows_sum[place], now.turns_sum[place]
        slopes = np.tensordot(reach, wrong(self.slope[i]), axes=1)
        q = weight @ (wrong(self.power[i]) + slopes) + turned @ wrong(self.power[i]) + left
        q[:p] += self.signals.rad[i]
        off, kicks = wrong(self.moved[i]), np.tensordot(reach, wrong(self.turned[i]), axes=1)
        added, bent = weight @ off, turned @ off + weight @ kicks
        others = (now.others[place] + weight @ wrong(self.others[i])).reshape(len(weight), _CHUNK, -1).sum(axis=1)
        moved = self._periods(now.plain[place]) + self._periods(added, every=True)
        vertex = self._periods(now.vertex[place]) + self._periods(added[:p] + bent[:p], every=True)
        plain = np.concatenate([moved, others], axis=1)
        state = plain[p:].copy()
        state[:, :b] += self._periods(now.bent[place, 0]) + self._periods(bent[p:], every=True)
        state = state * UP + TINY
        q = q * UP + TINY
        bound = self._implied(state, q[p:])
        if bound is None:
            return
        rest = q[:p] @ bound
        results[0][i] = (plain[:p] + rest) * UP + TINY
        results[1][i] = (vertex + rest[:, :b]) * UP + TINY

    def _periods(self, values: FloatArray, every: bool = False) -> FloatArray:
        """Return sums (..., f + k) over the periods of a chunk; of starts the largest, if not of them too."""
        *_, k, f = self.shape
        inputs, starts = values[..., : _CHUNK * f], values[..., _CHUNK * f :]
        starts = starts.reshape(*values.shape[:-1], _CHUNK, k)
        parts = [inputs.reshape(*values.shape[:-1], _CHUNK, f).sum(axis=-2)]
        return np.concatenate([*parts, starts.sum(axis=-2) if every else starts.max(axis=-2)], axis=-1)

    @staticmethod
    def _implied(summed: FloatArray, q: FloatArray) -> FloatArray | None:
        """Return Y, finite and above 0, with summed + q Y < Y, or None."""
        bound = summed
        for _ in range(_ROUNDS):
            following = (summed + q @ bound) * UP
            if (following < bound).all():
                return bound
            bound = np.maximum(bound, following) * (1.0 + _SLACK)
        return None


def _gather(gathered: FloatArray, values: FloatArray, summed: int) -> None:
    """Add values to what was gathered; behind so many columns keep the largest instead."""
    gathered[..., :summed] += values[..., :summed]
    if values.shape[-1] > summed:
        np.maximum(gathered[..., summed:], values[..., summed:], out=gathered[..., summed:])


def _flat(array: FloatArray) -> FloatArray:
    """Return a view (N, d, r c) of an array (N, d, r, c)."""
    N, d, r, c = array.shape
    return array.reshape(N, d, r * c)


def _joined(*parts: Enclosure) -> Enclosure:
    """Join along the last axis."""
    return Enclosure(np.concatenate([part.mid for part in parts], -1), np.concatenate([part.rad for part in parts], -1))
