"""Rows of real processes: sim_drone, a relay with faults and a controller, flown in real time and judged alike."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, one_line
from flatsat_ros.base.files import make_folder
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.demo.live import SLICE, Live
from flatsat_ros.demo.processes import command_of, end, start
from flatsat_ros.falsification.faults.accepted import is_accepted
from flatsat_ros.falsification.faults.criteria import DroneOutcome, Remark, broken
from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS, LiveFault
from flatsat_ros.falsification.faults.record import Record
from flatsat_ros.falsification.faults.rows import Row, row_of
from flatsat_ros.falsification.faults.scene import TEXT, VEHICLE
from flatsat_ros.falsification.faults.table import LIVE
from flatsat_ros.flight.modes import Mode

if TYPE_CHECKING:
    from flatsat_ros.nodes.fault_lab import FaultLab

ROBOTS = ("cf1", "cf2")
_STARTS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))  # m
_ARRIVED = 0.15  # m below the height of the flight at which the take-off is over
_SETTLING = 5.0  # s of hover before the fault
_HOVER_LATEST = 60.0  # s, that it may take to come to that: on a busy machine a take-off may be given up
_ASK_AGAIN = 3.0  # s, after which drones that stand are asked to take off again
_ANSWER = 5.0  # s, that the answer of a service may take
_FLOOR = 1e-3  # m: a drone this low is on the floor
_LAST = 0.5  # s: the motors turn in the end if a thrust was sent so recently
_ENDING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL}


def fly_live(wanted: Sequence[str], folder: Path, certificate: str) -> Generator[Row]:
    """Yield the rows of live faults, by name, in their order; the nodes' logs go below the folder.

    Args:
        wanted: the faults.
        folder: of the logs.
        certificate: that the controller flies: packaged name or path.

    Raises:
        FlatsatError: there is no such certificate.
    """
    shown = load_certificate(certificate).name
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name in wanted:
        yield _fly(LIVE_FAULTS[name], folder / name, certificate, shown)


def _fly(fault: LiveFault, logs: Path, certificate: str, shown: str) -> Row:
    from flatsat_ros.nodes.conductor import conducting
    from flatsat_ros.nodes.fault_lab import FaultLab

    make_folder(logs)
    namespace = f"/faults/{fault.name}"
    nodes: dict[str, subprocess.Popen[bytes]] = {}
    with conducting(ROBOTS, namespace, FaultLab) as lab:
        flight = LiveFlight(lab, nodes, _commands(namespace, fault.height, certificate), logs)
        try:
            flight.prepared = b"" if fault.prepare is None else fault.prepare(lab)
            return _judged(fault, _perform(fault, flight), flight, shown)
        except FlatsatError as error:  # the drones did not come as far as the fault
            return row_of(fault.name, LIVE, 0, [], [], [], [one_line(str(error), TEXT)], shown)
        finally:
            for process in nodes.values():
                if process.poll() is None:
                    process.send_signal(signal.SIGCONT)
            end(nodes)


def _commands(namespace: str, height: float, certificate: str) -> dict[str, list[str]]:
    """Return the command line of every node by name."""
    from flatsat_ros.nodes.fault_relay import UPSTREAM

    names = f"[{','.join(ROBOTS)}]"
    controller = command_of(
        "controller_node",
        namespace,
        {"robot_names": names, "certificate": certificate, "vehicle": VEHICLE, "takeoff_height": repr(height)},
    )
    starts = str([entry for place in _STARTS for entry in place])
    drones = {"robot_names": names, "vehicle": VEHICLE, "start_positions": starts, "position_noise": "0.0"}
    return {
        "sim_drone": command_of("sim_drone", f"{namespace}/{UPSTREAM}", drones),
        "relay": command_of("fault_relay", namespace, {"robot_names": names}),
        "controller": controller,
        "second_controller": controller,
    }


class LiveFlight(Live):
    """A flight of real processes in progress.

    Attributes:
        conductor: asks, hears and records.
        paths: (M, 3) places that each drone is to pass, m.
        remarks: what services answered.
        prepared: what the fault has made before the flight.
        failure: what ended unexpectedly; empty for nothing.
    """

    conductor: FaultLab
    prepared: bytes

    def __init__(
        self, lab: FaultLab, nodes: dict[str, subprocess.Popen[bytes]], commands: dict[str, list[str]], logs: Path
    ) -> None:
        """Start nothing yet.

        Args:
            lab: see `conductor`.
            nodes: gets the processes by name.
            commands: command lines by name.
            logs: folder of the log files.
        """
        super().__init__(lab, nodes, logs)
        self.conductor = lab
        self.paths = [np.array([place]) for place in _STARTS]
        self.remarks: list[Remark] = []
        self.prepared = b""
        self.failure = ""
        self.nodes, self._commands = nodes, commands
        self._ended: set[str] = set()  # by the fault itself
        self._files: dict[Path, int] = {}  # logs of controllers, and how much of each was there before the fault

    def step(self) -> None:
        """Let messages come in, and see who has ended that should not have."""
        self.conductor.spin(SLICE)
        for name, process in self.nodes.items():
            code = process.poll()
            if code is not None and name not in self._ended:
                self._ended.add(name)
                self.failure = self.failure or f"{name} ended with exit code {code}"

    def start(self, name: str) -> None:
        """Start a node, anew if it ran before."""
        old = self.nodes.get(name)
        if old is not None and old.stdin is not None:
            old.stdin.close()
        number = len(list(self._logs.glob(f"{name}*.log")))
        log = self._logs / f"{name}{number or ''}.log"
        self.nodes[name] = start(self._commands[name], log)
        self._ended.discard(name)
        if "controller" in name:
            self._files[log] = 0

    def send(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        if number in _ENDING:
            self._ended.add(name)
        self.nodes[name].send_signal(number)

    def relay(self, name: str, value: str) -> None:
        """Set a parameter of the relay.

        Raises:
            FlatsatError: it was refused.
        """
        from flatsat_ros.nodes.fault_lab import RELAY

        if refusal := self._answer(self.conductor.set_parameter(RELAY, name, value)):
            raise FlatsatError(f"the relay refused {name} = {value!r}: {refusal}")

    def set_parameter(self, name: str, value: object) -> None:
        """Ask the controller to take another value of a parameter."""
        from flatsat_ros.nodes.fault_lab import CONTROLLER

        self._remark(self._answer(self.conductor.set_parameter(CONTROLLER, name, value)))

    def go_to(self, drone: int, goal: FloatArray) -> None:
        """Send a goal (3,), m, and let the path lead there."""
        self.paths[drone] = np.vstack([self.paths[drone], goal])
        self.conductor.send_goal(drone, goal.tolist())

    def land_drone(self, drone: int) -> None:
        """Ask the controller to land a drone."""
        self._remark(self._answer(self.conductor.ask_landing(drone)))

    def ask_drone(self, drone: int, name: str) -> None:
        """Ask a drone itself for an emergency stop or a reboot."""
        self._answer(self.conductor.ask_drone(drone, name))

    def _answer(self, answer: Any) -> str:
        """Wait for an answer of rclpy and return why it is a refusal, nothing if it is none."""
        return self.conductor.refusal(answer) if self.wait_until(answer.done, _ANSWER) else "no answer"

    def _remark(self, refusal: str) -> None:
        if refusal:
            self.remarks += [Remark(0.0, drone, f"refused: {refusal}") for drone in range(len(ROBOTS))]

    def begin(self) -> None:
        """Forget what the controllers have said so far."""
        self._files = {log: log.stat().st_size for log in self._files}

    def heard(self) -> list[Remark]:
        """Return what was said since the fault began, of a drone that is named or else of all."""
        remarks = list(self.remarks)
        for log, begin in self._files.items():
            for line in log.read_bytes()[begin:].decode("utf-8", errors="replace").splitlines():
                text = one_line(line.rpartition("]: ")[2], TEXT)
                named = [drone for drone, robot in enumerate(ROBOTS) if robot in text]
                remarks += [Remark(0.0, drone, text) for drone in named or range(len(ROBOTS))]
        return remarks

    def hover(self, height: float) -> bool:
        """Let all drones take off until they have been flown above a height, m, for a while; return whether they were.

        A drone that stands again, as its take-off was given up or its flight has ended, is asked again.
        """
        self.take_off()
        asked = low = self.now()
        latest = asked + _HOVER_LATEST
        while (now := self.now()) < low + _SETTLING:
            if now > latest:
                return False
            if not (self.conductor.heights() >= height).all() or self.conductor.robots_in(*set(Mode) - {Mode.FLY}):
                low = now
            if now > asked + _ASK_AGAIN and self.conductor.robots_in(Mode.IDLE, Mode.CUT):
                self.take_off()
                asked = self.now()
            self.let_pass(SLICE)
        return True


def _perform(fault: LiveFault, flight: LiveFlight) -> float:
    """Fly, let the fault happen, and watch; return when it began on the record's clock, s.

    Raises:
        FlatsatError: the nodes did not find each other, or the drones did not take off.
    """
    for name in ("sim_drone", "relay", "controller"):
        flight.start(name)
    flight.wait_for_nodes()
    total = _SETTLING + max(delay for delay, _ in fault.steps) + fault.watched
    with flight.progress(total, fault.name, leave=False):
        for drone, path in enumerate(flight.paths):
            flight.paths[drone] = np.vstack([path, path[-1] + (0.0, 0.0, fault.height)])
        if not flight.hover(fault.height - _ARRIVED):
            raise FlatsatError(f"{fault.name}: the drones do not hover {fault.height:g} m high in {_HOVER_LATEST:g} s")
        flight.begin()
        moment, began = flight.now(), flight.conductor.seconds(flight.conductor.now())
        for delay, action in fault.steps:
            flight.let_pass(max(moment + delay - flight.now(), 0.0))
            action(flight)
        flight.let_pass(fault.watched)
    return began


def _judged(fault: LiveFault, began: float, flight: LiveFlight, certificate: str) -> Row:
    """Judge a flight from its record since the fault."""
    outcomes = _outcomes(began, flight)
    ended = [flight.failure] if flight.failure else []
    if fault.leaves:
        code = flight.nodes["controller"].poll()
        if code != 0:
            ended.append(f"the controller {'has not ended' if code is None else f'ended with exit code {code}'}")
    remarks, name, victims = flight.heard(), fault.name, fault.victims
    problems = ended + list(broken(outcomes, fault.bounds, victims, remarks, lands=False))
    judged = bool(problems) and not ended
    accepted = judged and is_accepted(certificate, name, LIVE, outcomes, victims, remarks, lands=False)
    return row_of(name, LIVE, 0, outcomes, victims, remarks, problems, certificate, accepted=accepted)


def _outcomes(began: float, flight: LiveFlight) -> list[DroneOutcome]:
    lab = flight.conductor
    times, places = lab.truth()
    velocities = np.zeros_like(places)
    velocities[1:] = np.diff(places, axis=0) / np.maximum(np.diff(times), 1e-6)[:, np.newaxis, np.newaxis]
    record = Record(np.array(_STARTS), 0.0)
    record.paths = flight.paths
    grounded = places[:, :, 2] <= _FLOOR
    for time, place, velocity, down in zip(times, places, velocities, grounded, strict=True):
        if time >= began:
            record.feel(velocity, down)
            record.look(time, place)
    motors = lab.thrusts(load_vehicle(VEHICLE), lab.seconds(lab.now()) - _LAST) > 0.0
    alive = flight.nodes["controller"].poll() is None
    modes = lab.modes()
    return [
        record.outcome(
            drone,
            grounded=bool(grounded[-1, drone]),
            motors=bool(motors[drone]),
            speed=float(np.linalg.norm(velocities[-1, drone])),
            off=float(np.linalg.norm(places[-1, drone] - flight.paths[drone][-1])),
            mode=modes[drone] if alive else None,
        )
        for drone in range(len(ROBOTS))
    ]
