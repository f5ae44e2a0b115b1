"""Which poses can be true: what motion capture, a clock or a frame does wrong, told apart from motion.

The thresholds of what is judged pose by pose stand here; those of how long poses may stand still in `flight.stillness`,
and those of what is judged by the motion at the head of detectors (`command_check`, `exchange`, `unmoved`, `falls`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from flatsat_ros.base.constants import FARTHEST_PLACE
from flatsat_ros.flight.stillness import REPEATED, Stillness

# a stamp may be ahead of the arrival by this much, s: clocks of two machines differ a little
_AHEAD = 0.1
# stamps this far behind the arrival, s, are of another clock, or come too late to be flown on; those with the second
# age, s, are told of if they last for the third, s: more delay than any certificate here allows for
_BEHIND = 0.5
_LATE, _LATE_FOR = 0.15, 0.5
# a drone that moves faster than this, m/s, is never twice in the same place
_MOVES = 0.05
# One may stand where its poses are rounded coarsely, or have repeated for the first time, s, before its flight, unless
# they were noisy before: nobody flies blindly for so long. Others that repeat since before it, or since it was in the
# air, for the second time, s, are old ones if poses were fine before, or commands should have moved the drone so fast,
# m/s. Of a drone that is about to take off those that were noisy are old ones sooner, after the first time of
# `REPEATED`: it loses nothing if it waits.
_STOOD = 1.0
_BLIND = 0.5, 1e-3
# an orientation in the air that has turned about the vertical by this, rad, and this rate, rad/s, and in any time by
# the third angle, rad, is not of this body any more: markers are taken for one another
_TURN, _TURN_RATE, _TURN_MOST = 0.5, 2.0, 1.0
# a refusal of the same kind within this time, s, is the same event
_SAME_EVENT = 1.0
# a quaternion's norm may differ from 1 by this much
_QUATERNION_TOLERANCE = 0.1


class PoseRefusal(Enum):
    """Why a pose is refused; the value is what a person is told, None for what happens all the time."""

    OLD = None  # a duplicate, or out of order
    NOT_FINITE = "poses that are not finite or beyond 10 km"
    AHEAD = "pose stamps {0:.2f} s ahead of the clock: set the clocks alike"
    LOST = "poses of all zeros: motion capture has lost the drone"
    REPEATED = "the same pose again and again: motion capture has lost the drone"
    STILL = "poses whose {0} has stood still for {1:.2f} s, at most {2:g} s while others live: motion capture lost it"
    EXCHANGED = "poses that fit another drone: the two may be exchanged"
    JUMP = "poses that jump by {0:.2f} m"
    FAR = "poses that jump by {0:.2f} m in flight, more than any motion: not flown to"


class PoseScreen:
    """Looks at the poses of N drones before they are taken in."""

    def __init__(self, count: int) -> None:
        self._last: list[tuple[float, ...]] = [()] * count  # position of the newest pose
        self._since = np.full(count, np.inf)  # s, stamp from which on it repeats
        self._stands = np.ones(count, dtype=bool)  # the drone may stand there
        self._old = np.zeros(count, dtype=bool)  # it is an old one until another one comes
        self._stillness = Stillness(count)
        self._late_since = [math.inf] * count  # s, since when all poses have come late
        self._told: dict[tuple[int, str], float] = {}  # s, when an event was seen last
        self._complaints: list[tuple[int, str]] = []

    def refuse(
        self,
        index: int,
        stamp: float,
        position: Sequence[float],
        quaternion: Sequence[float],
        now: float,
        newest: float,
        acceleration: Sequence[float],
        estimate: Sequence[float],
        airborne: bool,
        aloft: bool,
    ) -> tuple[PoseRefusal, tuple[float | str, ...]] | None:
        """Return why a pose of drone index cannot be true, with what its text needs; None if it can.

        Args:
            index: which drone.
            stamp: s.
            position: (3,) m.
            quaternion: (4,) x, y, z, w.
            now: time of its arrival, s.
            newest: stamp of the newest pose taken in, s.
            acceleration: (3,) commanded where nothing keeps the drone from moving, m/s^2.
            estimate: (9,) of its position, velocity and disturbance, m, m/s, m/s^2.
            airborne: it is steered in the air.
            aloft: it may be in the air, steered or not.
        """
        x, y, z = position
        if not abs(x) + abs(y) + abs(z) <= FARTHEST_PLACE or not math.isfinite(stamp):
            return PoseRefusal.NOT_FINITE, ()
        if stamp > now + _AHEAD:
            return PoseRefusal.AHEAD, (stamp - now,)
        if stamp <= newest:
            return PoseRefusal.OLD, ()
        if not any(position) and not any(quaternion):
            return PoseRefusal.LOST, ()
        place = (x, y, z)
        still = self._stillness.look(index, stamp, place, acceleration, estimate, airborne)
        if still is not None and still.limit:
            return PoseRefusal.STILL, ("xyz"[still.axis], still.lasted, still.limit)
        if place != self._last[index]:
            self._last[index], self._since[index], self._old[index] = place, stamp, False
            if airborne or not aloft:
                self._stands[index] = airborne or self._stillness.is_coarse(index)
            return None if still is None else (PoseRefusal.OLD, ())
        lasted, commanded = stamp - self._since[index], math.hypot(*acceleration)
        if not airborne:
            return self._repeated(index, lasted, commanded, math.hypot(*estimate[3:6]), aloft)
        if self._stillness.is_fine(index):
            moves = math.hypot(*estimate[3:6]) > _MOVES
            self._old[index] |= any(lasted >= time and commanded >= least for time, least in REPEATED)
        else:
            moves = self._stillness.has_moved(index, stamp)
            self._old[index] |= moves and lasted >= REPEATED[0][0]
        self._stands[index] &= not moves
        if self._old[index]:
            return PoseRefusal.REPEATED, ()
        return (PoseRefusal.OLD, ()) if moves else None

    def _repeated(
        self, index: int, lasted: float, commanded: float, speed: float, aloft: bool
    ) -> tuple[PoseRefusal, tuple[float | str, ...]] | None:
        """Return `refuse` for a pose of a drone that is not steered in the air, which has repeated for some time, s.

        Args:
            index: which drone.
            lasted: s.
            commanded: size of the acceleration, see `refuse`, m/s^2.
            speed: estimated, m/s.
            aloft: see `refuse`.
        """
        fine = self._stillness.is_fine(index)
        if aloft:
            moved = lasted >= _BLIND[0] and (speed > _BLIND[1] or fine)
            self._old[index] |= moved and not self._stands[index]
        elif commanded and fine:  # its flight has begun
            self._old[index] |= lasted >= REPEATED[0][0] and self._stillness.is_noisy(index)
        else:
            stood = lasted >= _STOOD and not self._stillness.is_noisy(index)
            self._stands[index] = stood or self._stillness.is_coarse(index)
        if self._old[index]:
            return PoseRefusal.REPEATED, ()
        return (PoseRefusal.OLD, ()) if aloft and not self._stands[index] and speed > _MOVES else None

    def is_old(self, index: int) -> bool:
        """Tell whether the newest pose of drone index was refused because it repeats."""
        return bool(self._old[index])

    def complain(self, index: int, fault: PoseRefusal, now: float, *values: float | str) -> None:
        """Remember to tell about a refused pose, with the values of its text, once per event."""
        if fault.value is not None:
            self._tell(index, fault.name, fault.value.format(*values), now)

    def note_age(self, index: int, stamp: float, now: float) -> None:
        """Remember to tell about a pose whose stamp is far behind its arrival, or about many that are behind."""
        age = now - stamp
        if age > _BEHIND:
            shown = f"{age:.2f}" if age < 1e5 else f"{age:.3g}"
            self._tell(index, "BEHIND", f"pose stamps {shown} s behind the clock: set the clocks alike", now)
        self._late_since[index] = min(self._late_since[index], now) if age > _LATE else math.inf
        if now - self._late_since[index] >= _LATE_FOR and age <= _BEHIND:
            self._tell(index, "LATE", f"poses {age:.2f} s old when they arrive: they come late, or clocks differ", now)

    def note_move(self, index: int, distance: float, now: float) -> None:
        """Remember to tell that poses have jumped by a distance, m, for good, and are taken as they are."""
        self._tell(index, "MOVED", f"poses have jumped by {distance:.2f} m and stay there: they are followed", now)

    def note_orientation(self, index: int, now: float) -> None:
        """Remember to tell about an orientation that is NaN or not of unit length."""
        self._tell(index, "ORIENTATION", "poses without a valid orientation: its yaw is not seen", now)

    @staticmethod
    def spins(turn: float, elapsed: float) -> bool:
        """Tell whether an orientation has turned about the vertical as no drone does, rad within s."""
        return abs(turn) > min(_TURN + _TURN_RATE * elapsed, _TURN_MOST)

    def note_turn(self, index: int, turn: float, now: float) -> None:
        """Remember to tell about an orientation that has turned by an angle, rad, at once."""
        text = f"poses that turn by {math.degrees(turn):.0f} deg at once in flight: its yaw is kept as it was"
        self._tell(index, "TURN", text, now)

    def _tell(self, index: int, kind: str, text: str, now: float) -> None:
        if not 0.0 <= now - self._told.get((index, kind), -math.inf) < _SAME_EVENT:
            self._complaints.append((index, text))
        self._told[index, kind] = now

    def complaints(self) -> list[tuple[int, str]]:
        """Return what is to be told, drone and text, once."""
        complaints, self._complaints = self._complaints, []
        return complaints


def yaw_and_tilt(quaternion: Sequence[float]) -> tuple[float, float] | None:
    """Return psi, rad, and the angle between the body's z axis and the vertical, rad, of an orientation.

    Args:
        quaternion: (4,) x, y, z, w, body -> world.

    Returns:
        None for one that is NaN or not of unit length.
    """
    qx, qy, qz, qw = quaternion
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw) if max(map(abs, quaternion)) < 2.0 else math.inf
    if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
        return None
    square = norm * norm
    yaw = math.atan2(2.0 * (qw * qz + qx * qy), square - 2.0 * (qy * qy + qz * qz))
    return yaw, math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (qx * qx + qy * qy) / square)))
