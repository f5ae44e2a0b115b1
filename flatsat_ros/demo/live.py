"""The demo over real DDS: starts the nodes as processes, conducts and records the flight, stops the nodes."""

from __future__ import annotations

import os
import re
import select
import sys
import time
import webbrowser
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.demo.choreography import Stage, perform
from flatsat_ros.demo.processes import Nodes, command_of, commands_of, require_alive, running
from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.demo.scenario import VEHICLE, Scenario, record_of
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.plans.performance import PATIENCE

if TYPE_CHECKING:
    from flatsat_ros.nodes.conductor import Conductor

# everything of the demo lives below this name, so that it never speaks to a drone of the user's
NAMESPACE = "/demo"
BAG = "bag"  # in the folder of the results
_LOGS = "log"  # there, too
_DISCOVERY = 30.0  # s, until all nodes must have found each other
_NAMED = 6  # of what is missing then; forty drones have hundreds of topics and services
_LISTENING = 1.0  # s, in which another demo would be noticed
SLICE = 0.02  # s
_ANSWER = 10.0  # s, that the answer of a service may take
_READY = 10.0  # s, after which a drone that still may not take off fails the flight
_OPENING = 10.0  # s, for people to open the console
_AGAIN = 0.5  # s, after which a take-off is asked for again; modes are known by then


def require_ros() -> None:
    """Refuse to fly where ROS is not to be had.

    Raises:
        FlatsatError: a library is missing, most often because no ROS is sourced.
    """
    try:
        import_module("flatsat_ros.nodes.conductor")
    except ImportError as error:
        reason = " ".join(str(error).split())
        raise FlatsatError(f"flying live needs ROS 2 ({reason}): source its setup, or give --headless") from error


def fly(scenario: Scenario, folder: Path, *, console: bool = False) -> FlightRecord:
    """Fly the scenario with one controller process, and sim_drone processes as `processes.commands_of` says.

    Args:
        scenario: what is flown.
        folder: for the logs of the nodes and the bag.
        console: serve the page that shows the drones, and wait a moment before the take-off for people to open it.

    Raises:
        FlatsatError: a robot's name is none in ROS, the nodes did not find each other, one died, another demo is
            running, the controller refused to arm, take off or land, or a drone did not arrive at its first way-point.
    """
    from flatsat_ros.nodes.conductor import Conductor, conducting
    from flatsat_ros.nodes.ros.bag import write_bag
    from flatsat_ros.nodes.ros.parameters import require_robot_names

    require_robot_names(scenario.robots)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    vehicle = load_vehicle(VEHICLE)
    with conducting(scenario.robots, NAMESPACE, Conductor) as conductor:
        _listen_for_others(conductor)
        commands = commands_of(scenario, NAMESPACE)
        if console:
            commands["console"] = command_of("console", NAMESPACE, {"port": "0"})
        with running(commands, folder / _LOGS) as nodes:
            stage = Live(conductor, nodes, folder / _LOGS, planned=scenario.plan is not None)
            stage.wait_for_nodes()
            if console:
                stage.show(folder / _LOGS / "console.log")
            start = perform(scenario, stage)
        write_bag(folder / BAG, conductor.recorded)
        robots = {
            name: RobotRecord(
                conductor.poses(name), conductor.ticks(name), conductor.commands(name, vehicle), swap.shifted(start)
            )
            for name, swap in zip(scenario.robots, scenario.swaps, strict=True)
        }
    return record_of(scenario, robots, start)


def _address(log: Path) -> str:
    """Return the address that the console's log names, empty if it does not yet."""
    found = re.search(r"http://[\d.:]+", log.read_text(encoding="utf-8"))
    return found[0] if found else ""


def _listen_for_others(conductor: Conductor) -> None:
    """Refuse to fly among the messages of another demo."""
    for _ in range(round(_LISTENING / SLICE)):
        conductor.spin(SLICE)
        if conductor.occupied():
            raise FlatsatError(
                f"somebody already uses topics below {NAMESPACE} in this ROS domain: "
                "stop that demo first, or set another ROS_DOMAIN_ID"
            )


class Live(Stage):
    """The nodes, asked and heard through the conductor; a step lets messages come in, and all nodes must live."""

    def __init__(self, conductor: Conductor, nodes: Nodes, logs: Path, *, planned: bool = False) -> None:
        """Ask and hear the nodes, whose logs are in a folder; if planned, the controller has a plan to be started."""
        super().__init__()
        self._planned = planned
        self._conductor = conductor
        self._nodes, self._logs = nodes, logs

    def now(self) -> float:
        """Return the time of a clock that nobody sets, s."""
        return time.monotonic()

    def step(self) -> None:
        """Let messages come in.

        Raises:
            FlatsatError: a node died.
        """
        self._conductor.spin(SLICE)
        require_alive(self._nodes, self._logs)

    def wait_for_nodes(self) -> None:
        """Wait until all nodes have found each other.

        Raises:
            FlatsatError: they have not in time.
        """
        with self.progress(_DISCOVERY, "waiting for the nodes", leave=False):
            if not self.wait_until(lambda: not self._conductor.missing(), _DISCOVERY):
                missing = self._conductor.missing()
                others = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
                raise FlatsatError(f"not heard of after {_DISCOVERY:g} s: {', '.join(missing[:_NAMED])}{others}")

    def show(self, log: Path) -> None:
        """Say where the console serves its page, open it where there is a display, and wait for Enter or a while.

        Args:
            log: of the console.

        Raises:
            FlatsatError: it does not say where.
        """
        if not self.wait_until(lambda: bool(_address(log)), _DISCOVERY):
            raise FlatsatError(f"the console has not started after {_DISCOVERY:g} s; see {log}")
        print(f"open {_address(log)} in a browser; the drones take off in {_OPENING:g} s, or when you press Enter")
        if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(_address(log))
        self.wait_until(lambda: sys.stdin in select.select([sys.stdin], [], [], 0.0)[0], _OPENING)

    def _ask(self, name: str, *who: str) -> str:
        """Ask the controller to arm, takeoff or land one robot, or all; return why it refused, nothing if it did not.

        Raises:
            FlatsatError: no answer came in time.
        """
        answer = self._conductor.ask(name, *who)
        if not self.wait_until(answer.done, _ANSWER):
            raise FlatsatError(f"no answer of the controller to {name} after {_ANSWER:g} s")
        return self._conductor.refusal(answer)

    def _demand(self, name: str) -> None:
        """Ask for all robots.

        Raises:
            FlatsatError: the controller refused, or no answer came in time.
        """
        if refusal := self._ask(name):
            raise FlatsatError(refusal)

    def arm(self) -> None:
        """Arm all drones."""
        self._demand("arm")

    def take_off(self) -> None:
        """Ask for all robots, then again for each that was not ready: its pose unknown yet, or its lock still opening.

        Raises:
            FlatsatError: the controller still refuses.
        """
        end = self.now() + _READY
        refusals = [self._ask("takeoff")]
        while any(refusals):
            if self.now() > end:
                raise FlatsatError("; ".join(filter(None, refusals)))
            self.let_pass(_AGAIN)
            refusals = [self._ask("takeoff", robot) for robot in self._conductor.robots_in(Mode.IDLE, Mode.UNLOCK)]

    def send_goals(self, places: FloatArray) -> None:
        """Send all drones to places (N, 3), m."""
        for i, place in enumerate(places.tolist()):
            self._conductor.send_goal(i, place)

    def send_trajectories(self, trajectories: Sequence[Trajectory], lead: float) -> float:
        """Send each drone a trajectory that begins in `lead` seconds; return when that is on the record's clock, s.

        Those of a plan begin when all drones are within their tubes.

        Raises:
            FlatsatError: they are not in time, or the controller refused.
        """
        if self._planned:
            answer = self._conductor.start_plan()
            if not self.wait_until(answer.done, _ANSWER) or self._conductor.refusal(answer):
                text = self._conductor.refusal(answer) if answer.done() else f"no answer after {_ANSWER:g} s"
                raise FlatsatError(f"the plan is not started: {text}")
            if not self.wait_until(lambda: self._conductor.plan_began() is not None, PATIENCE):
                raise FlatsatError(f"the plan does not begin within {PATIENCE:g} s: drones are not within their tubes")
            return self._conductor.seconds(self._conductor.plan_began() or 0)
        start = self._conductor.now() + round(lead * 1e9)
        for i, trajectory in enumerate(trajectories):
            self._conductor.send_trajectory(i, trajectory, start)
        return self._conductor.seconds(start)

    def land(self) -> None:
        """Let all drones land."""
        self._demand("land")

    def away(self, places: FloatArray, distance: float) -> list[str]:
        """Return the names of the drones that are farther than a distance, m, from their places (N, 3), m."""
        return self._conductor.away(places, distance)

    def in_use(self) -> list[str]:
        """Return the names of the drones that the controller still commands."""
        return self._conductor.robots_in(*set(Mode) - {Mode.IDLE})
