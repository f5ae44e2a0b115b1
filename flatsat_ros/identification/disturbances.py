"""Accelerations that commands and drone do not explain, up to a bandwidth: what a certificate calls disturbances.

They come from second differences over +-H, so they are means weighted by a triangle of +-H = 0.25 s; their rate of
change is the difference over 0.1 s. Noise of 1 mm of the positions makes 0.04 m/s^2 of a disturbance and 0.6 m/s^3 of
its rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.identification.fit import Fit
from flatsat_ros.identification.residuals import EVERY, REACH, ComparedFlight
from flatsat_ros.identification.screening import STEP

_APART = 2  # residuals, EVERY samples apart, between which the rate is taken
BANDWIDTH = 0.3189 / (REACH * STEP)  # Hz, where a mean weighted by a triangle of +-H has fallen to 1 / sqrt 2


def disturbances(
    flights: Sequence[ComparedFlight], found: Fit, slowing: FloatArray | None = None, thrust_full: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return what is left of the acceleration, and how it changes.

    Args:
        flights: of one drone.
        found: their fit.
        slowing: (3,) 1/s, deceleration by the velocity that counts as known, drag and tilt together; None: the fit's.
        thrust_full: thrust at PWM 65535 that counts as known, m/s^2; None: each flight's own.

    Returns:
        (n, 3) m/s^2 and (m, 3) m/s^3, world frame, every 50 ms.
    """
    figures, square = found.figures, (REACH * STEP) ** 2
    own = np.array([figures.drag_xy, figures.drag_xy, figures.drag_z])
    own[:2] -= GRAVITY * figures.velocity_tilt
    left, changes = [], []
    for flight, each in zip(flights, found.misfits, strict=True):
        pushed = each.position / square
        pushed[:, :2] += (flight.pushed @ each.trim).reshape(-1, 2) / square
        if slowing is not None:
            pushed -= (own - slowing) * flight.drifted / square
        if thrust_full is not None:
            pushed[:, 2] += (each.thrust_full / thrust_full - 1.0) * GRAVITY
        left.append(pushed)
        steps, change = (values[_APART:] - values[:-_APART] for values in (flight.position_at, pushed))
        changes.append(change[steps == _APART * EVERY] / (_APART * EVERY * STEP))
    return np.concatenate(left), np.concatenate(changes)


def blur(noise: float, share: float) -> tuple[float, float]:
    """Return up to which sizes noise of the positions alone makes disturbances and their changes appear.

    Args:
        noise: standard deviation of a measured coordinate, m.
        share: of the samples, below 1.

    Returns:
        Of the vectors of disturbances, m/s^2, and of their changes, m/s^3.
    """
    pushed = math.sqrt(6.0) * noise / (REACH * STEP) ** 2  # of p(t + H) - 2 p(t) + p(t - H), per axis
    change = math.sqrt(2.0) * pushed / (_APART * EVERY * STEP)
    wide = float(chi.ppf(share, 3))
    return pushed * wide, change * wide


def shared(vectors: FloatArray) -> FloatArray:
    """Return the larger (n,) of the norms over the axes that share a loop, x and y, and z, of vectors (n, 3)."""
    return np.asarray(np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), np.abs(vectors[:, 2])))
