"""Drones that move as others are commanded: since before their take-off their poses have been each other's.

Where such poses are exchanged in the air they jump, see `flight.estimator`; those that always were do not. While all
climb alike nothing is wrong. Then the one that is seen too high is the other, which is pushed down, and so on: within a
second both are thrown away, one up and one down. If one leaves the ground first, the other is held down there, and the
first is told to climb without end. But each is seen to move as another one is commanded, to a few percent, and as no
lateness, gust or wrong thrust makes it move.
"""

from __future__ import annotations

from collections import deque
from itertools import islice

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.flight.descent import SINKING

# only where one is disturbed up or down by so much, m/s^2, drones are compared
_DISTURBED = 0.5
# They are by changes of the climb rate over the first time, s, that differ over the second one, s: a thrust that is not
# known yet adds the same to all of them.
_CHANGE, _WINDOW = 0.2, 0.48
# A drone moves as another is commanded if that leaves this share of the variance that its own commands leave, and those
# leave so much, m/s, for so long, s.
_LEFT, _UNEXPLAINED, _LASTING = 0.15, 0.04, 0.1
# One moves as another that is not seen to leave the ground if it is seen to be accelerated upward by the first, m/s^2,
# more by the second than it is commanded; what the other is commanded explains all but these shares of that, and of the
# variance.
_RISES, _BEYOND, _REST, _LEFT_LOW = 1.0, 2.0, 0.5, 0.3
# if it may be several, it may be those that leave at most so many times the variance of the best one
_ALIKE = 3.0
# One that is seen under another's name and sinks is pushed by this, 1/s, times what is missing to its speed, up to so
# much, m/s^2.
_PUSHED, _PUSHED_MOST = 3.0, 2.5
_SPAN = 2  # looks, over which a climb rate is measured
_FORGOTTEN = 1.0  # s, in which it is forgotten as whom a drone moved


class ExchangeDetector:
    """Tells which of N drones are seen under each other's names.

    Attributes:
        any: whether there are any.
        name: (N,) number of the drone under whose name each is seen.
        places: height, m, and climb rate, m/s, of those that are seen under another's name, when that was found.
    """

    def __init__(self, count: int, period: float, late: float) -> None:
        """Begin with everybody seen under its own name.

        Args:
            count: N.
            period: between two looks, s.
            late: how long a command takes to act, s.
        """
        self.any, self.name, self.places = False, np.arange(count), dict[int, tuple[float, float]]()
        self._period, self._count = period, count
        self._late, self._change = max(1, round(late / period)), max(1, round(_CHANGE / period))
        self._span, self._recent = self._change * period, max(1, round(_LASTING / period))  # s, and looks
        size = max(4, round(_WINDOW / period)) + self._change + _SPAN
        self._seen: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=size)  # stamps, s, and heights, m
        self._commanded: deque[FloatArray] = deque([np.zeros(count)], size + self._late)  # since the start, m/s
        self._follows = np.zeros((count, count), dtype=bool)  # as whom each moved at the last look
        self._lasted = np.zeros(count)  # s, for how long it has moved so
        self._moved_as = np.zeros((count, count))  # s, for how long of late each moved as each
        self._quiet = 0  # looks since when nobody was compared

    def look(
        self,
        push: FloatArray,
        newest: FloatArray,
        height: FloatArray,
        disturbance: FloatArray,
        free: np.ndarray,
        grounded: np.ndarray,
    ) -> list[int]:
        """Return who is found to be seen under another's name.

        Args:
            push: (N,) commanded change of the climb rate since the last look, m/s.
            newest: (N,) stamps of the newest poses, s; nobody changes them later.
            height: (N,) measured then, m; likewise.
            disturbance: (N,) estimated, vertical, m/s^2.
            free: (N,) who is steered in the air, and does not land.
            grounded: (N,) who is steered, and not seen in the air.
        """
        if self._count == 1:
            return []
        self._seen.append((newest, height))
        self._commanded.append(self._commanded[-1] + push)
        disturbed = free & (np.abs(disturbance) > _DISTURBED)
        if not any_of(disturbed) or len(self._commanded) < (self._commanded.maxlen or 0):
            self._lasted[:] = 0.0
            self._quiet += 1
            return []
        follows = self._compare(free, grounded)
        self._moved_as *= max(0.0, 1.0 - (1 + self._quiet) * self._period / _FORGOTTEN)
        self._moved_as += self._period * follows
        self._quiet = 0
        self._lasted = np.where((follows & self._follows).any(axis=1), self._lasted + self._period, 0.0)
        self._follows = follows
        found: set[int] = set()
        for seen in map(int, np.flatnonzero(self._lasted >= _LASTING)):
            bodies = np.flatnonzero(follows[seen] & (self.name != seen))
            self.name[bodies] = seen
            found.update(map(int, bodies))
            if bodies.size:
                found.update(self._displaced(seen, int(bodies[0])))
        for index in found:
            self.places[index] = float(self._seen[-1][1][self.name[index]]), self._climb(index)
        self.any |= bool(found)
        return sorted(found)

    def _displaced(self, index: int, place: int) -> list[int]:
        """Return who cannot be seen under its own name, as another is: drone index, and so on.

        Each is seen as whoever has moved as it for longest of late; as the one before, if nobody has: it is not seen to
        do anything, and in that place.

        Args:
            index: under whose name another drone is seen.
            place: number of that drone.
        """
        displaced = []
        while self.name[index] == index:
            moved = self._moved_as[:, index].copy()
            moved[index] = 0.0
            name = int(np.argmax(moved)) if moved.max() > moved[place] else place
            self.name[index] = name
            displaced.append(index)
            index, place = name, index
        return displaced

    def _climb(self, index: int) -> float:
        """Return how fast drone index will climb, m/s, once all that was commanded has acted, as it was seen last."""
        (before, low), (after, high) = (self._seen[look] for look in (-1 - _SPAN, -1))
        name = self.name[index]
        rate = (high[name] - low[name]) / max(after[name] - before[name], self._period / 2.0)
        return float(rate + self._commanded[-1][index] - self._commanded[-1 - _SPAN // 2 - self._late][index])

    def pushed(self, velocity: FloatArray, pushed: FloatArray, usable: np.ndarray) -> tuple[FloatArray, np.ndarray]:
        """Return how much drones that sink are pushed down, (N,) m/s^2, and who of them is seen, (N,).

        What was learnt of the thrust of those that are seen under another's name is of the other.

        Args:
            velocity: (N,) vertical, m/s, of the names.
            pushed: (N,) m/s^2, of the others.
            usable: (N,) which names are seen.
        """
        exchanged = self.name != np.arange(self._count)
        own = np.clip(_PUSHED * (velocity[self.name] + SINKING), -_PUSHED_MOST, _PUSHED_MOST)
        return np.where(exchanged, own, pushed), usable[self.name]

    def forget(self, index: int) -> None:
        """Take drone index to be seen under its own name."""
        if self.any:
            self.name[index], self._lasted[index] = index, 0.0
            self.places.pop(index, None)
            self.any = bool(np.count_nonzero(self.name != np.arange(self._count)))

    def _compare(self, free: np.ndarray, grounded: np.ndarray) -> np.ndarray:
        """Return as whom each in the air moves, (N, N); on the ground several may be the one that it is."""
        follows, aloft = np.zeros((self._count, self._count), dtype=bool), np.flatnonzero(free)
        drones = np.concatenate([aloft, np.flatnonzero(grounded & ~free)])  # those on the ground at the end
        if drones.size == 1:
            return follows
        stamps, heights = (np.array(values)[:, aloft] for values in zip(*self._seen, strict=True))
        elapsed = np.maximum(stamps[_SPAN:] - stamps[:-_SPAN], self._period / 2.0)
        moved = self._changes((heights[_SPAN:] - heights[:-_SPAN]) / elapsed)
        speeds = np.array(list(islice(self._commanded, len(self._seen))))[:, drones]
        commanded = self._changes((speeds[_SPAN:] + speeds[:-_SPAN]) / 2.0)
        left = moved[:, :, np.newaxis] - commanded[:, np.newaxis]  # of each, by the commands of each
        spread = left.var(axis=0)
        own = spread.diagonal()[:, np.newaxis]
        rising, mean = (values[-self._recent :].mean(axis=0) / self._span for values in (moved, left))
        beyond = mean.diagonal()[:, np.newaxis]
        fits = own > _UNEXPLAINED**2
        high = fits & (spread < _LEFT * own) & (spread == spread.min(axis=1, keepdims=True))
        high[:, aloft.size :] = False
        low = fits & (spread < _LEFT_LOW * own) & (np.abs(mean) < _REST * beyond) & (beyond > _BEYOND)
        low &= (rising > _RISES)[:, np.newaxis] & ~high.any(axis=1, keepdims=True)
        low[:, : aloft.size] = False
        alike = np.where(low, spread, np.inf)
        low &= alike < _ALIKE * alike.min(axis=1, keepdims=True)
        # who is seen as another that is seen in the air is itself seen under a name
        square = high[:, : aloft.size]
        while any_of(left_over := square & ~(square.any(axis=1) & square.any(axis=0)[:, np.newaxis])):
            square &= ~left_over
        follows[np.ix_(aloft, drones)] = high | low
        return follows

    def _changes(self, rates: FloatArray) -> FloatArray:
        return np.asarray(rates[self._change :] - rates[: -self._change])
