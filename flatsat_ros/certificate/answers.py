"""Sums of absolute values of stable loops' answers, and of answers moved by their derivatives, never below the truth.

Rows C A^i are computed in floating point, a chunk of periods at a time. What each chunk is wrong by, and what is left
of the rows where the sum ends, is a row too: of it the answer is at most its absolute value times Y, the sums of
absolute values of the state itself, and Y obeys the same inequality, Y <= (what was summed) + q Y with a small q.
docs/mathematics.md has the proof.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

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

# Some of the loops, or all.
_Which: TypeAlias = "NDArray[np.intp] | slice"

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
    count = len(A.mid)
    parts = [slice(i, i + _BATCH) for i in range(0, count, _BATCH)]
    found = [_Sums(A[s], B[s], starts, signals[s], steps[s], kicks[s], vertices[s]).all() for s in parts]
    return Answers(*(np.concatenate([np.asarray(getattr(part, name)) for part in found]) for name in _NAMES))


_NAMES = ("sums", "peaks", "vertex_sums", "vertex_peaks")


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
        # columns that are followed stand first: f inputs, starts, then the other inputs
        first = Enclosure(np.zeros((N, n, k)) + starts)
        bending, kicks = _joined(B[..., :f], first), _joined(kicks, Enclosure(np.zeros((N, d, n, k))))
        columns = _joined(bending, B[..., f:])
        power, slope = Enclosure(np.broadcast_to(np.eye(n), (N, n, n))), Enclosure(np.zeros((N, d, n, n)))
        moved, turned = [], []
        for _ in range(_CHUNK):
            moved.append(power @ columns)
            turned.append(slope @ bending[:, None] + power[:, None] @ kicks)
            power, slope = power @ A, slope @ A[:, None] + power[:, None] @ steps
        self.moved, self.turned = _joined(*moved), _joined(*turned)
        self.power, self.slope, self.signals = power, slope, signals
        # combinations of a term's own value and its derivatives
        self.shares = np.concatenate([np.ones((*vertices.shape[:2], 1)), vertices], axis=2)
        self.reach = np.abs(vertices).max(axis=1)

    def all(self) -> Answers:
        """Sum up."""
        N, n, m, k, f = self.shape
        p, d, V = self.signals.shape[1], self.reach.shape[1], self.shares.shape[1]
        every = np.broadcast_to(np.eye(n), (N, n, n))
        rows, turns = np.concatenate([self.signals.mid, every], axis=1), np.zeros((N, d, p + n, n))
        b, width = f + k, m + k  # columns that are followed, and all
        bends = np.arange(_CHUNK * width) % width < b
        moved, turned = self.moved.mid, self.turned.mid
        bending = np.ascontiguousarray(moved[:, None, :, bends])
        starting = np.arange(b) >= f  # of which the largest value counts instead of the sum
        self._plain = _Gathered((N, p + n), width, np.pad(starting, (0, width - b)))
        self._vertex = _Gathered((N, V, p), b, starting)
        self._bent = _Gathered((N, n), b, starting)  # derivatives of the state, times their reach
        self._rows, self._turns = np.zeros_like(rows), np.zeros_like(rows)
        results = [np.full(shape, np.inf) for shape in ((N, p, width), (N, V, p, b))]
        active = np.arange(N)
        for _ in range(_PERIODS_MAX // _CHUNK):
            some = slice(None) if len(active) == N else active  # no copies while all of them go on
            values = rows @ moved[some]
            first = turns @ bending[some] + rows[:, None] @ turned[some]
            terms = np.concatenate([values[:, None, :p, bends], first[:, :, :p]], axis=1)
            combined = self.shares[some] @ terms.reshape(len(active), d + 1, -1)
            self._plain.add(some, values)
            self._vertex.add(some, combined.reshape(len(active), V, p, -1))
            reach = self.reach[some]
            turning = reach[:, None] @ np.abs(first[:, :, p:]).reshape(len(active), d, -1)
            self._bent.add(some, turning.reshape(len(active), n, -1))
            self._rows[some] += np.abs(rows)
            self._turns[some] += (reach[:, :, None, None] * np.abs(turns)).sum(axis=1)
            turns = turns @ self.power.mid[some][:, None] + rows[:, None] @ self.slope.mid[some]
            rows = rows @ self.power.mid[some]
            left = np.abs(rows) + (reach[:, :, None, None] * np.abs(turns)).sum(axis=1)
            going = np.ones(len(active), dtype=bool)
            sizes = self._state_sums(some)
            with np.errstate(all="ignore"):
                remembered = np.nan_to_num(((left[:, p:] @ sizes) / sizes).max(axis=(1, 2)), nan=np.inf)
            for place in np.flatnonzero((remembered < _FORGOTTEN) | ~(remembered < 1e12)):
                going[place] = False
                if remembered[place] < 1.0:
                    self._finish(int(active[place]), left[place], results)
            active, rows, turns = active[going], rows[going], turns[going]
            if not len(active):
                break
        plain, vertex = results
        order = [*range(f), *range(b, width)]
        return Answers(plain[..., order], plain[..., f:b], vertex[..., :f], vertex[..., f:])

    def _state_sums(self, which: _Which) -> FloatArray:
        """Return the sums over all columns of what was gathered of each entry of the state, (., n, 1)."""
        n = self.shape[1]
        total = self._plain.values[which, -n:].sum(axis=2) + self._bent.values[which].sum(axis=2)
        return np.asarray(total[..., None])

    def _finish(self, i: int, left: FloatArray, results: list[FloatArray]) -> None:
        """Add what rounding and the rest of time may add, for one loop.

        Args:
            i: which.
            left: (p + n, n) bound of the rows that are left and of their derivatives, times their reach.
            results: to write to.
        """
        _, n, m, k, f = self.shape
        p, b, width = self.signals.shape[1], f + k, m + k
        reach, share = self.reach[i], rounding(n + len(self.reach[i]) + 4)

        def wrong(value: Enclosure) -> FloatArray:
            """By how much products with it are wrong, per unit of the other factor."""
            return np.asarray(value.rad + share * np.abs(value.mid))

        weight, turned = self._rows[i], self._turns[i]
        slopes = np.tensordot(reach, wrong(self.slope[i]), axes=1)
        q = weight @ (wrong(self.power[i]) + slopes) + turned @ wrong(self.power[i]) + left
        q[:p] += self.signals.rad[i]
        off = wrong(self.moved[i])
        added = (weight @ off).reshape(-1, _CHUNK, width).sum(axis=1)
        moved = off.reshape(n, _CHUNK, width)[..., :b].sum(axis=1)
        kicks = np.tensordot(reach, wrong(self.turned[i]), axes=1).reshape(n, _CHUNK, b).sum(axis=1)
        bent = turned @ moved + weight @ kicks
        plain, vertex = self._plain.total(i) + added, self._vertex.total(i) + added[:p, :b] + bent[:p]
        state = plain[p:].copy()
        state[:, :b] += self._bent.total(i) + bent[p:]
        state = state * UP + TINY
        q = q * UP + TINY
        bound = self._implied(state, q[p:])
        if bound is None:
            return
        rest = q[:p] @ bound
        results[0][i] = (plain[:p] + rest) * UP + TINY
        results[1][i] = (vertex + rest[:, :b]) * UP + TINY

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


class _Gathered:
    """Sums of the absolute values of some columns over time, and the largest ones of the others."""

    def __init__(self, shape: tuple[int, ...], columns: int, largest: NDArray[np.bool_]) -> None:
        self._largest = np.tile(largest, _CHUNK)
        self._columns = columns
        self._any = bool(largest.any())
        self._sums = np.zeros((*shape, _CHUNK * columns))

    def add(self, which: _Which, values: FloatArray) -> None:
        """Take in values (..., periods x columns) of some loops, which it overwrites."""
        np.abs(values, out=values)
        before = self._sums[which]  # of a slice it is no copy
        if self._any:
            most = np.maximum(before[..., self._largest], values[..., self._largest])
        before += values
        if self._any:
            before[..., self._largest] = most
        if not isinstance(which, slice):
            self._sums[which] = before

    @property
    def values(self) -> FloatArray:
        """Sums (..., columns); of the others, too."""
        return np.asarray(self._sums.reshape(*self._sums.shape[:-1], _CHUNK, self._columns).sum(axis=-2))

    def total(self, i: int) -> FloatArray:
        """Return sums and largest values of one loop."""
        each = self._sums[i].reshape(*self._sums.shape[1:-1], _CHUNK, self._columns)
        total = each.sum(axis=-2)
        largest = self._largest[: self._columns]
        total[..., largest] = each[..., largest].max(axis=-2)
        return np.asarray(total)


def _joined(*parts: Enclosure) -> Enclosure:
    """Join along the last axis."""
    return Enclosure(np.concatenate([part.mid for part in parts], -1), np.concatenate([part.rad for part in parts], -1))
