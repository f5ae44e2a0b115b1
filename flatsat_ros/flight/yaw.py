"""The yaw of each drone is turned toward its reference, by a limited rate or by an angle that leads it by as much."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of

# the rate is in proportion to the error, 1/s, and at most this, rad/s
_GAIN = 1.5
_RATE_MAX = 1.0
_LEAD_MAX = _RATE_MAX / _GAIN  # rad
_TURN = 2.0 * np.pi


class YawControl:
    """Turns N drones.

    Attributes:
        heading: (N,) commanded psi of the last tick, rad, in [-pi, pi].
    """

    def __init__(self, count: int) -> None:
        self.heading = np.zeros(count)

    def turn(self, yaw: FloatArray, wanted: FloatArray, steered: np.ndarray, kept: np.ndarray) -> FloatArray:
        """Return the commanded rates (N,), rad/s, counter-clockwise, and note the headings.

        Args:
            yaw: (N,) measured psi, rad.
            wanted: (N,) psi of the references, rad.
            steered: (N,) who is steered; the others do not turn.
            kept: (N,) who keeps the heading of the last tick, because nothing is known of its yaw; those neither
                steered nor kept have the heading that was measured.
        """
        lead = wanted - yaw
        if any_of(np.abs(lead) > _LEAD_MAX):
            lead = np.minimum(np.maximum(_wrapped(lead), -_LEAD_MAX), _LEAD_MAX)
        rate, heading = _GAIN * lead, _wrapped(yaw + lead)
        if all_of(steered):
            self.heading = heading
            return rate
        self.heading = np.where(steered, heading, np.where(kept, self.heading, yaw))
        return np.where(steered, rate, 0.0)


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return the same angles in [-pi, pi]."""
    if not any_of(np.abs(angle) > np.pi):
        return angle
    return np.asarray(angle - _TURN * np.rint(angle / _TURN))
