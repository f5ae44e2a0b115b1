"""What changes in flight: the disturbance within a second, and references that jump."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.assumptions import RATE_TIME
from flatsat_ros.flight.references import References

# disturbances are remembered so often, s
_REMEMBERED = 0.1
# a reference that moves on by another way than its velocity, m, or velocity than its acceleration, m/s, has jumped
_JUMP, _JUMP_VELOCITY = 1e-3, 1e-2


class RecentDisturbances:
    """The estimated disturbances of N drones over the last second."""

    def __init__(self, period: float, count: int) -> None:
        """Begin with none; period is the time from tick to tick, s."""
        self._past: deque[FloatArray] = deque(maxlen=round(RATE_TIME / _REMEMBERED) + 1)
        self._every, self._ticks, self._count = max(1, round(_REMEMBERED / period)), 0, count

    def note(self, disturbance: FloatArray, change: FloatArray) -> None:
        """Note disturbances (N, 3), m/s^2, and write now and then by how much they have changed into `change`."""
        self._ticks += 1
        if self._ticks % self._every == 0:
            self._past.append(disturbance.copy())
            np.subtract(disturbance, self._past[0], out=change)

    def mean(self) -> FloatArray:
        """Return their mean, (N, 3), m/s^2."""
        return np.mean(self._past, axis=0) if self._past else np.zeros((self._count, 3))


class Jumps:
    """Finds references of N drones that move otherwise than by their velocity, when some are new."""

    def __init__(self, references: References, period: float, count: int) -> None:
        """Begin with none; period is the time from tick to tick, s."""
        self._references, self._period = references, period
        self._last, self._assigned = np.zeros((count, 9)), 0

    def look(self, reference: FloatArray, elapsed: float) -> np.ndarray | None:
        """Return whose references (N, 9) moved otherwise in the time since the last tick, s; None if none are new."""
        before, self._last = self._last, reference
        if self._assigned == self._references.assigned:
            return None
        self._assigned = self._references.assigned
        step = elapsed if math.isfinite(elapsed) else self._period
        off = reference[:, :6] - before[:, :6] - (step / 2.0) * (reference[:, 3:] + before[:, 3:])
        off[:, 3:] *= _JUMP / _JUMP_VELOCITY
        return np.asarray(np.abs(off).max(axis=1) > _JUMP)
