"""Measured less simulated, of a flight: attitude, and second differences of the position, which need no velocity.

    p(t + H) - 2 p(t) + p(t - H) = integral of (H - |s|) p''(t + s) ds over |s| <= H,   H = 0.25 s

What differs from flight to flight is found along the way, linearly: the full thrust T_full, the angles of the marker
frame against the thrust axis, and a constant horizontal acceleration (trim).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.identification.response import Figures, Motion, lift, motion_of, respond
from flatsat_ros.identification.screening import STEP, Samples

REACH = 25  # samples, H
EVERY = 5  # samples between the residuals that are used


@dataclass(frozen=True, eq=False)
class ComparedFlight:
    """What of a flight does not depend on the figures.

    Attributes:
        motion: what was measured and commanded.
        attitude_at: (K,) the samples at which attitude is compared.
        position_at: (L,) the samples at which second differences of the position are compared.
        second: (L, 3) these, m.
        drifted: (L, 3) second differences that a deceleration by the velocity would give, for drag of 1/s, m.
        pushed: (2 L, 2) those, of x and y in turn, that accelerations ahead and to the left of 1 m/s^2 would give, m.
    """

    motion: Motion
    attitude_at: NDArray[np.intp]
    position_at: NDArray[np.intp]
    second: FloatArray
    drifted: FloatArray
    pushed: FloatArray

    @classmethod
    def of(cls, samples: Samples) -> ComparedFlight:
        """Prepare a flight."""
        motion, usable, place = motion_of(samples), samples.usable, samples.position
        whole = np.convolve(usable, np.ones(2 * REACH + 1), mode="valid") > 2 * REACH + 0.5
        at = np.flatnonzero(whole)[::EVERY] + REACH
        second = place[at + REACH] - 2.0 * place[at] + place[at - REACH]
        cos, sin = motion.heading.T
        axes = twice_integrated(np.stack([cos, -sin, sin, cos], axis=-1), at).reshape(-1, 2)
        drifted = twice_integrated(motion.velocity, at)
        return cls(motion, np.flatnonzero(usable)[::EVERY], at, second, drifted, axes)


@dataclass(frozen=True, eq=False)
class Misfit:
    """The residuals of one flight.

    Attributes:
        attitude: (K, 2) roll and pitch, measured less simulated, without the frame's offset, rad.
        position: (L, 3) second differences, measured less simulated, without trim, m.
        thrust_full: T_full, m/s^2, at PWM 65535 by the power law, at the flight's mean voltage where it was logged.
        frame: (2,) roll and pitch of the marker frame where the simulated attitude is level, rad.
        trim: (2,) acceleration ahead and to the left that the commands do not explain, m/s^2.
    """

    attitude: FloatArray
    position: FloatArray
    thrust_full: float
    frame: FloatArray
    trim: FloatArray

    def vector(self, attitude: float, position: float) -> FloatArray:
        """Return all residuals in units of the scales attitude, rad, and position, m."""
        return np.concatenate([self.attitude.ravel() / attitude, self.position.ravel() / position])


def misfit(flight: ComparedFlight, figures: Figures) -> Misfit:
    """Return measured less simulated for a flight, with its own thrust, frame and trim found by least squares."""
    tilt, thrust = respond(flight.motion, figures)
    turned = flight.motion.samples.angles[flight.attitude_at, :2] - tilt[flight.attitude_at]
    frame = np.asarray(np.median(turned, axis=0), dtype=np.float64)

    drag = np.array([figures.drag_xy, figures.drag_xy, figures.drag_z])
    wanted = flight.second + drag * flight.drifted
    wanted[:, 2] += GRAVITY * (REACH * STEP) ** 2
    offered = twice_integrated(lift(flight.motion, tilt, thrust), flight.position_at)
    full = float(wanted[:, 2] @ offered[:, 2]) / max(float(offered[:, 2] @ offered[:, 2]), 1e-30)
    left = wanted - full * offered
    trim = np.asarray(np.linalg.lstsq(flight.pushed, left[:, :2].reshape(-1), rcond=None)[0], dtype=np.float64)
    left[:, :2] -= (flight.pushed @ trim).reshape(-1, 2)
    return Misfit(turned - frame, left, full, frame, trim)


def twice_integrated(acceleration: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Return the integral of (H - |s|) times values (M, n) around the samples `at` (L,), (L, n)."""
    columns = np.ascontiguousarray(acceleration.T)
    for _ in range(2):  # a box on a box is a triangle
        total = np.cumsum(np.pad(columns, ((0, 0), (1, 0))), axis=1)
        columns = total[:, REACH:] - total[:, :-REACH]
    return np.asarray(columns[:, at - REACH + 1].T * STEP * STEP)
