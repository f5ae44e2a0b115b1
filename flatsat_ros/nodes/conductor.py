"""The demo's own node: gives the drones their references and records every message as it came."""

from __future__ import annotations

from collections.abc import Sequence

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from flatsat_ros.core.reference import Trajectory
from flatsat_ros.core.vehicle import VehicleProfile
from flatsat_ros.core.wire import input_from_setpoint
from flatsat_ros.nodes import interfaces, messages
from flatsat_ros.nodes.bag import Recorded
from flatsat_ros.nodes.interfaces import Topic

_RECORDED = (interfaces.POSE, interfaces.COMMAND, interfaces.TELEMETRY, interfaces.GOAL, interfaces.TRAJECTORY)


class Conductor(Node):  # type: ignore[misc]
    """Publishes references, records all topics of the robots.

    Attributes:
        recorded: all messages so far, in order of arrival.
    """

    def __init__(self, robots: Sequence[str], namespace: str) -> None:
        """Connect to the topics of the robots below the namespace."""
        super().__init__("flatsat_demo", namespace=namespace)
        self._robots = list(robots)
        self.recorded: list[Recorded] = []
        self._heard: set[str] = set()
        self._goals = [self.create_publisher(interfaces.GOAL.kind, interfaces.GOAL.of(r), interfaces.GOAL.publish) for r in robots]
        self._trajectories = [
            self.create_publisher(interfaces.TRAJECTORY.kind, interfaces.TRAJECTORY.of(r), interfaces.TRAJECTORY.publish)
            for r in robots
        ]
        for robot in robots:
            for topic in _RECORDED:
                self._record(topic, robot)

    def _record(self, topic: Topic, robot: str) -> None:
        name = topic.of(robot)
        package, _, kind = topic.kind.__module__.split(".")[0], "msg", topic.kind.__name__
        full_name, full_kind = f"{self.get_namespace()}/{name}", f"{package}/msg/{kind}"

        def keep(data: bytes) -> None:
            self.recorded.append(Recorded(self.now(), full_name, full_kind, data))
            self._heard.add(name)

        self.create_subscription(topic.kind, name, keep, topic.subscribe, raw=True)

    def now(self) -> int:
        """Return the time, ns."""
        return int(self.get_clock().now().nanoseconds)

    def occupied(self) -> bool:
        """Tell whether somebody else already publishes poses or listens for goals under these names."""
        return any(
            self.count_publishers(interfaces.POSE.of(r)) or self.count_subscribers(interfaces.GOAL.of(r)) > 1
            for r in self._robots
        )

    def missing(self) -> list[str]:
        """Return what has not been heard of yet: topics without a message, references without a listener."""
        silent = [
            topic.of(robot)
            for robot in self._robots
            for topic in (interfaces.POSE, interfaces.TELEMETRY)
            if topic.of(robot) not in self._heard
        ]
        # our own recording is one of the listeners
        deaf = [
            topic.of(robot)
            for robot in self._robots
            for topic in (interfaces.GOAL, interfaces.TRAJECTORY)
            if self.count_subscribers(topic.of(robot)) < 2
        ]
        unflown = [r for r in self._robots if self.count_subscribers(interfaces.COMMAND.of(r)) < 2]
        return silent + deaf + [interfaces.COMMAND.of(r) for r in unflown]

    def send_goal(self, index: int, position: Sequence[float]) -> None:
        """Send a set-point, m, world frame, to one robot."""
        message = PoseStamped()
        message.header.frame_id = "world"
        messages.fill_pose(message, self.now(), position, (0.0, 0.0, 0.0, 1.0))
        self._goals[index].publish(message)

    def send_trajectory(self, index: int, trajectory: Trajectory, start: int) -> None:
        """Send a trajectory whose times count from start, ns."""
        self._trajectories[index].publish(messages.message_from_trajectory(trajectory, start))


def poses_of(recorded: Sequence[Recorded], topic: str, origin: int) -> list[list[float]]:
    """Return [stamp s after origin, x, y, z] of each recorded pose of a topic."""
    rows = []
    for entry in recorded:
        if entry.topic == topic:
            stamp, position, _ = messages.pose_from_cdr(entry.data)
            rows.append([(stamp - origin) / messages.NANOSECONDS, *position])
    return rows


def ticks_of(recorded: Sequence[Recorded], topic: str, origin: int) -> list[list[float]]:
    """Return [arrival s after origin, telemetry...] of each recorded telemetry message of a topic."""
    kind = interfaces.TELEMETRY.kind
    return [
        [(entry.time - origin) / messages.NANOSECONDS, *deserialize_message(entry.data, kind).data]
        for entry in recorded
        if entry.topic == topic
    ]


def commands_of(
    recorded: Sequence[Recorded], topic: str, origin: int, vehicle: VehicleProfile
) -> list[list[float]]:
    """Return [arrival s after origin, T, phi, theta, yaw rate] of each recorded command of a topic."""
    kind = interfaces.COMMAND.kind
    return [
        [
            (entry.time - origin) / messages.NANOSECONDS,
            *input_from_setpoint(messages.command_from_message(deserialize_message(entry.data, kind)), vehicle),
        ]
        for entry in recorded
        if entry.topic == topic
    ]
