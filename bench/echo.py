"""A bare rclpy node with the controller's traffic: it stores the poses, and at every tick publishes what it has ready.

Same topics, types, qualities of service, executor and signal handling; nothing is computed.
"""

from __future__ import annotations

import sys

from geometry_msgs.msg import Twist

from flatsat_ros.nodes.ros import interfaces, messages, runtime


class Echo(runtime.ProgramNode):
    """Poses in, a command and a telemetry row per drone out."""

    def __init__(self) -> None:
        super().__init__("echo")
        robots = self.declare_parameter("robot_names", ["cf1"]).value
        raw = self.declare_parameter("raw", True).value
        period = self.declare_parameter("period", 0.1).value
        self._poses = [None] * len(robots)
        self._command, self._telemetry = Twist(), messages.telemetry_message()
        self._publishers_of = []
        for index, robot in enumerate(robots):
            pose = interfaces.POSE
            self.create_subscription(
                pose.kind, pose.of(robot), lambda data, index=index: self._store(index, data), pose.subscribe, raw=raw
            )
            self._publishers_of.append([
                self.create_publisher(topic.kind, topic.of(robot), topic.publish)
                for topic in (interfaces.COMMAND, interfaces.TELEMETRY)
            ])  # fmt: skip
        self.create_timer(period, self._on_tick)

    def _store(self, index: int, pose: object) -> None:
        self._poses[index] = pose

    def _on_tick(self) -> None:
        for command, telemetry in self._publishers_of:
            command.publish(self._command)
            telemetry.publish(self._telemetry)


if __name__ == "__main__":
    sys.exit(runtime.run(Echo))
