"""Which certified set each drone is in, and whether the guarantee holds now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sets import Place


@dataclass(frozen=True, eq=False)
class Assessment:
    """Where N drones are.

    Attributes:
        relative_level: (N,) V over the level of the ellipsoid, at most 1 inside; W takes V's place with lag or delay.
        place: (N,) values of `certificate.sets.Place`: the smallest set around the state.
        kappa: (N,) lower bound of the applied gain, for set-points.
        guaranteed: (N,) whether the state provably never leaves its set again.
    """

    relative_level: FloatArray
    place: FloatArray
    kappa: FloatArray
    guaranteed: np.ndarray


class Watch:
    """Follows N drones through the certified sets.

    A set-point is covered by all sets of the certificate. A moving reference has the ellipsoid of its margin m alone,
    eps = m^2 / alpha, and no guarantee is claimed: between two ticks the reference moves on while the command is held.
    """

    def __init__(self, certificate: Certificate, count: int) -> None:
        self._sets = certificate.sets
        self._timing = certificate.timing
        self._rest = np.zeros((count, self._timing.size - 2, 3))
        self._radius = certificate.limits.inner_radius

    def assess(self, error: FloatArray, margin: FloatArray, still: np.ndarray) -> Assessment:
        """Return where the drones are.

        Args:
            error: xi (N, 6), m and m/s.
            margin: (N,) distance of the references' accelerations to the boundary of the input set, m/s^2.
            still: (N,) whether the law's base is 0: a set-point, and nothing compensated.
        """
        state = np.concatenate([error, self._rest.reshape(len(error), -1)], axis=1) if self._rest.size else error
        membership = self._sets.classify(state)
        relative = membership.level / np.minimum(1.0, margin / self._radius) ** 2
        place = membership.place
        if not still.all():
            place = np.where(still, place, np.where(relative <= 1.0, Place.ELLIPSOID.value, Place.OUTSIDE.value))
        return Assessment(relative, place, membership.kappa, membership.guaranteed & still)

    def follow(self, acceleration: FloatArray) -> None:
        """Note what the drones were commanded, (N, 3), m/s^2: with lag or delay it is on its way for some time."""
        if self._rest.size:
            self._rest = self._timing.follow(self._rest, acceleration)
