"""Drones of several kinds in one set-up, and the two meanings of the yaw on the wire, over DDS."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import SetBool

from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.cdr import yaw_from_quaternion

if TYPE_CHECKING:
    from conftest import Lab

ROBOTS = """
fileversion: 3
robots:
  cf1: {enabled: true, uri: udp://127.0.0.1:1, initial_position: [0.0, 0.0, 0.0], type: stock}
  cf2: {enabled: true, uri: udp://127.0.0.1:2, initial_position: [0.0, 1.0, 0.0], type: strong}
robot_types: {stock: {big_quad: false}, strong: {big_quad: false}}
"""


@pytest.fixture
def crazyflies(tmp_path: Path) -> Path:
    """A crazyflies.yaml with two types."""
    path = tmp_path / "crazyflies.yaml"
    path.write_text(ROBOTS, encoding="utf-8")
    return path


@pytest.mark.parametrize(("yaw_mode", "source"), [("rate", "odom"), ("angle", "pose")])
def test_drones_of_two_types_fly_side_by_side_and_turn_to_their_yaw(
    lab: Lab, crazyflies: Path, yaw_mode: str, source: str
) -> None:
    """By their poses, and by the odometry of sim_server."""
    kinds = {"crazyflies_yaml": crazyflies, "robot_types__strong__vehicle": "brushless", "yaw_mode": yaw_mode}
    poses = {robot: lab.watch(interfaces.POSE, robot) for robot in ("cf1", "cf2")}
    commands = {robot: lab.watch(interfaces.COMMAND, robot) for robot in poses}
    if source == "odom":
        lab.start("sim_server", odom_rate=100.0, **kinds)
    else:
        lab.start("sim_drone", **kinds)
    controller = lab.fly("cf1", "cf2", pose_source=source, **kinds)
    arm = interfaces.service_of("cf2", interfaces.ARM)
    lab.wait(lambda: "asked to arm" in lab.ask(SetBool, arm, data=True).message, "the brushless drone to be armed")
    for robot, y in (("cf1", 0.0), ("cf2", 1.0)):
        goal = PoseStamped()
        messages.fill_pose(goal, 0, (0.3, y, 0.5), (0.0, 0.0, math.sin(0.5), math.cos(0.5)))
        lab.go_to(robot, (0.0, y, 0.5))
        lab.publish(interfaces.GOAL, robot, goal)
    for robot, y in (("cf1", 0.0), ("cf2", 1.0)):
        lab.wait_for_flight(robot, poses[robot], (0.3, y, 0.5))

        def turned(seen: list[PoseStamped] = poses[robot]) -> bool:
            q = seen[-1].pose.orientation
            return abs(yaw_from_quaternion(q.x, q.y, q.z, q.w) - 1.0) < 0.1

        lab.wait(turned, f"{robot} to turn")
    assert all(f"{robot}: poses from {robot}/{source}" in controller.output for robot in poses)
    # hovering, 29 g of 0.480 N and 39.3 g of 0.800 N
    hover = {robot: commands[robot][-1].linear.z for robot in commands}
    assert hover["cf1"] == pytest.approx(38842, rel=0.05)
    assert hover["cf2"] == pytest.approx(31583, rel=0.05)


def test_a_yaw_mode_that_is_none_is_refused(lab: Lab) -> None:
    controller = lab.start("controller", yaw_mode="absolute")
    assert controller.wait() == 2
    assert "parameter yaw_mode = 'absolute': must be one of rate, angle" in controller.output
