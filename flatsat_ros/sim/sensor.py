"""Simulated motion capture: samples of the true poses at a rate, with noise, losses and delay."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_positive

_ROUNDING = 1e-9  # s: times closer than this are the same
# standard deviations that noise stays within, horizontally and vertically, so that it can keep a bound for certain
NOISE_BOUND = 5.0


class Sample(NamedTuple):
    """One measured pose of one drone.

    Attributes:
        stamp: time of the measurement, s.
        drone: index in the fleet.
        position: (3,) m, world.
        quaternion: (4,) x, y, z, w; body -> world.
    """

    stamp: float
    drone: int
    position: FloatArray
    quaternion: FloatArray


@dataclass(frozen=True)
class MotionCapture:
    """The properties of a motion capture system; by default it has no faults.

    Attributes:
        rate: samples of each drone per second, Hz; a sample falls on the first integration step at or after its time.
        noise: standard deviation of the position per axis, m; it stays within NOISE_BOUND of them.
        dropout: probability that a sample of a drone is lost, independently of all others.
        gaps: pairs (start, end) of times, s, between which there is no sample of any drone.
        latency: time from the stamp of a sample to its release, s.

    Raises:
        FlatsatError: a value is not a number of its range, or a gap does not end after it starts.
    """

    rate: float = 100.0
    noise: float = 0.0
    dropout: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()
    latency: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_positive, rate="Hz")
        require_fields(self, require_not_negative, noise="m", latency="s")
        require(0.0 <= self.dropout <= 1.0, "dropout", self.dropout, "", "a probability, from 0 to 1")
        require(all(start <= end for start, end in self.gaps), "gaps", self.gaps, "s", "pairs of start and end")


class PoseSampler:
    """Samples a fleet and hands out each sample when its latency is over; times are seconds of simulated time."""

    def __init__(self, capture: MotionCapture, generator: np.random.Generator) -> None:
        """Begin before the first sample.

        Args:
            capture: its properties.
            generator: of noise and drop-out.
        """
        self._capture = capture
        self._generator = generator
        self._taken = 0
        self._waiting: deque[Sample] = deque()

    def is_due(self, time: float) -> bool:
        """Whether the next sample's time has come."""
        return time >= self._taken / self._capture.rate - _ROUNDING

    def take(self, time: float, position: FloatArray, quaternion: FloatArray) -> None:
        """Sample all drones; what is lost draws the same random numbers, so that it changes nothing for the others.

        Args:
            time: the present, s.
            position: (N, 3) m, world.
            quaternion: (N, 4) x, y, z, w; body -> world.
        """
        self._taken += 1
        noisy = position + self._capture.noise * _bounded(self._generator.standard_normal(position.shape))
        kept = self._generator.random(len(position)) >= self._capture.dropout
        if any(start <= time < end for start, end in self._capture.gaps):
            return
        self._waiting.extend(Sample(time, int(i), noisy[i], quaternion[i]) for i in np.flatnonzero(kept))

    def release(self, time: float) -> list[Sample]:
        """Return the samples whose latency is over at a time, s, in order; each is returned once."""
        released = []
        while self._waiting and self._waiting[0].stamp + self._capture.latency <= time + _ROUNDING:
            released.append(self._waiting.popleft())
        return released


def _bounded(noise: FloatArray) -> FloatArray:
    """Return noise (N, 3) of standard deviation 1, its horizontal and its vertical part no longer than NOISE_BOUND."""
    sides, upright = np.hypot(noise[:, 0], noise[:, 1]), np.abs(noise[:, 2])
    size: FloatArray = np.maximum(np.stack([sides, sides, upright], axis=1), NOISE_BOUND)
    return noise * NOISE_BOUND / size
