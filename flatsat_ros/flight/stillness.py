"""Coordinates that stand still in poses though they should not: motion capture, or the firmware, repeats them.

The noise of a measurement lets no coordinate repeat exactly, unless poses are rounded coarsely. How coarsely is seen:
no change of a coordinate is less than that. One that repeats in poses whose other coordinates live is an old one

- in fine poses, if the others are noisy, or if a little motion along it has been commanded for a while;
- in all poses, if what was commanded since, beyond what balanced it then, and the speed that it had should have moved
  it by more than the poses are rounded. In rounded poses what balances it is not known so well: what is commanded as it
  begins to repeat is off by what the last step had commanded, and what was on average may be that of a manoeuvre. Where
  each tells another way, the shorter one counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

# poses whose coordinates change by less than this now and then, m, are fine
_FINE = 5e-5
_UNKNOWN = 1.0  # what changes are less than, m, before there were any
# a coordinate of fine poses that repeats while so much, m/s^2, is commanded for so long, s, or a whole position that
# repeats for so long while so much is commanded, is an old one; a coordinate in so many poses at least
REPEATED = ((0.15, 0.05), (0.6, 1e-3))
_POSES = 3
# The others are noisy if they turn back, by more than this, m, in so many pairs of poses one after the other: of noise
# 5 of 12 pairs do. What swings, however often, turns back at its crests alone, once each.
_TURNS, _NOISE = 8, 1e-5
# One that should have moved by so much, m, or so many of the least changes, and so fast, m/s, and so many of them in a
# second more, as what is rounded lets an estimated velocity be off, is no longer taken in. It is an old one if it
# repeats for the first time, s, and should have moved by the second distance, or when the second time has passed since.
_DUPLICATE = 1e-3, 10.0
_MOVES = 0.05, 100.0
_STANDS = 0.03, 40.0
_LASTED = 0.15, 0.6
# what is commanded counts on average for so long, s
_LATELY = 1.0
# poses farther apart than this, s, say nothing of what was between them
_GAP = 0.5


class Still(NamedTuple):
    """A coordinate that repeats though it should not.

    Attributes:
        axis: which.
        lasted: for how long, s.
        limit: how long it may, s; 0 if it need not be an old one yet.
    """

    axis: int
    lasted: float
    limit: float


@dataclass(slots=True)
class _Repeat:
    """A coordinate that repeats.

    Attributes:
        since: stamp from which on, s.
        free: stamp from which on, meanwhile, nothing kept it from moving, s.
        velocity: along it then, m/s.
        balance: acceleration commanded then, m/s^2.
        usual: acceleration commanded until then on average, in rounded poses, m/s^2.
        poses: number of repetitions.
        turns: how often another one turned back twice in succession meanwhile.
        speed: change of velocity that was commanded since then beyond the balance, m/s.
        way: that velocity and this change have led so far, m.
        duplicate: stamp from which on it is not taken in until it changes, s; infinite before.
        limit: see `Still`.
        weak: stamps, s, at which less than each size of `REPEATED` was commanded last.
    """

    since: float
    free: float
    velocity: float
    balance: float
    usual: float
    poses: int = 0
    turns: int = 0
    speed: float = 0.0
    way: float = 0.0
    duplicate: float = math.inf
    limit: float = 0.0
    weak: list[float] = field(default_factory=lambda: [-math.inf] * len(REPEATED))


class Stillness:
    """The coordinates of N drones, as poses show them one after the other."""

    def __init__(self, count: int) -> None:
        """Begin before the first poses."""
        self._last: list[tuple[float, tuple[float, float, float]] | None] = [None] * count  # stamp, position
        # at the last pose one of whose coordinates repeated, or of one that was not known to be noisy, m
        self._changes = [(0.0, 0.0, 0.0)] * count
        self._turned = [(False, False, False)] * count  # which turned back there
        self._shaken = [0] * count  # how often coordinates turned back twice in succession, while not in the air
        self._repeats: list[dict[int, _Repeat]] = [{} for _ in range(count)]  # by axis
        self._finest = [_UNKNOWN] * count  # least change of a coordinate so far, m
        # what was commanded on average, m/s^2, and the stamp until which, s; of rounded poses in which one repeats
        self._usual: list[Sequence[float]] = [(0.0, 0.0, 0.0)] * count
        self._averaged = [-math.inf] * count

    def look(
        self,
        index: int,
        stamp: float,
        place: tuple[float, float, float],
        acceleration: Sequence[float],
        estimate: Sequence[float],
        airborne: bool,
    ) -> Still | None:
        """Look at a pose; return which coordinate repeats though it should not, None for none.

        Args:
            index: whose.
            stamp: s.
            place: (3,) m.
            acceleration: (3,) commanded, m/s^2.
            estimate: (9,) of position, velocity and disturbance, m, m/s, m/s^2.
            airborne: it is steered in the air, where nothing keeps it from moving.
        """
        last, self._last[index] = self._last[index], (stamp, place)
        if last is None:
            return None
        before, (x, y, z) = last
        change = place[2] - z
        if change and place[0] != x and place[1] != y:
            if abs(change) < self._finest[index]:
                self._finest[index] = abs(change)
            if self._repeats[index]:
                self._repeats[index].clear()
            if not airborne and self._shaken[index] < _TURNS:
                self._shaken[index] += self._turns(index, (place[0] - x, place[1] - y, change))
            return None
        changes = place[0] - x, place[1] - y, change
        self._finest[index] = min([self._finest[index], *(abs(size) for size in changes if size)])
        return self._repeated(index, stamp, before, changes, acceleration, estimate, airborne)

    def _turns(self, index: int, changes: tuple[float, float, float]) -> int:
        """Return how many coordinates of drone index turn back by changes (3,), m, as they did at the pose before."""
        x, y, z = self._changes[index]
        turned = _turned(changes[0], x), _turned(changes[1], y), _turned(changes[2], z)
        turns = sum(now and last for now, last in zip(turned, self._turned[index], strict=True))
        self._changes[index], self._turned[index] = changes, turned
        return turns

    def _repeated(
        self,
        index: int,
        stamp: float,
        before: float,
        changes: tuple[float, float, float],
        acceleration: Sequence[float],
        estimate: Sequence[float],
        airborne: bool,
    ) -> Still | None:
        """Go on with a pose some of whose coordinates repeat.

        Args:
            index: whose.
            stamp: s.
            before: stamp of the pose before, s.
            changes: (3,) since that, m.
            acceleration: (3,) commanded, m/s^2.
            estimate: see `look`.
            airborne: see `look`.
        """
        repeats, elapsed, worst = self._repeats[index], stamp - before, None
        if elapsed > _GAP:
            repeats.clear()
        turns = self._turns(index, changes)
        usual = acceleration if self.is_fine(index) else self._average(index, stamp, acceleration, airborne)
        for axis, change in enumerate(changes):
            if change:
                repeats.pop(axis, None)
                continue
            one = repeats.setdefault(axis, _Repeat(before, before, estimate[3 + axis], acceleration[axis], usual[axis]))
            if airborne or one.duplicate < math.inf:
                one.speed += (acceleration[axis] - one.balance) * elapsed
                one.way += (one.velocity + one.speed) * elapsed
            else:
                one.free, one.velocity = stamp, estimate[3 + axis]
                one.balance = one.usual = acceleration[axis]
                one.speed = one.way = 0.0
            for number, (_, least) in enumerate(REPEATED):
                if abs(acceleration[axis]) < least:
                    one.weak[number] = stamp
            lives = any(changes)  # what repeats as a whole is another matter
            if lives:
                one.poses, one.turns = one.poses + 1, one.turns + turns
                if airborne and self._has_moved(index, one, stamp - one.free):
                    one.duplicate = min(one.duplicate, stamp)
            if lives and not one.limit and one.poses >= _POSES:
                one.limit = self._limit(index, one, stamp)
            if one.limit or (one.duplicate < math.inf and lives and worst is None):
                worst = Still(axis, stamp - one.since, one.limit)
        return worst

    def is_fine(self, index: int) -> bool:
        """Tell whether the poses of drone index are fine, as far as was seen."""
        return self._finest[index] <= _FINE

    def is_coarse(self, index: int) -> bool:
        """Tell whether the poses of drone index are seen to be rounded coarsely."""
        return _FINE < self._finest[index] < _UNKNOWN

    def is_noisy(self, index: int) -> bool:
        """Tell whether the poses of drone index are fine, and were seen to be noisy before it was in the air."""
        return self.is_fine(index) and self._shaken[index] >= _TURNS

    def has_moved(self, index: int, stamp: float) -> bool:
        """Tell whether drone index, whose position repeats, should be elsewhere at a stamp, s."""
        return any(self._has_moved(index, one, stamp - one.free) for one in self._repeats[index].values())

    def _average(self, index: int, stamp: float, acceleration: Sequence[float], airborne: bool) -> Sequence[float]:
        """Return what was commanded until now on average, (3,) m/s^2, and count what is now, see `look`."""
        usual = self._usual[index]
        share = min((stamp - self._averaged[index]) / _LATELY, 1.0) if airborne else 1.0
        self._usual[index] = [old + share * (new - old) for old, new in zip(usual, acceleration, strict=True)]
        self._averaged[index] = stamp
        return usual

    def _has_moved(self, index: int, one: _Repeat, lasted: float) -> bool:
        other = one.way + (one.balance - one.usual) * lasted**2 / 2.0
        way = min(abs(one.way), abs(other)) if one.way * other > 0.0 else 0.0
        least = max(self._counts(index, _DUPLICATE), (_MOVES[0] + _MOVES[1] * self._finest[index]) * lasted)
        return way > least

    def _counts(self, index: int, least: tuple[float, float]) -> float:
        """Return which way counts, m: the first entry, or the second one times the least change."""
        return max(least[0], least[1] * self._finest[index])

    def _limit(self, index: int, one: _Repeat, stamp: float) -> float:
        """Return how long, s, the coordinate of drone index may repeat that repeats at a stamp, s; 0 if longer."""
        soon, late = _LASTED
        lasted, fine = stamp - one.since, self.is_fine(index)
        limits = [time for (time, _), weak in zip(REPEATED, one.weak, strict=True) if fine and stamp - weak >= time]
        if fine and one.turns >= _TURNS:
            limits.append(soon)
        if abs(one.way) > self._counts(index, _STANDS) and one.duplicate < math.inf:
            limits.append(soon)
        if stamp - one.duplicate >= late:
            limits.append(late)
        limit = min(limits, default=math.inf)
        return limit if lasted >= limit else 0.0


def _turned(change: float, before: float) -> bool:
    """Tell whether a coordinate that changes, m, after it has changed before, m, turned back like noise."""
    return change * before < 0.0 and abs(change) > _NOISE
