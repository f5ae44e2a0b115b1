"""Drones that do not move as commanded brake while they sink: by then it is seen how they do move.

A wrong yaw turns what is commanded, a wrong sign of an axis mirrors it. `flight.astray.AstrayDetector` has compared
both when it finds a drone astray, and so knows how to command what shall come. Only the velocity is fed back, so that
a wrong position or frame of reference cannot lead the drone anywhere.
"""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.law.input_set import InputSet

# the deceleration is in proportion to the velocity, 1/s, and at most this share of what the limit of the tilt allows
_GAIN = 2.5
_SHARE = 0.8
# a drone that becomes faster than it was by this, m/s, does not brake any more: what was seen of it is wrong
_FASTER = 0.3


class Braking:
    """Braking of N drones.

    Attributes:
        active: (N,) who brakes while it sinks, as long as its velocity is known.
    """

    def __init__(self, limits: InputSet, count: int) -> None:
        """Begin with nobody braking; limits are V_c."""
        self._most = _SHARE * math.tan(limits.tilt_max) * limits.gravity  # m/s^2
        self.active = np.zeros(count, dtype=bool)
        self._answer = np.tile(np.eye(2), (count, 1, 1))
        self._fastest = np.zeros(count)  # m/s

    def begin(self, index: int, answer: FloatArray | None, velocity: FloatArray, under_way: float = 0.0) -> None:
        """Let drone index brake, or sink level if it is not known how it moves.

        Args:
            index: which drone.
            answer: (2, 2) what comes of what is commanded along the two horizontal axes of the body; None if unknown.
            velocity: (2,) horizontal, m/s.
            under_way: change of it by commands that have not acted yet, m/s.
        """
        self.active = self.active.copy()
        self.active[index] = answer is not None
        self._fastest[index] = float(np.hypot(*velocity)) + under_way + _FASTER
        self.learn(index, answer)

    def learn(self, index: int, answer: FloatArray | None) -> None:
        """Take in what is seen of drone index meanwhile; None keeps what was seen before."""
        if answer is not None:
            self._answer[index] = answer

    def accelerations(
        self, velocity: FloatArray, yaw: FloatArray, sinking: np.ndarray
    ) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Return who brakes, how, and what is commanded for it.

        Args:
            velocity: (N, 2) horizontal, m/s, world frame.
            yaw: (N,) psi, rad, by which commands are turned into the body's axes.
            sinking: (N,) who sinks and has a known velocity.

        Returns:
            Indices (K,), horizontal accelerations (K, 2) that shall come, and those to command, m/s^2, world frame.
        """
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        self.active = self.active & ~(sinking & (speed > self._fastest))
        who = np.flatnonzero(self.active & sinking)
        speed = speed[who]
        wanted = velocity[who] * (-np.minimum(_GAIN, self._most / np.maximum(speed, 1e-9)))[:, np.newaxis]
        sin, cos = np.sin(yaw[who]), np.cos(yaw[who])
        body = np.array([[cos, sin], [-sin, cos]]).transpose(2, 0, 1)  # from the world into the body's axes
        asked = body.transpose(0, 2, 1) @ self._answer[who].transpose(0, 2, 1) @ body @ wanted[..., np.newaxis]
        return who, wanted, asked[..., 0]
