"""The demo's own node: has the drones take off, gives them references, lands them and records every message."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import rclpy
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.interrupts import signals_held
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import input_from_setpoint
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.ros import cdr, interfaces, messages
from flatsat_ros.nodes.ros.bag import Recorded
from flatsat_ros.nodes.ros.interfaces import Topic

_RECORDED = (interfaces.POSE, interfaces.COMMAND, interfaces.TELEMETRY, interfaces.GOAL, interfaces.TRAJECTORY)
# what the controller is asked for, by name
_REQUESTS = {
    interfaces.ARM: (SetBool, messages.arming_request(SetBool, True)),
    "takeoff": (Trigger, Trigger.Request()),
    "land": (Trigger, Trigger.Request()),
}
MODE = FIELDS.index("mode")
# how the controller's log says when a plan begins, see `plans.performance`
_PLAN_BEGINS = re.compile(rb"the plan is flown from (\d+\.\d+) s on")
_LOG_KIND = "rcl_interfaces/msg/Log"


class Conductor(Node):
    """Asks for take-off and landing, publishes references, records all topics of the robots.

    Attributes:
        recorded: all messages so far, in order of arrival.
    """

    def __init__(
        self, robots: Sequence[str], namespace: str, executor: Executor, deliver_signals: Callable[[], None]
    ) -> None:
        """Connect to the topics of the robots.

        Args:
            robots: names.
            namespace: below which they are.
            executor: through which messages come in.
            deliver_signals: called whenever they have.
        """
        super().__init__("flatsat_demo", namespace=namespace)
        self._robots = list(robots)
        self._executor = executor
        self._deliver_signals = deliver_signals
        self.recorded: list[Recorded] = []
        self._newest: dict[str, bytes] = {}  # message by topic
        goal, trajectory = interfaces.GOAL, interfaces.TRAJECTORY
        self._goals = [self.create_publisher(goal.kind, goal.of(robot), goal.publish) for robot in robots]
        self._trajectories = [
            self.create_publisher(trajectory.kind, trajectory.of(robot), trajectory.publish) for robot in robots
        ]
        asked = [(interfaces.ALL, name) for name in _REQUESTS] + [(robot, "takeoff") for robot in robots]
        self._lifecycle = {
            (who, name): self.create_client(_REQUESTS[name][0], interfaces.service_of(who, name)) for who, name in asked
        }
        self._plan = self.create_client(Trigger, "plan/start")
        for robot in robots:
            for topic in _RECORDED:
                self.record(topic, topic.of(robot))
        self.record(interfaces.SETUP, interfaces.SETUP.suffix)
        self.record(interfaces.MARKERS, interfaces.MARKERS.suffix)
        # loggers are named after their nodes, with dots: of others in this domain nothing is kept
        self.record(interfaces.LOG, interfaces.LOG.suffix, f"{namespace.strip('/')}.".encode())

    def record(self, topic: Topic, name: str, mark: bytes = b"") -> None:
        """Record the messages of a topic, by its name; of those that contain a mark, if one is given."""
        full_name = self.resolve_topic_name(name)
        full_kind = f"{topic.kind.__module__.split('.')[0]}/msg/{topic.kind.__name__}"

        def keep(data: bytes) -> None:
            if mark in data:
                self.recorded.append(Recorded(self.now(), full_name, full_kind, data))
                self._newest[name] = data

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
        """Return what is not there yet: topics without a message, references without a listener, services."""
        silent = [
            topic.of(robot)
            for robot in self._robots
            for topic in (interfaces.POSE, interfaces.TELEMETRY)
            if topic.of(robot) not in self._newest
        ]
        # our own recording is one of the listeners
        deaf = [
            topic.of(robot)
            for robot in self._robots
            for topic in (interfaces.GOAL, interfaces.TRAJECTORY)
            if self.count_subscribers(topic.of(robot)) < 2
        ]
        unflown = [r for r in self._robots if self.count_subscribers(interfaces.COMMAND.of(r)) < 2]
        unserved = [client.srv_name for client in self._lifecycle.values() if not client.service_is_ready()]
        return silent + deaf + [interfaces.COMMAND.of(r) for r in unflown] + unserved

    def away(self, places: FloatArray, distance: float) -> list[str]:
        """Return the robots whose newest pose is farther than the distance, m, from their place (N, 3), m."""
        positions = [cdr.pose_from_cdr(self._newest[interfaces.POSE.of(r)])[1] for r in self._robots]
        far = np.linalg.norm(np.array(positions) - places, axis=1) > distance
        return [robot for robot, is_far in zip(self._robots, far, strict=True) if is_far]

    def robots_in(self, *modes: Mode) -> list[str]:
        """Return the robots whose newest telemetry reports one of these flight modes."""
        rows = {robot: _row(self._newest[interfaces.TELEMETRY.of(robot)]) for robot in self._robots}
        return [robot for robot, row in rows.items() if row[MODE] in modes]

    def ask(self, name: str, who: str = interfaces.ALL) -> Future:
        """Ask the controller to arm, takeoff or land; the answer comes in while spinning."""
        return self._lifecycle[who, name].call_async(_REQUESTS[name][1])

    def start_plan(self) -> Future:
        """Ask the controller to start its plan; the answer comes in while spinning."""
        return self._plan.call_async(Trigger.Request())

    def plan_began(self) -> int | None:
        """Return when the references of the plan begin, ns, as the controller's log says; None before it does."""
        for entry in reversed(self.recorded):
            found = _PLAN_BEGINS.search(entry.cdr) if entry.kind == _LOG_KIND else None
            if found is not None:
                # from when that was said, not from when it was heard: drones move by a millimetre in one millisecond
                said = messages.nanoseconds_from_stamp(deserialize_message(entry.cdr, interfaces.LOG.kind).stamp)
                return said + round(float(found[1]) * messages.NANOSECONDS)
        return None

    def refusal(self, answer: Future) -> str:
        """Return why the controller refused what it was asked for, nothing if it did not; the answer must be there."""
        return messages.refusal_from_answer(answer.result())

    def send_goal(
        self, index: int, position: Sequence[float], orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
    ) -> None:
        """Send a set-point, m, world frame, with an orientation x, y, z, w to one robot."""
        message = messages.pose_message()
        messages.fill_pose(message, self.now(), position, orientation)
        self._goals[index].publish(message)

    def send_trajectory(self, index: int, trajectory: Trajectory, start: int) -> None:
        """Send a trajectory whose times count from start, ns."""
        self._trajectories[index].publish(messages.message_from_trajectory(trajectory, start))

    def spin(self, seconds: float) -> None:
        """Let messages come in for at least the given time."""
        end = self.now() + round(seconds * messages.NANOSECONDS)
        while self.now() < end:
            self._executor.spin_once(timeout_sec=seconds)
            self._deliver_signals()

    def seconds(self, nanoseconds: int) -> float:
        """Return a time as seconds after the first recorded message."""
        return (nanoseconds - self.recorded[0].time) / messages.NANOSECONDS

    def poses(self, robot: str) -> FloatArray:
        """Return the recorded poses of a robot, (n, 4): stamp s, x, y, z m."""
        read = [(cdr.pose_from_cdr(entry.cdr)) for entry in self._of(interfaces.POSE, robot)]
        return np.array([[self.seconds(stamp), *position] for stamp, position, _ in read])

    def ticks(self, robot: str) -> FloatArray:
        """Return the recorded telemetry of a robot, (n, 1 + fields): arrival s, row."""
        read = [(e.time, _row(e.cdr)) for e in self._of(interfaces.TELEMETRY, robot)]
        return np.array([[self.seconds(when), *row] for when, row in read])

    def commands(self, robot: str, vehicle: VehicleProfile) -> FloatArray:
        """Return the recorded commands of a robot, (n, 5): arrival s, T m/s^2, phi, theta rad, yaw rate rad/s."""
        topic = interfaces.COMMAND
        read = [
            (e.time, messages.command_from_message(deserialize_message(e.cdr, topic.kind)))
            for e in self._of(topic, robot)
        ]
        return np.array([[self.seconds(when), *input_from_setpoint(setpoint, vehicle)] for when, setpoint in read])

    def _of(self, topic: Topic, robot: str) -> list[Recorded]:
        name = f"{self.get_namespace()}/{topic.of(robot)}"
        return [entry for entry in self.recorded if entry.topic == name]


def _row(data: bytes) -> FloatArray:
    """Return a row of telemetry from its serialised message."""
    return messages.telemetry_from_message(deserialize_message(data, interfaces.TELEMETRY.kind))


C = TypeVar("C", bound=Conductor)


@contextmanager
def conducting(robots: Sequence[str], namespace: str, make: type[C]) -> Iterator[C]:
    """Run a conductor in this process; signals that stop it are delivered where messages are let in.

    Raised wherever it comes, an exception can get lost, as in a finalizer: a demo once flew on.

    Args:
        robots: names.
        namespace: below which they are.
        make: which conductor.

    Raises:
        FlatsatError: ROS does not start as it is set up.
    """
    with signals_held() as deliver:
        try:
            rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:  # RCLError, as of a ROS_DOMAIN_ID that is no number
            raise FlatsatError(f"ROS does not start: {error}") from error
        executor = EventsExecutor()
        try:
            conductor = make(robots, namespace, executor, deliver)
            executor.add_node(conductor)
            try:
                yield conductor
            finally:
                Node.destroy_node(conductor)
        finally:
            executor.shutdown()
            rclpy.try_shutdown()
