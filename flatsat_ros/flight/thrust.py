"""The thrust scale of each drone, learnt in flight: the force that its motors give over the force asked for."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray

# the scale follows its error with this time constant, s: slowly, beside the estimate of the disturbance
_TIME_CONSTANT = 3.0


class ThrustScale:
    """Estimates of N drones.

    What disturbs a drone vertically is taken for an error of its thrust, d_z = (actual / asked for - 1) T_z.

    Attributes:
        scale: (N,) actual thrust over the thrust asked for; 1 at first.
    """

    def __init__(self, count: int, error_max: float) -> None:
        """Begin with thrust as the vehicle profile promises it.

        Args:
            count: N.
            error_max: the scale stays within 1 -+ error_max; 0 learns nothing.
        """
        self.scale = np.ones(count)
        self._error_max = error_max

    def learn(self, upward: FloatArray, disturbance: FloatArray, learning: np.ndarray, period: float) -> None:
        """Follow what one tick shows.

        Args:
            upward: (N,) vertical part of the commanded thrust, m/s^2.
            disturbance: (N,) estimated vertical disturbance, m/s^2.
            learning: (N,) whose disturbance says something: in flight, away from the ground, which may carry a drone.
            period: since the last tick, s.
        """
        if self._error_max == 0.0:
            return
        useful = learning & (upward > 0.0)
        error = np.divide(disturbance, upward, out=np.zeros_like(upward), where=useful)
        scale = self.scale * (1.0 + period / _TIME_CONSTANT * error)
        self.scale = np.clip(scale, 1.0 - self._error_max, 1.0 + self._error_max)

    def cautious(self, steered: np.ndarray) -> FloatArray:
        """Return the scale (N,), no less than 1 for drones that are not steered: they shall not climb by mistake."""
        if np.count_nonzero(steered) == steered.size:
            return self.scale
        return np.where(steered, self.scale, np.maximum(self.scale, 1.0))
