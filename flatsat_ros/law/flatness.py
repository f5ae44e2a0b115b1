"""The flatness map between the acceleration v and the input u = (T, phi, theta) of a quadcopter.

With the commanded (or achieved) translational acceleration v, world frame ENU, and the measured yaw psi,

    v = R_psi f(u) - g e3,    f(u) = T (cos phi sin theta, sin phi, cos phi cos theta),
    R_psi = [[cos psi, sin psi, 0], [sin psi, -cos psi, 0], [0, 0, 1]]        (its own inverse)

(Do, Blanchini, Prodan, arXiv 2308.15177, eq. 1 and 3). The thrust direction is the body z axis of the ZYX Euler
angles, body -> world = Rz(psi) Ry(theta) Rx(phi). At psi = 0 a positive roll accelerates toward -y and a positive
pitch toward +x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, any_of, finite_array
from flatsat_ros.base.constants import GRAVITY

# Below this fraction of gravity the direction of v + g e3 is rounding noise: the thrust is defined as zero and level.
_SINGULAR_THRUST = 1e-12


def input_from_acceleration(v: ArrayLike, yaw: ArrayLike, gravity: float = GRAVITY) -> FloatArray:
    """Return the input that produces an acceleration: u = Phi(v).

    Args:
        v: (..., 3) acceleration, m/s^2, world frame. With v3 < -g the answer is an inverted drone (|theta| > pi/2);
            such v are outside every input set.
        yaw: (...) measured yaw psi, rad, counter-clockwise.
        gravity: g, m/s^2.

    Returns:
        (..., 3): thrust T (m/s^2, normalised by the mass), roll phi (rad), pitch theta (rad). At the singular point
        v = -g e3 the answer is defined as (0, 0, 0).

    Raises:
        FlatsatError: a shape is wrong or an entry is not finite.
    """
    v = finite_array("v", v, 3)
    yaw = finite_array("yaw", yaw)
    return input_from_finite(v, yaw, gravity)


def input_from_finite(v: FloatArray, yaw: FloatArray, gravity: float) -> FloatArray:
    """Return `input_from_acceleration` of arrays that are known to be finite, (..., 3) and (...)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    v1, v2 = v[..., 0].copy(), v[..., 1].copy()  # faster than columns where there are few
    h1 = cos * v1 + sin * v2
    h2 = sin * v1 - cos * v2
    h3 = v[..., 2] + gravity
    forward = np.hypot(h1, h3)
    u = np.empty(h1.shape + (3,))
    thrust = np.hypot(forward, h2, out=u[..., 0])
    # asin(h2 / |h|), without its loss of digits near 90 degrees
    np.arctan2(h2, forward, out=u[..., 1])
    np.arctan2(h1, h3, out=u[..., 2])
    singular = thrust <= _SINGULAR_THRUST * gravity
    if any_of(singular):
        u[singular] = 0.0
    return u


def acceleration_from_input(u: ArrayLike, yaw: ArrayLike, gravity: float = GRAVITY) -> FloatArray:
    """Return the acceleration that an input produces: v = R_psi f(u) - g e3.

    Args:
        u: (..., 3) thrust T (m/s^2), roll phi (rad), pitch theta (rad).
        yaw: (...) yaw psi, rad, counter-clockwise.
        gravity: g, m/s^2.

    Returns:
        (..., 3) acceleration, m/s^2, world frame.

    Raises:
        FlatsatError: a shape is wrong or an entry is not finite.
    """
    return acceleration_from_finite(finite_array("u", u, 3), finite_array("yaw", yaw), gravity)


def acceleration_from_finite(u: FloatArray, yaw: FloatArray, gravity: float) -> FloatArray:
    """Return `acceleration_from_input` of arrays that are known to be finite, (..., 3) and (...)."""
    thrust, roll, pitch = u[..., 0], u[..., 1], u[..., 2]
    f1 = thrust * np.cos(roll) * np.sin(pitch)
    f2 = thrust * np.sin(roll)
    cos, sin = np.cos(yaw), np.sin(yaw)
    h1 = cos * f1 + sin * f2
    v = np.empty(h1.shape + (3,))
    v[..., 0] = h1
    v[..., 1] = sin * f1 - cos * f2
    v[..., 2] = thrust * np.cos(roll) * np.cos(pitch) - gravity
    return v
