"""References computed before a flight: smooth paths through way-points. Numpy and scipy only."""

from flatsat_ros.planning.spline import spline_through

__all__ = [
    "spline_through",
]
