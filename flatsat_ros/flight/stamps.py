"""From stamps of the ROS clock to steady time, on which the ticks stand: whoever sets a clock moves no drone.

The ROS clock is the system's, or /clock with `use_sim_time`. Both can be set, by any amount and in flight. Steady time
is counted from the start of the node and never set. Their offset is followed while it drifts, and learnt anew when it
jumps.
"""

from __future__ import annotations

from collections.abc import Callable

from flatsat_ros.base.constants import NANOSECONDS

# a larger change of the offset between two looks is a clock that was set, ns; more than /clock at 20 Hz moves by itself
_JUMP = 50_000_000
# of a smaller change, this share is followed at each look
_DRIFT_SHARE = 0.02
# of the age of a pose, this share enters the age that is expected of the next one
_AGE_SHARE = 0.1
# the largest age that is expected, ns: what is older says nothing about the clock
_AGE_MAX = 500_000_000


class StampClock:
    """Steady time, and the stamps of N sources on it.

    A source that stamps on this machine's clock jumps along with it, one on another machine's does not. Which it is
    shows in the poses after a jump: a stamp is read on the clock that gives it the age which the poses before had.

    Attributes:
        now: the last look at steady time, s since the start.
    """

    def __init__(self, count: int, ros: Callable[[], int], steady: Callable[[], int]) -> None:
        """Start steady time at 0.

        Args:
            count: N.
            ros: the ROS clock, ns; 0 while it has no time yet.
            steady: a clock that nobody sets, ns.
        """
        self._ros, self._steady = ros, steady
        self._origin = self._now = steady()
        reading = ros()
        self._has_time = reading != 0
        self._offset = reading - self._origin  # ROS clock minus steady time, ns
        self._lag = [0] * count  # by how much the offset of a source is less than that: it did not jump along, ns
        self._age = [0.0] * count  # expected of each source's poses, ns
        self.now = 0.0

    def look(self) -> float:
        """Read both clocks; return by how much the ROS clock was set since the last look, s, 0.0 if it was not."""
        self._now, reading = self._steady(), self._ros()
        self.now = (self._now - self._origin) / NANOSECONDS
        if reading == 0:
            return 0.0
        change = reading - self._now - self._offset
        if not self._has_time:
            self._offset, self._has_time = self._offset + change, True
            return 0.0
        if abs(change) <= _JUMP:
            self._offset += round(_DRIFT_SHARE * change)
            return 0.0
        self._offset += change
        self._lag = [lag + change for lag in self._lag]
        return change / NANOSECONDS

    def measured(self, source: int, stamp: int) -> float:
        """Return when a source measured what it stamped so, ns: s since the start."""
        time, lag = stamp - self._offset, self._lag[source]
        if lag:
            expected = self._now - self._age[source]
            if abs(lag) > _JUMP and abs(time + lag - expected) < abs(time - expected):
                time += lag
            else:
                self._lag[source] = 0
        age = self._now - time
        if 0 <= age <= _AGE_MAX:
            self._age[source] += _AGE_SHARE * (age - self._age[source])
        return (time - self._origin) / NANOSECONDS

    def origin(self) -> int:
        """Return what the ROS clock showed at the start of steady time, as it goes now, ns."""
        return self._origin + self._offset
