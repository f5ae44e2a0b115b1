"""The input set V_c: the accelerations a quadcopter can produce within its thrust and tilt limits.

    V_c = { v : |v + g e3| <= T_max, |(v1, v2)| <= tan(eps_max) (v3 + g), v3 + g >= T_min }

a ball about free fall, v = -g e3, cut by an upright cone with its apex there (arXiv 2308.15177, eq. 7; the bound T_min
is ours). Everything here is exact up to rounding: the saturation factor is the reciprocal of the gauge (Minkowski
functional) of V_c, not the candidate list of the paper's eq. 10, whose maximum may lie outside V_c (docs/errata.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, all_of, any_of, finite_array
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import (
    LARGEST,
    SMALLEST,
    refusal,
    require,
    require_fields,
    require_not_negative,
    require_number,
    require_positive,
)

# How far outside V_c, relative to the limits, a base point may lie by rounding alone.
_ROUNDING = 1e-12

# The smallest float above 0, to divide by instead of 0.
_TINY = math.ulp(0.0)


class Limits(NamedTuple):
    """Which limits of an input set are meant: T_max, eps_max and T_min, by the surfaces that they give it."""

    sphere: bool
    cone: bool
    plane: bool


_ALL = Limits(sphere=True, cone=True, plane=True)


@dataclass(frozen=True)
class InputSet:
    """The set V_c of one vehicle.

    Attributes:
        thrust_max: T_max, m/s^2, thrust normalised by the mass; above gravity.
        tilt_max: eps_max, rad, in (0, pi/2).
        gravity: g, m/s^2.
        thrust_min: T_min, m/s^2, in [0, gravity).

    Raises:
        FlatsatError: 0 would not be an interior point of V_c (the drone could not hover), or a limit is not finite.
    """

    thrust_max: float
    tilt_max: float
    gravity: float = GRAVITY
    thrust_min: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_positive, thrust_max="m/s^2", gravity="m/s^2")
        require_fields(self, require_not_negative, thrust_min="m/s^2")
        require_fields(self, require_number, tilt_max="rad")
        most, tilt, g, least = self.thrust_max, self.tilt_max, self.gravity, self.thrust_min
        require(most > g, "thrust_max", most, "m/s^2", f"above gravity = {g} m/s^2, or it cannot hover")
        valid = f"from {SMALLEST:g} to below pi/2 rad, which is 90 deg"
        require(SMALLEST <= tilt < math.pi / 2, "tilt_max", tilt, "rad", valid)
        require(least < g, "thrust_min", least, "m/s^2", f"below gravity = {g} m/s^2")

    def contains(self, v: ArrayLike, tolerance: float = _ROUNDING) -> np.ndarray:
        """Tell which accelerations lie in (1 + tolerance) V_c.

        Args:
            v: (..., 3) acceleration, m/s^2, world frame.
            tolerance: relative; 0 asks for gauge(v) <= 1 as computed.

        Returns:
            (...) booleans.

        Raises:
            FlatsatError: the shape is wrong or an entry is not finite.
        """
        return np.asarray(self.gauge(v) <= 1.0 + tolerance)

    def gauge(self, v: ArrayLike) -> FloatArray:
        """Return the gauge psi(v) = min { t >= 0 : v in t V_c }.

        It is at most 1 exactly on V_c, positively homogeneous and convex. Relative error a few units in the last
        place for |v| from 1e-300 to 1e300 m/s^2.

        Args:
            v: (..., 3) acceleration, m/s^2, world frame.

        Returns:
            (...) dimensionless.

        Raises:
            FlatsatError: the shape is wrong, or an entry is not finite (NaN and infinity have no direction).
        """
        return self.gauge_of_finite(finite_array("v", v, 3))

    def gauge_of_finite(self, v: FloatArray) -> FloatArray:
        """Return `gauge` of an array v that is known to be finite and (..., 3)."""
        g, sin = self.gravity, math.sin(self.tilt_max)
        scale = _size(v)
        scaled = v / scale[..., np.newaxis]
        horizontal, v3 = np.hypot(scaled[..., 0], scaled[..., 1]), scaled[..., 2]
        cone = (horizontal * math.cos(self.tilt_max) - v3 * sin) / (g * sin)
        plane = v3 / (self.thrust_min - g)
        square = horizontal * horizontal + v3 * v3
        room = (self.thrust_max - g) * (self.thrust_max + g)
        root = g * np.abs(v3) + np.sqrt(g * g * v3 * v3 + square * room)
        # the branch without cancellation: root / room going up, square / root going down
        sphere = np.where(v3 >= 0.0, root / room, square / np.where(root > 0.0, root, 1.0))
        return np.asarray(np.maximum(np.maximum(cone, plane), sphere) * scale)

    def worst_gauge(self, horizontal: FloatArray, vertical: FloatArray) -> FloatArray:
        """Return the largest gauge of any v with |(v1, v2)| = horizontal and |v3| = vertical.

        Upward it is the sphere's, downward the cone's or that of T_min.

        Args:
            horizontal: (...) at least 0, m/s^2.
            vertical: (...) at least 0, m/s^2.

        Returns:
            (...) dimensionless.
        """
        side, down, up, slant = self._worst_slopes
        cone = side * horizontal + vertical / self.gravity
        sphere = up * vertical + np.hypot(up * vertical, slant * np.hypot(horizontal, vertical))
        return np.asarray(np.maximum(np.maximum(cone, down * vertical), sphere))

    @cached_property
    def _worst_slopes(self) -> tuple[float, float, float, float]:
        """What `worst_gauge` multiplies by: of cone and plane, then of the sphere."""
        room = (self.thrust_max - self.gravity) * (self.thrust_max + self.gravity)
        down = 1.0 / (self.gravity - self.thrust_min)
        return 1.0 / (self.gravity * self._slope), down, self.gravity / room, 1.0 / math.sqrt(room)

    def saturate(self, v: ArrayLike) -> FloatArray:
        """Return the longest vector of V_c in the direction of v and no longer than v: sat(v) = v / max(1, psi(v)).

        Args:
            v: (..., 3) acceleration, m/s^2, world frame.

        Returns:
            (..., 3) in V_c, v itself where v is in V_c.

        Raises:
            FlatsatError: the shape is wrong or an entry is not finite.
        """
        v = finite_array("v", v, 3)
        return v / np.maximum(1.0, self.gauge_of_finite(v))[..., np.newaxis]

    def exit_factor(self, base: ArrayLike, v: ArrayLike) -> FloatArray:
        """Return the largest factor lambda with base + lambda v in V_c; infinite where v = 0.

        At base 0 it is 1 / gauge(v). The reference's acceleration is the base when a trajectory is tracked.

        Args:
            base: (..., 3) point of V_c, m/s^2, world frame.
            v: (..., 3) direction, m/s^2, world frame, broadcast against base.

        Returns:
            (...) dimensionless, at least 0.

        Raises:
            FlatsatError: a shape is wrong, an entry is not finite, or a base lies outside V_c.
        """
        base = finite_array("base", base, 3)
        return self.exit_factor_of_finite(base, finite_array("v", v, 3))

    def exit_factor_of_finite(self, base: FloatArray, v: FloatArray) -> FloatArray:
        """Return `exit_factor` of base and v that are known to be finite and (..., 3); it refuses the same bases."""
        radius, up = np.hypot(base[..., 0], base[..., 1]), base[..., 2] + self.gravity
        left = np.minimum(
            self.thrust_max - np.hypot(radius, up), np.minimum(self._slope * up - radius, up - self.thrust_min)
        )
        if any_of(left < -_ROUNDING * self.thrust_max):
            worst = base.reshape(-1, 3)[int(np.argmin(left))]
            outside = -float(self.margin(worst))
            raise refusal("base", worst.tolist(), "m/s^2", f"inside the input set, it is {outside:.6g} m/s^2 outside")
        scale = _size(v)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return np.asarray(1.0 / (self._exits(base, v / scale[..., np.newaxis], _ALL) * scale))

    def reach_of_finite(self, base: FloatArray, v: FloatArray, most: FloatArray) -> FloatArray:
        """Return the smaller one of most (...) and `exit_factor` of base and v, known to be finite and (..., 3).

        To be called where numpy does not warn of divisions.
        """
        half_width = self._half_width
        if any_of(np.abs(base) > half_width):
            return np.minimum(most, self.exit_factor_of_finite(base, v))
        way = most[..., np.newaxis] * v
        end = base + way
        size = np.abs(end)
        if all_of(size <= half_width):
            return most
        # V_c is convex: a limit that both ends keep is kept between them
        radius, up = np.hypot(end[..., 0], end[..., 1]), end[..., 2] + self.gravity
        sphere = any_of(np.hypot(radius, up) > self.thrust_max)
        if sphere and not all_of(size <= LARGEST):
            return np.minimum(most, self.exit_factor_of_finite(base, v))
        cone = any_of(radius > self._slope * up)
        plane = any_of(up < self.thrust_min)
        if not (sphere or cone or plane):
            return most
        return most / np.maximum(self._exits(base, way, Limits(sphere, cone, plane)), 1.0)

    def _exits(self, base: FloatArray, v: FloatArray, limits: Limits) -> FloatArray:
        """Return the reciprocal, at least 0, of the largest factor lambda with base + lambda v within some limits.

        Args:
            base: (..., 3) in V_c.
            v: (..., 3), its squares neither over- nor underflow.
            limits: which.
        """
        # copies: numpy computes faster with few entries that lie together
        p1, p2, up = base[..., 0].copy(), base[..., 1].copy(), base[..., 2] + self.gravity
        v1, v2, v3 = v[..., 0].copy(), v[..., 1].copy(), v[..., 2].copy()
        radius = np.hypot(p1, p2)
        horizontal = v1 * v1 + v2 * v2
        along = p1 * v1 + p2 * v2
        nearest: FloatArray = np.zeros(())
        if limits.sphere:
            thrust = np.hypot(radius, up)
            a, b = horizontal + v3 * v3, along + up * v3
            c = np.maximum(self.thrust_max - thrust, 0.0) * (self.thrust_max + thrust)
            nearest = np.fmax(nearest, _reciprocal_root(a, b, c, b * b + a * c))
        if limits.cone:
            reach, rise = self._slope * up, self._slope * v3
            a, b = np.maximum(horizontal - rise * rise, 0.0), along - reach * rise
            c = np.maximum(reach - radius, 0.0) * (reach + radius)
            # b^2 + a c with its equal terms cancelled by hand
            turn, m1, m2 = p1 * v2 - p2 * v1, reach * v1 - rise * p1, reach * v2 - rise * p2
            discriminant = np.maximum(m1 * m1 + m2 * m2 - turn * turn, 0.0)
            nearest = np.fmax(nearest, _reciprocal_root(a, b, c, discriminant))
        if limits.plane:  # negative upward
            nearest = np.fmax(nearest, (0.0 - v3) / np.maximum(up - self.thrust_min, _TINY))
        return nearest

    def margin(self, v: ArrayLike) -> FloatArray:
        """Return the distance from v to the boundary of V_c, the radius of the largest ball around v inside V_c.

        The function is concave, so its minimum over control points bounds it over their convex hull.

        Args:
            v: (..., 3) acceleration, m/s^2, world frame.

        Returns:
            (...) m/s^2; negative outside V_c (there it is no longer a distance).

        Raises:
            FlatsatError: the shape is wrong or an entry is not finite.
        """
        v = finite_array("v", v, 3)
        radius, up = np.hypot(v[..., 0], v[..., 1]), v[..., 2] + self.gravity
        cone = up * math.sin(self.tilt_max) - radius * math.cos(self.tilt_max)
        return np.asarray(np.minimum(np.minimum(cone, self.thrust_max - np.hypot(radius, up)), up - self.thrust_min))

    def nearest_limit(self, v: ArrayLike) -> str:
        """Return the name of the limit nearest to one acceleration v (3,), m/s^2; other shapes and NaN are refused."""
        v = finite_array("v", v, 3)
        radius, up = math.hypot(v[0], v[1]), float(v[2]) + self.gravity
        distances = {
            "tilt_max": up * math.sin(self.tilt_max) - radius * math.cos(self.tilt_max),
            "thrust_max": self.thrust_max - math.hypot(radius, up),
            "thrust_min": up - self.thrust_min,
        }
        return min(distances, key=lambda name: distances[name])

    @cached_property
    def _slope(self) -> float:
        """tan(eps_max), the slope of the cone."""
        return math.tan(self.tilt_max)

    @cached_property
    def _half_width(self) -> float:
        """Half the width of the largest cube in the largest ball around 0 in V_c, m/s^2."""
        return self.inner_radius / math.sqrt(3.0)

    @cached_property
    def inner_radius(self) -> float:
        """Radius r_in of the largest ball around 0 in V_c, m/s^2: min(g sin eps_max, T_max - g, g - T_min)."""
        return min(
            self.gravity * math.sin(self.tilt_max), self.thrust_max - self.gravity, self.gravity - self.thrust_min
        )

    @property
    def inner_box(self) -> FloatArray:
        """Half-widths (3,), m/s^2, of the largest-volume box |v_i| <= vbar_i in V_c with vbar_1 = vbar_2.

        Of height z it is bounded by the cone at its lower corners, s <= tan(eps)(g - z), and by the sphere at its upper
        corners, s^2 <= T^2 - (g + z)^2, with s = sqrt(2) vbar_1. Both volumes s^2 z are log-concave in z, so the
        largest lies at the maximum of one of them, where the bounds cross, or at the T_min bound.
        """
        g, limit, slope = self.gravity, self.thrust_max, math.tan(self.tilt_max)

        def square(z: float) -> float:
            return min((slope * (g - z)) ** 2, (limit - g - z) * (limit + g + z))

        a, b, c = 1.0 + slope * slope, g * (1.0 - slope * slope), g * g * (1.0 + slope * slope) - limit * limit
        heights = [g / 3.0, (-2.0 * g + math.sqrt(g * g + 3.0 * limit * limit)) / 3.0, g - self.thrust_min]
        if b * b >= a * c:
            heights += [(-b + math.sqrt(b * b - a * c)) / a, (-b - math.sqrt(b * b - a * c)) / a]
        valid = [z for z in heights if 0.0 < z <= min(g - self.thrust_min, limit - g)]
        height = max(valid, key=lambda z: square(z) * z)
        half_width = math.sqrt(square(height) / 2.0)
        return np.array([half_width, half_width, height])


def _size(v: FloatArray) -> FloatArray:
    """Return the largest absolute entry of v (..., 3), above 0; divided by it, no square of v over- or underflows."""
    size = np.abs(v)
    # entry by entry, for a max over so short an axis is slow
    return np.asarray(np.maximum(np.maximum(size[..., 0], size[..., 1]), np.maximum(size[..., 2], _TINY)))


def _reciprocal_root(a: FloatArray, b: FloatArray, c: FloatArray, discriminant: FloatArray) -> FloatArray:
    """Return 1/l for the smallest l > 0 with a l^2 + 2 b l - c = 0, c >= 0; 0 or NaN where there is none.

    With D the root of the discriminant b^2 + a c, the two forms (b + D)/c and a/(D - b) are equal; each is used where
    it does not cancel. A negative a serves in the first only and is given as 0. c = 0 is a base on the boundary: the
    exit is immediate (infinite) unless the direction points inward (b < 0) or along a ruling (a <= 0 = b).
    """
    size = np.abs(b) + np.sqrt(discriminant)
    return np.where(b > 0.0, size / c, a / size)
