"""The way down that is left when the control step fails: level, with a little less thrust than was sent before.

It shares no code with the control step and knows nothing of poses: what it goes by are the set-points that were sent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from flatsat_ros.crazyflie.wire import WireSetpoint

# the thrust that was sent is averaged over about this time, s: in flight that is what carries the drone
_MEMORY = 2.0
# a drone that was sent nothing for this long is flown by somebody else, s; the firmware gives a set-point up then
_SILENCE = 0.5
# The descent: share of that thrust, its fall per s, and its duration, s. The air brakes a drone that sinks; one that
# still rises, because what was sent made it climb, comes down all the same, later.
_SHARE, _FALL, _DESCENT = 0.93, 0.01, 12.0
# then zero thrust for this long, s: silence in its place would lock the drone, see flight.modes
_REST = 2.5


class LastResort:
    """Set-points of N drones for when there are no others.

    Attributes:
        since: when each drone's last resort began, s, None where it has not.
    """

    def __init__(self, hover: Sequence[float], *, keeps_yaw: bool, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with nothing sent.

        Args:
            hover: (N,) thrust that carries each drone according to its profile, PWM: where the average begins.
            keeps_yaw: the yaw on the wire is an angle, to be kept; else it is a rate, and becomes zero.
            clock: shows s and is never set.
        """
        count = len(hover)
        self.since: list[float | None] = [None] * count
        self._hover = list(hover)
        self._keeps_yaw, self._clock = keeps_yaw, clock
        self._thrust = [0.0] * count  # averaged, PWM
        self._yaw = [0.0] * count
        self._sent = [-math.inf] * count  # when, s

    def note(self, index: int, setpoint: WireSetpoint) -> None:
        """Remember what is sent to a drone."""
        now = self._clock()
        elapsed, self._sent[index] = now - self._sent[index], now
        if setpoint.thrust == 0.0:
            self._thrust[index] = 0.0
        elif self._thrust[index] == 0.0 or elapsed >= _SILENCE:
            self._thrust[index] = self._hover[index]
        else:
            self._thrust[index] += min(elapsed / _MEMORY, 1.0) * (setpoint.thrust - self._thrust[index])
        self._yaw[index] = setpoint.yaw if self._keeps_yaw else 0.0

    def begin(self, index: int) -> None:
        """Let a drone descend from now on; there is no way back."""
        if self.since[index] is None:
            self.since[index] = self._clock()

    def setpoint(self, index: int) -> WireSetpoint | None:
        """Return what a drone is told now: level and sinking if it flew, then zero thrust, then nothing.

        Nothing from the first as well for a drone that was sent nothing when its last resort began.
        """
        since = self.since[index]
        if since is None or since - self._sent[index] >= _SILENCE:
            return None
        elapsed, descent = self._clock() - since, _DESCENT if self._thrust[index] > 0.0 else 0.0
        if elapsed >= descent + _REST:
            return None
        thrust = (_SHARE - _FALL * elapsed) * self._thrust[index] if elapsed < descent else 0.0
        return WireSetpoint(roll=0.0, pitch=0.0, yaw=self._yaw[index], thrust=thrust)
