"""The laboratory of the multi-node tests: real processes in a ROS domain of each test's own, and an observer.

Nothing sleeps for correctness: a test waits for conditions, each with a deadline that only a broken node reaches.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint, input_from_setpoint
from flatsat_ros.flight.estimator import PREDICTION_MAX
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.law.flatness import acceleration_from_input
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.interfaces import Topic

DEADLINE = 40.0  # s
GOODBYE = 20.0  # s, for a process that was told to stop
CLEARING = 0.5  # s, for the processes that a test leaves behind
# How near its goal the controller keeps a drone, m, at the rate of its default certificate and with what disturbs it
# compensated: 3 mm, and 3 cm where poses have 1 mm of noise (test/sim/test_lifecycle.py measures both); the rest is for
# the pauses of a busy machine.
NEAR = 0.05
# the observer loses nothing that comes between two looks
KEEP = QoSProfile(depth=2000)

_PRIORITY = -10  # niceness

# On a busy machine Fast DDS's five first announcements can all be missed, and the next one comes only after 3 s. What
# was killed is forgotten after 20 s; here after 8 s, longer than any process is stopped.
_DISCOVERY = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="eager" is_default_profile="true"><rtps><builtin><discovery_config>
    <leaseDuration><sec>8</sec></leaseDuration><leaseAnnouncement><sec>2</sec></leaseAnnouncement>
    <initialAnnouncements><count>50</count><period><sec>0</sec><nanosec>100000000</nanosec></period></initialAnnouncements>
  </discovery_config></builtin></rtps></participant>
</profiles>
"""


def position(pose: PoseStamped) -> tuple[float, float, float]:
    """Return the position of a pose, m."""
    p = pose.pose.position
    return p.x, p.y, p.z


class Process:
    """One executable of the package, running.

    Attributes:
        name: of the executable.
        expected: whether it may end, by a signal or by itself with exit code 0.
    """

    def __init__(self, executable: Path, arguments: Sequence[str], log: Path) -> None:
        self.name = executable.name
        self.expected = False
        self._log = log
        with log.open("wb") as stream:
            self._popen = subprocess.Popen(
                [executable, *arguments], stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT
            )
        # flights are in real time: where it may be asked for, they come before whatever else the machine does
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, self._popen.pid, _PRIORITY)

    @property
    def output(self) -> str:
        """What it wrote so far."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    @property
    def returncode(self) -> int | None:
        """The exit code, None while it runs."""
        return self._popen.poll()

    def send(self, number: signal.Signals) -> None:
        """Send it a signal; after one that may end it, it may be gone."""
        self.expected = self.expected or number not in (signal.SIGSTOP, signal.SIGCONT)
        self._popen.send_signal(number)

    def wait(self) -> int:
        """Return the exit code of a process that is about to end."""
        self.expected = True
        return self._popen.wait(GOODBYE)

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Tell it to stop and return its exit code."""
        self.send(number)
        return self.wait()

    def tell_to_end(self) -> None:
        """Let it end, also if it is stopped; that it does is the subject of other tests."""
        if self.returncode is None:
            self._popen.send_signal(signal.SIGCONT)
            self._popen.terminate()

    def end(self, latest: float) -> None:
        """Make sure that it is gone, by a time on the monotonic clock, s."""
        try:
            self._popen.wait(max(latest - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()


class Lab:
    """Processes, and a node of the test's that watches and asks.

    Attributes:
        node: the observer.
        certificate, vehicle: what the controller flies with if a test says nothing else.
        near: how near its goal it keeps a drone, m.
    """

    near = NEAR

    def __init__(self, executables: Path, folder: Path) -> None:
        self.certificate = load_certificate("paper_experiment")
        self.vehicle = load_vehicle("cf21")
        self._executables = executables
        self._folder = folder
        self._processes: list[Process] = []
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, AsyncParameterClient] = {}
        self._flown: set[str] = set()  # by a controller
        self._linked: set[str] = set()
        self._overheard: set[str] = set()  # whose commands the observer itself listens to
        self._services: dict[tuple[type[Any], str], Any] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("observer", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._begin = time.monotonic()
        self._story: dict[str, list[str]] = {}
        self.node.create_subscription(interfaces.DIAGNOSTICS_KIND, interfaces.DIAGNOSTICS, self._follow, KEEP)

    def _follow(self, diagnostics: Any) -> None:
        """Note what changed in the condition of every drone, for whoever reads about a failure."""
        for status in diagnostics.status:
            story = self._story.setdefault(status.name, [])
            if not story or not story[-1].endswith(status.message):
                story.append(f"{time.monotonic() - self._begin:.1f} s {status.message}")

    def close(self) -> None:
        """End every process and print what it wrote: pytest shows it if the test failed."""
        for name, story in self._story.items():
            print(f"--- {name}: {', '.join(story)}")
        for process in self._processes:
            process.tell_to_end()
        end = time.monotonic() + CLEARING
        for process in self._processes:
            process.end(end)
            print(f"--- {process.name}, exit code {process.returncode}\n{process.output}")
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def start(self, executable: str, **parameters: object) -> Process:
        """Start an executable with ROS parameters; `__` in a name stands for a dot."""
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value).replace("'", "")
            arguments += ["-p", f"{name.replace('__', '.')}:={text}"]
        return self.run(self._executables / executable, *arguments)

    def run(self, executable: Path, *arguments: str) -> Process:
        """Start an executable of others'."""
        log = self._folder / f"{len(self._processes)}_{executable.name}.log"
        process = Process(executable, arguments, log)
        self._processes.append(process)
        return process

    def wait(self, condition: Callable[[], object], what: str, deadline: float = DEADLINE) -> None:
        """Take messages in until the condition holds; fail at the deadline or when a process ends unexpectedly."""
        end = time.monotonic() + deadline
        while not condition():
            for process in self._processes:
                code = process.returncode
                if code is not None and not (process.expected and code <= 0):
                    pytest.fail(f"{process.name} ended with exit code {code} while waiting for {what}")
            if time.monotonic() > end:
                pytest.fail(f"not within {deadline:g} s: {what}")
            self._executor.spin_once(timeout_sec=0.05)

    def listen(self, seconds: float) -> None:
        """Take messages in for a while: for what must not happen."""
        end = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() >= end, "time to pass", 2.0 * seconds + DEADLINE)

    def watch(self, topic: Topic, robot: str) -> list[Any]:
        """Return a list to which every message of the topic is added as it comes."""
        seen: list[Any] = []
        self.node.create_subscription(topic.kind, topic.of(robot), seen.append, KEEP)
        if topic is interfaces.COMMAND:
            self._overheard.add(robot)
        return seen

    def watch_diagnostics(self, name: str) -> list[Any]:
        """Return a list to which every diagnostic status of that name is added."""
        seen: list[Any] = []

        def take(message: Any) -> None:
            seen.extend(status for status in message.status if status.name == name)

        self.node.create_subscription(interfaces.DIAGNOSTICS_KIND, interfaces.DIAGNOSTICS, take, KEEP)
        return seen

    def publish(self, topic: Topic, robot: str, message: Any) -> None:
        """Publish, once somebody listens."""
        self._publisher(topic, robot).publish(message)

    def stream(self, robot: str, command: WireSetpoint, frequency: float = 20.0) -> Timer:
        """Send a command over and over; return the timer that does it, to cancel."""
        publisher, message = self._publisher(interfaces.COMMAND, robot), Twist()
        messages.fill_command(message, command)
        publisher.publish(message)
        return self.node.create_timer(1.0 / frequency, lambda: publisher.publish(message))

    def withdraw(self, topic: Topic, robot: str) -> None:
        """Publish no more, so that another may be the only one who does."""
        self.node.destroy_publisher(self._publishers.pop(topic.of(robot)))

    def _publisher(self, topic: Topic, robot: str) -> Any:
        """Return a publisher to which somebody listens."""
        name = topic.of(robot)
        if name not in self._publishers:
            self._publishers[name] = self.node.create_publisher(topic.kind, name, topic.publish)
        self.wait(self._publishers[name].get_subscription_count, f"a listener to {name}")
        return self._publishers[name]

    def go_to(self, robot: str, position: Sequence[float], *, linked: bool = True) -> None:
        """Give a robot a set-point, m; if linked, once it listens: the first commands open its thrust lock."""
        if linked:
            self._wait_for_link(robot)
        message = PoseStamped()
        messages.fill_pose(message, 0, position, (0.0, 0.0, 0.0, 1.0))
        self.publish(interfaces.GOAL, robot, message)

    def take_off(self, *robots: str) -> None:
        """Send robots up through the service, once they listen and the controller knows their poses."""
        for robot in robots:
            self._wait_for_link(robot)
        for robot in robots:
            name = interfaces.service_of(robot, "takeoff")
            self.wait(lambda name=name: self.ask(Trigger, name).success, f"{robot} to take off")

    def land(self, *robots: str) -> None:
        """Land robots through the service and wait until the controller leaves them in peace on the ground."""
        telemetry = {robot: self.watch(interfaces.TELEMETRY, robot) for robot in robots}
        for robot in robots:
            answer = self.ask(Trigger, interfaces.service_of(robot, "land"))
            assert answer.success, answer.message
        for robot, seen in telemetry.items():

            def rests(seen: list[Any] = seen) -> bool:
                modes = [message.data[FIELDS.index("mode")] for message in seen]
                return Mode.REST in modes and modes[-1] == Mode.IDLE

            self.wait(rests, f"{robot} to touch down and rest")

    def _wait_for_link(self, robot: str) -> None:
        """Wait until somebody else listens to a robot's commands."""
        self.wait(lambda: self._is_heard(robot), f"{robot} to listen to its commands")
        if robot not in self._linked:
            self._linked |= {other for other in {robot, *self._flown} if self._is_heard(other)}
            # the controller takes us for the drone that it waits for, before it knows the other listener
            if self._overheard & self._linked:
                self.listen(0.7)

    def _is_heard(self, robot: str) -> bool:
        listeners = {info.node_name for info in self.node.get_subscriptions_info_by_topic(interfaces.COMMAND.of(robot))}
        return bool(listeners - {self.node.get_name()})

    def set_parameters(self, values: dict[str, object], *, atomically: bool = False) -> list[tuple[bool, str]]:
        """Set parameters of the controller through its services; return (successful, reason) of each, or of all."""
        client = self.parameters_of(interfaces.CONTROLLER_NODE)
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        send = client.set_parameters_atomically if atomically else client.set_parameters
        result = self.answer(send(parameters))
        return [(r.successful, r.reason) for r in ([result.result] if atomically else result.results)]

    def get_parameters(self, *names: str) -> list[Any]:
        """Return values of the controller's parameters, None for one that is not set."""
        answer = self.answer(self.parameters_of(interfaces.CONTROLLER_NODE).get_parameters(names))
        return [parameter_value_to_python(value) for value in answer.values]

    def parameters_of(self, node: str) -> AsyncParameterClient:
        """Return a client of a node's parameter services, which are there."""
        if node not in self._clients:
            self._clients[node] = AsyncParameterClient(self.node, node)
        self._await_service(self._clients[node].services_are_ready, f"the parameter services of {node}")
        return self._clients[node]

    def _await_service(self, is_ready: Callable[[], bool], what: str) -> None:
        """Wait until requests arrive, and a little more: an answer gets lost while the server does not know us yet."""
        if not is_ready():
            self.wait(is_ready, what)
            self.listen(0.3)

    def answer(self, request: Future[Any]) -> Any:
        """Return the answer to a request."""
        self.wait(request.done, "the answer of a service")
        return request.result()

    def ask(self, kind: type[Any], name: str, **fields: object) -> Any:
        """Call a service, once it is there, and return its answer."""
        if (kind, name) not in self._services:
            self._services[kind, name] = self.node.create_client(kind, name)
        client = self._services[kind, name]
        self._await_service(client.service_is_ready, f"the service {name}")
        return self.answer(client.call_async(kind.Request(**fields)))

    def wait_for_flight(self, robot: str, poses: list[Any], goal: Sequence[float], tolerance: float = NEAR) -> None:
        """Wait until a robot has stayed near a goal, m, for a second, by the stamps of its poses."""
        second = 100  # poses

        def stays() -> bool:
            recent = np.array([position(pose) for pose in poses[-second:]])
            return len(recent) == second and bool((np.abs(recent - goal) <= tolerance).all())

        self.wait(stays, f"{robot} to stay within {tolerance} m of {goal}")

    def fly(self, *robots: str, **parameters: object) -> Process:
        """Start the controller for these robots; poses may be as late as it bears, for the stalls of a busy machine."""
        self._flown.update(robots)
        patient = {"robot_names": list(robots), "pose_timeout": PREDICTION_MAX, "certificate": "paper_experiment"}
        return self.start("controller", **{**patient, **parameters})

    def require_within_limits(self, commands: Sequence[Twist]) -> FloatArray:
        """Require that every command is finite and within the certificate's limits; return them as (M, 3) inputs."""
        assert commands
        setpoints = np.array([messages.command_from_message(command) for command in commands])
        assert np.isfinite(setpoints).all()
        assert (setpoints[:, 3] >= 0.0).all()
        assert (setpoints[:, 3] <= self.vehicle.pwm_max).all()
        inputs = np.array([input_from_setpoint(messages.command_from_message(c), self.vehicle)[:3] for c in commands])
        limits = self.certificate.limits
        rounding = 1e-9
        assert (inputs[:, 0] <= limits.thrust_max + rounding).all()
        v = acceleration_from_input(inputs, np.zeros(len(inputs)), limits.gravity)
        tilt = np.arctan2(np.hypot(v[:, 0], v[:, 1]), v[:, 2] + limits.gravity)
        assert (tilt <= limits.tilt_max + rounding).all()
        return inputs


@pytest.fixture(scope="session", autouse=True)
def eager_discovery(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let nodes find each other at once; a saving of time that nothing depends on."""
    profile = tmp_path_factory.mktemp("fastdds") / "profile.xml"
    profile.write_text(_DISCOVERY, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
        yield


@pytest.fixture
def lab(ros_domain: int, executables: Path, tmp_path: Path) -> Iterator[Lab]:
    """A laboratory that is empty again after the test."""
    laboratory = Lab(executables, tmp_path)
    try:
        yield laboratory
    finally:
        laboratory.close()


@pytest.fixture
def column() -> Callable[[Sequence[Any], str], FloatArray]:
    """How to read one field, (M,), from telemetry messages."""
    return lambda telemetry, field: np.array([message.data[FIELDS.index(field)] for message in telemetry])
