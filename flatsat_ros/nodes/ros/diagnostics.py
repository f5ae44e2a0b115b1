"""What a node reports about its robots on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from flatsat_ros.nodes.ros import interfaces, messages

PERIOD = 1.0  # s


class Level(Enum):
    """How well a robot is."""

    OK = DiagnosticStatus.OK
    WARN = DiagnosticStatus.WARN
    ERROR = DiagnosticStatus.ERROR


class RobotCondition(NamedTuple):
    """What is said of one robot.

    Attributes:
        robot: its name.
        hardware: what tells it from others of its kind: its name, or the URI of its link.
        level: how well it is.
        text: its condition in a few words.
        values: figures and flags by name; a name contains the unit.
    """

    robot: str
    hardware: str
    level: Level
    text: str
    values: Mapping[str, object]


class Diagnostics:
    """Publishes a node's reports once every PERIOD, in one message."""

    def __init__(self, node: Node, collect: Callable[[int], Sequence[RobotCondition]]) -> None:
        """Start the timer.

        Args:
            node: publishes; the name of each status is the node's and the robot's.
            collect: returns the reports at a time, ns; nothing is published when there is none.
        """
        self._node, self._collect = node, collect
        self._publisher = node.create_publisher(
            interfaces.DIAGNOSTICS_KIND, interfaces.DIAGNOSTICS, interfaces.DIAGNOSTICS_QOS
        )
        node.create_timer(PERIOD, self._publish)

    def _publish(self) -> None:
        now = self._node.get_clock().now().nanoseconds
        statuses = [
            messages.diagnostic_status(
                f"{self._node.get_name()}: {report.robot}", report.hardware, report.level.value, report.text,
                report.values,
            )
            for report in self._collect(now)
        ]  # fmt: skip
        if statuses:
            self._publisher.publish(messages.diagnostics_message(now, statuses))
