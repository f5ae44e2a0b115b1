"""Watches whether all holds that a flight certificate takes for granted, and says whether the tube is claimed.

No monitor proves an assumption. One that fails says that the tube is not claimed now, and why.
"""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.flight.assumptions import COLUMNS, Assumed, Assumption, Seen, in_words
from flatsat_ros.flight.beginnings import Beginnings
from flatsat_ros.flight.changes import Jumps, RecentDisturbances
from flatsat_ros.flight.lateness import Lateness
from flatsat_ros.flight.references import References

# a drone outside its tube for so long, s, although all that can be watched holds, has a fault
_OUTSIDE = 0.5
# what is broken again is told again once it has held for so long, s; a disturbance that becomes so many times as large,
# as well
_SILENCE, _LARGER = 1.0, 2.0
# a pose so far, m, from where the model expects it is not the model's: its estimate begins anew
_LOST = 0.15
_TINY = 1e-12

_WHICH = np.array(COLUMNS)
_OF_DISTURBANCE = COLUMNS.index(Assumption.DISTURBANCE)
_OF_RATE = Assumption.DISTURBANCE_RATE.value == _WHICH
_START, _TUBE, _REFERENCE = Assumption.START.value, Assumption.TUBE.value, Assumption.REFERENCE.value


class Told:
    """What people were told of N drones, and when."""

    def __init__(self, count: int) -> None:
        """Begin with nothing told."""
        self._last = np.full((count, len(Assumption)), -np.inf)  # when each did not hold last, s
        self._least = np.zeros(count)  # disturbance since one was told of, m/s^2

    def is_new(self, index: int, which: int, now: float, disturbance: float) -> bool:
        """Take note that something does not hold; return whether that is to be told.

        Args:
            index: of which drone.
            which: value of `Assumption`.
            now: s.
            disturbance: of the drone, m/s^2.
        """
        last, self._last[index, which] = self._last[index, which], now
        anew = now - last > _SILENCE
        anew |= which == Assumption.DISTURBANCE and disturbance > _LARGER * self._least[index]
        self._least[index] = disturbance if anew else min(disturbance, self._least[index])
        return bool(anew)


class Monitors:
    """Watches N drones.

    Attributes:
        bounds: of what is watched.
        recent: the disturbances over the last second.
        broken: (N,) values of `Assumption`.
        ratio: (N,) distance to the reference over the tube, the larger of horizontal and vertical.
        quiet: whether nothing that is watched was beyond its bounds, for any drone.
        lost: (N,) whose poses are so far from where they are expected that its estimate is wrong.
    """

    def __init__(self, flight: FlightSection, clip: float, references: References) -> None:
        """Watch drones of which nothing holds yet.

        Args:
            flight: what is assumed.
            clip: largest disturbance that is compensated, m/s^2.
            references: of N drones, and what they ask for.
        """
        count, period = len(references.at_rest), flight.horizontal.design.period
        self._references, self._period = references, period
        self._lateness, self._late = Lateness(flight.horizontal, count), False
        self.bounds = Assumed.of(flight, clip, self._lateness.bound)
        self.recent, self._jumps = RecentDisturbances(period, count), Jumps(references, period, count)
        self._beginnings, self._told = Beginnings(flight, count), Told(count)
        self._now = -math.inf
        self._vectors = np.zeros((count, 6, 3))  # e, e', v0, innovation, d^ and its change
        # of the last tick that was not quiet: sizes of e, e' and v0, and all that is watched
        self._sizes, self._values = np.zeros((count, 3, 2)), np.zeros((count, len(COLUMNS)))
        self._outside = np.zeros(count)  # s for which it has been outside without a reason
        self._nothing, self._nobody = np.zeros(count, dtype=int), np.zeros(count, dtype=bool)
        self.broken, self.lost = np.full(count, _START), self._nobody
        self.ratio, self.quiet = np.zeros(count), False

    def look(self, now: float, flying: np.ndarray, seen: Seen) -> None:
        """Look at one tick.

        Args:
            now: s.
            flying: (N,) who is steered.
            seen: at it.
        """
        before, self._now = self._now, now
        elapsed, bounds, beginnings = now - before, self.bounds, self._beginnings
        vectors = self._vectors
        vectors[:, :2] = seen.error.reshape(-1, 2, 3)
        vectors[:, 2], vectors[:, 3], vectors[:, 4] = seen.nominal, seen.innovation, seen.disturbance
        self.recent.note(seen.disturbance, vectors[:, 5])
        squares = vectors * vectors
        squares[..., 0] += squares[..., 1]
        squares = squares[..., ::2]
        shares = squares[:, 0] / bounds.easy[0]
        self.ratio = np.sqrt(np.maximum(shares[:, 0], shares[:, 1]))
        all_fly = all_of(flying)
        steady = flying if all_fly and now >= beginnings.ready else beginnings.steady(now, flying)
        most = bounds.most
        if self._lateness.note(seen, steady):
            self._late = float(self._lateness.excess.max()) > most[10]
        even = max(elapsed, 2.0 * self._period - elapsed)
        jumped = self._jumps.look(seen.reference, elapsed)
        if (
            even <= most[1]
            and jumped is None
            and not self._late
            and all_fly
            and all_of(squares <= bounds.easy)
            and all_of(seen.age <= most[0])
            and all_of(self._references.demand <= most[7])
            and all_of(seen.gain <= most[8])
            and all_of(seen.gain * most[9] >= 1.0)
            and all_of(beginnings.due <= now)
        ):
            self.broken, self.lost, self.quiet = self._nothing, self._nobody, True
            if np.count_nonzero(self._outside):
                self._outside = np.zeros(len(flying))
            return
        sizes, self.quiet = np.sqrt(squares), False
        self.lost = np.maximum(sizes[:, 3, 0], sizes[:, 3, 1]) > _LOST
        gain, demand = np.maximum(seen.gain, _TINY), self._references.demand
        if jumped is not None:
            demand = np.where(jumped, np.inf, demand)
        self._sizes = sizes[:, :3]
        values = self._values
        values[:, 0], values[:, 1], values[:, 2:4] = seen.age, even, sizes[:, 3]
        values[:, 4], values[:, 5:7] = np.sqrt(squares[:, 4, 0] + squares[:, 4, 1]), sizes[:, 5]
        values[:, 7], values[:, 8], values[:, 9], values[:, 10] = demand, gain, 1.0 / gain, self._lateness.excess
        self._judge(now, flying, self._sizes, values > most)
        if jumped is not None:  # a reference that begins with a drone's flight has come from nowhere
            self.broken[(self.broken == _REFERENCE) & jumped & beginnings.began(before)] = _START

    def _judge(self, now: float, flying: np.ndarray, sizes: FloatArray, over: np.ndarray) -> None:
        """Find out what does not hold, at a tick at which it may be that something does not.

        Args:
            now: s.
            flying: (N,) who is steered.
            sizes: (N, 3, 2) of e, e' and v0, horizontal and vertical.
            over: (N, K) which quantities exceed their bounds.
        """
        bounds, beginnings = self.bounds, self._beginnings
        failing = over.any(axis=1)
        anew = failing | ~flying
        if any_of(anew):
            lately = ~flying | (over & ~_OF_RATE).any(axis=1)
            beginnings.begin(now, anew, lately, sizes[:, :2])
        within = (sizes <= bounds.inside).all(axis=(1, 2))
        outside = (sizes[:, 0] - bounds.uncertain > bounds.tube).any(axis=1)
        due = now >= beginnings.due
        holds = ~anew & ((within & (now >= beginnings.settled)) | (due & ~outside))
        self.broken = np.where(failing, _WHICH[over.argmax(axis=1)], np.where(due & ~anew, _TUBE, _START) * ~holds)
        self._outside = np.where(~anew & due & outside, self._outside + self._period, 0.0)

    def astray(self) -> list[int]:
        """Return who is outside its tube for longer than noise explains, although all seems to be as assumed."""
        if not np.count_nonzero(self._outside):
            return []
        return [int(index) for index in np.flatnonzero(self._outside >= _OUTSIDE)]

    def reports(self, flying: np.ndarray) -> list[tuple[int, str]]:
        """Return what is to be told of the drones in flight, drone and text, once per event."""
        if not np.count_nonzero(self.broken):
            return []
        found = []
        for index in map(int, np.flatnonzero(flying & (self.broken != 0) & (self.broken != _START))):
            disturbance = float(self._values[index, _OF_DISTURBANCE])
            if self._told.is_new(index, int(self.broken[index]), self._now, disturbance):
                found.append((index, self.sentence(index)))
        return found

    def sentence(self, index: int) -> str:
        """Return in words what does not hold for drone index; empty if all does."""
        which = int(self.broken[index])
        return in_words(which, *self._beyond(index, which))

    def _beyond(self, index: int, which: int) -> tuple[float, float]:
        """Return value and bound of what does not hold for drone index, `which` assumption."""
        if which == _TUBE:
            sizes, tube = self._sizes[index, 0], self.bounds.tube
            part = int((sizes / tube).argmax())
            return float(sizes[part]), float(tube[part])
        column = int((self._values[index] > self.bounds.most).argmax())
        return float(self._values[index, column]), float(self.bounds.most[column])
