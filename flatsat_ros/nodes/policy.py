"""The parameters of the flight modes."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from flatsat_ros.base.errors import require
from flatsat_ros.flight.defaults import DISTURBANCE_MAX, THRUST_ERROR_MAX
from flatsat_ros.flight.estimator import PREDICTION_MAX
from flatsat_ros.flight.policy import GoalMode, Policy, YawSource
from flatsat_ros.nodes.ros.parameters import declare, declare_choice

# parameter, what it means, unit, default and range
_FIGURES = (
    ("pose_timeout", "age above which a pose is stale", "s", Policy.pose_timeout, (0.01, PREDICTION_MAX)),
    ("level_time", "held level without poses before it sinks without position", "s", Policy.level_time, (0.1, 5.0)),
    ("unlock_time", "zero thrust before take-off, ten set-points at least", "s", Policy.unlock_time, (0.01, 10.0)),
    ("lift_off_time", "commanded climb on the ground that is no take-off", "s", Policy.lift_off_time, (0.5, 600.0)),
    ("speed_max", "largest speed of paths to goals, level and upright", "m/s", Policy.speed_max, (0.05, 10.0)),
    ("floor", "height of the floor", "m", Policy.floor, (-1e3, 1e3)),
    ("ceiling", "largest height of a reference", "m", Policy.ceiling, (-1e3, 1e3)),
    ("separation", "least distance of two drones, vertically twice as much", "m", Policy.separation, (0.05, 10.0)),
    ("disturbance_max", "largest disturbance that is compensated; 0 is the paper's law", "m/s^2", DISTURBANCE_MAX,
     (0.0, 100.0)),
    ("thrust_error_max", "largest error of the thrust that is estimated and corrected; 0: none", "", THRUST_ERROR_MAX,
     (0.0, 0.5)),
)  # fmt: skip


def declare_policy(node: Node, drag: float) -> Policy:
    """Declare the figures of the flight modes and return them.

    Args:
        node: whose parameters they are.
        drag: vertical drag of the drones over their mass, 1/s.

    Raises:
        FlatsatError: a figure is out of its range.
    """
    figures: dict[str, Any] = {
        name: declare(node, name, default, meaning, unit=unit, bounds=bounds)
        for name, meaning, unit, default, bounds in _FIGURES
    }
    walls = declare(node, "walls", list(Policy.walls), "smallest x, y and largest x, y of a reference", unit="m")
    goal_mode = declare_choice(node, "goal_mode", GoalMode, "a goal is flown to on a path, or is the paper's step")
    yaw_source = declare_choice(node, "yaw_source", YawSource, "where the yaw of the drones comes from")
    require(len(walls) == 4, "walls", walls, "m", "four numbers: x_min, y_min, x_max, y_max")
    x_min, y_min, x_max, y_max = walls
    sides = (x_min, y_min, x_max, y_max)
    return Policy(drag=drag, walls=sides, goal_mode=goal_mode, yaw_source=yaw_source, **figures)
