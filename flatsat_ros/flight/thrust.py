"""The thrust scale of each drone, learnt in flight: the force that its motors give over the force asked for."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.base.constants import GRAVITY

# a drone that has not lifted off although commanded upward for this time, s, before and after its thrust was learnt,
# loses this share of its scale a second
_LIFTING_TIME = 0.3, 1.0
_LIFTING_RATE = 0.3
# seconds in the air after which the scale can be relied on
_SETTLED_TIME = 5.0

# the scale follows its error with this time constant, s: slowly, beside the estimate of the disturbance
_TIME_CONSTANT = 3.0
# and with an estimate of the disturbance that knows the lag of the thrust, in so many first seconds in the air
_QUICK_TIME_CONSTANT, _QUICK_TIME = 0.5, 2.0
# by then of a drone that is flown softly: what is disturbance of a loop that is late would swing it otherwise
_DOUBTED_TIME_CONSTANT = 1.0
# less thrust, m/s^2, shows next to nothing of its scale: what disturbs a drone then is taken for an error of so much
_LEAST = GRAVITY / 2.0


class ThrustScale:
    """Estimates of N drones.

    What disturbs a drone vertically is taken for an error of its thrust, d_z = (actual / asked for - 1) T_z. One that
    stands on the ground although it is commanded upward has less thrust than it is asked for.

    Attributes:
        scale: (N,) actual thrust over the thrust asked for; at first rather too high, so that no drone leaps up.
        quick: the scales are learnt faster at the beginning.
    """

    def __init__(self, count: int, error_max: float, quick: bool = False) -> None:
        """Begin with what is not known.

        Args:
            count: N.
            error_max: the scale stays within 1 -+ error_max; 0 learns nothing.
            quick: learn faster at the beginning; the disturbance must be that of an estimate that knows lag and delay.
        """
        self.quick = quick
        self._first = 1.0 + error_max / 2.0
        self.scale = np.full(count, self._first)
        self._error_max = error_max
        self._gained: FloatArray | None = None
        self._learnt = np.zeros(count)  # s in which it followed
        self._lifting = np.zeros(count)  # s of being commanded upward on the ground, less those of not

    def learn(
        self,
        upward: FloatArray,
        disturbance: FloatArray,
        flying: np.ndarray,
        lifting: np.ndarray,
        period: float | FloatArray,
        doubted: np.ndarray | None = None,
    ) -> None:
        """Follow what one tick shows.

        Args:
            upward: (N,) vertical part of the commanded thrust, m/s^2.
            disturbance: (N,) estimated vertical disturbance, m/s^2.
            flying: (N,) who is in the air, away from the ground, which may carry it.
            lifting: (N,) who stands on the ground and is commanded upward.
            period: since the last tick, s; for each drone, or one for all.
            doubted: (N,) who is flown softly in height; nobody by default.
        """
        self._learnt += period * flying
        # noise of the velocity hides that it stands, now and then
        self._lifting = np.maximum(self._lifting + np.where(lifting, period, -period), 0.0)
        if self._error_max == 0.0:
            return
        error = np.where(flying & (upward > 0.0), disturbance / np.maximum(upward, _LEAST), 0.0)
        weak = lifting & (self._lifting > np.where(self._learnt < _SETTLED_TIME, *_LIFTING_TIME))
        constant: float | FloatArray = _TIME_CONSTANT
        if self.quick:
            quick: float | FloatArray = _QUICK_TIME_CONSTANT
            if doubted is not None:
                quick = np.where(doubted, _DOUBTED_TIME_CONSTANT, quick)
            constant = np.where(self._learnt < _QUICK_TIME, quick, _TIME_CONSTANT)
        scale = self.scale * (1.0 + period / constant * error - period * _LIFTING_RATE * weak)
        before, self.scale = self.scale, np.minimum(np.maximum(scale, 1.0 - self._error_max), 1.0 + self._error_max)
        if self.quick:
            self._gained = (before / self.scale - 1.0) * (upward + disturbance)

    def take_gained(self) -> FloatArray | None:
        """Return what the last change of the scales adds to the actual thrusts, (N,) m/s^2, once; None for nothing."""
        gained, self._gained = self._gained, None
        return gained

    def take_over(self, index: int) -> None:
        """Begin with drone index in the air, if it is not known yet: there, too little thrust lets it drop."""
        if not self.is_settled(index):
            self.scale = self.scale.copy()
            self.scale[index] = 1.0

    def forget(self, index: int) -> None:
        """Begin anew with drone index."""
        self.scale = self.scale.copy()
        self.scale[index], self._learnt[index] = self._first, 0.0

    @property
    def hurried(self) -> np.ndarray | None:
        """(N,) whose scale is still learnt faster than later; None if none ever is."""
        return self._learnt < _QUICK_TIME if self.quick and self._error_max > 0.0 else None

    @property
    def settled(self) -> np.ndarray:
        """(N,) whose thrust was seen for long enough to be relied on."""
        return self._learnt >= _SETTLED_TIME

    def is_settled(self, index: int) -> bool:
        """Tell whether the thrust of drone index was seen for long enough to be relied on."""
        return bool(self.settled[index])

    def cautious(self, steered: np.ndarray) -> FloatArray:
        """Return the scale (N,), no less than 1 for drones that are not steered: they shall not climb by mistake.

        What was seen for long enough holds for them, too.
        """
        if all_of(steered):
            return self.scale
        return np.where(steered | self.settled, self.scale, np.maximum(self.scale, 1.0))
