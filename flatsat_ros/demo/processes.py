"""The nodes of a live flight as processes: their command lines, their start and their end."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.files import make_folder
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.demo.scenario import POSE_NOISE, VEHICLE, Scenario
from flatsat_ros.flight.defaults import GAMMA_0, MU, V_INF

_GOODBYE = 5.0  # s, that a node has to end by itself, and once more after a second signal, before it is killed

Nodes = Mapping[str, "subprocess.Popen[bytes]"]


def commands_of(scenario: Scenario, namespace: str) -> dict[str, list[str]]:
    """Return the command line of every node by name: one controller, and a sim_drone for each drone.

    The drones of a plan share one, and its room: there may be many.
    """
    link_delay = 0.0 if scenario.paper else LINK_DELAY
    commands = {
        "controller": command_of(
            "controller_node",
            namespace,
            {
                "robot_names": json.dumps(scenario.robots),
                "certificate": str(scenario.certificate_path.resolve()),
                "vehicle": VEHICLE,
                "mu": repr(MU),
                "v_inf": repr(V_INF),
                "gamma_0": repr(GAMMA_0),
                "takeoff_height": repr(scenario.height),
                "floor": repr(scenario.floor),
                "separation": repr(scenario.policy.separation),
                "restart_gain": repr(not scenario.paper).lower(),
                "goal_mode": scenario.policy.goal_mode.value,
                "thrust_error_max": repr(scenario.policy.thrust_error_max),
                "disturbance_max": repr(scenario.policy.disturbance_max),
                "link_delay": repr(link_delay),
                **({} if scenario.plan_path is None else {"plan": str(scenario.plan_path.resolve())}),
            },
        )
    }
    apart = scenario.plan is None
    numbers = range(len(scenario.robots))
    for i, members in enumerate([[number] for number in numbers] if apart else [list(numbers)]):
        robots = [scenario.robots[number] for number in members]
        commands[f"sim_drone_{robots[0]}" if apart else "sim_drone"] = command_of(
            "sim_drone",
            namespace,
            {
                "robot_names": json.dumps(robots),
                "vehicle": VEHICLE,
                "dynamics": scenario.dynamics,
                "start_positions": str(scenario.start[members].ravel().tolist()),
                "floor": repr(scenario.floor),
                "wind": f"[{scenario.wind!r}, 0.0, 0.0]",
                "position_noise": repr(POSE_NOISE),
                "command_delay": repr(link_delay),
                "seed": str(i),
            },
        )
    return commands


def command_of(module: str, namespace: str, parameters: Mapping[str, str]) -> list[str]:
    """Return the command line of a node that ends with this process, however that ends.

    Args:
        module: of flatsat_ros.nodes.
        namespace: in which it runs.
        parameters: values as on a command line.
    """
    settings = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
    program = [sys.executable, "-m", "flatsat_ros.demo.leashed", f"flatsat_ros.nodes.{module}"]
    return [*program, "--ros-args", "-r", f"__ns:={namespace}", *settings]


def start(command: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
    """Start a node and let it write into a log file.

    It is no member of the terminal's group: Ctrl-C reaches this process alone, which then ends it.
    """
    with log.open("wb") as stream:
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=stream, stderr=stream, start_new_session=True)


@contextmanager
def running(commands: Mapping[str, list[str]], logs: Path) -> Iterator[Nodes]:
    """Start the processes, each with its own log file, and end them, whatever happens in between.

    Raises:
        FlatsatError: a process that was still running at the end did not leave by itself with exit code 0.
    """
    make_folder(logs)
    started: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, command in commands.items():
            started[name] = start(command, logs / f"{name}.log")
        yield started
    except BaseException:
        end(started)
        raise
    unclean = end(started)
    if unclean:
        raise FlatsatError(f"{', '.join(unclean)} did not end cleanly; see {logs}")


def require_alive(nodes: Nodes, logs: Path) -> None:
    """Refuse to go on without one of the processes, whose logs are in a folder.

    Raises:
        FlatsatError: one has ended.
    """
    for name, process in nodes.items():
        if process.poll() is not None:
            log = logs / f"{name}.log"
            raise FlatsatError(f"node {name} died in flight with exit code {process.returncode}; see {log}")


def end(nodes: Nodes) -> list[str]:
    """End all processes and return the names of those that did not leave by themselves with exit code 0."""
    for _ in range(2):  # the second signal ends a controller that is still landing its drones
        for process in nodes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        _wait(nodes)
    unclean = []
    for name, process in nodes.items():
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stdin is not None:
            process.stdin.close()
        if process.returncode != 0:
            unclean.append(f"{name} (exit code {process.returncode})")
    return unclean


def _wait(nodes: Nodes) -> None:
    """Give processes that were told to end the time for it."""
    deadline = time.monotonic() + _GOODBYE
    for process in nodes.values():
        with suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, deadline - time.monotonic()))
