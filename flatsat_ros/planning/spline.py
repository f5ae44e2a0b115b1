"""Smooth references through way-points: a B-spline of degree 5, at rest at both ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from flatsat_ros.base.arrays import finite_array, require_each
from flatsat_ros.base.errors import LARGEST, refusal, require_positive
from flatsat_ros.flight.trajectory import Trajectory

_DEGREE = 5


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
    points = finite_array("waypoints", waypoints, 3)
    if points.ndim != 2 or len(points) < 2:
        raise refusal("shape of waypoints", points.shape, "", "(M, 3) with M >= 2")
    require_each(np.abs(points) <= LARGEST, "an entry of waypoints", points, "m", f"within {LARGEST:g} m")
    times = require_positive("leg_time", leg_time, "s") * np.arange(len(points))
    at_rest = [(order, np.zeros(3)) for order in (1, 2)]
    spline = make_interp_spline(times, points, k=_DEGREE, bc_type=(at_rest, at_rest))
    knots = np.unique(spline.t)
    velocities, accelerations = (spline.derivative(order)(knots) for order in (1, 2))
    for derivative in (velocities, accelerations):
        derivative[[0, -1]] = 0.0  # the boundary conditions, without the solver's rounding
    return Trajectory.through(knots, spline(knots), velocities, accelerations, yaw)
