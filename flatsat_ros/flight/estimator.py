"""From stamped positions to the state at the tick, for N drones at once.

Per axis a Kalman filter of the double integrator with a constant disturbance, state (p, pdot, d):

    pdot' = a(t) + d + white noise,  d' = white noise,  measured: p + noise

where a(t) is the known commanded acceleration. The three axes of a drone share one covariance. A measurement is taken
in when it arrives, in plain floats: for one drone that is twenty times faster than arrays of length three. What real
motion capture does wrong is either survived or counted as rejected.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from operator import attrgetter
from struct import Struct

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.flight.plausibility import PoseRefusal, PoseScreen, yaw_and_tilt

# standard deviation of a measured position, m
_POSITION_NOISE = 1e-3
# spectral density of the unknown acceleration, (m/s^2)^2/Hz, and of the disturbance's drift, (m/s^3)^2/Hz
_ACCELERATION_NOISE = 0.04
_DISTURBANCE_NOISE = 0.25
# standard deviations after a restart: velocity m/s, disturbance m/s^2
_START_VELOCITY = 1.0
_START_DISTURBANCE = 1.0
# the velocity is usable once its standard deviation is below this, m/s
_SETTLED_VELOCITY = 0.25
# an innovation beyond this many standard deviations plus this distance (m) is a jump, not noise
_GATE_DEVIATIONS = 6.0
_GATE_DISTANCE = 0.05
# a jump that ends so near, m, to where another drone was seen within this time, s, is that drone
_EXCHANGED_DISTANCE = 0.25
_EXCHANGED_TIME = 30.0
# so many jumps in a row mean that the drone really is elsewhere
_JUMPS_TO_RESTART = 5
# A jump farther than this, m, beyond the gate is no motion: in the air such poses are not taken in, until within the
# second time, s, one is again as near to the prediction as the second distance, m.
_FAR = 0.5
_NEAR_AGAIN, _AGAIN_TIME = 0.25, 1.0
# silence (s) after which the old velocity says nothing any more: no estimate predicts further
PREDICTION_MAX = 0.5

_PACK, _PACKED = Struct("9d").pack, attrgetter("packed")


class Estimator:
    """The estimates of N drones.

    Times are seconds on one clock, that of the measurement stamps.

    Attributes:
        yaw: (N,) psi, rad, from the last valid orientation; 0 before the first.
        tilt: (N,) angle of the body's z axis to the vertical, rad, likewise; NaN before the first.
        newest: (N,) stamp of the newest accepted measurement, -inf before the first.
        measured: (N, 3) the position measured then, m.
        oriented: (N,) stamp of the newest valid orientation, -inf before the first.
        rejected: (N,) number of measurements refused so far.
    """

    def __init__(self, count: int) -> None:
        self._filters = [_Filter() for _ in range(count)]
        nothing = np.zeros((count, 3))
        self._nothing = -math.inf, nothing, nothing.ravel().tolist()
        # since when, s, and what is commanded, m/s^2, as array and as list of 3 N floats
        self._commands = deque([self._nothing])
        self._screen = PoseScreen(count)
        self._airborne = self._aloft = [False] * count
        self._settled = np.zeros(count, dtype=bool)
        self.yaw = np.zeros(count)
        self.tilt = np.full(count, np.nan)
        self.newest = np.full(count, -np.inf)
        self.measured = np.zeros((count, 3))
        self.oriented = np.full(count, -np.inf)
        self.rejected = np.zeros(count, dtype=int)

    def measure(
        self, index: int, stamp: float, position: Sequence[float], quaternion: Sequence[float], now: float
    ) -> bool:
        """Take in one measurement of drone index.

        Args:
            index: which drone.
            stamp: when it was measured, s.
            position: (3,) m, world frame.
            quaternion: (4,) x, y, z, w, body -> world. One that is NaN, not of unit length or, in the air, turned at
                once leaves the yaw as it is.
            now: the present, when it is taken in, s.

        Returns:
            Whether it was accepted. Refused, and counted: what cannot be true (`flight.plausibility`), a stamp that is
            not newer than the newest one (a duplicate, or late), and a jump until it has lasted for several
            measurements.
        """
        newest = float(self.newest[index])
        self._screen.note_age(index, stamp, now)
        airborne, mean = self._airborne[index], self._filters[index].mean
        commanded = self._commands[-1][2][3 * index : 3 * index + 3] if airborne else self._lifting(index)
        refused = self._screen.refuse(
            index, stamp, position, quaternion, now, newest, commanded, mean, airborne, self._aloft[index]
        )
        fault, values = refused or (self._filter(index, newest, stamp, position, now), ())
        if fault is not None:
            self._screen.complain(index, fault, now, *(values or (math.dist(position, mean[:3]),)))
            self.rejected[index] += 1
            if fault is PoseRefusal.REPEATED and not self._aloft[index]:
                self._settled[index] = False  # nobody takes off blindly
            return False
        self.newest[index], self.measured[index] = stamp, position
        self._settled[index] = self._filters[index].c11 <= _SETTLED_VELOCITY**2
        attitude = yaw_and_tilt(quaternion)
        if attitude is None:
            self._screen.note_orientation(index, now)
            return True
        turn = math.remainder(attitude[0] - float(self.yaw[index]), 2.0 * math.pi)
        if self._aloft[index] and self.tilt[index] >= 0.0 and self._screen.spins(turn, stamp - self.oriented[index]):
            self._screen.note_turn(index, turn, now)
            return True
        self.yaw[index], self.tilt[index] = attitude
        self.oriented[index] = stamp
        return True

    def complaints(self) -> list[tuple[int, str]]:
        """Return what is to be told about poses, drone and text, once per event."""
        return self._screen.complaints()

    def is_old(self, index: int) -> bool:
        """Tell whether drone index is shown in a place where it has been seen before, again and again."""
        return self._screen.is_old(index)

    def restart(self) -> None:
        """Forget all measurements and commands, as after a step of the clock."""
        self.newest[:] = self.oriented[:] = -np.inf
        self._commands = deque([self._nothing])

    def command(
        self,
        t: float,
        acceleration: FloatArray,
        airborne: np.ndarray | None = None,
        aloft: np.ndarray | None = None,
    ) -> None:
        """Note what is commanded from now on.

        Args:
            t: s, never decreasing.
            acceleration: (N, 3) m/s^2.
            airborne: (N,) who is steered in the air, where nothing keeps it from moving; nobody by default.
            aloft: (N,) who may be in the air, steered or not; as before by default, nobody at first.
        """
        if airborne is not None:
            self._airborne = airborne.tolist()
        if aloft is not None:
            self._aloft = aloft.tolist()
        self._commands.append((t, acceleration, acceleration.ravel().tolist()))
        while len(self._commands) > 1 and self._commands[1][0] < t - PREDICTION_MAX:
            self._commands.popleft()

    def estimate(self, now: float) -> FloatArray:
        """Return the state of all drones at now, (N, 9); zeros before the first measurement.

        Returns:
            Position (m), velocity (m/s) and disturbance (m/s^2): what accelerates the drones beside the commands.
        """
        state = np.frombuffer(b"".join(map(_PACKED, self._filters))).reshape(-1, 3, 3)
        position, velocity, disturbance = state.transpose(1, 0, 2).copy()
        measured = np.minimum(np.maximum(self.newest, now - PREDICTION_MAX), now)
        elapsed = _of_axes(now - measured)
        gain = elapsed * (disturbance + self._commands[-1][1])  # of velocity
        position += elapsed * (velocity + 0.5 * gain)
        velocity += gain
        # what earlier commands did otherwise, from the measurements to their ends
        for (end, after, _), (_, before, _) in pairwise(reversed(self._commands)):
            if not any_of(measured < end):
                break
            span = _of_axes(np.maximum(end - measured, 0.0))
            change = (before - after) * span
            velocity += change
            position += change * (now - end + span / 2.0)
        return np.concatenate([position, velocity, disturbance], axis=1)

    def usable(self, now: float, timeout: float) -> np.ndarray:
        """Tell whose estimate can be flown on, (N,): fresh within timeout (s) and with a settled velocity.

        A timeout is at most PREDICTION_MAX.
        """
        return np.asarray((now - self.newest <= timeout) & self._settled)

    def _lifting(self, index: int) -> Sequence[float]:
        """Return what is commanded of a drone that is not steered in the air, (3,) m/s^2: to lift off, if anything."""
        upward = 0.0 if self._aloft[index] else self._commands[-1][2][3 * index + 2]
        return 0.0, 0.0, max(upward, 0.0)

    def _filter(
        self, index: int, newest: float, stamp: float, position: Sequence[float], now: float
    ) -> PoseRefusal | None:
        """Predict drone index to stamp and correct by position; return why it was not taken."""
        state, silence = self._filters[index], stamp - newest
        state.doubted &= self._aloft[index]
        if state.doubted and not (silence < _AGAIN_TIME and state.away(position, silence) < _NEAR_AGAIN):
            return PoseRefusal.EXCHANGED if self._is_another(index, stamp, position) else PoseRefusal.FAR
        if silence > PREDICTION_MAX:
            if newest > -math.inf and self._is_another(index, stamp, position):
                state.doubted = self._aloft[index]
                return PoseRefusal.EXCHANGED
            state.restart(position)
            return None
        push = [0.0, 0.0, 0.0]
        shift = [0.0, 0.0, 0.0]
        end = stamp
        for begin, _, accelerations in reversed(self._commands):
            span = end - max(begin, newest)
            if span > 0.0:
                lever = span * (stamp - end + span / 2.0)
                for axis, a in enumerate(accelerations[3 * index : 3 * index + 3]):
                    push[axis] += a * span
                    shift[axis] += a * lever
                end -= span
            if begin <= newest:
                break
        jump = state.advance(silence, position, push, shift)
        if jump == 0.0:
            return None
        exchanged = self._is_another(index, stamp, position)
        if exchanged or (jump > _FAR and self._aloft[index]):
            state.jumps = 0  # it is no jump that may last: the drone is not where these poses say
            state.doubted = self._aloft[index]
            return PoseRefusal.EXCHANGED if exchanged else PoseRefusal.FAR
        if state.jumps == _JUMPS_TO_RESTART:
            self._screen.note_move(index, jump, now)
            state.restart(position)
            return None
        return PoseRefusal.JUMP

    def _is_another(self, index: int, stamp: float, position: Sequence[float]) -> bool:
        """Tell whether a position is where another drone was seen lately, and not this one."""
        lately = [i for i, newest in enumerate(self.newest) if i != index and stamp - newest < _EXCHANGED_TIME]
        return not self._filters[index].fits(position) and any(self._filters[i].fits(position) for i in lately)


def _of_axes(values: FloatArray) -> FloatArray:
    """Return values (N,) three times, (N, 3): with few of them numpy computes faster so than with a column."""
    return values.repeat(3).reshape(-1, 3)


class _Filter:
    """The Kalman filter of one drone.

    Attributes:
        mean: position, velocity, disturbance: nine floats, m, m/s, m/s^2; and `packed`, as bytes.
        c00, c01, c02, c11, c12, c22: covariance of (p, pdot, d), the same for each axis.
        jumps: number of jumps since the last position that was none.
        doubted: its poses have jumped as no motion does, and have not come back since.
    """

    __slots__ = ("c00", "c01", "c02", "c11", "c12", "c22", "doubted", "jumps", "mean", "packed")

    def __init__(self) -> None:
        self.restart((0.0, 0.0, 0.0))

    def restart(self, position: Sequence[float]) -> None:
        """Begin anew at a measured position, at rest but not sure of it."""
        self.mean = *position, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        self.packed = _PACK(*self.mean)
        self.c00, self.c11, self.c22 = _POSITION_NOISE**2, _START_VELOCITY**2, _START_DISTURBANCE**2
        self.c01 = self.c02 = self.c12 = 0.0
        self.jumps, self.doubted = 0, False

    def away(self, position: Sequence[float], t: float) -> float:
        """Return how far a position is, m, from where this drone would be t seconds later with its velocity."""
        return math.dist(position, [p + t * v for p, v in zip(self.mean[:3], self.mean[3:6], strict=True)])

    def fits(self, position: Sequence[float]) -> bool:
        """Tell whether a position is near to where this drone was seen last, or below."""
        x, y, z = self.mean[:3]
        return math.hypot(position[0] - x, position[1] - y) <= _EXCHANGED_DISTANCE >= position[2] - z

    def advance(self, t: float, position: Sequence[float], push: list[float], shift: list[float]) -> float:
        """Predict over t seconds, in which commands add push (m/s) and shift (m), then correct by the position.

        Returns:
            0; for a jump, which is counted but not taken in, how far it goes beyond what noise and motion explain, m.
        """
        q, r = _ACCELERATION_NOISE, _DISTURBANCE_NOISE
        t2 = t * t
        half, t3 = t2 / 2.0, t2 * t
        # F C F' + Q with F = [[1, t, t^2/2], [0, 1, t], [0, 0, 1]]
        a02 = self.c02 + t * self.c12 + half * self.c22
        a12 = self.c12 + t * self.c22
        a01 = self.c01 + t * self.c11 + half * self.c12
        a11 = self.c11 + t * self.c12
        a00 = self.c00 + t * self.c01 + half * self.c02
        c00 = a00 + t * a01 + half * a02 + q * t3 / 3.0 + r * t2 * t3 / 20.0
        c01 = a01 + t * a02 + q * half + r * t2 * t2 / 8.0
        c02 = a02 + r * t3 / 6.0
        c11 = a11 + t * a12 + q * t + r * t3 / 3.0
        c12 = a12 + r * half
        c22 = self.c22 + r * t

        variance = c00 + _POSITION_NOISE**2
        x, y, z, vx, vy, vz, dx, dy, dz = self.mean
        x = x + t * vx + half * dx + shift[0]
        y = y + t * vy + half * dy + shift[1]
        z = z + t * vz + half * dz + shift[2]
        ix, iy, iz = position[0] - x, position[1] - y, position[2] - z
        jump = math.hypot(ix, iy, iz) - _GATE_DEVIATIONS * math.sqrt(variance) - _GATE_DISTANCE
        if jump > 0.0:
            self.jumps += 1
            return jump
        w0, w1, w2 = c00 / variance, c01 / variance, c02 / variance
        self.mean = (
            x + w0 * ix, y + w0 * iy, z + w0 * iz,
            vx + t * dx + push[0] + w1 * ix, vy + t * dy + push[1] + w1 * iy, vz + t * dz + push[2] + w1 * iz,
            dx + w2 * ix, dy + w2 * iy, dz + w2 * iz,
        )  # fmt: skip
        self.packed = _PACK(*self.mean)
        self.c00, self.c01, self.c02 = c00 - w0 * c00, c01 - w0 * c01, c02 - w0 * c02
        self.c11, self.c12, self.c22 = c11 - w1 * c01, c12 - w1 * c02, c22 - w2 * c02
        self.jumps, self.doubted = 0, False
        return 0.0
