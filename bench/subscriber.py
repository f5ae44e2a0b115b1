"""A bare rclpy node that hears what the console shows, keeps the newest messages and does nothing else."""

from __future__ import annotations

import sys
from functools import partial

from flatsat_ros.nodes.ros import interfaces, runtime


class Subscriber(runtime.ProgramNode):
    """Poses, telemetry and batteries, as bytes."""

    def __init__(self) -> None:
        super().__init__("subscriber")
        self._newest: dict[str, bytes] = {}
        for robot in self.declare_parameter("robot_names", ["cf1"]).value:
            for topic in (interfaces.POSE, interfaces.TELEMETRY, interfaces.BATTERY):
                name = topic.of(robot)
                take = partial(self._newest.__setitem__, name)
                self.create_subscription(topic.kind, name, take, topic.subscribe, raw=True)


if __name__ == "__main__":
    sys.exit(runtime.run(Subscriber))
