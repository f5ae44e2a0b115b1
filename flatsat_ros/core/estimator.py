"""From stamped positions to the state at the tick, for N drones at once.

Per axis a Kalman filter of the double integrator with a constant disturbance, state (p, pdot, d):

    pdot' = a(t) + d + white noise,  d' = white noise,  measured: p + noise

where a(t) is the known commanded acceleration. The three axes of a drone share one covariance. Measurements are taken
in the order of their stamps; what real motion capture does wrong is either survived or counted as rejected.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from flatsat_ros.core.flatness import FloatArray

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
# so many jumps in a row mean that the drone really is elsewhere
_JUMPS_TO_RESTART = 5
# silence (s) after which the old velocity says nothing any more
_SILENCE_TO_RESTART = 0.5
# a quaternion's norm may differ from 1 by this much
_QUATERNION_TOLERANCE = 0.1
# stamps may be ahead of the arrival by this much, s: clocks of two machines differ a little
_CLOCK_TOLERANCE = 0.1
# sum of coordinates, m, beyond which a position is a fault
_FARTHEST = 1e4
# measurements kept between two ticks
_BACKLOG = 1024


class Estimator:
    """The estimates of N drones.

    Times are seconds on one clock, that of the measurement stamps.

    Attributes:
        yaw: (N,) psi, rad, from the last valid orientation; 0 before the first.
        newest: (N,) stamp of the newest accepted measurement, -inf before the first.
        rejected: (N,) number of measurements refused so far.
    """

    def __init__(self, count: int) -> None:
        self._mean = np.zeros((count, 3, 3))
        self._covariance = np.zeros((count, 3, 3))
        self._backlog: list[deque[tuple[float, float, float, float]]] = [deque(maxlen=_BACKLOG) for _ in range(count)]
        self._jumps = np.zeros(count, dtype=int)
        self._command_times: deque[float] = deque()
        self._commands: deque[FloatArray] = deque()
        self.yaw = np.zeros(count)
        self.newest = np.full(count, -np.inf)
        self.rejected = np.zeros(count, dtype=int)

    def measure(
        self, index: int, stamp: float, position: Sequence[float], quaternion: Sequence[float], now: float
    ) -> bool:
        """Store one measurement of drone index; it enters the estimate at the next tick.

        Args:
            index: which drone.
            stamp: when it was measured, s.
            position: (3,) m, world frame.
            quaternion: (4,) x, y, z, w, body -> world. An invalid one (NaN, not of unit length) leaves the yaw as it is.
            now: when it arrived, s.

        Returns:
            Whether it was kept. Refused, and counted: a position or stamp that is not finite or beyond 10 km, a stamp
            that is not newer than the newest one (a duplicate, or late), a stamp that lies in the future.
        """
        x, y, z = position
        backlog = self._backlog[index]
        latest = backlog[-1][0] if backlog else self.newest[index]
        plausible = abs(x) + abs(y) + abs(z) <= _FARTHEST and latest < stamp <= now + _CLOCK_TOLERANCE
        if not plausible:
            self.rejected[index] += 1
            return False
        backlog.append((stamp, x, y, z))
        qx, qy, qz, qw = quaternion
        norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        if abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
            self.yaw[index] = math.atan2(2.0 * (qw * qz + qx * qy), norm * norm - 2.0 * (qy * qy + qz * qz))
        return True

    def restart(self) -> None:
        """Forget all measurements and commands, as after a step of the clock."""
        self.newest[:] = -np.inf
        for queue in (*self._backlog, self._command_times, self._commands):
            queue.clear()

    def command(self, t: float, acceleration: FloatArray) -> None:
        """Note the acceleration (N, 3), m/s^2, that is commanded from time t (s, never decreasing) on."""
        self._command_times.append(t)
        self._commands.append(acceleration)
        while len(self._command_times) > 1 and self._command_times[1] < t - _SILENCE_TO_RESTART:
            self._command_times.popleft()
            self._commands.popleft()

    def estimate(self, now: float) -> FloatArray:
        """Take in the stored measurements and return position and velocity of all drones at now, (N, 6), m and m/s."""
        while pending := [i for i, backlog in enumerate(self._backlog) if backlog]:
            samples = np.array([self._backlog[i].popleft() for i in pending])
            self._update(np.array(pending), samples[:, 0], samples[:, 1:])
        known = np.isfinite(self.newest)
        elapsed = np.where(known, np.clip(now - self.newest, 0.0, _SILENCE_TO_RESTART), 0.0)
        mean = _transition(elapsed) @ self._mean
        self._add_commands(mean, np.arange(len(elapsed)), np.where(known, self.newest, now), elapsed)
        return np.concatenate([mean[:, 0], mean[:, 1]], axis=1)

    def usable(self, now: float, timeout: float) -> np.ndarray:
        """Tell whose estimate can be flown on, (N,): fresh within timeout (s) and with a settled velocity."""
        fresh = now - self.newest <= timeout
        return np.asarray(fresh & (self._covariance[:, 1, 1] <= _SETTLED_VELOCITY**2))

    def _update(self, index: np.ndarray, stamp: FloatArray, position: FloatArray) -> None:
        elapsed = stamp - self.newest[index]
        restart = elapsed > _SILENCE_TO_RESTART
        elapsed = np.where(restart, 0.0, elapsed)
        transition = _transition(elapsed)
        mean = transition @ self._mean[index]
        self._add_commands(mean, index, stamp - elapsed, elapsed)
        covariance = transition @ self._covariance[index] @ transition.transpose(0, 2, 1) + _process_noise(elapsed)

        innovation = position - mean[:, 0]
        variance = covariance[:, 0, 0] + _POSITION_NOISE**2
        gate = _GATE_DEVIATIONS * np.sqrt(variance) + _GATE_DISTANCE
        jump = ~restart & (np.sqrt((innovation * innovation).sum(axis=1)) > gate)
        self._jumps[index] = np.where(jump, self._jumps[index] + 1, 0)
        self.rejected[index] += jump
        restart |= self._jumps[index] >= _JUMPS_TO_RESTART
        keep = restart | ~jump

        weight = covariance[:, :, 0] / variance[:, np.newaxis]
        mean = mean + weight[:, :, np.newaxis] * innovation[:, np.newaxis, :]
        covariance = covariance - weight[:, :, np.newaxis] * covariance[:, np.newaxis, 0, :]
        if restart.any():
            mean[restart] = 0.0
            mean[restart, 0] = position[restart]
            covariance[restart] = np.diag([_POSITION_NOISE**2, _START_VELOCITY**2, _START_DISTURBANCE**2])
            self._jumps[index[restart]] = 0
        kept = index[keep]
        self._mean[kept], self._covariance[kept], self.newest[kept] = mean[keep], covariance[keep], stamp[keep]

    def _add_commands(self, mean: FloatArray, index: np.ndarray, start: FloatArray, elapsed: FloatArray) -> None:
        """Add to the means what the commands between start and start + elapsed do to position and velocity."""
        end = start + elapsed
        edges = [*self._command_times, math.inf]
        for begin, stop, acceleration in zip(edges[:-1], edges[1:], self._commands, strict=True):
            left, right = np.maximum(start, begin), np.minimum(end, stop)
            span = np.maximum(right - left, 0.0)[:, np.newaxis]
            if span.any():
                push = acceleration[index] * span
                mean[:, 1] += push
                mean[:, 0] += push * (end[:, np.newaxis] - np.where(span > 0.0, left[:, np.newaxis] + span / 2.0, 0.0))


def _transition(elapsed: FloatArray) -> FloatArray:
    """Return the transition matrices (M, 3, 3) of (p, pdot, d) over the given times (M,), s."""
    matrix = np.zeros((len(elapsed), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = matrix[:, 2, 2] = 1.0
    matrix[:, 0, 1] = matrix[:, 1, 2] = elapsed
    matrix[:, 0, 2] = elapsed * elapsed / 2.0
    return matrix


def _process_noise(elapsed: FloatArray) -> FloatArray:
    """Return the covariances (M, 3, 3) of what white acceleration and disturbance drift add over the given times."""
    t = elapsed
    q, r = _ACCELERATION_NOISE, _DISTURBANCE_NOISE
    t2, t3 = t * t, t * t * t
    matrix = np.empty((len(t), 3, 3))
    matrix[:, 0, 0] = q * t3 / 3.0 + r * t2 * t3 / 20.0
    matrix[:, 0, 1] = matrix[:, 1, 0] = q * t2 / 2.0 + r * t2 * t2 / 8.0
    matrix[:, 0, 2] = matrix[:, 2, 0] = r * t3 / 6.0
    matrix[:, 1, 1] = q * t + r * t3 / 3.0
    matrix[:, 1, 2] = matrix[:, 2, 1] = r * t2 / 2.0
    matrix[:, 2, 2] = r * t
    return matrix
