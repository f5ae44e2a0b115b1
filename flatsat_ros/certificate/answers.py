"""Sums of absolute values of stable loops' answers, and of answers moved by their derivatives, never below the truth.

Rows C A^i are computed in floating point, a chunk of periods at a time. What each chunk is wrong by, and what is left
of the rows where the sum ends, is a row too: of it the answer is at most its absolute value times Y, the sums of
absolute values of the state itself, and Y obeys the same inequality, Y <= (what was summed) + q Y with a small q.
docs/mathematics.md has the proof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import TINY, UP, Enclosure, rounding
from flatsat_ros.certificate.running_sums import Running, flat

# Periods that are summed in one go.
_CHUNK = 16

# A loop has forgotten once so little of the state's sums can be left, relatively.
_FORGOTTEN = 1e-4

# Chunks after which it is asked whether a loop is one that grows.
_GIVE_UP = 8

# Periods after which a loop that still remembers is given up.
_PERIODS_MAX = 20_000

# Loops that are summed side by side: so many that calls cost little beside what they compute, and so few that what is
# computed stays near the processor.
_BATCH = 6

# By how much, relatively, the sums of the state are taken to be above what was summed, and rounds to find them.
_SLACK, _ROUNDS = 1e-6, 60


@dataclass(frozen=True)
class Answers:
    """Bounds of what signals C z answer to inputs, z+ = A z + B w, and to starts z(0), the columns of Z.

    Infinite where the loop is not stable. N is the number of loops. Of the p signals the last e are not followed.

    Attributes:
        sums: (N, p, m) sum_i |C A^i B|.
        peaks: (N, p, k) max_i |C A^i Z|; infinite, so that nothing is claimed, but for the last factor.
        vertex_sums: (N, V, p - e, f) the first f sums, with each term moved by its derivative in the direction of a
            vertex.
        vertex_peaks: (N, V, p - e, k) likewise.
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
    factors: Sequence[float] = (1.0,),
    plain: int = 0,
) -> list[Answers]:
    """Return bounds of what loops answer, hardly above what they do answer, for each of some factors.

    Args:
        A: (N, n, n).
        B: (N, n, m).
        starts: (n, k) Z, exact.
        signals: (N, p, n) rows C.
        steps: (N, d, n, n) derivatives of A by each parameter.
        kicks: (N, d, n, f) those of the first f columns of B, which are followed to first order; starts are, too.
        vertices: (N, V, d) points of the parameters.
        factors: at least 1, by which z+ is multiplied in every period: of the loop with r A, r B and so on.
        plain: e, so many last rows of C have sums for the loops themselves alone.
    """
    count, moving = len(A.mid), vertices.any(axis=(0, 1))  # the other parameters are what they are in the middle
    steps, kicks, vertices = steps[:, moving], kicks[:, moving], vertices[..., moving]
    parts = [slice(i, i + _BATCH) for i in range(0, count, _BATCH)]
    found = [
        _Sums(A[s], B[s], starts, signals[s], steps[s], kicks[s], vertices[s], factors, plain).all() for s in parts
    ]
    return [
        Answers(*(np.concatenate([np.asarray(getattr(part, name)) for part in same]) for name in _NAMES))
        for same in zip(*found, strict=True)
    ]


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
        factors: Sequence[float],
        plain: int,
    ) -> None:
        N, n, m = B.shape
        self.shape = N, n, m, starts.shape[1], kicks.shape[3]
        self.followed = signals.shape[1] - plain
        d, f, k = kicks.shape[1], kicks.shape[3], starts.shape[1]
        first = Enclosure(np.zeros((N, n, k)) + starts)
        followed, others = _joined(B[..., :f], first), B[..., f:]
        kicks = _joined(kicks, Enclosure(np.zeros((N, d, n, k))))
        power, slope = Enclosure(np.broadcast_to(np.eye(n), (N, n, n))), Enclosure(np.zeros((N, d, n, n)))
        moved, moved_others, turned = [], [], []
        for _ in range(_CHUNK):
            moved.append(power @ followed)
            moved_others.append(power @ others)
            turned.append(slope @ followed[:, None] + power[:, None] @ kicks)
            power, slope = power @ A, slope @ A[:, None] + power[:, None] @ steps
        self.moved, self.others, self.turned = _side_by_side(moved), _side_by_side(moved_others), _side_by_side(turned)
        self.power, self.slope, self.signals = power, slope, signals
        # combinations of a term's own value and its derivatives
        self.shares = np.concatenate([np.ones((*vertices.shape[:2], 1)), vertices], axis=2)
        self.reach = np.abs(vertices).max(axis=1)
        share = rounding(n + d + 4)

        def wrong(value: Enclosure) -> FloatArray:
            """By how much products with it are wrong, per unit of the other factor."""
            return np.asarray(value.rad + share * np.abs(value.mid))

        def together(derivatives: FloatArray) -> FloatArray:
            """Add up derivatives (N, d, ...), times their reach."""
            return np.asarray((self.reach.reshape(N, d, 1, 1) * derivatives).sum(axis=1))

        # in a chunk, of A^16 and its derivatives, and of each column over all periods, of those that are followed,
        # their derivatives, and the others
        self.wrong_power, self.wrong_slope = wrong(power), together(wrong(slope))
        whole = wrong(self.moved), together(wrong(self.turned)), wrong(self.others)
        self.off, self.kicks, self.off_others = (value.reshape(N, n, -1, _CHUNK).sum(axis=3) for value in whole)
        # what answers to inputs, (16, F), and starts, (16 k,), are multiplied with in a chunk, and from one to the next
        powers = np.cumprod(np.tile(factors, (_CHUNK, 1)), axis=0)
        self.inputs, self.chunk = powers, powers[-1]
        self.starts = np.tile(powers[:, -1] / factors[-1], k)

    def _beginning(self) -> Running:
        """Return rows of the first chunk, and nothing gathered."""
        N, n, m, k, f = self.shape
        p, d, V, F = self.followed, self.reach.shape[1], self.shares.shape[1], len(self.chunk)
        own, unit = self.signals.mid, np.broadcast_to(np.eye(n), (N, n, n))
        rows = np.concatenate([own[:, :p], unit, own[:, p:]], axis=1)
        all_rows, followed = rows.shape[1], rows[:, : p + n]
        return Running(
            place=np.arange(N),
            waiting=np.ones((N, F), dtype=bool),
            rows=rows,
            turns=np.concatenate([np.zeros((N, d, p + n, n)), np.zeros((N, d, p + n, n)) + followed[:, None]], axis=3),
            rows_size=np.abs(rows),
            turns_size=np.zeros((N, p + n, n)),
            rows_sum=np.zeros((N, F, all_rows, n)),
            turns_sum=np.zeros((N, F, p + n, n)),
            plain=np.zeros((N, all_rows, f, F)),
            others=np.zeros((N, all_rows, m - f, F)),
            vertex=np.zeros((N, V, p, f, F)),
            bent=np.zeros((N, n, f, F)),
            peaks=np.zeros((N, all_rows, k * _CHUNK)),
            vertex_peaks=np.zeros((N, V, p, k * _CHUNK)),
            bent_peaks=np.zeros((N, n, k * _CHUNK)),
            moved=self.moved.mid.copy(),
            moved_others=self.others.mid.copy(),
            turned=_over(self.moved.mid, self.turned.mid),
            power=self.power.mid.copy(),
            slope=_over(self.power.mid, self.slope.mid),
            shares=self.shares.copy(),
            reach=self.reach.copy(),
        )

    def all(self) -> list[Answers]:
        """Sum up."""
        N, n, m, k, f = self.shape
        p, d, V, F = self.followed, self.reach.shape[1], self.shares.shape[1], len(self.chunk)
        e, both = self.signals.shape[1] - p, p + n
        found = [tuple(np.full(shape, np.inf) for shape in ((N, p + e, m + k), (N, V, p, f + k))) for _ in range(F)]
        now, scale, ever = self._beginning(), np.ones(F), range(_PERIODS_MAX // _CHUNK)
        # products go to memory that is there: to be given some would take longer than to multiply
        columns = f * _CHUNK
        shapes = (N, 1 + d, both, columns), (N, V, p, columns), (N, e, columns), (N, both + e, (m - f) * _CHUNK)
        memory = [np.empty(shape) for shape in shapes]
        totals = [np.empty((*shape[:-1], shape[-1] // _CHUNK, F)) for shape in shapes]
        begun = [np.empty((*shape[:-1], k * _CHUNK)) for shape in shapes[:3]]
        followed, started = slice(columns), slice(columns, None)
        with np.errstate(all="ignore"):  # of loops that are not stable all grows beyond all numbers
            for number in ever:
                count = len(now.place)
                if not count:
                    break
                values, vertex, alone, others = now_in = [array[:count] for array in memory]
                now.answer(followed, values, vertex, alone)
                np.abs(np.matmul(now.rows, now.moved_others, out=others), out=others)
                sums, vertex_sums, alone_sums, others_sums = now_out = [array[:count] for array in totals]
                for array, total in zip(now_in, now_out, strict=True):
                    np.matmul(array.reshape(-1, _CHUNK), self.inputs * scale, out=flat(total, -1))
                now.vertex[:] += vertex_sums
                now.others[:] += others_sums
                reach, turns = now.reach[:, :, None, None], now.turns[..., :n]
                now.plain[:, :both] += sums[:, 0]
                now.plain[:, both:] += alone_sums
                now.bent[:] += (reach[..., None] * sums[:, 1:, p:]).sum(axis=1)
                if k:
                    values, vertex, alone = begun_now = [array[:count] for array in begun]
                    now.answer(started, values, vertex, alone)
                    for array in begun_now:
                        array *= scale[-1] * self.starts
                    for array, part in ((values[:, 0], now.peaks[:, :both]), (alone, now.peaks[:, both:])):
                        np.maximum(part, array, out=part)
                    np.maximum(now.vertex_peaks, vertex, out=now.vertex_peaks)
                    bent = (reach * values[:, 1:, p:]).sum(axis=1)
                    np.maximum(now.bent_peaks, bent, out=now.bent_peaks)
                now.rows_sum[:] += scale[:, None, None] * now.rows_size[:, None]
                now.turns_sum[:] += scale[:, None, None] * now.turns_size[:, None]
                turns[:] = now.turns @ now.slope
                now.rows[:] = now.rows @ now.power
                now.turns[..., n:] = now.rows[:, None, :both]
                np.abs(now.rows, out=now.rows_size)
                np.sum(reach * np.abs(turns), axis=1, out=now.turns_size)
                scale = scale * self.chunk
                left = now.rows_size.copy()
                left[:, :both] += now.turns_size
                state = slice(p, both)
                # of each entry alone no less is left; loops that grow are looked for now and then
                single = np.einsum("ijj->ij", left[:, state]).max(axis=1)[:, None] * scale
                if number % _GIVE_UP and (single >= _FORGOTTEN)[now.waiting].all():
                    continue
                sizes = now.others[:, state].sum(axis=2) + (now.plain[:, state] + now.bent).sum(axis=2)
                sizes[..., -1] += (now.peaks[:, state] + now.bent_peaks).sum(axis=2)
                remembered = (scale * (left[:, state] @ sizes) / sizes).max(axis=1)
                done = now.waiting & ((remembered < _FORGOTTEN) | ~(remembered < 1e12))
                now.waiting[done] = False
                for place in np.flatnonzero(done.any(axis=1))[::-1].tolist():
                    for which in np.flatnonzero(done[place] & (remembered[place] < 1.0)).tolist():
                        self._finish(now, place, which, scale[which] * left[place], found[which])
                    if not now.waiting[place].any():
                        now = now.without(place)
        order = [*range(f), *range(f + k, m + k)]
        return [Answers(a[..., order], a[..., f : f + k], b[..., :f], b[..., f:]) for a, b in found]

    def _finish(self, now: Running, place: int, number: int, left: FloatArray, found: tuple[FloatArray, ...]) -> None:
        """Add what rounding and the rest of time may add, for one loop and one factor.

        Args:
            now: what was gathered.
            place: of the loop in it.
            number: of the factor.
            left: (p + n + e, n) bound of the rows that are left and of their derivatives, times their reach.
            found: to write to.
        """
        _, n, _, k, f = self.shape
        i, last = int(now.place[place]), number == len(self.chunk) - 1
        b = f + k if last else f  # to starts for the last factor alone
        p, grown = self.followed, self.chunk[number]
        both = p + n
        weight, turned = now.rows_sum[place, number], now.turns_sum[place, number]
        power = grown * self.wrong_power[i]
        q = weight @ power + left
        q[:both] += weight[:both] @ (grown * self.wrong_slope[i]) + turned @ power
        q[:p] += self.signals.rad[i, :p]
        q[both:] += self.signals.rad[i, p:]
        off, kicks, others = grown * self.off[i, :, :b], grown * self.kicks[i, :, :b], grown * self.off_others[i]
        plain, vertex = now.plain[place, ..., number], now.vertex[place, ..., number]
        own = now.bent[place, ..., number]
        if last:
            plain, vertex, own = (
                np.concatenate([sums, peaks[place].reshape(*sums.shape[:-1], k, _CHUNK).max(axis=-1)], axis=-1)
                for sums, peaks in ((plain, now.peaks), (vertex, now.vertex_peaks), (own, now.bent_peaks))
            )
        added, bent = weight @ off, turned @ off + weight[:both] @ kicks
        vertex = vertex + added[:p] + bent[:p]
        plain = np.concatenate([plain + added, now.others[place, ..., number] + weight @ others], axis=1)
        state = plain[p:both].copy()
        state[:, :b] += own + bent[p:]
        state = state * UP + TINY
        q = q * UP + TINY
        bound = self._implied(state, q[p:both])
        if bound is None:
            return
        rows = [*range(p), *range(both, len(q))]
        rest = q[rows] @ bound
        sums, vertex = (plain[rows] + rest) * UP + TINY, (vertex + rest[:p, :b]) * UP + TINY
        found[0][i][:, :b], found[0][i][:, f + k :], found[1][i][..., :b] = sums[:, :b], sums[:, b:], vertex

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


def _over(values: FloatArray, derivatives: FloatArray) -> FloatArray:
    """Return (N, d, 2 n, m): values (N, n, m) over each of their derivatives (N, d, n, m)."""
    return np.concatenate([np.zeros_like(derivatives) + values[:, None], derivatives], axis=2)


def _side_by_side(parts: Sequence[Enclosure]) -> Enclosure:
    """Join columns (..., m) of some times to (..., m times), the times of a column side by side."""
    mid, rad = (
        flat(np.stack([getattr(part, name) for part in parts], axis=-1), parts[0].mid.ndim - 1)
        for name in ("mid", "rad")
    )
    return Enclosure(mid, rad)


def _joined(*parts: Enclosure) -> Enclosure:
    """Join along the last axis."""
    return Enclosure(np.concatenate([part.mid for part in parts], -1), np.concatenate([part.rad for part in parts], -1))
