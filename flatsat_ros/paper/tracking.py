"""Two constant saturation factors for tracking, to compare the law's own with.

The error dynamics allow v~ = v - v_ref in V_c - V_ref (Pontryagin difference) when all that is known of the reference
is a set V_ref it stays in. The controller knows v_ref(t) and uses the exit factor from it, which is never smaller than
either of these. All keep v_ref + lambda v in V_c; in rising order: the paper's polytope (its eq. 44), the exact factor
of a hull of vertices, the exit factor from v_ref(t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import refusal
from flatsat_ros.law.input_set import InputSet


def hull_factor(limits: InputSet, vertices: ArrayLike, v: ArrayLike) -> FloatArray:
    """Return the largest lambda with lambda v in V_c - conv{vertices}: the smallest exit factor over the vertices.

    Exact: V_c is convex, so the hull moved by lambda v stays inside if and only if its vertices do.

    Args:
        limits: V_c.
        vertices: (M, 3) points of V_c, m/s^2, whose hull holds the reference's acceleration.
        v: (..., 3) direction, m/s^2.

    Returns:
        (...) at least 0.

    Raises:
        FlatsatError: a shape is wrong, an entry is not finite, or a vertex lies outside V_c.
    """
    v = finite_array("v", v, 3)
    return np.asarray(limits.exit_factor(finite_array("vertices", vertices, 3), v[..., np.newaxis, :]).min(axis=-1))


@dataclass(frozen=True, eq=False)
class Polytope:
    """{ v : normals v <= offsets }, m/s^2.

    Attributes:
        normals: (F, 3).
        offsets: (F,), above 0.
    """

    normals: FloatArray
    offsets: FloatArray

    def factor(self, v: ArrayLike) -> FloatArray:
        """Return the largest lambda with lambda v inside, (...): the least offset / (normal v) above 0 (eq. 44)."""
        reach = finite_array("v", v, 3) @ self.normals.T
        with np.errstate(over="ignore"):
            factors = np.divide(self.offsets, reach, out=np.full_like(reach, np.inf), where=reach > 0.0)
        return np.asarray(factors.min(axis=-1))

    def minus(self, vertices: ArrayLike) -> Polytope:
        """Return the Pontryagin difference with the hull of (M, 3) vertices.

        Raises:
            FlatsatError: nothing is left around 0.
        """
        offsets = self.offsets - (finite_array("vertices", vertices, 3) @ self.normals.T).max(axis=0)
        if not (offsets > 0.0).all():
            raise refusal("offset left by the vertices", offsets.min(), "m/s^2", "above 0")
        return Polytope(self.normals, offsets)


def inner_polytope(limits: InputSet, sides: int) -> Polytope:
    """Return a polytope inside V_c that fills it as the number of sides grows.

    The cone becomes the pyramid over the regular polygon inscribed in each of its circles. The sphere becomes planes
    around it at the nodes of a grid of directions on the cap, moved in by the cosine of the grid's covering angle: a
    direction of the cap is at most that angle from a node, so no point beyond the sphere is left.

    Args:
        limits: V_c.
        sides: of the polygon, at least 3; the cap has a ring of so many nodes for every eighth of them.

    Returns:
        The polytope.

    Raises:
        FlatsatError: sides is below 3, or so few that hovering is cut off.
    """
    if sides < 3:
        raise refusal("sides", sides, "", "at least 3")
    g, tilt = limits.gravity, limits.tilt_max
    azimuth = 2.0 * np.pi * np.arange(sides) / sides
    slope = math.tan(tilt) * math.cos(math.pi / sides)
    pyramid = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(sides, -slope)], axis=1)

    rings = math.ceil(sides / 8)
    polar = (np.arange(rings) + 0.5) * tilt / rings
    covering = math.hypot(tilt / rings / 2.0, math.sin(tilt) * math.pi / sides)
    theta, around = (grid.ravel() for grid in np.meshgrid(polar, azimuth, indexing="ij"))
    cap = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=1)

    offsets = np.concatenate(
        [
            np.full(sides, slope * g),
            limits.thrust_max * math.cos(covering) - g * cap[:, 2],
            [g - limits.thrust_min],
        ]
    )
    if not (offsets > 0.0).all():
        raise refusal("sides", sides, "", "more: so coarse a polytope leaves no room to hover")
    return Polytope(np.concatenate([pyramid, cap, [[0.0, 0.0, -1.0]]]), offsets)
