"""Flights by each of the topics that poses may come from, over DDS: `make test-crazyswarm2`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab

PLACES = {"cf1": (0.0, 0.0, 0.0), "cf2": (0.0, 1.0, 0.0)}
# source, the topic of cf1 that is named, package of its messages
SOURCES = [
    ("poses", "/poses", "motion_capture_tracking_interfaces"),
    ("tf", "/tf", "tf2_msgs"),
    ("odom", "cf1/odom", "nav_msgs"),
]


@pytest.mark.parametrize(("source", "topic", "package"), SOURCES)
def test_two_drones_take_off_fly_to_goals_and_land_by_another_source_of_poses(
    lab: Lab, source: str, topic: str, package: str
) -> None:
    pytest.importorskip(f"{package}.msg", reason="PACKAGES")
    seen = {robot: lab.watch(interfaces.POSE, robot) for robot in PLACES}
    starts = [entry for place in PLACES.values() for entry in place]
    lab.start("sim_server", robot_names=list(PLACES), start_positions=starts, odom_rate=100.0, seed=1)
    controller = lab.fly(*PLACES, pose_source=source, certificate="cf21_50hz", takeoff_height=0.6)
    lab.take_off(*PLACES)
    for line in (f"cf1: poses from {topic}", "cf1: backend cflib"):
        lab.wait(lambda line=line: line in controller.output, line)
    for robot, (x, y, _) in PLACES.items():
        lab.wait_for_flight(robot, seen[robot], (x, y, 0.6))
    goals = {"cf1": (0.5, -0.3, 0.8), "cf2": (-0.4, 1.2, 0.5)}
    for robot, goal in goals.items():
        lab.go_to(robot, goal)
    for robot, goal in goals.items():
        lab.wait_for_flight(robot, seen[robot], goal)
    lab.land(*PLACES)
    assert all(poses[-1].pose.position.z < 0.02 for poses in seen.values())
    assert not [line for line in controller.output.splitlines() if "[ERROR]" in line]
