"""The descent without position: level, with the thrust learnt in flight, for as long as the last known height needs.

Nothing measures it. From its last known climb rate the drone is brought to a slow sinking by a known acceleration, and
kept there by a thrust that drag and gravity balance. What is left is the error of the thrust that was learnt: drag lets
1 % of it be 0.1 m/s^2 over 0.4 1/s, a quarter of a metre per second. Before anything was learnt the thrust is rather
too low than too high. One that has moved unseen before anything was learnt gets ever less once it should be down, so
slowly that it sinks slowly when it begins to, with more thrust than is known, too. One that has left the ground unseen
may have climbed: it is braked harder.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of

SINKING = 0.5  # m/s
_CHANGE = 1.0  # m/s^2, to come to that speed
# the descent lasts this much longer than its height needs at that speed, relatively and in s
_LONGER, _LATER = 1.3, 1.0
_SEEN = 3.0  # and so many times as long while poses, if there are any, show it in the air
_DECEIVED = 1.5  # or if poses that stand still came before: its thrust and its climb are known less well
# One that has left the ground unseen changes to sinking by this, m/s^2.
_UNSEEN_CHANGE = 2.0
# Who has moved unseen gets so much less of its weight every second, until it gets so little: not enough to fly with 1.4
# times the thrust.
_LESS, _LEAST = 0.01, 0.68

# Whether it has left what it stood on is tried: it is pushed aside by this, m/s^2, for so long, s, and back as long.
_ASIDE, _ASIDE_TIME = 0.3, 0.5


class BlindDescent:
    """Descents of N drones."""

    def __init__(self, gravity: float, drag: float, level_thrust: float, count: int) -> None:
        """Begin with nobody descending.

        Args:
            gravity: g, m/s^2.
            drag: vertical drag over the mass, 1/s.
            level_thrust: of a drone whose thrust was not learnt, as a fraction of g.
            count: N.
        """
        self._gravity, self._drag, self._level = gravity, drag, level_thrust
        self._began = np.full(count, np.inf)
        self._climb = np.zeros(count)  # m/s, at the beginning
        self._lift = np.zeros(count)  # m/s^2, disturbance that was learnt
        self._known = np.zeros(count, dtype=bool)  # the thrust was learnt
        # it has left the ground unseen; or, it or not, it has no lift that is known and has moved unseen
        self._hopped, self._unsure = np.zeros((2, count), dtype=bool)
        self._length = np.full(count, np.inf)  # s
        self._fuller = np.full(count, np.inf)  # s, until one that is unsure gets ever less

    def begin(
        self,
        index: int,
        now: float,
        height: float,
        climb: float,
        lift: float | None,
        *,
        unseen: bool = False,
        unsure: bool = False,
    ) -> None:
        """Let drone index be held level, and then sink, from time now, s, on.

        Args:
            index: which drone.
            now: s.
            height: last known height above the ground, m.
            climb: last known climb rate, m/s.
            lift: estimated vertical disturbance, m/s^2; None if neither it nor the thrust was learnt.
            unseen: it may have left the ground unseen, and has no lift that is known: height and climb rate are those
                of a drone as it should be. Whether it is in the air is tried, see `aside`.
            unsure: it has no lift that is known either, and may have moved for a while unseen.
        """
        self._hopped[index], self._unsure[index] = unseen, unseen or unsure
        self._began[index], self._climb[index] = now, climb
        self._known[index], self._lift[index] = lift is not None, lift or 0.0
        height = max(height, 0.0)
        needed = height / SINKING + abs(climb + SINKING) / _CHANGE
        if lift is None and not unseen:
            # it may still climb: the longer time at which height + climb t - down t^2 / 2 is 0
            down = (1.0 - self._level) * self._gravity + 1e-3
            needed = (climb + math.sqrt(climb * climb + 2.0 * down * height)) / down
        self._length[index] = _LONGER * needed + _LATER
        self._fuller[index] = abs(climb + SINKING) / _UNSEEN_CHANGE if unseen else needed

    def thrust(self, now: float) -> FloatArray:
        """Return the thrusts (N,), m/s^2, at time now, s."""
        change = -SINKING - self._climb
        changing = now - self._began < np.abs(change) / _CHANGE
        known = self._gravity - self._lift + np.where(changing, np.sign(change) * _CHANGE, -self._drag * SINKING)
        thrust = np.where(self._known, known, self._level * self._gravity)
        if not any_of(self._unsure):
            return thrust
        since = now - self._began - self._fuller
        less = self._gravity * np.maximum(self._level - _LESS * np.maximum(since, 0.0), _LEAST)
        slowing = np.where(self._hopped, self._gravity + np.sign(change) * _UNSEEN_CHANGE, thrust)
        return np.where(self._unsure, np.where(since < 0.0, slowing, less), thrust)

    def aside(self, now: float) -> FloatArray | None:
        """Return the accelerations along x, (N,) m/s^2, that show at time now, s, who is in the air; None for none."""
        if not any_of(self._hopped):
            return None
        back = np.where(now - self._began < _ASIDE_TIME, _ASIDE, -_ASIDE)
        return np.where(self._hopped & (now - self._began < 2.0 * _ASIDE_TIME), back, 0.0)

    def set_clock_back(self, now: float) -> None:
        """Let no descent last longer because the clock was set back to now, s."""
        self._began = np.where(np.isfinite(self._began), np.minimum(self._began, now), np.inf)

    def over(
        self, now: float, aloft: Callable[[], np.ndarray], deceived: np.ndarray, immobile: np.ndarray | None = None
    ) -> np.ndarray:
        """Tell whose descent has lasted long enough, (N,): for those that are seen in the air three times as long.

        Args:
            now: s.
            aloft: returns who is seen in the air, (N,); asked for where it matters.
            deceived: (N,) whose poses stand still; they are not seen.
            immobile: (N,) who has not moved as it was pushed aside; nobody by default.
        """
        lasted = now - self._began
        ended = np.asarray(lasted >= self._length)
        if not any_of(ended):
            return ended
        longer = np.where(deceived, _DECEIVED, np.where(aloft(), _SEEN, 1.0))
        if not any_of(self._unsure):
            return np.asarray(lasted >= longer * self._length)
        unsure = self._unsure if immobile is None else self._unsure & ~immobile
        longest = self._fuller + (self._level - _LEAST) / _LESS
        return np.asarray(lasted >= np.where(unsure, longest, longer * self._length))
