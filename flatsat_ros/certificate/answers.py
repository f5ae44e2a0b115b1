"""Upper bounds of the responses of stable loops: the sums of absolute values of impulse responses, and their peaks.

Such a sum is the l1 norm of the loop, the largest output that an input bounded by 1 can cause. The same is bounded for
responses that are changed, to first order, by changes of the loop's parameters.

Rows C A^i are computed in floating point, a chunk of periods at a time. The error of each chunk, and what remains of
the rows where the sum ends, are rows as well. The response to such a row is at most its absolute value times Y, the
sums of absolute values of the state itself, and Y obeys the same inequality, Y <= (what was summed) + q Y with a small
q. docs/mathematics.md has the proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import TINY, UP, Enclosure, joined, rounding
from flatsat_ros.certificate.modes import inverse, modes_of
from flatsat_ros.certificate.running_sums import Products, Running, columns_by_time, implied, over

# Periods that are summed in one go: two to the power of this.
_DOUBLINGS = 4
_CHUNK = 2**_DOUBLINGS

# The sum of a loop ends once the rest of the state's sums is at most this share of them: the loop has forgotten.
_FORGOTTEN = 1e-4

# Coarse sums end once the rest is at most this share of them, for the first factor and for the others. It is checked
# after every _EVERY chunks, from when the slowest mode has decayed to _FADED on; after _CHUNKS_MAX chunks they end.
_CLOSE = 0.06, 0.2
_FADED, _EVERY, _CHUNKS_MAX = 0.06, 4, 40

# After each so many chunks it is checked whether a loop is unstable.
_GIVE_UP = 8

# Periods after which a loop that still remembers is given up.
_PERIODS_MAX = 20_000

# Loops that are summed side by side: so many that calls cost little beside what they compute, and so few that what is
# computed stays near the processor.
_BATCH = 8


@dataclass(frozen=True)
class Answers:
    """Bounds of the responses of signals C z to inputs, z+ = A z + B w, and to initial states z(0), the columns of Z.

    Infinite where the loop is not stable. N is the number of loops. The last e of the p signals have no vertex bounds.

    Attributes:
        sums: (N, p, m) sum_i |C A^i B|.
        peaks: (N, p, k) max_i |C A^i Z|; infinite, so that nothing is claimed, but for the last factor.
        vertex_sums: (N, V, p - e, f) the sums for the first f inputs, with each term changed to first order as at a
            vertex of the parameters.
        vertex_peaks: (N, V, p - e, k) likewise.
    """

    sums: FloatArray
    peaks: FloatArray
    vertex_sums: FloatArray
    vertex_peaks: FloatArray


class AnsweringLoops(NamedTuple):
    """N loops z+ = A z + B w, and how they change with parameters.

    Attributes:
        A: (N, n, n).
        B: (N, n, m).
        starts: (N, n, k) Z.
        signals: (N, p, n) rows C.
        steps: (N, d, n, n) derivatives of A by each parameter.
        kicks: (N, d, n, f) derivatives of the first f columns of B. The responses to these and to the starts are
            bounded at the vertices, too.
        vertices: (N, V, d) points of the parameters.
    """

    A: Enclosure
    B: Enclosure
    starts: Enclosure
    signals: Enclosure
    steps: Enclosure
    kicks: Enclosure
    vertices: FloatArray

    def some(self, which: slice) -> AnsweringLoops:
        """Return some of them."""
        return AnsweringLoops._make(part[which] for part in self)

    def moving(self) -> AnsweringLoops:
        """Return them without the parameters that are at all vertices what they are in the middle."""
        moving = self.vertices.any(axis=(0, 1))
        steps, kicks = self.steps[:, moving], self.kicks[:, moving]
        return self._replace(steps=steps, kicks=kicks, vertices=self.vertices[..., moving])

    def in_coordinates(self, modes: FloatArray) -> AnsweringLoops:
        """Return them with z = G z', G (N, n, n)."""
        away = inverse(modes)
        A, steps = away @ self.A @ modes, away[:, None] @ self.steps @ modes[:, None]
        B, starts, kicks = away @ self.B, away @ self.starts, away[:, None] @ self.kicks
        return AnsweringLoops(A, B, starts, self.signals @ modes, steps, kicks, self.vertices)


def answers(
    loops: AnsweringLoops, factors: Sequence[float] = (1.0,), plain: int = 0, coarse: bool = False
) -> list[Answers]:
    """Return bounds, hardly above the true values, of the responses of loops, for each of some factors.

    Args:
        loops: N of them.
        factors: at least 1, by which z+ is multiplied in every period: of the loop with r A, r B and so on.
        plain: e, the number of last rows of C without vertex bounds.
        coarse: whether bounds may be some hundredths too large, which takes a third of the time.
    """
    loops, fading, found = loops.moving(), None, []
    with np.errstate(all="ignore"):  # the sums of unstable loops overflow
        if coarse:
            modes, fading = modes_of(loops.A.mid)
            loops = loops.in_coordinates(modes)
        for s in (slice(i, i + _BATCH) for i in range(0, len(loops.A.mid), _BATCH)):
            sums = _Sums(loops.some(s), factors, plain)
            found.append(sums.all(None if fading is None else fading[s]))
    return [
        Answers(*(np.concatenate([np.asarray(getattr(part, name)) for part in same]) for name in _NAMES))
        for same in zip(*found, strict=True)
    ]


_NAMES = ("sums", "peaks", "vertex_sums", "vertex_peaks")


class _Sums:
    """The sums of a few loops."""

    def __init__(self, loops: AnsweringLoops, factors: Sequence[float], plain: int) -> None:
        A, B, starts, signals, steps, kicks, vertices = loops
        N, n, m = B.shape
        d, f, k = kicks.shape[1], kicks.shape[3], starts.shape[2]
        self.shape = N, n, m, k, f
        self.followed = signals.shape[1] - plain
        moved, others = joined(B[..., :f], starts), B[..., f:]
        turned = joined(kicks, Enclosure(np.zeros((N, d, n, k))))
        power, slope = A, steps
        for _ in range(_DOUBLINGS):
            turned = joined(turned, slope @ moved[:, None] + power[:, None] @ turned)
            moved, others = joined(moved, power @ moved), joined(others, power @ others)
            power, slope = power @ power, slope @ power[:, None] + power[:, None] @ slope
        self.moved, self.others, self.turned = (columns_by_time(part, _CHUNK) for part in (moved, others, turned))
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
        # what answers to inputs, (F, 16), and starts, (16 k,), are multiplied with in a chunk, and from one to the next
        powers = np.cumprod(np.tile(factors, (_CHUNK, 1)), axis=0)
        self.inputs, self.chunk = np.ascontiguousarray(powers.T), powers[-1]
        self.starts = np.tile(powers[:, -1] / factors[-1], k)

    def _beginning(self) -> Running:
        """Return the rows of the first chunk, and sums of 0."""
        N, n, m, k, f = self.shape
        p, d, V, F = self.followed, self.reach.shape[1], self.shares.shape[1], len(self.chunk)
        own, moved, power = self.signals.mid, self.moved.mid, self.power.mid
        rows = np.concatenate([own[:, :p], np.broadcast_to(np.eye(n), (N, n, n)), own[:, p:]], axis=1)
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
            plain=np.zeros((N, F, all_rows, f)),
            others=np.zeros((N, F, all_rows, m - f)),
            vertex=np.zeros((N, F, V, p, f)),
            bent=np.zeros((N, F, n, f)),
            peaks=np.zeros((N, all_rows, k * _CHUNK)),
            vertex_peaks=np.zeros((N, V, p, k * _CHUNK)),
            bent_peaks=np.zeros((N, n, k * _CHUNK)),
            moved=moved.copy(),
            moved_others=self.others.mid.copy(),
            turned=over(moved, self.turned.mid),
            power=power.copy(),
            slope=over(power, self.slope.mid),
            shares=self.shares.copy(),
            reach=self.reach.copy(),
        )

    def all(self, fading: FloatArray | None) -> list[Answers]:
        """Return the bounds for each factor.

        Args:
            fading: (N,) absolute eigenvalue of the slowest mode, for coarse bounds; None for close ones.
        """
        N, n, m, k, f = self.shape
        p, V, F, e = self.followed, self.shares.shape[1], len(self.chunk), self.signals.shape[1] - self.followed
        found = [tuple(np.full(shape, np.inf) for shape in ((N, p + e, m + k), (N, V, p, f + k))) for _ in range(F)]
        # products go to memory that is there: to be given some would take longer than to multiply
        memory = [Products.of((N, self.reach.shape[1], V, p, n, e), columns * _CHUNK) for columns in (f, k)]
        memory_others = np.empty((N, p + n + e, (m - f) * _CHUNK))
        now, scale, asked = self._beginning(), np.ones(F), None
        if fading is not None:
            faded = np.log(fading) + math.log(self.chunk[-1]) / _CHUNK
            asked = np.where(faded < 0.0, np.ceil(math.log(_FADED) / _CHUNK / faded), _CHUNKS_MAX)
        for number in range(_PERIODS_MAX // _CHUNK):
            self._gather(now, scale, memory, memory_others[: len(now.place)])
            now.move(scale)
            scale = scale * self.chunk
            left = now.rows_size.copy()
            left[:, : p + n] += now.turns_size
            done = self._done(now, number, scale, left) if asked is None else _asked(now, number, asked)
            for which in np.flatnonzero(done.any(axis=0)).tolist():
                places = np.flatnonzero(done[:, which])
                rest = self._finish(now, places, which, scale[which] * left[places], found[which])
                if asked is not None and number + 1 < _CHUNKS_MAX:
                    done[places, which] = rest <= _CLOSE[min(which, 1)]
            now.waiting[done] = False
            for place in np.flatnonzero(~now.waiting.any(axis=1))[::-1].tolist():
                now = now.without(place)
            if not len(now.place):
                break
        order = [*range(f), *range(f + k, m + k)]
        return [Answers(a[..., order], a[..., f : f + k], b[..., :f], b[..., f:]) for a, b in found]

    def _gather(self, now: Running, scale: FloatArray, memory: Sequence[Products], others: FloatArray) -> None:
        """Add the responses of a chunk of periods to the sums."""
        k, columns = self.shape[3], self.shape[4] * _CHUNK
        inputs, starts = (part.some(len(now.place)) for part in memory)
        now.answer(slice(columns), inputs)
        np.abs(np.matmul(now.rows, now.moved_others, out=others), out=others)
        pairs = [(inputs.rows, now.plain), (inputs.vertex, now.vertex), (others, now.others), (inputs.bent, now.bent)]
        for array, total in pairs:
            for number, weights in enumerate(self.inputs * scale[:, None]):
                sums = np.matmul(array.reshape(-1, _CHUNK), weights).reshape(
                    *array.shape[:-1], array.shape[-1] // _CHUNK
                )
                total[:, number] += now.together(sums) if array is inputs.bent else sums
        if k:
            now.answer(slice(columns, None), starts)
            pairs = [(starts.rows, now.peaks), (starts.vertex, now.vertex_peaks), (starts.bent, now.bent_peaks)]
            for array, most in pairs:
                array *= scale[-1] * self.starts
                np.maximum(most, now.together(array) if array is starts.bent else array, out=most)

    def _done(self, now: Running, number: int, scale: FloatArray, left: FloatArray) -> NDArray[np.bool_]:
        """Tell the sums of which loops (N, F) can end after a chunk. Those of unstable loops do not wait any longer.

        Args:
            now: what was gathered.
            number: of the chunk.
            scale: (F,) of the next chunk's first period.
            left: (N, p + n + e, n) as of `_finish`, but for the scale.
        """
        state = slice(self.followed, self.followed + self.shape[1])
        # of each entry alone no less is left; loops that grow are looked for now and then
        single = np.einsum("ijj->ij", left[:, state]).max(axis=1)[:, None] * scale
        if number % _GIVE_UP and (single >= _FORGOTTEN)[now.waiting].all():
            return np.zeros_like(now.waiting)
        sizes = now.others[:, :, state].sum(axis=3) + (now.plain[:, :, state] + now.bent).sum(axis=3)
        sizes[:, -1] += (now.peaks[:, state] + now.bent_peaks).sum(axis=2)
        rest = (left[:, None, state] @ sizes[..., None])[..., 0]
        remembered = (scale[:, None] * rest / sizes).max(axis=2)
        now.waiting[~(remembered < 1e12)] = False
        return np.asarray(now.waiting & (remembered < _FORGOTTEN))

    def _finish(
        self, now: Running, places: NDArray[np.intp], number: int, left: FloatArray, found: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Add bounds of rounding errors and of later periods, for some loops and one factor; return their share (P,).

        Args:
            now: what was gathered.
            places: (P,) of the loops in it.
            number: of the factor.
            left: (P, p + n + e, n) bound of the rows that are left and of their derivatives, times their reach.
            found: to write to.
        """
        _, n, _, k, f = self.shape
        i, last = now.place[places], number == len(self.chunk) - 1
        b = f + k if last else f  # to starts for the last factor alone
        p, grown = self.followed, self.chunk[number]
        both = p + n
        weight, turned = now.rows_sum[places, number], now.turns_sum[places, number]
        power = grown * self.wrong_power[i]
        q = weight @ power + left
        q[:, :both] += weight[:, :both] @ (grown * self.wrong_slope[i]) + turned @ power
        q[:, :p] += self.signals.rad[i, :p]
        q[:, both:] += self.signals.rad[i, p:]
        off, kicks, others = grown * self.off[i, :, :b], grown * self.kicks[i, :, :b], grown * self.off_others[i]
        plain, vertex, own = now.plain[places, number], now.vertex[places, number], now.bent[places, number]
        if last:
            plain, vertex, own = (
                np.concatenate([sums, peaks[places].reshape(*sums.shape[:-1], k, _CHUNK).max(axis=-1)], axis=-1)
                for sums, peaks in ((plain, now.peaks), (vertex, now.vertex_peaks), (own, now.bent_peaks))
            )
        added, bent = weight @ off, turned @ off + weight[:, :both] @ kicks
        vertex = vertex + (added[:, :p] + bent[:, :p])[:, None]
        plain = np.concatenate([plain + added, now.others[places, number] + weight @ others], axis=2)
        state = plain[:, p:both].copy()
        state[..., :b] += own + bent[:, p:]
        q = q * UP + TINY
        bound, shown = implied(state * UP + TINY, q[:, p:both])
        rows = [*range(p), *range(both, q.shape[1])]
        rest = q[:, rows] @ bound
        sums, vertex = (plain[:, rows] + rest) * UP + TINY, (vertex + rest[:, None, :p, :b]) * UP + TINY
        i, sums = i[shown], sums[shown]
        found[0][i, :, :b], found[0][i, :, f + k :], found[1][i, ..., :b] = sums[..., :b], sums[..., b:], vertex[shown]
        return np.where(shown, (rest[:, :p, :b] / plain[:, :p, :b]).max(axis=(1, 2)), np.inf)


def _asked(now: Running, number: int, first: FloatArray) -> NDArray[np.bool_]:
    """Tell for which loops (N, F) it is checked after a chunk whether coarse sums can end; from `first` (N,) on."""
    if number + 1 == _CHUNKS_MAX:
        return now.waiting.copy()
    return np.asarray(now.waiting & ((number + 1) % _EVERY == 0) & (number + 1 >= first)[now.place, None])
