"""Faults of real processes: signals, restarts, odd messages, and what a relay does to poses and commands."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from flatsat_ros.falsification.faults.criteria import Criteria, End
from flatsat_ros.flight.trajectory import Trajectory

if TYPE_CHECKING:
    from flatsat_ros.falsification.faults.live import LiveFlight
    from flatsat_ros.nodes.fault_lab import FaultLab

Action = Callable[["LiveFlight"], object]

ONE, BOTH = (0,), (0, 1)
_POSE = r"pose"
_LATE = r"late|stall|stood still|tick"
_REFUSED = r"refused|must be|at most|too (many|long)"
_UNDISTURBED = Criteria(End.DONE, distance=0.5, told=_REFUSED)
_POINTS = 100_000


@dataclass(frozen=True, eq=False)
class LiveFault:
    """Something that goes wrong with real processes.

    Attributes:
        name: on the command line.
        meaning: what goes wrong, in words.
        steps: what happens, with the time since the beginning of the fault, s, in order.
        bounds: what the drones with the fault must keep.
        victims: the drones with the fault.
        height: of the flight, m.
        watched: for how long after the last step the drones are watched, s.
        leaves: the controller must end by itself, with exit code 0.
        prepare: what takes long and is therefore done before the flight.
    """

    name: str
    meaning: str
    steps: tuple[tuple[float, Action], ...]
    bounds: Criteria
    victims: tuple[int, ...] = ONE
    height: float = 1.0
    watched: float = 8.0
    leaves: bool = False
    prepare: Callable[[FaultLab], bytes] | None = None


def _send(name: str, number: signal.Signals) -> Action:
    return lambda flight: flight.send(name, number)


def _start(name: str) -> Action:
    return lambda flight: flight.start(name)


def _poses(fault: str) -> Action:
    return lambda flight: flight.relay("pose_fault", fault)


def _set(name: str, value: object) -> Action:
    return lambda flight: flight.set_parameter(name, value)


def _ask_drone(name: str) -> Action:
    return lambda flight: flight.ask_drone(0, name)


def _goal(*position: float, w: float = 1.0) -> Action:
    return lambda flight: flight.conductor.send_goal(0, position, (0.0, 0.0, 0.0, w))


def _goal_above(flight: LiveFlight) -> None:
    flight.go_to(0, flight.paths[0][-1] + (0.0, 0.0, 1.0))


def _once(name: str, meaning: str, action: Action, bounds: Criteria, victims: tuple[int, ...] = ONE) -> LiveFault:
    """Do one thing, and watch for longer."""
    return LiveFault(name, meaning, ((0.0, action),), bounds, victims, watched=10.0)


def _ends(
    name: str, meaning: str, *steps: tuple[float, signal.Signals], bounds: Criteria, height: float = 1.0
) -> LiveFault:
    """End the controller by signals."""
    actions = tuple((delay, _send("controller", number)) for delay, number in steps)
    return LiveFault(name, meaning, actions, bounds, BOTH, height, watched=10.0, leaves=True)


def _standing(lab: FaultLab) -> bytes:
    """Return the message of a trajectory of very many points that stays where drone 0 hovers."""
    times = 0.001 * np.arange(_POINTS)
    places, rest = np.tile([0.0, 0.0, 1.0], (_POINTS, 1)), np.zeros((_POINTS, 3))
    return lab.serialized(Trajectory.through(times, places, rest, rest))


LIVE_FAULTS: dict[str, LiveFault] = {
    fault.name: fault
    for fault in (
        LiveFault(
            "controller_killed",
            "kill -9 of the controller, started again at once; the firmware stops the motors after 2 s",
            ((0.0, _send("controller", signal.SIGKILL)), (0.3, _start("controller"))),
            Criteria(End.DOWN, impact=math.inf),
            BOTH,
        ),
        LiveFault(
            "sim_drone_killed",
            "kill -9 of sim_drone, started again at once: the drones are back on the floor",
            ((0.0, _send("sim_drone", signal.SIGKILL)), (0.5, _start("sim_drone"))),
            Criteria(End.DOWN, impact=math.inf, told=_POSE),
            BOTH,
            watched=12.0,
        ),
        LiveFault(
            "controller_stopped_1s",
            "SIGSTOP of the controller for 1 s",
            ((0.0, _send("controller", signal.SIGSTOP)), (1.0, _send("controller", signal.SIGCONT))),
            Criteria(End.DONE, told=_LATE),
            BOTH,
        ),
        LiveFault(
            "controller_stopped_5s",
            "SIGSTOP of the controller for 5 s; the firmware stops the motors after 2 s",
            ((0.0, _send("controller", signal.SIGSTOP)), (5.0, _send("controller", signal.SIGCONT))),
            Criteria(End.DOWN, impact=math.inf, told=_LATE),
            BOTH,
        ),
        LiveFault(
            "sim_drone_stopped_1s",
            "SIGSTOP of sim_drone for 1 s: no poses, and the drones stand still in the air",
            ((0.0, _send("sim_drone", signal.SIGSTOP)), (1.0, _send("sim_drone", signal.SIGCONT))),
            Criteria(End.DONE, told=_POSE),
            BOTH,
        ),
        LiveFault(
            "relay_killed",
            "kill -9 of the link, poses and commands: the firmware stops the motors after 2 s",
            ((0.0, _send("relay", signal.SIGKILL)),),
            Criteria(End.DOWN, impact=math.inf, told=_POSE),
            BOTH,
        ),
        _ends("sighup", "SIGHUP, as of a closed terminal", (0.0, signal.SIGHUP), bounds=Criteria(End.DOWN)),
        _ends("sigterm", "SIGTERM", (0.0, signal.SIGTERM), bounds=Criteria(End.DOWN)),
        _ends("ctrl_c", "Ctrl-C, 1 m above the floor", (0.0, signal.SIGINT), bounds=Criteria(End.DOWN)),
        _ends("ctrl_c_2m", "Ctrl-C, 2 m above the floor", (0.0, signal.SIGINT), bounds=Criteria(End.DOWN), height=2.0),
        _ends(
            "ctrl_c_then_sigterm",
            "Ctrl-C, 0.5 s later SIGTERM",
            (0.0, signal.SIGINT),
            (0.5, signal.SIGTERM),
            bounds=Criteria(End.DOWN),
        ),
        _ends(
            "ctrl_c_twice",
            "Ctrl-C, and again 0.5 s later",
            (0.0, signal.SIGINT),
            (0.5, signal.SIGINT),
            # the firmware keeps the last command for 2 s
            bounds=Criteria(End.DOWN, impact=math.inf),
        ),
        _once("use_sim_time", "use_sim_time is set in flight", _set("use_sim_time", True), _UNDISTURBED, BOTH),
        LiveFault(
            "parameters",
            "parameters that cannot be: mu of NaN, a cap of 1e9, a read-only one, one that is not there",
            tuple(
                (0.1 * number, _set(name, value))
                for number, (name, value) in enumerate(
                    [("mu", math.nan), ("gamma_max", 1e9), ("pose_timeout", 5.0), ("no_such_parameter", 1.0)]
                )
            ),
            _UNDISTURBED,
            BOTH,
        ),
        _once("goal_orientation", "a goal with w = 1e200", _goal(0.0, 0.0, 1.0, w=1e200), _UNDISTURBED),
        _once("goal_huge", "a goal of 1.7e308 m", _goal(1.7e308, 0.0, 1.0), _UNDISTURBED),
        _once("goal_nan", "a goal of NaN", _goal(math.nan, 0.0, 1.0), _UNDISTURBED),
        LiveFault(
            "trajectory_long",
            f"a trajectory of {_POINTS} points",
            ((0.0, lambda flight: flight.conductor.send_serialized(0, flight.prepared)),),
            _UNDISTURBED,
            prepare=_standing,
        ),
        LiveFault(
            "pose_bytes",
            "poses of eight odd bytes among the right ones, for 2 s",
            ((0.0, _poses("bytes")), (2.0, _poses(""))),
            Criteria(End.DONE, distance=0.5, told=r"pose|byte"),
        ),
        _once("pose_frame", "poses in another frame_id", _poses("frame"), Criteria(End.DOWN, told=r"frame")),
        LiveFault(
            "poses_lost_1s",
            "no pose for 1 s",
            ((0.0, _poses("lost")), (1.0, _poses(""))),
            Criteria(End.DONE, told=_POSE),
        ),
        _once("poses_lost", "no pose for good", _poses("lost"), Criteria(End.DOWN, told=_POSE)),
        _once(
            "poses_repeated",
            "the last pose again and again, with fresh stamps",
            _poses("repeated"),
            Criteria(End.DOWN, told=_POSE),
        ),
        _once(
            "second_source",
            "a second source of poses, 1 m off, in bursts of 0.5 s",
            _poses("second_source"),
            Criteria(End.SAFE, told=r"second|sender|two|publishers"),
        ),
        LiveFault(
            "second_controller",
            "a second controller for the same drones, and a goal for both controllers",
            ((0.0, _start("second_controller")), (3.0, _goal_above)),
            Criteria(End.SAFE, told=r"second|sender|two|publishers|another"),
            BOTH,
        ),
        LiveFault(
            "land_in_climb",
            "land, 0.7 s after a goal 1 m above",
            ((0.0, _goal_above), (0.7, lambda flight: flight.land_drone(0))),
            Criteria(End.DOWN),
            watched=12.0,
        ),
        LiveFault(
            "emergency_reboot",
            "emergency stop, 3 s later a reboot",
            ((0.0, _ask_drone("emergency")), (3.0, _ask_drone("reboot"))),
            Criteria(End.DOWN, impact=math.inf, told=r"climb|motors|fall|rise|emergency|lock|reboot"),
            watched=12.0,
        ),
    )
}  # fmt: skip
