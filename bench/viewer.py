"""What the viewer costs: a report beside reading its bag, and the console beside a bare subscriber and the controller.

Everything is compared within the same run: costs in processor time, the controller's ticks as it tells them itself.
"""

from __future__ import annotations

import http.client
import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import processes
from geometry_msgs.msg import Twist
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from report import Quartiles, quartiles
from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.law.gain import Tuning
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.bag import Recorded, write_bag
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture
from flatsat_ros.viewing import Recorder, read_flight, report, setup_of
from flatsat_ros.viewing.bag import opened

SIZE_TARGET, READING_TARGET = 8e6, 3.0  # bytes; over reading the bag
SUBSCRIBER_TARGET = 0.5  # the console's processor time without a browser over that of a bare subscriber
CONSOLE, SUBSCRIBER = "console", "subscriber"
_DRONES, _SECONDS = 10, 60.0  # s, of the flight that is reported
_ROUNDS, _ROUND = 5, 3.0  # s
_SETTLING = 2.0  # s
_DISCOVERY = 20.0  # s


class ReportCost(NamedTuple):
    """A report of ten drones in the air for a minute.

    Attributes:
        size: bytes.
        over_reading: processor time of making it over that of reading all messages of the bag, in each round.
    """

    size: int
    over_reading: list[float]


class ConsoleCost(NamedTuple):
    """Each figure in each round.

    Attributes:
        unseen: the console's processor time without a browser over that of a bare subscriber to its topics.
        seen: the same with a page that follows.
        ticks_without: the controller's median tick without a console, us.
        ticks_with: that with a console and a page, us.
    """

    unseen: list[float]
    seen: list[float]
    ticks_without: list[float]
    ticks_with: list[float]

    def spread(self) -> float:
        """Return how far the tick without a console is from its own median in the worst round, as a factor."""
        return max(self.ticks_without) / quartiles(self.ticks_without).median

    def ticks(self) -> Quartiles:
        """Return the tick with a console over that without, round by round."""
        return quartiles([one / other for one, other in zip(self.ticks_with, self.ticks_without, strict=True)])


def report_cost(folder: Path) -> ReportCost:
    """Fly, write the bag, and time reading and reporting in turns."""
    bag = folder / "flown"
    write_bag(bag, _flown())
    ratios, size = [], 0
    for _ in tqdm(range(_ROUNDS), desc="reports", leave=False):
        reading = _timed(lambda: _read(bag))
        making = _timed(lambda: (folder / "flown.html").write_text(report(read_flight(bag)), encoding="utf-8"))
        size = (folder / "flown.html").stat().st_size
        ratios.append(making / reading)
    return ReportCost(size, ratios)


def _timed(call: Callable[[], object]) -> float:
    before = time.process_time()
    call()
    return time.process_time() - before


def _read(bag: Path) -> int:
    with opened(bag) as reader:
        return sum(len(reader.deserialize(data, c.msgtype).__dict__) for c, _, data in reader.messages())


def _flown() -> list[Recorded]:
    """Fly drones with noise and a path each; return what their topics would have carried, poses at 50 Hz."""
    certificate, vehicle = load_certificate(DEFAULT_CERTIFICATE), load_vehicle("cf21")
    names = [f"cf{number}" for number in range(1, _DRONES + 1)]
    policy = Policy()
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, _DRONES)
    places = np.array([[0.8 * (index % 5), 0.8 * (index // 5), 0.0] for index in range(_DRONES)])
    capture = MotionCapture(rate=1.0 / certificate.period, noise=5e-4)
    fleet = SimulatedFleet(vehicle, _DRONES, start=places, capture=capture, seed=1)
    recorder = Recorder(names, setup_of(certificate, policy))
    now = fly(pilot, fleet, vehicle, 1.0, recorder.observe)
    for index in range(_DRONES):
        pilot.take_off(index, 1.0)
    fly(pilot, fleet, vehicle, _SECONDS, recorder.observe, start=now)
    found = []
    pose, row, command = messages.pose_message(), messages.telemetry_message(), Twist()
    for track in recorder.flight("").tracks:
        for kind, channel in track.channels.items():
            for time_, *values in channel.samples.tolist():
                stamp = round(time_ * messages.NANOSECONDS)
                if kind == "pose":
                    topic, message = interfaces.POSE, pose
                    messages.fill_pose(pose, stamp, values[:3], values[3:])
                elif kind == "tick":
                    topic, message = interfaces.TELEMETRY, row
                    messages.fill_telemetry(row, np.array(values))
                else:
                    topic, message = interfaces.COMMAND, command
                    command.linear.y, command.linear.x, command.angular.z, command.linear.z = values
                name = f"{topic.kind.__module__.partition('.')[0]}/msg/{topic.kind.__name__}"
                found.append(Recorded(stamp, f"/{topic.of(track.name)}", name, serialize_message(message)))
    return sorted(found, key=lambda entry: entry.time)


class Watcher(Node):  # type: ignore[misc]
    """Hears the controller's telemetry, and sends its drones up."""

    def __init__(self) -> None:
        super().__init__("bench")
        self.rows: list[bytes] = []
        for robot in processes.ROBOTS:
            topic = interfaces.TELEMETRY
            self.create_subscription(topic.kind, topic.of(robot), self.rows.append, topic.subscribe, raw=True)
        goal = interfaces.GOAL
        self._goals = [self.create_publisher(goal.kind, goal.of(robot), goal.publish) for robot in processes.ROBOTS]

    def send_goals(self) -> None:
        """Make the controller fly."""
        for index, publisher in enumerate(self._goals):
            message = messages.pose_message()
            messages.fill_pose(message, 0, (float(index), 0.0, 1.0), (0.0, 0.0, 0.0, 1.0))
            publisher.publish(message)

    def is_heard(self) -> bool:
        """Tell whether the controller listens to goals."""
        return all(publisher.get_subscription_count() for publisher in self._goals)

    def taken(self) -> FloatArray:
        """Return all rows (n, len(FIELDS)) that came since the last call."""
        rows, self.rows[:] = list(self.rows), []
        kind = interfaces.TELEMETRY.kind
        return np.array([deserialize_message(row, kind).data for row in rows]).reshape(-1, len(FIELDS))


def console_cost(folder: Path) -> ConsoleCost:
    """Fly three simulated drones with poses and ticks at 50 Hz; the console comes and goes.

    Raises:
        FlatsatError: a process did not start or died, or the drones do not fly.
    """
    robots = ["-p", f"robot_names:=[{','.join(processes.ROBOTS)}]"]
    commands = {
        "sim_drone": _node("sim_drone", *robots, "-p", "pose_rate:=50.0"),
        "controller": _node("controller_node", *robots, "-p", "certificate:=cf21_50hz"),
        SUBSCRIBER: [sys.executable, str(Path(__file__).with_name("subscriber.py")), "--ros-args", *robots],
    }
    with processes.heard(commands, folder / "log", Watcher) as (watcher, executor, nodes):
        return _rounds(watcher, executor, nodes, folder)


def _node(module: str, *arguments: str) -> list[str]:
    return [sys.executable, "-m", f"flatsat_ros.nodes.{module}", "--ros-args", *arguments]


def _rounds(
    watcher: Watcher, executor: EventsExecutor, nodes: dict[str, subprocess.Popen[bytes]], folder: Path
) -> ConsoleCost:
    spin = partial(processes.spin_beside, nodes, executor)

    def measured(pids: dict[str, int]) -> tuple[float, float]:
        """Return the console's processor time over the subscriber's, NaN without one, and the median tick, us."""
        watcher.taken()
        before = processes.processor_times(pids)
        spin(_ROUND)
        after = processes.processor_times(pids)
        rows = watcher.taken()
        if len(rows) == 0 or (rows[:, FIELDS.index("mode")] != Mode.FLY).any():
            raise FlatsatError("the drones do not fly")
        spent = {name: after[name] - before[name] for name in pids}
        share = spent[CONSOLE] / spent[SUBSCRIBER] if CONSOLE in spent else float("nan")
        return share, float(np.median(rows[:, FIELDS.index("tick_us")]))

    deadline = time.monotonic() + _DISCOVERY
    while not watcher.is_heard():
        spin(0.1)
        if time.monotonic() > deadline:
            raise FlatsatError(f"the processes have not found each other within {_DISCOVERY:g} s")
    spin(_SETTLING)
    watcher.send_goals()
    deadline = time.monotonic() + _DISCOVERY
    while True:
        spin(_SETTLING)
        modes = watcher.taken()[-len(processes.ROBOTS) :, FIELDS.index("mode")]
        if len(modes) and (modes == Mode.FLY).all():
            break
        if time.monotonic() > deadline:
            raise FlatsatError(f"the drones do not fly within {_DISCOVERY:g} s")
    cost = ConsoleCost([], [], [], [])
    subscriber = {SUBSCRIBER: nodes[SUBSCRIBER].pid}
    command = {CONSOLE: _node("console", "-p", "port:=0")}
    for number in tqdm(range(_ROUNDS), desc="rounds with and without a console", leave=False):
        cost.ticks_without.append(measured(subscriber)[1])
        logs = folder / f"log{number}"
        with processes.running(command, logs) as consoles:
            spin(2.0 * _SETTLING)
            pids = subscriber | {CONSOLE: consoles[CONSOLE].pid}
            cost.unseen.append(measured(pids)[0])
            with _following(logs / f"{CONSOLE}.log") as pictures:
                spin(_SETTLING)
                share, tick = measured(pids)
                if len(pictures) < _ROUND / 0.1:
                    raise FlatsatError(f"the console sent {len(pictures)} pictures: must be twenty a second")
            cost.seen.append(share)
            cost.ticks_with.append(tick)
        spin(_SETTLING)
    return cost


@contextmanager
def _following(log: Path) -> Iterator[list[int]]:
    """Follow the stream that a console's log names, as a page does; yields sizes of the pictures that come.

    Raises:
        FlatsatError: the log names no address, or the stream ended by itself or brought what is no picture.
    """
    found = re.search(r"http://([\d.]+:\d+)", log.read_text(encoding="utf-8"))
    if found is None:
        raise FlatsatError(f"{log} names no address")
    with closing(http.client.HTTPConnection(found[1], timeout=10.0)) as connection, ThreadPoolExecutor(1) as pool:
        connection.connect()
        line = connection.sock
        connection.request("GET", "/events")
        answer = connection.getresponse()  # has the connection from now on
        pictures: list[int] = []
        reader = pool.submit(_read_pictures, answer, pictures)
        try:
            yield pictures
            if reader.done():
                reader.result()
                raise FlatsatError("the console's stream ended by itself")
        finally:
            with suppress(OSError):  # the console closed it
                line.shutdown(socket.SHUT_RDWR)  # for who reads it the stream ends, which is no error
            reader.exception()
            answer.close()
        reader.result()


def _read_pictures(stream: http.client.HTTPResponse, pictures: list[int]) -> None:
    """Note the sizes of the pictures of drones to the end of a stream; its last line may be a part of one."""
    while (line := stream.readline()).endswith(b"\n"):
        if line.startswith(b"data: ") and json.loads(line[6:])["drones"]:
            pictures.append(len(line))
