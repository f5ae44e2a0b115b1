"""What is proved about references, its check with integers, and the file in which it travels. Numpy and PyYAML only."""

from flatsat_ros.plans.bounds import Bounds, Claim
from flatsat_ros.plans.curve import Curve
from flatsat_ros.plans.drone import PlannedDrone, Tube, Waypoint
from flatsat_ros.plans.obstacles import Box
from flatsat_ros.plans.pairs import Pair
from flatsat_ros.plans.plan import Plan
from flatsat_ros.plans.separation import Closest, closest

__all__ = [
    "Bounds",
    "Box",
    "Claim",
    "Closest",
    "Curve",
    "Pair",
    "Plan",
    "PlannedDrone",
    "Tube",
    "Waypoint",
    "closest",
]
