"""Whose poses are missed, and whose velocity is not known well since they came again."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of

# for so long, s, after poses were missed for the second time, s, the estimated velocity may still be wrong, by metres a
# second
_RETURNS, _MISSED = 0.5, 0.15


class PoseGaps:
    """Gaps between the poses of N drones, from look to look.

    Attributes:
        any: whether anybody's poses are missing, or have come again lately.
    """

    def __init__(self, count: int, period: float) -> None:
        """Begin without gaps; period is the time between two looks, s."""
        self._period = period
        self._taken = np.full(count, -np.inf)  # stamps of the poses that were seen last, s
        self._missing = np.zeros(count)  # s, for how long there has been no new pose
        self._returning = np.zeros(count)  # s, until the velocity is known well
        self.any = False

    def resume(self, index: int) -> None:
        """Take note that drone index is steered again, after it was without poses."""
        self._returning[index], self.any = _RETURNS, True

    def passed(self) -> np.ndarray:
        """Tell whose velocity is known well, (N,)."""
        return self._returning <= 0.0

    def look(self, newest: FloatArray | None) -> np.ndarray:
        """Tell who has a new pose, (N,); newest are stamps (N,), s, None if all poses are new."""
        new = np.ones(self._taken.size, dtype=bool) if newest is None else newest != self._taken
        if newest is not None:
            self._taken = newest.copy()
        if self.any or not all_of(new):
            self._missing = np.where(new, 0.0, self._missing + self._period)
            self._returning = np.maximum(self._returning - self._period, _RETURNS * (self._missing >= _MISSED))
            self.any = bool(np.count_nonzero(self._missing + self._returning))
        return new
