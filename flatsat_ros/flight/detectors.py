"""What a drone's motion says about the ground: whether it has touched down, and whether it will not leave it."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# A landing drone stands when its sinking reference has left it behind by this much, m, while it is this slow, m/s, for
# this long, s.
_LEFT_BEHIND = 0.25
_SLOW = 0.05
_STANDING_TIME = 0.5

# a drone is off the ground when it is so far, m, from the height at which its lock was opened
_LIFTED_OFF = 0.05


class TouchDownDetector:
    """Tells which landing drones stand on something.

    Attributes:
        landing: (N,) whether a drone is landing; of others nothing is told.
    """

    def __init__(self, count: int) -> None:
        self.landing = np.zeros(count, dtype=bool)
        self._offset = np.zeros(count)  # height above the reference when the landing began, m
        self._slow_since = np.full(count, np.inf)

    def begin(self, index: int, offset: float) -> None:
        """Watch drone index, which begins its landing at a height of offset, m, above its reference."""
        self.landing[index], self._offset[index], self._slow_since[index] = True, offset, np.inf

    def end(self, index: int) -> None:
        """Watch drone index no more."""
        self.landing[index] = False

    def standing(self, now: float, state: FloatArray, reference: FloatArray) -> np.ndarray:
        """Tell which drones stand, (N,).

        Args:
            now: s.
            state: (N, 6) position, m, and velocity, m/s.
            reference: (N, 9) of the landing.
        """
        if not np.count_nonzero(self.landing):
            return self.landing
        left_behind = state[:, 2] - reference[:, 2] - self._offset > _LEFT_BEHIND
        slow = self.landing & left_behind & (np.abs(state[:, 5]) < _SLOW)
        self._slow_since = np.where(slow, np.minimum(self._slow_since, now), np.inf)
        return np.asarray(now - self._slow_since >= _STANDING_TIME)


class LiftOffDetector:
    """Tells which drones are commanded to climb and stay on the ground."""

    def __init__(self, count: int, patience: float) -> None:
        """Watch nobody at first.

        Args:
            count: N.
            patience: s of a commanded climb after which a drone that is still on the ground will not leave it.
        """
        self._patience = patience
        self._ground = np.full(count, np.nan)  # height at which its lock was opened, m; NaN once it is off the ground
        self._held_since = np.full(count, np.inf)

    def begin(self, index: int, height: float) -> None:
        """Watch drone index, which stands at a height, m, and is about to take off."""
        self._ground[index], self._held_since[index] = height, np.inf

    def held(self, now: float, height: FloatArray, climbing: np.ndarray) -> np.ndarray:
        """Tell which drones have been commanded to climb for too long without leaving the ground, (N,).

        Args:
            now: s.
            height: (N,) z, m.
            climbing: (N,) who was commanded to climb at the last tick.
        """
        watched = np.asarray(~np.isnan(self._ground))
        if not np.count_nonzero(watched):
            return watched
        self._ground[watched & (np.abs(height - self._ground) >= _LIFTED_OFF)] = np.nan
        waiting = climbing & ~np.isnan(self._ground)
        self._held_since = np.where(waiting, np.minimum(self._held_since, now), np.inf)
        return np.asarray(now - self._held_since >= self._patience)
