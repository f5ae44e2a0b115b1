"""When the detectors look, and what drones were commanded from one look to the next."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# the detectors look so often, s: they judge by what lasts for tenths of a second
_LOOK = 0.05


class Looks:
    """The ticks at which the detectors look, and the commands of N drones.

    Attributes:
        period: from look to look, s.
        acceleration: (N, 3) commanded at the last tick, m/s^2.
        above: (N,) height above the reference then, m.
        looked: whether the detectors look at that tick, and before the next one.
    """

    def __init__(self, tick: float, count: int) -> None:
        """Begin with a look; tick is the time from tick to tick, s."""
        self._tick, self._every = tick, max(1, round(_LOOK / tick))  # s, and ticks from look to look
        self.period = self._every * tick
        self._ticks, self.looked = 0, True
        self.acceleration, self.above = np.zeros((count, 3)), np.zeros(count)
        self._push = np.zeros((count, 3))  # commanded change of velocity since the last look, m/s

    def note(self, acceleration: FloatArray, above: FloatArray) -> bool:
        """Note what is commanded at a tick, see the attributes; tell whether the detectors look at it."""
        self.acceleration, self.above = acceleration, above
        self._push += self._tick * acceleration
        self._ticks += 1
        self.looked = self._ticks % self._every == 0
        return self.looked

    def take_push(self) -> FloatArray:
        """Return by how much velocities should have changed since the last look, (N, 3) m/s, and begin anew."""
        push, self._push = self._push, np.zeros(self._push.shape)
        return push
