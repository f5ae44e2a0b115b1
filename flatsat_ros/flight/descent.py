"""The descent without position: level, with the thrust learnt in flight, for as long as the last known height needs.

Nothing measures it. From its last known climb rate the drone is brought to a slow sinking by a known acceleration, and
kept there by a thrust that drag and gravity balance. What is left is the error of the thrust that was learnt: drag lets
1 % of it be 0.1 m/s^2 over 0.4 1/s, a quarter of a metre per second. Before anything was learnt the thrust is rather
too low than too high.
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
        self._length = np.full(count, np.inf)  # s

    def begin(self, index: int, now: float, height: float, climb: float, lift: float | None) -> None:
        """Let drone index be held level, and then sink, from time now, s, on.

        Args:
            index: which drone.
            now: s.
            height: last known height above the ground, m.
            climb: last known climb rate, m/s.
            lift: estimated vertical disturbance, m/s^2; None if neither it nor the thrust was learnt.
        """
        self._began[index], self._climb[index] = now, climb
        self._known[index], self._lift[index] = lift is not None, lift or 0.0
        height = max(height, 0.0)
        needed = height / SINKING + abs(climb + SINKING) / _CHANGE
        if lift is None:
            # it may still climb: the longer time at which height + climb t - down t^2 / 2 is 0
            down = (1.0 - self._level) * self._gravity + 1e-3
            needed = (climb + math.sqrt(climb * climb + 2.0 * down * height)) / down
        self._length[index] = _LONGER * needed + _LATER

    def thrust(self, now: float) -> FloatArray:
        """Return the thrusts (N,), m/s^2, at time now, s."""
        change = -SINKING - self._climb
        changing = now - self._began < np.abs(change) / _CHANGE
        known = self._gravity - self._lift + np.where(changing, np.sign(change) * _CHANGE, -self._drag * SINKING)
        return np.where(self._known, known, self._level * self._gravity)

    def set_clock_back(self, now: float) -> None:
        """Let no descent last longer because the clock was set back to now, s."""
        self._began = np.where(np.isfinite(self._began), np.minimum(self._began, now), np.inf)

    def over(self, now: float, aloft: Callable[[], np.ndarray], deceived: np.ndarray) -> np.ndarray:
        """Tell whose descent has lasted long enough, (N,): for those that are seen in the air three times as long.

        Args:
            now: s.
            aloft: returns who is seen in the air, (N,); asked for where it matters.
            deceived: (N,) whose poses stand still; they are not seen.
        """
        lasted = now - self._began
        ended = np.asarray(lasted >= self._length)
        if not any_of(ended):
            return ended
        return np.asarray(lasted >= np.where(deceived, _DECEIVED, np.where(aloft(), _SEEN, 1.0)) * self._length)
