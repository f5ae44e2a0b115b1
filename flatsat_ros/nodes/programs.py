"""The console scripts of the nodes: each loads its node when it is called, so that a missing ROS is one line.

Nothing of ROS is imported here.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from types import FrameType


def controller(argv: Sequence[str] | None = None) -> int:
    """Run the controller."""
    return _run("controller_node", argv)


def sim_drone(argv: Sequence[str] | None = None) -> int:
    """Run the simulated drones."""
    return _run("sim_drone", argv)


def sim_server(argv: Sequence[str] | None = None) -> int:
    """Run the simulated drones in the place of crazyswarm2's server."""
    return _run("sim_server", argv)


def cflib_bridge(argv: Sequence[str] | None = None) -> int:
    """Run the link to real Crazyflies through cflib."""
    return _run("cflib_bridge", argv)


def mocap_player(argv: Sequence[str] | None = None) -> int:
    """Run the player of recordings."""
    return _run("mocap_player", argv)


def record(argv: Sequence[str] | None = None) -> int:
    """Run the recorder of bags."""
    return _run("recorder", argv)


def console(argv: Sequence[str] | None = None) -> int:
    """Run the page that shows and commands the drones."""
    return _run("console", argv)


def _run(module: str, argv: Sequence[str] | None) -> int:
    """Run the main function of a node's module.

    Returns:
        The exit code of the process: 2 if a library is missing, 130 where Ctrl-C comes before the node hears it.
    """
    stopped: list[int] = []
    try:
        with _stoppable(stopped):
            program = import_module(f"flatsat_ros.nodes.{module}")
    except (Exception, KeyboardInterrupt) as error:
        # an import that Ctrl-C ends may fail with an error of its own
        if not stopped:
            if not isinstance(error, ImportError):
                raise
            reason = " ".join(str(error).split())
            hint = "" if find_spec("rclpy") else "; source ROS 2 Jazzy first: . /opt/ros/jazzy/setup.bash"
            print(f"error: {reason}{hint}", file=sys.stderr)
            return 2
    if stopped:
        print("stopped", file=sys.stderr)
        return 128 + signal.SIGINT
    return int(program.main(argv))


@contextmanager
def _stoppable(stopped: list[int]) -> Iterator[None]:
    """Let Ctrl-C raise KeyboardInterrupt, where it is not ignored, and take a note of it."""

    def stop(number: int, _frame: FrameType | None) -> None:
        stopped.append(number)
        raise KeyboardInterrupt

    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        yield
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
