"""The demo over real DDS: starts the nodes as processes, conducts and records the flight, stops the nodes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from tqdm import tqdm

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.demo.scenario import (
    BAR,
    CLIMB_TIME,
    GAMMA_0,
    GATHER_TIME,
    LANDING_LATEST,
    LANDING_TIME,
    MU,
    POSE_NOISE,
    STANDING_TIME,
    V_INF,
    VEHICLE,
    Scenario,
    record_of,
)  # fmt: skip
from flatsat_ros.flight.supervisor import Mode

if TYPE_CHECKING:
    from flatsat_ros.nodes.conductor import Conductor

# everything of the demo lives below this name, so that it never speaks to a drone of the user's
NAMESPACE = "/demo"
BAG = "bag"  # in the folder of the results
_DISCOVERY = 30.0  # s, until all nodes must have found each other
_LISTENING = 1.0  # s, in which another demo would be noticed
_LEAD = 0.5  # s, from sending the trajectories to their start
_GOODBYE = 5.0  # s, that a node has to end by itself
_SLICE = 0.02  # s
_GATHERED = 0.15  # m, from its first way-point, that a drone may be when the swap begins
_LATE = 20.0  # s, that a stalled machine may be late with the climb
_ANSWER = 10.0  # s, that the answer of a service may take
_READY = 10.0  # s, after which a drone that still may not take off fails the flight
_AGAIN = 0.5  # s, after which a take-off is asked for again; modes are known by then


def require_ros() -> None:
    """Refuse to fly where ROS is not to be had.

    Raises:
        FlatsatError: a library is missing, most often for no ROS is sourced.
    """
    try:
        import_module("flatsat_ros.nodes.conductor")
    except ImportError as error:
        reason = " ".join(str(error).split())
        raise FlatsatError(f"flying live needs ROS 2 ({reason}): source its setup, or give --headless") from error


def fly(scenario: Scenario, folder: Path) -> FlightRecord:
    """Fly the scenario with one controller process and one sim_drone process per drone.

    Raises:
        FlatsatError: the nodes did not find each other, one died, another demo is running, the controller refused to
            arm, take off or land, or a drone did not land.
    """
    from flatsat_ros.nodes.conductor import conducting
    from flatsat_ros.nodes.ros.bag import write_bag

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    vehicle = load_vehicle(VEHICLE)
    with conducting(scenario.robots, NAMESPACE) as conductor:
        _listen_for_others(conductor)
        with _nodes(_commands(scenario), folder / "log") as nodes:
            begin = _conduct(scenario, conductor, nodes)
        write_bag(folder / BAG, conductor.recorded)
        start = conductor.seconds(begin)
        robots = {
            name: RobotRecord(
                conductor.poses(name), conductor.ticks(name), conductor.commands(name, vehicle), swap.shifted(start)
            )
            for name, swap in zip(scenario.robots, scenario.swaps, strict=True)
        }
    return record_of(scenario, robots, start)


def _commands(scenario: Scenario) -> dict[str, list[str]]:
    """Return the command line of every node, by name."""

    def node(module: str, parameters: dict[str, str]) -> list[str]:
        settings = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
        program = [sys.executable, "-m", f"flatsat_ros.nodes.{module}"]
        return [*program, "--ros-args", "-r", f"__ns:={NAMESPACE}", *settings]

    commands = {
        "controller": node(
            "controller_node",
            {
                "robot_names": f"[{','.join(scenario.robots)}]",
                "certificate": str(scenario.certificate_path.resolve()),
                "vehicle": VEHICLE,
                "mu": repr(MU),
                "v_inf": repr(V_INF),
                "gamma_0": repr(GAMMA_0),
                "takeoff_height": repr(scenario.height),
                "restart_gain": "false",
                "disturbance_max": repr(scenario.disturbance_max),
            },
        )
    }
    for i, (robot, start) in enumerate(zip(scenario.robots, scenario.start.tolist(), strict=True)):
        commands[f"sim_drone_{robot}"] = node(
            "sim_drone",
            {
                "robot_names": f"[{robot}]",
                "vehicle": VEHICLE,
                "dynamics": scenario.dynamics,
                "start_positions": str(start),
                "position_noise": repr(POSE_NOISE),
                "seed": str(i),
            },
        )
    return commands


@contextmanager
def _nodes(commands: dict[str, list[str]], logs: Path) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Start the processes, each with its own log file, and end them, whatever happens in between.

    Raises:
        FlatsatError: a process that was still running at the end did not leave by itself with exit code 0.
    """
    logs.mkdir(parents=True, exist_ok=True)
    running: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, command in commands.items():
            with (logs / f"{name}.log").open("wb") as log:
                running[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        yield running
    except BaseException:
        _stop(running)
        raise
    left = _stop(running)
    if left:
        raise FlatsatError(f"{', '.join(left)} did not end cleanly; see {logs}")


def _stop(running: dict[str, subprocess.Popen[bytes]]) -> list[str]:
    """End all processes and return the names of those that did not leave by themselves with exit code 0."""
    for process in running.values():
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + _GOODBYE
    unclean = []
    for name, process in running.items():
        try:
            process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.returncode != 0:
            unclean.append(f"{name} (exit code {process.returncode})")
    return unclean


def _listen_for_others(conductor: Conductor) -> None:
    """Refuse to fly among the messages of another demo."""
    for _ in range(round(_LISTENING / _SLICE)):
        conductor.spin(_SLICE)
        if conductor.occupied():
            raise FlatsatError(
                f"somebody already uses topics below {NAMESPACE} in this ROS domain: "
                "stop that demo first, or set another ROS_DOMAIN_ID"
            )


@dataclass(frozen=True)
class _Watch:
    """Waits in flight: messages come in, the bar moves, and the nodes must live.

    Attributes:
        conductor: hears and asks.
        nodes: the processes by name.
        bar: s flown.
    """

    conductor: Conductor
    nodes: dict[str, subprocess.Popen[bytes]]
    bar: tqdm[NoReturn]

    def let_pass(self, seconds: float) -> None:
        """Wait that long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._look()

    def until_none(self, left: Callable[[], list[str]], seconds: float, complaint: str) -> None:
        """Wait until nobody is left.

        Raises:
            FlatsatError: who is left after that time, with the complaint.
        """
        end = time.monotonic() + seconds
        while names := left():
            if time.monotonic() > end:
                raise FlatsatError(f"{complaint} after {seconds:g} s: {', '.join(names)}")
            self._look()

    def ask(self, name: str, *who: str) -> str:
        """Ask the controller to arm, takeoff or land one robot, or all; return why it refused, nothing if it did not.

        Raises:
            FlatsatError: no answer came in time.
        """
        answer = self.conductor.ask(name, *who)
        self.until_none(lambda: [] if answer.done() else [name], _ANSWER, "no answer of the controller")
        return self.conductor.refusal(answer)

    def demand(self, name: str) -> None:
        """Ask for all robots.

        Raises:
            FlatsatError: the controller refused, or no answer came in time.
        """
        if refusal := self.ask(name):
            raise FlatsatError(refusal)

    def _look(self) -> None:
        begin = time.monotonic()
        self.conductor.spin(_SLICE)
        for name, process in self.nodes.items():
            if process.poll() is not None:
                raise FlatsatError(f"node {name} died in flight with exit code {process.returncode}; see its log")
        self.bar.update(min(time.monotonic() - begin, self.bar.total - self.bar.n))


def _take_off(watch: _Watch) -> None:
    """Ask for all robots, then again for each that was not ready: its pose not known yet, or its lock still opening.

    Raises:
        FlatsatError: the controller still refuses.
    """
    end = time.monotonic() + _READY
    refusals = [watch.ask("takeoff")]
    while any(refusals):
        if time.monotonic() > end:
            raise FlatsatError("; ".join(filter(None, refusals)))
        watch.let_pass(_AGAIN)
        refusals = [watch.ask("takeoff", robot) for robot in watch.conductor.robots_in(Mode.IDLE, Mode.UNLOCK)]


def _conduct(scenario: Scenario, conductor: Conductor, nodes: dict[str, subprocess.Popen[bytes]]) -> int:
    """Wait for the nodes, take off, gather, swap, land; return when the swap began, ns."""
    with tqdm(total=_DISCOVERY, unit="s", desc="waiting for the nodes", bar_format=BAR, leave=False) as bar:
        _Watch(conductor, nodes, bar).until_none(conductor.missing, _DISCOVERY, "not heard of")
    total = STANDING_TIME + CLIMB_TIME + scenario.duration + LANDING_TIME
    with tqdm(total=total, unit="s", desc="taking off", bar_format=BAR) as bar:
        watch = _Watch(conductor, nodes, bar)
        watch.demand("arm")
        watch.let_pass(STANDING_TIME)
        _take_off(watch)
        watch.let_pass(GATHER_TIME)
        for i, position in enumerate(scenario.gathering.tolist()):
            conductor.send_goal(i, position)
        watch.let_pass(CLIMB_TIME - _LEAD - GATHER_TIME)
        where = f"not within {_GATHERED:g} m of its place"
        watch.until_none(lambda: conductor.away(scenario.gathering, _GATHERED), _LATE, where)
        start = conductor.now() + round(_LEAD * 1e9)
        for i, swap in enumerate(scenario.swaps):
            conductor.send_trajectory(i, swap, start)
        bar.set_description_str("swapping")
        watch.let_pass(_LEAD + scenario.duration)
        bar.set_description_str("landing")
        watch.demand("land")
        watch.until_none(lambda: conductor.robots_in(*set(Mode) - {Mode.IDLE}), LANDING_LATEST, "did not land")
        bar.update(total - bar.n)
    return start
