"""Which certified set each drone is in, and whether the guarantee holds now."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sets import Place

_PLACES = np.array([Place.OUTSIDE.value, Place.ELLIPSOID.value])  # by whether a state is inside the ellipsoid


class Assessment(NamedTuple):
    """Where N drones are.

    Attributes:
        relative_level: (N,) V over the level of the ellipsoid, at most 1 inside; W takes V's place with lag or delay,
            and with a flight section the distance to the reference over the tube that of both.
        place: (N,) values of `certificate.sets.Place`: the smallest set around the state.
        kappa: (N,) lower bound of the applied gain, for set-points.
        guaranteed: (N,) whether the state provably never leaves its set again.
        broken: (N,) values of `assumptions.Assumption`; None without a flight section.
        tube: largest distances to the reference, horizontal and vertical, (2,), m; None without a flight section.
    """

    relative_level: FloatArray
    place: FloatArray
    kappa: FloatArray
    guaranteed: np.ndarray
    broken: np.ndarray | None = None
    tube: FloatArray | None = None


class GuaranteeMonitor:
    """Follows N drones through the certified sets.

    A set-point is covered by all sets of the certificate. A moving reference has the ellipsoid of its margin m alone,
    eps = m^2 / alpha, and no guarantee is claimed: between two ticks the reference moves on while the command is held.
    """

    def __init__(self, certificate: Certificate, count: int) -> None:
        """Begin with drones that hover: nothing is on its way to them."""
        self._sets = certificate.sets
        self._timing = certificate.timing
        # what z holds beyond position and velocity: achieved acceleration and commands on their way, about the base
        self._hidden = np.zeros((count, 3 * (self._timing.size - 2)))
        self._radius = certificate.limits.inner_radius

    def assess(self, error: FloatArray, margin: FloatArray, fixed: np.ndarray) -> Assessment:
        """Return where the drones are.

        Args:
            error: xi (N, 6), m and m/s.
            margin: (N,) distance of the references' accelerations to the boundary of the input set, m/s^2.
            fixed: (N,) whether the law's base is 0 for good: a set-point, and nothing compensated.
        """
        state = np.concatenate([error, self._hidden], axis=1) if self._hidden.size else error
        shrunk = np.minimum(1.0, margin / self._radius) ** 2
        if not any_of(fixed):
            level, kappa = self._sets.level_and_kappa(state)
            relative = level / shrunk
            return Assessment(relative, _PLACES.take(relative <= 1.0), kappa, fixed)
        membership = self._sets.classify(state)
        relative, place = membership.level / shrunk, membership.place
        if not all_of(fixed):
            place = np.where(fixed, place, _PLACES.take(relative <= 1.0))
        return Assessment(relative, place, membership.kappa, membership.guaranteed & fixed)

    def follow(self, command: FloatArray) -> None:
        """Note the commands (N, 3), m/s^2, about their base: with lag or delay they are on their way for some time."""
        if self._hidden.size:
            self._hidden = self._timing.follow(self._hidden, command)
