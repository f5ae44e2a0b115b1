"""References made offline: splines through way-points."""

from flatsat_ros.planning.spline import spline_through

__all__ = [
    "spline_through",
]
