"""Smooth references through way-points: B-splines at rest at both ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from flatsat_ros.base.arrays import FloatArray, finite_array, require_each
from flatsat_ros.base.errors import LARGEST, refusal, require_positive
from flatsat_ros.flight.trajectory import Trajectory

_DEGREE = 5
_DENSE = 0.1  # s, between points of a path of higher degree


def spline_through(waypoints: ArrayLike, leg_time: float, yaw: float = 0.0) -> Trajectory:
    """Return the path that passes the way-points at equal time intervals and rests at the first and last.

    Args:
        waypoints: (M, 3) positions, m, world frame, M >= 2; repeat the first one at the end for a closed path.
        leg_time: time from one way-point to the next, s.
        yaw: held on the whole path, rad, counter-clockwise.

    Returns:
        A trajectory whose times begin at 0 s. Its points are the knots of the spline, between which both are
        polynomials of degree 5: the trajectory is the spline exactly.

    Raises:
        FlatsatError: fewer than two way-points, a value that is not finite or beyond `LARGEST`, or a leg time that is
            not above 0.
    """
    points, times = _checked(waypoints, leg_time)
    at_rest = [(order, np.zeros(3)) for order in (1, 2)]
    spline = make_interp_spline(times, points, k=_DEGREE, bc_type=(at_rest, at_rest))
    knots = np.unique(spline.t)
    velocities, accelerations = (spline.derivative(order)(knots) for order in (1, 2))
    for derivative in (velocities, accelerations):
        derivative[[0, -1]] = 0.0  # the boundary conditions, without the solver's rounding
    return Trajectory.through(knots, spline(knots), velocities, accelerations, yaw)


def gentle_spline_through(waypoints: ArrayLike, leg_time: float, yaw: float = 0.0) -> Trajectory:
    """Return the path of degree 7 that is as `spline_through`, but begins and ends without a jerk as well.

    Its points are dense: the quintics between them are off by less than a micrometre in position.
    """
    points, times = _checked(waypoints, leg_time)
    at_rest = [(order, np.zeros(3)) for order in (1, 2, 3)]
    spline = make_interp_spline(times, points, k=_DEGREE + 2, bc_type=(at_rest, at_rest))
    dense = np.linspace(0.0, times[-1], max(2, round(times[-1] / _DENSE)) + 1)
    velocities, accelerations = (spline.derivative(order)(dense) for order in (1, 2))
    for derivative in (velocities, accelerations):
        derivative[[0, -1]] = 0.0
    return Trajectory.through(dense, spline(dense), velocities, accelerations, yaw)


def _checked(waypoints: ArrayLike, leg_time: float) -> tuple[FloatArray, FloatArray]:
    """Return way-points (M, 3), m, and their times (M,), s."""
    points = finite_array("waypoints", waypoints, 3)
    if points.ndim != 2 or len(points) < 2:
        raise refusal("shape of waypoints", points.shape, "", "(M, 3) with M >= 2")
    require_each(np.abs(points) <= LARGEST, "an entry of waypoints", points, "m", f"within {LARGEST:g} m")
    return points, require_positive("leg_time", leg_time, "s") * np.arange(float(len(points)))
