"""Heights that stand still but for noise though commands should have moved the drone: they are of something else.

The reference leads a drone to another height, but its height stays within a little, while what was commanded beyond the
disturbance that was known should have led it far towards the reference. Motion capture repeats an old value, or tracks
another body, or something holds the drone. Gusts, which commands counter while nothing moves, take no reference away:
one that has rested for a while leads nobody anywhere, however far gusts have blown a drone that is flown softly. Nor is
one that moves enough where the air is rough, which is seen sideways: a gust may hold a drone against its command for a
while, so that it must have been led much farther there. And of a drone whose thrust is not known yet it is not known
either how late its commands come: one that swings for that stands still at each turn, while commands lead it back that
have not come yet. It must have been led away by those of a moment ago, too.
Along the horizontal a wrong body is noticed by motion that does not follow the commands, see `flight.astray`.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of

# a height stands still while it stays within so much, m; it is looked at for so long, s, and then anew
STILL = 0.015
_WINDOW = 0.8
# while the reference is so far away, m,
_AWAY = 0.1
# and has moved by the first, m, within the second, s,
_MOVED, _RESTED = 0.05, 3.0
# in which it should have changed by so much, m, the second if the thrust is not known yet or the air is rough; from
# another change, m, on nothing is learnt from it
_WAY = 0.12, 0.4
# and in the second case by what was commanded so long ago, s, too
_LATE = 0.25
# The air is rough if within so long, s, what disturbs sideways was so far, m/s^2, from its mean over as long.
_ROUGH, _ROUGH_TIME = 0.35, 3.0
DOUBTFUL = 0.015


class UnmovedDetector:
    """The heights of N drones, from look to look.

    Attributes:
        way: (N,) how much higher each should be than where it has stood since, m.
    """

    def __init__(self, count: int, period: float) -> None:
        """Begin with nobody watched.

        Args:
            count: N.
            period: between two looks, s; every second one is enough, and the others cost next to nothing.
        """
        self._period, self._skips = 2.0 * period, False
        self._push, self._nobody = np.zeros(count), np.zeros(count, dtype=bool)
        self._lasted = np.full(count, _WINDOW)  # s
        self._height, self._speed, self._balance = np.zeros((3, count))  # m and m/s^2 at first; m/s by now
        late = max(1, round(_LATE / self._period))
        # of what was commanded a moment ago: m/s, each, newest last; and what comes of that, m/s and m
        self._pushes = deque([np.zeros(count)] * late, maxlen=late)
        self._late_speed, self._late_way = np.zeros((2, count))
        self._past = np.zeros((2, count))  # way, m, and speed, m/s, until the look began, since it stands still
        self._wanted, self._rested = np.full(count, np.inf), np.zeros(count)  # m, and s for which it has been that
        self._wind, self._gust = np.zeros((count, 2)), np.zeros(count)  # m/s^2: mean, and how far from it
        self.way = np.zeros(count)

    def look(
        self,
        estimated: FloatArray,
        push: FloatArray,
        error: FloatArray,
        watched: np.ndarray,
        settled: np.ndarray,
        resting: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return which heights have stood still though they should have changed, (N,).

        Args:
            estimated: (N, 9) position, velocity, disturbance: m, m/s, m/s^2.
            push: (N,) commanded change of the climb rate since the last look, m/s.
            error: (N,) height above the reference, m.
            watched: (N,) who is steered in the air.
            settled: (N,) whose thrust is known.
            resting: (N,) who was taken over and has not moved at all since: it is found if it should have sunk, be it
                that something carries it; nobody by default.
        """
        self._push += push
        self._skips = not self._skips
        if self._skips:
            return self._nobody
        if any_of(watched):
            self._follow(estimated, watched)
        else:
            self._past[:] = 0.0
            self._begin(slice(None), estimated)
        self._pushes.append(self._push.copy())
        self._push[:] = 0.0
        share = self._period / _ROUGH_TIME
        off = estimated[:, 6:8] - self._wind
        self._wind += share * off
        self._gust = np.maximum((1.0 - share) * self._gust, np.hypot(off[:, 0], off[:, 1]))
        self._rested += self._period
        wanted = estimated[:, 2] - error
        moved = np.abs(wanted - self._wanted) > _MOVED
        if any_of(moved):
            self._wanted[moved], self._rested[moved] = wanted[moved], 0.0
        away = np.abs(error) >= _AWAY
        if not any_of(away):
            return self._nobody
        away &= self._rested < _RESTED
        known, sign = settled & (self._gust < _ROUGH), -np.sign(error)
        led = sign * self.way
        led = np.where(known, led, np.minimum(led, sign * self._late_way))
        if resting is not None:
            led = np.where(resting, np.where(sign < 0.0, -self._climbs()[0], 0.0), led)
        return np.asarray(away & (led >= np.where(known, *_WAY)))

    def _follow(self, estimated: FloatArray, watched: np.ndarray) -> None:
        """Add up what the commands of those that stand still should have come to, see `look`."""
        stands = np.abs(estimated[:, 2] - self._height) <= STILL
        stands &= watched
        anew = ~(stands & (self._lasted < _WINDOW))
        if any_of(anew):
            self._past[:, anew] = np.where(stands, self._climbs(), 0.0)[:, anew] if any_of(stands) else 0.0
        self._lasted += self._period
        balanced = self._period * self._balance
        for speed, way, push in (
            (self._speed, self.way, self._push),
            (self._late_speed, self._late_way, self._pushes[0]),
        ):
            speed += push
            speed += balanced
            way += self._period * speed
        if any_of(anew):
            self._begin(anew, estimated)

    def _begin(self, which: np.ndarray | slice, estimated: FloatArray) -> None:
        """Begin with where some drones are and how they move, see `look`."""
        self._height[which], self._balance[which] = estimated[which, 2], estimated[which, 8]
        self._speed[which] = self._late_speed[which] = estimated[which, 5]
        self._lasted[which] = self.way[which] = self._late_way[which] = 0.0

    def climb(self, index: int) -> tuple[float, float]:
        """Return how far, m, and how fast, m/s, drone index should have climbed since its height stands still."""
        way, speed = self._climbs()[:, index].tolist()
        return way, speed

    def _climbs(self) -> FloatArray:
        """Return `climb` of all, (2, N); of those that are not watched it says nothing."""
        way, speed = self._past
        return np.array([way + speed * self._lasted + self.way, speed + self._speed])
