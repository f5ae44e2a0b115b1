"""How a node of this package lives: start, spin until a signal, finish what must be finished, leave."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from flatsat_ros.base.errors import FlatsatError

# a signal is noticed within this time, s
_PATIENCE = 0.1


def run(make_node: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or its own `done` attribute; return the process's exit code.

    A node's attribute `exit_code` says how it went, 0 without one. A node with a `finish` method is asked at the end to
    leave the world in a safe state; publishers still work then.

    rclpy's own signal handlers close the context under the running callbacks, after which nothing can be published;
    ours only set a flag, so that `finish` can still send the last commands.
    """
    stopped: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        stopped.append(number)

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    try:
        rclpy.init(args=None if arguments is None else list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # RCLError: arguments that ROS itself does not take
        print("error: " + " ".join(str(error).split()), file=sys.stderr)
        return 2
    try:
        node = make_node()
    except FlatsatError as error:
        print(f"error: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        while not stopped and not getattr(node, "done", False):
            executor.spin_once(timeout_sec=_PATIENCE)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        getattr(node, "finish", lambda: None)()
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return int(getattr(node, "exit_code", 0))
