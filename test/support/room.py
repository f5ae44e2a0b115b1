"""A room with two simulated drones and their controller, in this process and on simulated time.

Node, pilot and callbacks are the real ones; the clocks are the test's, the drones simulated, and the messages are
handed to the subscriptions as bytes, as rclpy would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.stamps import StampClock
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.flight_report import ThrottledLog
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.messages import NANOSECONDS
from flatsat_ros.sim.fleet import SimulatedFleet

EPOCH = 1_700_000_000 * NANOSECONDS


class Wire:
    """Takes the place of a publisher of set-points: hands them to a drone and remembers them."""

    def __init__(self, take: Callable[[WireSetpoint], None]) -> None:
        self.sent: list[WireSetpoint] = []
        self._take = take

    def publish(self, message: Twist) -> None:
        setpoint = messages.command_from_message(message)
        assert np.isfinite(setpoint).all()
        self.sent.append(setpoint)
        self._take(setpoint)

    def wait_for_all_acked(self, _: object) -> bool:
        return True

    def get_subscription_count(self) -> int:
        return 1


class Room:
    """Two simulated drones, 1 m apart, and their controller.

    Attributes:
        node: the controller.
        fleet: the drones.
        set_by: by how much the ROS clock has been set, ns.
        frame: frame_id of the poses.
        blind: drones whose poses are not seen.
    """

    def __init__(self, *arguments: str) -> None:
        rclpy.init(args=["controller", "--ros-args", "-p", "robot_names:=[cf1, cf2]", *arguments])
        self.node = ControllerNode()
        self.fleet = SimulatedFleet(load_vehicle("cf21"), 2, start=[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        self.period = self.node._certificate.period
        self._ticks, self.set_by, self.frame, self.blind = 0, 0, "world", set()  # type: ignore[var-annotated]
        self.node._stamps = StampClock(2, lambda: EPOCH + self.set_by + self._steady(), self._steady)
        self.node._log = ThrottledLog(self.node.get_logger(), lambda: self._ticks * self.period)
        self.node._commands.last_resort._clock = self.node._rivals._clock = lambda: self._ticks * self.period
        self.wires = [Wire(lambda s, i=i: self.fleet.command(i, *s)) for i in (0, 1)]  # type: ignore[misc]
        self.node._commands._publishers = self.wires  # type: ignore[assignment]
        self._callbacks = {s.topic_name: s.callback for s in self.node.subscriptions}

    def _steady(self) -> int:
        return round(self._ticks * self.period * NANOSECONDS)

    @property
    def modes(self) -> list[Mode]:
        return [Mode(mode) for mode in self.node._pilot.mode]

    def deliver(self, topic: str, data: Any) -> None:
        """Hand a message to the controller: its bytes, or itself where it is read with its fields."""
        self._callbacks[f"/{topic}"](data)

    def goal(self, robot: str, *position: float) -> None:
        message = PoseStamped()
        messages.fill_pose(message, 0, position, (0.0, 0.0, 0.0, 1.0))
        self.deliver(f"{robot}/goal_pose", serialize_message(message))

    def ask(self, name: str, kind: type[Any] = Trigger, **fields: object) -> Any:
        """Call a service of the controller."""
        (serve,) = [s.callback for s in self.node.services if s.srv_name == name]
        return serve(kind.Request(**fields), kind.Response())

    def run(self, seconds: float) -> np.ndarray:
        """Let time pass; return the drones' heights (M, 2), m, at the ticks."""
        heights = []
        for _ in range(round(seconds / self.period)):
            self._ticks += 1
            now = self._ticks * self.period
            self.fleet.advance_to(now)
            for sample in self.fleet.measurements(now):
                if sample.drone not in self.blind:
                    message = PoseStamped()
                    message.header.frame_id = self.frame
                    stamp = EPOCH + self.set_by + round(sample.stamp * NANOSECONDS)
                    messages.fill_pose(message, stamp, sample.position, sample.quaternion)
                    self.deliver(f"cf{sample.drone + 1}/pose", serialize_message(message))
            self.node._on_tick()
            heights.append(self.fleet.bodies.position[:, 2].copy())
        return np.array(heights)

    def hover(self, *robots: str) -> None:
        """Take drones up to 1 m."""
        self.run(0.5)
        for robot in robots:
            self.goal(robot, float(robot == "cf2"), 0.0, 1.0)
        self.run(7.0)
        assert all(abs(self.fleet.bodies.position[int(robot[2]) - 1, 2] - 1.0) < 0.1 for robot in robots)

    def impact(self, seconds: float) -> list[float]:
        """Let time pass until both drones stand; return how fast each came down at last, m/s."""
        speeds = [0.0, 0.0]
        for _ in range(round(seconds / self.period)):
            falling = -self.fleet.bodies.velocity[:, 2]
            self.run(self.period)
            for drone in (0, 1):
                if not self.fleet.bodies.grounded[drone]:
                    speeds[drone] = float(falling[drone])
        assert self.fleet.bodies.grounded.all()
        return speeds


def pose(position: Sequence[float], quaternion: Sequence[float], frame: str = "world", stamp: int = 0) -> bytes:
    message = PoseStamped()
    message.header.frame_id = frame
    messages.fill_pose(message, stamp, position, quaternion)
    return serialize_message(message)


@contextmanager
def rooms() -> Iterator[Callable[..., Room]]:
    """Lend a way to make rooms, by the arguments of their controllers; they are left at the end."""
    made: list[Room] = []

    def make(*arguments: str) -> Room:
        made.append(Room(*arguments))
        return made[-1]

    try:
        yield make
        for each in made:
            each.node.destroy_node()
    finally:
        rclpy.try_shutdown()
