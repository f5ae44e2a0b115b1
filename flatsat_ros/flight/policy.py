"""The figures of the flight layer that a lab chooses: times, limits, the room for references, what a goal means."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_number, require_positive
from flatsat_ros.flight.estimator import PREDICTION_MAX
from flatsat_ros.flight.path_limits import ReferenceBox


class GoalMode(str, Enum):
    """What a goal means: PATH, a path to it that can be followed; STEP, the paper's set-point, at once."""

    PATH = "path"
    STEP = "step"


class YawSource(str, Enum):
    """Where the yaw comes from: MEASURED, the orientation of the poses; ASSUMED, 0 until an orientation is seen.

    MOTION: as ASSUMED at first, then from how the drone moves on commands, while no orientation is seen.
    """

    MEASURED = "measured"
    ASSUMED = "assumed"
    MOTION = "motion"


@dataclass(frozen=True)
class Policy:
    """The figures of the state machine.

    Attributes:
        pose_timeout: age, s, above which a pose is stale and the drone is levelled; at most estimator.PREDICTION_MAX.
        level_time: s without poses in which the drone is held level before it sinks without position.
        unlock_time: s of zero thrust that open the firmware's thrust lock before take-off; ten set-points at least.
        lift_off_time: s of a commanded climb after which a drone that is not seen to leave the ground sinks, in case
            that it has, and its motors are stopped; after less time if it is commanded as much as lifts any.
        rest_time: s of zero thrust after touch-down; the firmware needs more than 1.8 s.
        level_thrust: thrust while the drone sinks and nothing is known of its motors, as a fraction of g, at most 1.
        drag: vertical drag over the mass, 1/s, by which a drone that sinks without position is slowed; 0 if unknown.
        disturbance_max: largest disturbance, m/s^2, that is compensated in flight; 0 is the paper's law.
        thrust_error_max: largest error of the thrust, as a fraction, that is estimated and corrected; 0 estimates none.
        yaw_source: where the yaw comes from.
        goal_mode: what a goal means.
        speed_max: largest speed of paths to goals, m/s, along the horizontal and along the vertical.
        floor: height of the floor, m, world frame.
        ceiling: largest height of a reference, m, world frame.
        walls: smallest x and y, largest x and y of a reference, m, world frame.
        separation: least distance of two drones, m, and along the vertical separation.DOWNWASH times as much.

    Raises:
        FlatsatError: a figure is out of its range; the text names it.
    """

    pose_timeout: float = 0.3
    level_time: float = 0.5
    unlock_time: float = 0.3
    lift_off_time: float = 3.0
    rest_time: float = 2.5
    level_thrust: float = 0.95
    drag: float = 0.0
    disturbance_max: float = 0.0
    thrust_error_max: float = 0.0
    yaw_source: YawSource = YawSource.MEASURED
    goal_mode: GoalMode = GoalMode.PATH
    speed_max: float = 1.0
    floor: float = 0.0
    ceiling: float = 10.0
    walls: tuple[float, float, float, float] = (-20.0, -20.0, 20.0, 20.0)
    separation: float = 0.4

    def __post_init__(self) -> None:
        seconds = ("pose_timeout", "level_time", "unlock_time", "lift_off_time", "rest_time")
        require_fields(self, require_positive, level_thrust="g", **dict.fromkeys(seconds, "s"))
        age = f"at most {PREDICTION_MAX} s: the estimate predicts no further"
        require(self.pose_timeout <= PREDICTION_MAX, "pose_timeout", self.pose_timeout, "s", age)
        require(self.level_thrust <= 1.0, "level_thrust", self.level_thrust, "g", "at most 1 g, or it would climb")
        require_fields(self, require_not_negative, disturbance_max="m/s^2", drag="1/s")
        require_fields(self, require_positive, speed_max="m/s", separation="m")
        require_number("thrust_error_max", self.thrust_error_max, "", 0.0, 0.5)
        require_fields(self, require_number, floor="m", ceiling="m")
        require(self.floor < self.ceiling, "ceiling", self.ceiling, "m", f"above the floor, {self.floor} m")
        require(len(self.walls) == 4, "walls", self.walls, "m", "four numbers: x_min, y_min, x_max, y_max")
        for low, high, names in ((0, 2, "x_min and x_max"), (1, 3, "y_min and y_max")):
            bottom, top = (require_number("walls", self.walls[i], "m") for i in (low, high))
            require(bottom < top, "walls", self.walls, "m", f"x_min, y_min, x_max, y_max with {names} in rising order")

    @property
    def box(self) -> ReferenceBox:
        """The room for references."""
        x_min, y_min, x_max, y_max = self.walls
        return ReferenceBox(np.array([x_min, y_min, self.floor]), np.array([x_max, y_max, self.ceiling]))
