"""Falls: drones that sink, or lie on the ground, though they are commanded to fly.

A drone whose motors do not obey falls by nearly g. One whose commands come late swings, and sinks fast when it was told
to a moment ago, though it is told to climb now. By its estimate that is disturbance, too. So what is looked at then is
its downward acceleration, as its poses show it: only a fall is faster than all that it was commanded lately.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of

# A drone falls when it sinks faster than this, m/s, is disturbed downward by more than this, m/s^2, and is seen to
# accelerate downward by as much more than whatever it was commanded: what a command does that comes up to so long, s,
# late is disturbance, too, but no fall. It is seen by three poses, so long, s, apart.
_FALLING_SPEED = 1.0
_FALLING_DISTURBANCE = 4.0
_LATEST = 0.5
_APART = 0.1
# It lies when so near, m, to the ground on which it once stood it stays within so little, m, though commanded upward by
# this, m/s^2, for this long, s.
_NEAR_GROUND = 0.10
_STILL = 0.003
_UPWARD = 0.3
_LYING_TIME = 1.5


class FallDetector:
    """Tells which drones fall, or lie on the ground, though they are commanded to fly: their motors do not obey."""

    def __init__(self, count: int, period: float) -> None:
        """Begin without a past.

        Args:
            count: N.
            period: s between two calls of `note`.
        """
        self._since = np.full(count, np.inf)
        self._place = np.full((count, 3), np.nan)  # where it has been lying since
        # of each call, newest last: upward accelerations commanded, m/s^2; stamps of the newest poses, s; heights, m
        calls = math.ceil((_LATEST + 2.0 * _APART) / period) + 1
        self._past: deque[tuple[FloatArray, FloatArray, FloatArray]] = deque(maxlen=calls)

    def note(self, upward: FloatArray, stamps: FloatArray, height: FloatArray) -> None:
        """Note what is commanded and seen, in arrays that nobody changes later.

        Args:
            upward: (N,) vertical acceleration that is commanded, m/s^2.
            stamps: (N,) of the newest poses, s.
            height: (N,) measured then, m.
        """
        self._past.append((upward, stamps, height))

    def fell(
        self,
        now: float,
        state: FloatArray,
        disturbance: FloatArray,
        upward: FloatArray,
        height: FloatArray,
        judged: np.ndarray,
    ) -> np.ndarray:
        """Tell who fell, (N,).

        Args:
            now: s.
            state: (N, 6) position, m, and velocity, m/s.
            disturbance: (N,) estimated vertical disturbance, m/s^2.
            upward: (N,) vertical acceleration that was commanded at the last tick, m/s^2.
            height: (N,) above the ground on which each stood last, m.
            judged: (N,) who has left the ground and is steered.
        """
        sinking, low = judged & (state[:, 5] < -_FALLING_SPEED), judged & (np.abs(height) < _NEAR_GROUND)
        if not (any_of(sinking) or any_of(low)):
            self._since[:] = np.inf
            return sinking
        falling = sinking & (disturbance < -_FALLING_DISTURBANCE)
        for index in map(int, np.flatnonzero(falling)):
            falling[index] = self._drops(index)
        lying = low & (upward > _UPWARD)
        if not any_of(lying):
            self._since[:] = np.inf
            return np.asarray(falling)
        moved = ~(np.abs(state[:, :3] - self._place).max(axis=1) < _STILL)
        self._place[moved] = state[moved, :3]
        self._since = np.where(lying & ~moved, np.minimum(self._since, now), np.inf)
        return np.asarray(falling | (now - self._since >= _LYING_TIME))

    def _drops(self, index: int) -> bool:
        """Tell whether drone index is seen to accelerate downward by more than any command of late explains."""
        if not self._past:
            return False
        commanded, stamps, heights = np.array([[float(each[index]) for each in call] for call in self._past]).T
        last = len(stamps) - 1
        middle = int(np.searchsorted(stamps, stamps[last] - _APART, side="right")) - 1
        first = int(np.searchsorted(stamps, stamps[middle] - _APART, side="right")) - 1
        if min(middle, first) < 0 or not math.isfinite(stamps[first]):
            return False
        before, after = np.diff(heights[[first, middle, last]]) / np.diff(stamps[[first, middle, last]])
        seen = 2.0 * (after - before) / (stamps[last] - stamps[first])
        return bool(seen < commanded.min() - _FALLING_DISTURBANCE)

    def set_clock_back(self, now: float) -> None:
        """Let nothing last longer because the clock was set back to now, s."""
        self._since = np.where(np.isfinite(self._since), np.minimum(self._since, now), np.inf)
        self._past.clear()
