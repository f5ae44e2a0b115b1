"""The relay with faults: what it lets through, what becomes of the rest, and that other robots are left alone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.parameter import Parameter

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.fault_relay import COMMAND_FAULTS, POSE_FAULTS, FaultRelay
from flatsat_ros.nodes.ros import messages

pytestmark = pytest.mark.in_process

SETPOINT = WireSetpoint(1.0, 2.0, 3.0, 40000.0)


class Heard(list[Any]):
    """A publisher that keeps its messages."""

    publish = list.append


class Relay:
    """A relay for cf1 and cf2 whose publishers keep their messages."""

    def __init__(self) -> None:
        self.node = FaultRelay()
        self.poses, self.others, self.commands = ([Heard(), Heard()] for _ in range(3))
        self.node._poses, self.node._commands = self.poses, self.commands  # type: ignore[assignment]

    def set(self, **values: str) -> str:
        """Set parameters and return why they were refused."""
        result = self.node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])
        if self.node._others:
            self.node._others = self.others  # type: ignore[assignment]
        return str(result.reason)

    def pose(self, index: int = 0, x: float = 1.0) -> PoseStamped:
        """Let a pose come from a drone."""
        message = messages.pose_message()
        messages.fill_pose(message, self.node.get_clock().now().nanoseconds, (x, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0))
        self.node._on_pose(index, message)
        return message

    def command(self, index: int = 0) -> Twist:
        """Let a command come from the controller."""
        message = Twist()
        messages.fill_command(message, SETPOINT)
        self.node._on_command(index, message)
        return message


@pytest.fixture
def relay() -> Iterator[Relay]:
    rclpy.init(args=["--ros-args", "-p", "robot_names:=[cf1,cf2]"])
    made = Relay()
    yield made
    made.node.destroy_node()
    rclpy.shutdown()


def test_without_faults_messages_go_through_as_they_are(relay: Relay) -> None:
    assert relay.poses[0] == [] == relay.commands[1]
    pose, command = relay.pose(0), relay.command(1)
    assert relay.poses == [[pose], []]
    assert relay.commands == [[], [command]]


def test_what_becomes_of_a_pose(relay: Relay) -> None:
    assert relay.set(pose_fault="lost") == ""
    relay.pose()
    assert relay.poses[0] == []
    relay.set(pose_fault="repeated")
    relay.pose(x=1.0)
    later = relay.pose(x=2.0)
    assert [pose.pose.position.x for pose in relay.poses[0]] == [1.0, 1.0]
    stamp = messages.nanoseconds_from_stamp(relay.poses[0][1].header.stamp)
    assert stamp == pytest.approx(messages.nanoseconds_from_stamp(later.header.stamp), abs=1000)
    relay.poses[0].clear()
    relay.set(pose_fault="nan")
    relay.pose()
    assert math.isnan(relay.poses[0][0].pose.position.z)
    relay.poses[0].clear()
    relay.set(pose_fault="frame")
    assert relay.pose().header.frame_id == relay.poses[0][0].header.frame_id == "odom"
    relay.poses[0].clear()
    relay.set(pose_fault="bytes")
    pose = relay.pose()
    assert relay.poses[0] == [bytes(range(8)), pose]
    relay.poses[0].clear()
    relay.set(pose_fault="")
    assert relay.poses[0] == [] == relay.others[0]
    assert relay.pose() is relay.poses[0][0]


def test_a_second_source_has_a_publisher_of_its_own(relay: Relay, monkeypatch: pytest.MonkeyPatch) -> None:
    relay.set(pose_fault="second_source")
    for time, both in ((0.2, False), (0.7, True)):
        monkeypatch.setattr(FaultRelay, "_now", time)
        relay.pose(x=1.0)
        assert len(relay.others[0]) == both
    assert len(relay.poses[0]) == 2
    assert relay.others[0][0].pose.position.y == 1.0


def test_commands_are_lost_or_wait(relay: Relay, monkeypatch: pytest.MonkeyPatch) -> None:
    relay.set(command_fault="lost")
    relay.command()
    relay.set(command_fault="late")
    monkeypatch.setattr(FaultRelay, "_now", 1.0)
    relay.command()
    for time, sent in ((1.1, []), (1.21, [SETPOINT])):
        monkeypatch.setattr(FaultRelay, "_now", time)
        relay.node._send_late()
        assert [messages.command_from_message(message) for message in relay.commands[0]] == sent


def test_other_robots_have_no_faults_unless_all_have(relay: Relay) -> None:
    relay.set(pose_fault="lost", command_fault="lost", faulty="cf2")
    pose, command = relay.pose(0), relay.command(0)
    relay.pose(1), relay.command(1)
    assert (relay.poses, relay.commands) == ([[pose], []], [[command], []])
    relay.set(faulty="all")
    relay.pose(0), relay.command(0)
    assert (relay.poses, relay.commands) == ([[pose], []], [[command], []])


@pytest.mark.parametrize("name", ["faulty", "pose_fault", "command_fault"])
def test_a_fault_that_there_is_not_is_refused(name: str, relay: Relay) -> None:
    assert relay.set(**{name: "gremlins"}).startswith(f"{name} = 'gremlins': must be one of")
    assert relay.set(pose_fault=list(POSE_FAULTS)[-1], command_fault=list(COMMAND_FAULTS)[-1]) == ""
