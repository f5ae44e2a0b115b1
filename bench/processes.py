"""The processor time of the controller against that of bare echo nodes, which hear the same poses at the same time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import psutil
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.files import make_folder
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import interfaces, messages

ROBOTS = ("cf1", "cf2", "cf3")
CONTROLLER, RAW_ECHO, TYPED_ECHO = "controller", "echo_raw", "echo_typed"
SELF = "poses (bench)"

POSE_RATE = 100.0  # Hz
_ROUNDS, _ROUND = 8, 3.0  # s
_DISCOVERY = 20.0  # s
_WARM_UP = 2.0  # s
_GOODBYE = 5.0  # s
# a process that does less than this share of its work cannot be compared
_LEAST_WORK = 0.5

N = TypeVar("N", bound=Node)


class Measurement:
    """What one rate of the tick gave.

    Attributes:
        cpu: seconds of processor time per second, of each process in each round.
        work: messages sent over those that were due, of each process in each round.
        memory: resident and proportional set size, bytes, of each process.
    """

    def __init__(self) -> None:
        self.cpu: dict[str, list[float]] = {}
        self.work: dict[str, list[float]] = {}
        self.memory: dict[str, tuple[int, int]] = {}


class Stage(Node):  # type: ignore[misc]
    """Publishes the poses of drones that sway around their set-points, and takes in what the others answer."""

    def __init__(self, players: Sequence[str]) -> None:
        super().__init__("bench")
        self._players = players
        self._pose = PoseStamped()
        self._pose.header.frame_id = "world"
        self._rng = np.random.default_rng(0)
        pose, goal = interfaces.POSE, interfaces.GOAL
        self._publishers_of = [self.create_publisher(pose.kind, f"/{pose.of(r)}", pose.publish) for r in ROBOTS]
        self._goals = [
            self.create_publisher(goal.kind, f"/{CONTROLLER}/{goal.of(robot)}", goal.publish) for robot in ROBOTS
        ]
        self.heard: dict[str, int] = {}
        self.last: dict[str, bytes] = {}
        for player in players:
            for robot in ROBOTS:
                for topic in (interfaces.COMMAND, interfaces.TELEMETRY):
                    self._listen(f"/{player}/{topic.of(robot)}", topic)
        self.create_timer(1.0 / POSE_RATE, self._on_timer)

    def _listen(self, name: str, topic: interfaces.Topic) -> None:
        self.heard[name] = 0

        def take(data: bytes) -> None:
            self.heard[name] += 1
            self.last[name] = data

        self.create_subscription(topic.kind, name, take, topic.subscribe, raw=True)

    def heard_of(self) -> dict[str, int]:
        """Return how many messages came from each player so far."""
        return {p: sum(n for name, n in self.heard.items() if name.startswith(f"/{p}/")) for p in self._players}

    def connected(self) -> bool:
        """Tell whether every player hears every pose and every player is heard."""
        return all(p.get_subscription_count() == len(self._players) for p in self._publishers_of) and all(
            self.count_publishers(name) for name in self.heard
        )

    def send_goals(self) -> None:
        """Make the controller fly."""
        for index, publisher in enumerate(self._goals):
            goal = PoseStamped()
            messages.fill_pose(goal, 0, (float(index), 0.0, 1.0), (0.0, 0.0, 0.0, 1.0))
            publisher.publish(goal)

    def flying(self) -> bool:
        """Tell whether the controller steers all drones."""
        topic, mode = interfaces.TELEMETRY, FIELDS.index("mode")
        rows = [self.last.get(f"/{CONTROLLER}/{topic.of(robot)}") for robot in ROBOTS]
        return all(row and deserialize_message(row, topic.kind).data[mode] == Mode.FLY for row in rows)

    def _on_timer(self) -> None:
        now = self.get_clock().now().nanoseconds
        sway = 0.05 * np.sin(2.0 * np.pi * 0.2 * now / messages.NANOSECONDS)
        # up and down, too: a drone that stays at its height while its thrust varies is taken for one on the ground
        positions = np.array([[i + sway, 0.0, 1.0 + sway] for i in range(len(ROBOTS))])
        positions += self._rng.normal(0.0, 1e-3, positions.shape)
        for publisher, position in zip(self._publishers_of, positions.tolist(), strict=True):
            messages.fill_pose(self._pose, now, position, (0.0, 0.0, 0.0, 1.0))
            publisher.publish(self._pose)


def measure(certificate: Path, folder: Path) -> Measurement:
    """Run all processes with the period of one certificate.

    Raises:
        FlatsatError: a process did not start, died, or sent less than it should.
    """
    period = Certificate.load(certificate).period
    commands = _commands(certificate, period)
    with heard(commands, folder / "log", lambda: Stage(list(commands))) as (stage, executor, players):
        return _rounds(stage, executor, players, period)


@contextmanager
def heard(
    commands: dict[str, list[str]], logs: Path, listener: Callable[[], N]
) -> Iterator[tuple[N, EventsExecutor, dict[str, subprocess.Popen[bytes]]]]:
    """Lend running processes, by name, and a node of this process beside them with the executor that serves it."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor()
    try:
        with running(commands, logs) as processes:
            node = listener()
            executor.add_node(node)
            try:
                yield node, executor, processes
            finally:
                node.destroy_node()
    finally:
        executor.shutdown()
        rclpy.try_shutdown()


def spin_beside(running: dict[str, subprocess.Popen[bytes]], executor: EventsExecutor, seconds: float) -> None:
    """Serve the executor for some seconds beside running processes, by name.

    Raises:
        FlatsatError: one of them has ended.
    """
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        executor.spin_once(timeout_sec=left)
    for name, process in running.items():
        if process.poll() is not None:
            raise FlatsatError(f"{name} ended with exit code {process.returncode}; see its log")


def _rounds(
    stage: Stage, executor: EventsExecutor, players: dict[str, subprocess.Popen[bytes]], period: float
) -> Measurement:
    spin = partial(spin_beside, players, executor)
    deadline = time.monotonic() + _DISCOVERY
    while not stage.connected():
        spin(0.1)
        if time.monotonic() > deadline:
            raise FlatsatError(f"the processes have not found each other within {_DISCOVERY:g} s")
    stage.send_goals()
    spin(_WARM_UP)
    measurement = Measurement()
    pids = {name: player.pid for name, player in players.items()}
    measurement.cpu = {name: [] for name in [*pids, SELF]}
    measurement.work = {name: [] for name in pids}
    for _ in tqdm(range(_ROUNDS), desc=f"processes, tick at {1.0 / period:g} Hz", leave=False):
        if not stage.flying():
            raise FlatsatError("the controller does not fly")
        heard = stage.heard_of()
        begin, before = time.monotonic(), processor_times(pids)
        spin(_ROUND)
        elapsed, after = time.monotonic() - begin, processor_times(pids)
        for name in measurement.cpu:
            measurement.cpu[name].append((after[name] - before[name]) / elapsed)
        for name, count in stage.heard_of().items():
            share = (count - heard[name]) * period / (elapsed * 2 * len(ROBOTS))
            if share < _LEAST_WORK:
                raise FlatsatError(f"{name} did {share:.0%} of its work: must be at least {_LEAST_WORK:.0%}")
            measurement.work[name].append(share)
    for name, pid in [*pids.items(), (SELF, os.getpid())]:
        memory = psutil.Process(pid).memory_full_info()
        measurement.memory[name] = (memory.rss, memory.pss)
    return measurement


def processor_times(pids: dict[str, int]) -> dict[str, float]:
    """Return user and system time of each process, s, to the nanosecond: the kernel's clock of that process."""
    times = {name: time.clock_gettime(~pid << 3 | 2) for name, pid in pids.items()}
    return times | {SELF: time.process_time()}


def _commands(certificate: Path, period: float) -> dict[str, list[str]]:
    """Return the command line of every process; each has a namespace of its own for what it sends."""

    def node(program: list[str], name: str, parameters: dict[str, str]) -> list[str]:
        parameters |= {"robot_names": f"[{','.join(ROBOTS)}]"}
        settings = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        poses = [interfaces.POSE.of(robot) for robot in ROBOTS]
        remapped = [word for pose in poses for word in ("-r", f"{pose}:=/{pose}")]
        return [sys.executable, *program, "--ros-args", "-r", f"__ns:=/{name}", *remapped, *settings]

    controller = ["-m", "flatsat_ros.nodes.controller_node"]
    echo = [str(Path(__file__).with_name("echo.py"))]
    tick = {"period": repr(period)}
    return {
        CONTROLLER: node(controller, CONTROLLER, {"certificate": str(certificate.resolve())}),
        RAW_ECHO: node(echo, RAW_ECHO, {**tick, "raw": "true"}),
        TYPED_ECHO: node(echo, TYPED_ECHO, {**tick, "raw": "false"}),
    }


@contextmanager
def running(commands: dict[str, list[str]], logs: Path) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Start the processes, each with its own log file, and end them, whatever happens in between."""
    make_folder(logs)
    running: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, command in commands.items():
            with (logs / f"{name}.log").open("wb") as log:
                running[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        yield running
    finally:
        for process in running.values():
            process.send_signal(signal.SIGINT)
        for process in running.values():
            try:
                process.wait(_GOODBYE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
