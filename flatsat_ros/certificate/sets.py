"""From where the guarantee holds: the paper's ellipsoid E, the larger set D, and what k >= kappa adds to both.

With V = V_h + V_v split into its horizontal and vertical part, |eta_h|^2 <= c_h V_h and |eta_v|^2 <= c_v V_v. So

    E = { V <= eps },    D = { (a, b) in R, a = sqrt(c_h V_h), b = sqrt(c_v V_v) },
    R = { (a, b) >= 0 : every v with |v_h| <= a and |v_3| <= b lies in V_c },

have v0 = -eta in V_c, an applied gain of at least 1, and V_h and V_v that do not grow: both are invariant, and E lies
in D. The smallest s with the state in s D is the gauge of V_c at the worse of (a, 0, b) and (a, 0, -b): no search.
There v0 lies in s V_c, so the applied gain is at least kappa = min(1, 1/s); as long as V_h and V_v do not grow for that
gain, s D is invariant too (the paper stops at kappa = 1).

With a lag or a delay W takes the place of V: the same sets, of the state z = (p, v[, a], past commands) of
`certificate.sampled_loop`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.base.errors import refusal
from flatsat_ros.law.input_set import InputSet


class Place(IntEnum):
    """The smallest set that a state is in. Arrays are filled with a `.value`, which numpy takes four times faster."""

    OUTSIDE = 0
    KAPPA = 1  # in the kappa-set of D for the smallest kappa that is certified
    LARGER = 2  # in D
    ELLIPSOID = 3  # in E
    TUBE = 4  # in the tube of a flight section, which takes the place of all sets


class Membership(NamedTuple):
    """Where N states are.

    Attributes:
        level: (N,) V_h + V_v over the level of E, at most 1 inside; infinite for a state that is not finite.
        place: (N,) values of `Place`.
        kappa: (N,) the applied gain is at least this, min(1, 1/s) with the smallest s D around the state; 0 for a
            state that is not finite.
        guaranteed: (N,) whether, from here on, V_h and V_v do not grow (beyond the level to which a disturbance may
            lift them) and so the state never leaves its set, for every gain gamma in [1, gain_max].
    """

    level: FloatArray
    place: FloatArray
    kappa: FloatArray
    guaranteed: np.ndarray


@lru_cache(maxsize=16)
def _all_inside(shape: tuple[int, ...]) -> tuple[np.ndarray, FloatArray, np.ndarray]:
    """Return place, kappa and guarantee of states (...) that are all in E, as read-only arrays."""
    place, kappa, guaranteed = (np.broadcast_to(value, shape) for value in (Place.ELLIPSOID.value, 1.0, True))
    return place, kappa, guaranteed


def _bounded(
    lateral: FloatArray, upright: FloatArray, total: FloatArray, finite: np.ndarray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return V_h, V_v and their sum, (...); 0, 0 and infinity where they are not finite."""
    if all_of(finite):
        return lateral, upright, total
    return np.where(finite, lateral, 0.0), np.where(finite, upright, 0.0), np.where(finite, total, np.inf)


@dataclass(frozen=True, eq=False)
class Sets:
    """The certified sets of one loop.

    Attributes:
        limits: V_c.
        horizontal, vertical: (n, n) matrices of one axis: V_h sums the first over x and y, V_v takes the second for z.
            They are blocks of P or, with a lag or a delay, of W.
        slope_horizontal, slope_vertical: c_h and c_v, m^2/s^4 per unit of V_h and V_v.
        level: eps.
        gain_min: the smallest applied gain that is certified.
        floor: the level up to which a disturbance may lift V_h and V_v; 0 without a disturbance.
    """

    limits: InputSet
    horizontal: FloatArray
    vertical: FloatArray
    slope_horizontal: float
    slope_vertical: float
    level: float
    gain_min: float
    floor: float = 0.0

    def levels(self, state: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return V_h and V_v, (...).

        Args:
            state: (..., 3 n) errors: position, velocity[, achieved acceleration, past commands], three entries each; or
                (..., 6), which stands for a drone that hovers: accelerations and past commands zero.

        Raises:
            FlatsatError: the shape is wrong.
        """
        state, width = np.asarray(state, dtype=np.float64), len(self._matrix)
        if state.ndim == 0 or state.shape[-1] not in (6, width):
            raise refusal("shape of state", state.shape, "", f"(..., 6) or (..., {width})")
        width = state.shape[-1]
        terms = state @ self._matrix[:width, :width] * state
        sums = terms @ self._directions[:width]
        return sums[..., 0], sums[..., 1]

    @cached_property
    def _matrix(self) -> FloatArray:
        """The matrix of V_h + V_v, (3 n, 3 n)."""
        axes = np.kron(self.horizontal, np.diag([1.0, 1.0, 0.0])), np.kron(self.vertical, np.diag([0.0, 0.0, 1.0]))
        return np.asarray(axes[0] + axes[1])

    @cached_property
    def _directions(self) -> FloatArray:
        """(3 n, 2): what sums the terms of x and y, and those of z."""
        return np.tile([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]], (len(self.horizontal), 1))

    def scale_ellipsoid(self, state: ArrayLike) -> FloatArray:
        """Return the smallest s with the state in s E, (...): sqrt(V / eps)."""
        lateral, upright = self.levels(state)
        return np.sqrt((lateral + upright) / self.level)

    def scale_larger(self, state: ArrayLike) -> FloatArray:
        """Return the smallest s with the state in s D, (...)."""
        return self._scale(*self.levels(state))

    def _scale(self, lateral: FloatArray, upright: FloatArray) -> FloatArray:
        a = np.sqrt(self.slope_horizontal * np.maximum(lateral, 0.0))
        b = np.sqrt(self.slope_vertical * np.maximum(upright, 0.0))
        return self.limits.worst_gauge(a, b)

    def kappa(self, state: ArrayLike) -> FloatArray:
        """Return the largest kappa in (0, 1] with the state in D's kappa-set, (...): a bound of the applied gain."""
        return 1.0 / np.maximum(self.scale_larger(state), 1.0)

    def classify(self, state: ArrayLike) -> Membership:
        """Tell where N states are and whether the guarantee holds now.

        Args:
            state: (N, 6) or (N, 3 n) errors, see `levels`; a row that is not finite is outside.
        """
        lateral, upright = self.levels(state)
        total = lateral + upright
        if all_of(total <= self.level):  # E lies in D: nothing more to compute
            return Membership(total / self.level, *_all_inside(total.shape))
        finite = np.isfinite(total)
        lateral, upright, total = _bounded(lateral, upright, total, finite)
        scale = self._scale(lateral, upright)
        lifted = self._scale(np.maximum(lateral, self.floor), np.maximum(upright, self.floor)) if self.floor else scale
        ellipsoid, larger = total <= self.level, scale <= 1.0
        guaranteed = finite & (ellipsoid | (lifted <= 1.0) | (lifted * self.gain_min < 1.0))
        place = np.where(ellipsoid, Place.ELLIPSOID.value, np.where(larger, Place.LARGER.value, Place.KAPPA.value))
        return Membership(
            level=total / self.level,
            place=np.where(finite & (larger | guaranteed), place, Place.OUTSIDE.value),
            kappa=np.where(finite, 1.0 / np.maximum(scale, 1.0), 0.0),
            guaranteed=np.asarray(guaranteed),
        )

    def level_and_kappa(self, state: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return level and kappa of N states, (N,) each, as `classify` does; the arguments are those of `levels`."""
        lateral, upright = self.levels(state)
        total = lateral + upright
        if all_of(total <= self.level):
            return total / self.level, _all_inside(total.shape)[1]
        finite = np.isfinite(total)
        lateral, upright, total = _bounded(lateral, upright, total, finite)
        return total / self.level, finite / np.maximum(self._scale(lateral, upright), 1.0)

    def _density(self) -> float:
        """Return det(P_h) sqrt(det(P_v)), the root of the determinant of P; of the slice of hover with lag or delay."""
        return float(np.linalg.det(self.horizontal[:2, :2]) * math.sqrt(np.linalg.det(self.vertical[:2, :2])))

    @property
    def volume_ellipsoid(self) -> float:
        """Volume of E in (m, m/s)^3: pi^3/6 eps^3 / sqrt(det P). The kappa-set has kappa^-6 times as much."""
        return math.pi**3 / 6.0 * self.level**3 / self._density()

    @property
    def volume_larger(self) -> float:
        """Volume of D in (m, m/s)^3.

        The volumes of { V_h <= t } and { V_v <= t } are pi^2/2 t^2 / det P_h and pi t / sqrt(det P_v), so it is
        pi^3 / (2 c_h^2 c_v) times the integral of 2 b a(b)^4 db over the densities, with a(b) the width of R at b:
        a(b)^2 is one of two polynomials of degree 2, and three Gauss points integrate each piece exactly.
        """
        top = min(self.limits.gravity - self.limits.thrust_min, self.limits.thrust_max - self.limits.gravity)
        edges = np.unique(np.clip([0.0, *self._crossings(), top], 0.0, top))
        nodes, weights = np.polynomial.legendre.leggauss(3)
        half = np.diff(edges)[:, np.newaxis] / 2.0
        b = edges[:-1, np.newaxis] + half * (nodes + 1.0)
        integral = float((half * weights * 2.0 * b * self.width(b) ** 4).sum())
        return math.pi**3 / (2.0 * self.slope_horizontal**2 * self.slope_vertical) * integral / self._density()

    def width(self, b: ArrayLike) -> FloatArray:
        """Return the largest a with (a, b) in R, m/s^2, for 0 <= b <= min(g - T_min, T_max - g)."""
        g, limit, b = self.limits.gravity, self.limits.thrust_max, np.asarray(b, dtype=np.float64)
        sphere = np.sqrt((limit - g - b) * (limit + g + b))
        return np.minimum(math.tan(self.limits.tilt_max) * (g - b), sphere)

    def _crossings(self) -> list[float]:
        """Return where the cone's and the sphere's bound of a(b) are equal."""
        g, limit, square = self.limits.gravity, self.limits.thrust_max, math.tan(self.limits.tilt_max) ** 2
        # (1 + t^2) b^2 + 2 g (1 - t^2) b + g^2 (1 + t^2) - T^2 = 0
        half, last = g * (1.0 - square) / (1.0 + square), g * g - limit * limit / (1.0 + square)
        root = half * half - last
        return [] if root < 0.0 else [-half - math.sqrt(root), -half + math.sqrt(root)]

    @property
    def rest_radius(self) -> float:
        """Radius, m, of the largest ball of positions from which a drone that hovers starts inside E."""
        return math.sqrt(self.level / max(self.horizontal[0, 0], self.vertical[0, 0]))
