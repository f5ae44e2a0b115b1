"""Robots that are not flown here: their poses are heard, and what is given wrongly is refused."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from rclpy.serialization import serialize_message

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes import pose_sources
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.other_robots import OtherRobots
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.faults import Faults

pytestmark = pytest.mark.in_process


@pytest.fixture
def started() -> Iterator[Callable[[str], ControllerNode]]:
    """How to make a controller with other robots; it is gone after the test."""
    made: list[ControllerNode] = []

    def start(others: str) -> ControllerNode:
        rclpy.init(args=["--ros-args", "-p", f"other_poses:={others}"])
        made.append(ControllerNode())
        return made[-1]

    yield start
    for node in made:
        node.destroy_node()
    rclpy.try_shutdown()


def test_goals_where_another_robot_is_seen_are_refused_by_its_name(
    started: Callable[[str], ControllerNode],
) -> None:
    node = started("['blimp', 'person']")
    (hear,) = (taken.callback for taken in node.subscriptions if taken.topic_name == "/person/pose")
    pose = messages.pose_message()
    messages.fill_pose(pose, 0, (1.0, 2.0, 1.5), (0.0, 0.0, 0.0, 1.0))
    hear(serialize_message(pose))
    node._others.take()
    with pytest.raises(FlatsatError, match="where person rests = 0"):
        node._set_reference(0, Trajectory.hold([1.0, 2.1, 1.5]))
    node._set_reference(0, Trajectory.hold([0.0, 0.0, 1.5]))
    pose.header.frame_id = "elsewhere"
    hear(serialize_message(pose))
    hear(b"garbage")
    node._others.take()
    assert node.faults.count("person") == 2


@pytest.mark.parametrize(
    ("others", "reason"),
    [
        ("['cf1']", "parameter other_poses = .?cf1.?: must be another: this one is flown here"),
        ("['blimp', 'blimp']", "must be given once"),
        ("['no name']", "must be letters, digits and underscores"),
        ("['blimp', '']", "must be letters, digits and underscores"),
        ("[1, 2]", "must be of type string array"),
    ],
)
def test_names_that_cannot_be_meant_are_refused(
    started: Callable[[str], ControllerNode], others: str, reason: str
) -> None:
    with pytest.raises(FlatsatError, match=reason):
        started(others)


def test_other_robots_that_only_motion_capture_tells_of_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """With stand-ins for node and messages, see test_pose_sources."""
    now, takes, seen = [0.0], {}, []
    entry = SimpleNamespace(name="person", pose=messages.pose_message().pose)
    entry.pose.position.x = 1.5
    frame = SimpleNamespace(header=messages.pose_message().header, poses=[entry])
    monkeypatch.setattr(
        pose_sources, "import_module", lambda _: SimpleNamespace(NamedPoseArray=object, TFMessage=object)
    )
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    node: Any = SimpleNamespace(
        create_subscription=lambda _kind, topic, take, *_, **__: takes.setdefault(topic, take),
        count_publishers=lambda topic: topic == interfaces.NAMED_POSES,
        get_logger=lambda: SimpleNamespace(info=lambda _: None),
        faults=Faults(SimpleNamespace()),
    )
    others = OtherRobots(node, ["blimp", "person"], "world", lambda number, place: seen.append((number, *place)))
    assert set(takes) == {"blimp/pose", "person/pose"}
    now[0] = 2.0
    others.look()
    takes[interfaces.NAMED_POSES](frame)
    others.take()
    assert seen == [(1, 1.5, 0.0, 0.0)]
