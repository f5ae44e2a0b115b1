"""Stands between simulated drones and a controller, and lets poses and commands through with faults.

What the drones publish below `sim/` it publishes without that prefix, and the commands the other way round. Parameters
switch one fault of the poses and one of the commands on and off, for the robots of `faulty`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare, declare_robots
from flatsat_ros.nodes.ros.runtime import ProgramNode, run
from flatsat_ros.sim import faults
from flatsat_ros.sim.faults import CommandFault, PoseFault
from flatsat_ros.sim.sensor import Sample

UPSTREAM = "sim"  # the drones' own topics are below it
_PERIOD = 0.005  # s, between two looks for samples that were held back
_ODD = b"\x00\x01\x02\x03\x04\x05\x06\x07"

# a fault of poses by its name; what has none changes the message and not the sample
POSE_FAULTS: dict[str, Callable[[], PoseFault] | None] = {
    "": None,
    "lost": lambda: faults.lost,
    "late": lambda: faults.delayed(0.2),
    "repeated": faults.repeated,
    "zero": faults.zeroed,
    "nan": faults.without_position,
    "second_source": lambda: faults.doubled((0.0, 1.0, 0.0), 0.5, 0.5),
    "ahead": lambda: faults.restamped(0.5),
    "frame": None,
    "bytes": None,
}
COMMAND_FAULTS: dict[str, Callable[..., CommandFault] | None] = {
    "": None,
    "lost": partial(faults.commands_lost, 1.0, 0),
    "late": partial(faults.commands_delayed, 0.2),
}


class FaultRelay(ProgramNode):
    """Relays the poses and commands of some robots."""

    def __init__(self) -> None:
        """Read the parameters and connect."""
        super().__init__("fault_relay")
        self._robots = [robot.name for robot in declare_robots(self)]
        self._names = {
            name: declare(self, name, default, meaning, changeable=True)
            for name, default, meaning in (
                ("faulty", self._robots[0], "the robot that has the faults, or all"),
                ("pose_fault", "", f"one of {', '.join(filter(None, POSE_FAULTS))}; empty: none"),
                ("command_fault", "", f"one of {', '.join(filter(None, COMMAND_FAULTS))}; empty: none"),
            )
        }
        self._origin = self.get_clock().now().nanoseconds
        self._pose_fault: PoseFault | None = None
        self._command_fault: CommandFault | None = None
        self._late: list[tuple[float, int, WireSetpoint]] = []  # in the order in which they are due
        pose, command = interfaces.POSE, interfaces.COMMAND
        self._poses = [self.create_publisher(pose.kind, pose.of(robot), pose.publish) for robot in self._robots]
        self._others: list[Publisher] = []  # of a second source
        self._commands = []
        for index, robot in enumerate(self._robots):
            own = f"{UPSTREAM}/{robot}"
            self._commands.append(self.create_publisher(command.kind, command.of(own), command.publish))
            self.create_subscription(pose.kind, pose.of(own), partial(self._on_pose, index), pose.subscribe)
            self.create_subscription(
                command.kind, command.of(robot), partial(self._on_command, index), command.subscribe
            )
        self.create_timer(_PERIOD, self._send_late)
        self.add_on_set_parameters_callback(self._change)

    def _change(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Take other faults, if there are such."""
        names = {**self._names, **{parameter.name: parameter.value for parameter in parameters}}
        valid = {"faulty": [*self._robots, interfaces.ALL], "pose_fault": POSE_FAULTS, "command_fault": COMMAND_FAULTS}
        for name, words in valid.items():
            if names[name] not in words:
                return messages.parameters_answer(f"{name} = {names[name]!r}: must be one of {', '.join(words)}")
        self._names = names
        make, make_command = POSE_FAULTS[names["pose_fault"]], COMMAND_FAULTS[names["command_fault"]]
        self._pose_fault = None if make is None else make()
        self._command_fault = None if make_command is None else make_command(*self._faulty)
        if names["pose_fault"] == "second_source" and not self._others:
            pose = interfaces.POSE
            self._others = [self.create_publisher(pose.kind, pose.of(robot), pose.publish) for robot in self._robots]
        return messages.parameters_answer()

    @property
    def _faulty(self) -> list[int]:
        name = self._names["faulty"]
        return [index for index, robot in enumerate(self._robots) if name in (robot, interfaces.ALL)]

    @property
    def _now(self) -> float:
        """Time since the start, s."""
        return float(self.get_clock().now().nanoseconds - self._origin) / messages.NANOSECONDS

    def _on_pose(self, index: int, message: PoseStamped) -> None:
        if index not in self._faulty:
            self._poses[index].publish(message)
            return
        name = self._names["pose_fault"]
        if name == "bytes":
            self._poses[index].publish(_ODD)
        if name == "frame":
            messages.set_frame(message, "odom")
        if self._pose_fault is None:
            self._poses[index].publish(message)
            return
        stamp, position, quaternion = messages.pose_from_message(message)
        seconds = (stamp - self._origin) / messages.NANOSECONDS
        self._publish(self._pose_fault(self._now, [Sample(seconds, index, np.array(position), np.array(quaternion))]))

    def _publish(self, samples: Sequence[Sample]) -> None:
        for number, sample in enumerate(samples):
            message = messages.pose_message()
            stamp = self._origin + round(sample.stamp * messages.NANOSECONDS)
            messages.fill_pose(message, max(stamp, 0), sample.position, sample.quaternion)
            # of a pair the second sample is the second source's
            publishers = self._others if number % 2 and self._others else self._poses
            publishers[sample.drone].publish(message)

    def _on_command(self, index: int, message: Twist) -> None:
        if self._command_fault is None or index not in self._faulty:
            self._commands[index].publish(message)
            return
        setpoint = messages.command_from_message(message)
        now = self._now
        self._late += [(now + delay, index, each) for delay, each in self._command_fault(now, index, setpoint)]

    def _send_late(self) -> None:
        """Send what was held back until now."""
        now = self._now
        if self._pose_fault is not None:
            self._publish(self._pose_fault(now, []))
        while self._late and self._late[0][0] <= now:
            _, index, setpoint = self._late.pop(0)
            message = Twist()
            messages.fill_command(message, setpoint)
            self._commands[index].publish(message)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the relay."""
    return run(FaultRelay, argv)


if __name__ == "__main__":
    sys.exit(main())
