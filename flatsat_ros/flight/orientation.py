"""Whether the orientations of N drones are seen, and what is done without: it depends on `yaw_source`."""

from __future__ import annotations

import numpy as np

from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.policy import YawSource

# a drone that stands is tilted by less than this, rad
_TILTED = 0.7
# an orientation older than this, s, does not show the yaw any more: the drone is not turned, and keeps its heading
_UNSEEN_TIME = 0.5
# with yaw_source measured a drone lands after so long, s, without an orientation: its yaw drifts by degrees meanwhile
_PATIENCE = 3.0


class Orientations:
    """Looks at the orientations that an estimator has taken in.

    Attributes:
        measured: the yaw comes from orientations alone.
        from_motion: the yaw comes from the motion while no orientation is seen.
    """

    def __init__(self, estimator: Estimator, source: YawSource, count: int) -> None:
        """Watch an estimator of N drones."""
        self._estimator = estimator
        self.measured = source is YawSource.MEASURED
        self.from_motion = source is YawSource.MOTION
        self._lands = np.zeros(count, dtype=bool)  # it was told to land because its orientation is not seen

    def unready(self, index: int) -> str:
        """Return why drone index must not take off though its position is known; empty if it may."""
        tilt = float(self._estimator.tilt[index])
        if np.isnan(tilt) and self.measured:
            return "its orientation was never seen: take-off needs it, unless yaw_source is assumed or motion"
        if tilt > _TILTED:
            return f"it is tilted by {np.degrees(tilt):.0f} deg: must be at most {np.degrees(_TILTED):.0f}; is z up?"
        return ""

    def unready_all(self) -> np.ndarray:
        """Tell who must not take off though its position is known, (N,); see `unready`."""
        tilt = self._estimator.tilt
        tilted = np.asarray(tilt > _TILTED)
        return tilted | np.isnan(tilt) if self.measured else tilted

    def unseen(self, now: float) -> np.ndarray:
        """Tell whose orientation is not seen, (N,)."""
        return np.asarray(now - self._estimator.oriented > _UNSEEN_TIME)

    def patience_ends(self, now: float, flying: np.ndarray) -> list[int]:
        """Return who shall land now because its orientation has not been seen for too long, each once per event.

        To be asked while the orientation of anybody is not seen.

        Args:
            now: s.
            flying: (N,) who is steered.
        """
        if not self.measured:
            return []
        unseen = flying & (now - self._estimator.oriented > _PATIENCE)
        found = [int(index) for index in np.flatnonzero(unseen & ~self._lands)]
        self._lands = unseen
        return found
