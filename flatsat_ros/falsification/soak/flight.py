"""Real processes that fly for long: take-off, goals, landing, again and again."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flatsat_ros.base.files import make_folder
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.demo.live import Live
from flatsat_ros.demo.processes import command_of, end, start
from flatsat_ros.falsification.soak.usage import left, present, sample
from flatsat_ros.falsification.soak.verdict import Soak
from flatsat_ros.flight.modes import AIRBORNE, Mode

if TYPE_CHECKING:
    from flatsat_ros.nodes.soak_lab import SoakLab

VEHICLE = "cf21"
NAMESPACE = "/soak"  # so that it never speaks to a drone of the user's
FLIGHT = 300.0  # s, from one take-off to the next
HEIGHT = 1.0  # m
_DISTANCE, _IN_A_ROW = 1.5, 5  # m between drones on the floor, how many of them stand in a row
_AWAY = (0.3, 0.2, 0.3)  # m, from one goal to the other
_NEAR = 0.5  # m, from where a take-off ends that began at one of the two places
_GOAL_EVERY, _SAMPLE_EVERY = 5.0, 1.0  # s
_CLIMB, _LANDING = 30.0, 60.0  # s, that they may take


def fly(drones: int, seconds: float, folder: Path, tell: Callable[[str], None]) -> Soak:
    """Fly some drones for a time, and watch the processes.

    Args:
        drones: their number.
        seconds: from the first take-off to the last landing.
        folder: gets the nodes' logs.
        tell: gets a line on how it is, twelve times at least.

    Raises:
        FlatsatError: the nodes did not find each other, one of them died, or the drones may not take off.
    """
    from flatsat_ros.nodes.conductor import conducting
    from flatsat_ros.nodes.soak_lab import SoakLab

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    make_folder(folder)
    robots = [f"cf{number}" for number in range(1, drones + 1)]
    soak = Soak(drones, load_certificate(DEFAULT_CERTIFICATE).period)
    nodes: dict[str, subprocess.Popen[bytes]] = {}
    before = present()  # of others, or left behind by others
    with conducting(robots, NAMESPACE, SoakLab) as lab:
        try:
            for name, command in _commands(robots).items():
                nodes[name] = start(command, folder / f"{name}.log")
            flight = SoakFlight(lab, nodes, folder, soak, tell)
            flight.wait_for_nodes()
            flight.perform(seconds)
        finally:
            unclean = end(nodes)
    soak.problems += [f"{name} did not end cleanly" for name in unclean]
    soak.left = left({name for samples in soak.samples.values() for entry in samples for name in entry.shared} - before)
    return soak


def _places(drones: int) -> np.ndarray:
    """Return where the drones stand, (N, 3), m."""
    return np.array([[_DISTANCE * (i % _IN_A_ROW), _DISTANCE * (i // _IN_A_ROW), 0.0] for i in range(drones)])


def _commands(robots: list[str]) -> dict[str, list[str]]:
    names = f"[{','.join(robots)}]"
    starts = str([entry for place in _places(len(robots)).tolist() for entry in place])
    controller = {
        "robot_names": names,
        "certificate": DEFAULT_CERTIFICATE,
        "vehicle": VEHICLE,
        "takeoff_height": repr(HEIGHT),
    }
    return {
        "sim_drone": command_of(
            "sim_drone", NAMESPACE, {"robot_names": names, "vehicle": VEHICLE, "start_positions": starts}
        ),
        "controller": command_of("controller_node", NAMESPACE, controller),
    }


class SoakFlight(Live):
    """Drones that take off, fly to and fro and land, until the time is over, and what their processes use."""

    def __init__(
        self,
        lab: SoakLab,
        nodes: dict[str, subprocess.Popen[bytes]],
        logs: Path,
        soak: Soak,
        tell: Callable[[str], None],
    ) -> None:
        """Fly nothing yet.

        Args:
            lab: see `Live`.
            nodes: the processes by name.
            logs: folder of the log files.
            soak: gets what is seen.
            tell: see `fly`.
        """
        super().__init__(lab, nodes, logs)
        self._lab, self._processes, self._soak, self._tell = lab, nodes, soak, tell
        soak.samples = {name: [] for name in nodes}
        self._next_sample = self._next_goal = self._next_line = self.now()
        self._begin = self._until = 0.0
        self._goals = 0  # so many were sent to each drone

    def perform(self, seconds: float) -> None:
        """Fly for a time, s."""
        self.arm()
        self._begin = self.now()
        self._until = self._begin + seconds
        first, began = self._lab.ticks_made()
        while self.now() < self._until and not self._soak.problems:
            self._fly_once(min(self._until, self.now() + FLIGHT))
        last, ended = self._lab.ticks_made()
        self._soak.ticks, self._soak.watched = last - first + 1, ended - began

    def _fly_once(self, until: float) -> None:
        """Take off, fly to and fro, and land at a time, s."""
        self._soak.flights += 1
        self.take_off()
        places = _places(self._soak.drones) + (0.0, 0.0, HEIGHT)
        # not before they are up: one that still stands waits for poses on the ground
        self._expect(lambda: not self._not_in(Mode.FLY) and not self.away(places, _NEAR), _CLIMB, "take off")
        while self.now() < until and not self._not_in(*AIRBORNE):
            self._send_goals()
            self._look()
            self.step()
        if lost := self._not_in(*AIRBORNE):
            self._soak.problems.append(f"no longer in the air: {', '.join(lost)}")
        if refusal := self._ask("land"):  # of a drone that is down already, at the latest
            self._soak.problems.append(refusal)
        self._expect(lambda: not self.in_use(), _LANDING, "land")

    def _expect(self, holds: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for what the drones were told, and note whether they did it in time."""
        end = self.now() + seconds
        while not holds():
            if self.now() > end:
                self._soak.problems.append(f"flight {self._soak.flights}: not all drones {what} within {seconds:g} s")
                return
            self._look()
            self.step()

    def _not_in(self, *modes: Mode) -> list[str]:
        return self._lab.robots_in(*set(Mode) - set(modes))

    def _send_goals(self) -> None:
        """Send all drones to the other one of their two places, when it is time."""
        if self.now() < self._next_goal:
            return
        self._next_goal = self.now() + _GOAL_EVERY
        self._goals += 1
        away = np.array(_AWAY) * (self._goals % 2)
        self.send_goals(_places(self._soak.drones) + (0.0, 0.0, HEIGHT) + away)

    def _look(self) -> None:
        """Look at the processes, and tell how it is, when it is time."""
        now = self.now()
        if now < self._next_sample:
            return
        self._next_sample = now + _SAMPLE_EVERY
        self._soak.unsteady += bool(self._lab.robots_in(Mode.LEVEL, Mode.DESCEND))
        for name, process in self._processes.items():
            self._soak.samples[name].append(sample(process.pid, now - self._begin))
        if now >= self._next_line:
            self._next_line = now + max((self._until - self._begin) / 12.0, _SAMPLE_EVERY)
            used = (f"{name} {samples[-1].memory:.1f} MiB" for name, samples in self._soak.samples.items())
            ticks, _ = self._lab.ticks_made()
            self._tell(f"{(now - self._begin) / 60.0:.1f} min: {', '.join(used)}, {ticks} ticks")
