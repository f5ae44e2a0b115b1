"""Drones that cannot follow their references: the limit of their tilt does not let them, or their loop swings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flatsat_ros.base.arrays import FloatArray, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.detectors import BobbingDetector, TiltLimitDetector

# gusts move a drone so far, m, in turns, however stiff its law is: what is corrected nearer to the reference swings not
_BLOWN_ABOUT = 0.075
_BLOWN = "at the limit of its tilt and {0:.1f} m off its reference, no nearer for seconds: wind? It lands where it is"
_SWINGS = "it swings from one side to the other: do poses or commands come too late?"
_AGAINST = "at the limit of its tilt it goes another way than it is told to: is its yaw what yaw_source assumes?"
_BOBS = "it swings up and down: do poses or commands come too late?"


class FollowingCheck:
    """Looks at how N drones follow their references.

    Attributes:
        blown: (N,) who lands because the wind is too strong, until it is down.
    """

    def __init__(self, certificate: Certificate, drag: float, count: int) -> None:
        """Begin without a past.

        Args:
            certificate: its limits, and the tubes inside which a stiff law corrects.
            drag: horizontal, 1/s: deceleration over speed through still air.
            count: N.
        """
        limits, flight = certificate.limits, certificate.flight
        # m, horizontal and vertical
        self._near = None if flight is None else [max(axis.tube.position, _BLOWN_ABOUT) for axis in flight.axes]
        self._drag = drag
        self._limit = TiltLimitDetector(count, limits.tilt_max, limits.gravity)
        self._bobbing = BobbingDetector(count)
        self.blown = np.zeros(count, dtype=bool)
        self._reports: list[tuple[int, str]] = []

    def set_clock_back(self, now: float) -> None:
        """Let nothing last longer because the clock was set back to now, s."""
        self._limit.set_clock_back(now)

    def reports(self) -> list[tuple[int, str]]:
        """Return what is to be told, drone and text, once."""
        reports, self._reports = self._reports, []
        return reports

    def look(
        self,
        now: float,
        acceleration: FloatArray,
        base: FloatArray,
        disturbance: FloatArray,
        error: FloatArray,
        steered: np.ndarray,
        landing: np.ndarray,
        assumed: np.ndarray | None,
        told: np.ndarray,
        ease: Callable[[float, np.ndarray], np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return whose loop swings or is against its commands, and whose swings, each (N,).

        Args:
            now: s.
            acceleration: (N, 3) commanded, m/s^2.
            base: (N, 9) the law's reference: its acceleration is commanded without an error, m/s^2.
            disturbance: (N, 3) estimated, m/s^2.
            error: (N, 6) state minus reference, m and m/s.
            steered: (N,) who is in the air and steered.
            landing: (N,) who lands.
            assumed: (N,) whose yaw nobody sees; nobody's if None.
            told: (N,) of whom it has been told that they go astray.
            ease: flies those softly who swing, and returns for whom that is something new: they may calm down.
        """
        correction = acceleration - base[:, 6:]
        if self._near is not None:  # what a stiff law corrects inside its tube is no swinging
            sides = np.hypot(error[:, 0], error[:, 1]) > self._near[0]
            correction = correction * np.stack([sides, sides, np.abs(error[:, 2]) > self._near[1]], axis=1)
        # without what its own motion through still air makes of it
        push = disturbance[:, :2] + self._drag * (error[:, 3:5] + base[:, 3:5])
        blown, swinging, opposed = self._limit.look(
            now, acceleration, correction[:, :2], push, error[:, :2], steered, landing, assumed
        )
        bobbing = self._bobbing.look(now, correction[:, 2], steered)
        if any_of(swinging | bobbing):
            eased = ease(now, swinging | bobbing)
            if any_of(eased):
                self._limit.forget(eased)
                self._bobbing.forget(eased)
                swinging, bobbing = swinging & ~eased, bobbing & ~eased
        late = swinging | bobbing
        astray = late | opposed
        if any_of(blown | astray):
            for index in map(int, np.flatnonzero(blown & ~self.blown)):
                self._reports.append((index, _BLOWN.format(float(np.hypot(*error[index, :2])))))
            against = opposed & assumed if assumed is not None else np.zeros_like(opposed)
            for found, text in ((swinging, _SWINGS), (against, _AGAINST), (bobbing, _BOBS)):
                self._reports += [(int(index), text) for index in np.flatnonzero(found & ~told)]
            self.blown = self.blown | blown
        return astray, late
