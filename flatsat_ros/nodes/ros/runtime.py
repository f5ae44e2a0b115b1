"""How a node of this package lives: start, spin until a signal, finish what must be finished, leave."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from flatsat_ros.base.errors import FlatsatError

# a signal is noticed within this time, s
_PATIENCE = 0.1
# a condition is looked at this often while a node finishes, s
_FINISHING_PATIENCE = 0.05


class ProgramNode(Node):
    """A node that is a whole program.

    Attributes:
        done: whether it has nothing left to do and the program shall end.
        exit_code: of the program.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.done = False
        self.exit_code = 0

    def finish(self) -> None:
        """Leave the world in a safe state at the end of the program; publishers and `spin_while` still work."""

    def spin_while(self, condition: Callable[[], bool]) -> None:
        """Let callbacks run for as long as the condition holds; for `finish`."""
        executor = self.executor
        while executor is not None and condition():
            executor.spin_once(timeout_sec=_FINISHING_PATIENCE)


def run(make_node: Callable[[], ProgramNode], arguments: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or its own `done`; return the process's exit code.

    rclpy's own signal handlers close the context under the running callbacks, after which nothing can be published;
    ours only set a flag, so that `finish` can still send the last commands. A further SIGINT is ignored while it does.
    The handlers of before are back when this returns.
    """
    stopped: list[int] = []
    with _handling_signals(lambda number, _: stopped.append(number)):
        try:
            options = SignalHandlerOptions.NO
            rclpy.init(args=None if arguments is None else list(arguments), signal_handler_options=options)
        except RuntimeError as error:  # RCLError: arguments that ROS itself does not take
            return _refuse(" ".join(str(error).split()))
        try:
            node = make_node()
        except (FlatsatError, OSError, NameValidationException, rclpy_implementation.RCLError) as error:
            rclpy.try_shutdown()
            return _refuse(" ".join(str(error).split()))
        executor: Executor = EventsExecutor()
        executor.add_node(node)
        try:
            while not stopped and not node.done:
                executor.spin_once(timeout_sec=_PATIENCE)
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            node.finish()
            executor.shutdown()
            node.destroy_node()
            rclpy.try_shutdown()
        return node.exit_code


@contextmanager
def _handling_signals(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Have SIGINT and SIGTERM call a handler; put the handlers of before back at the end."""
    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_DFL if old is None else old)


def _refuse(reason: str) -> int:
    print(f"error: {reason}", file=sys.stderr)
    return 2
