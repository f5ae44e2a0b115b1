"""Errors that end where they happen, so that what one message or one drone causes touches no other.

This is the one place where exceptions of callbacks are caught.
"""

from __future__ import annotations

import time
import traceback
from collections import Counter
from collections.abc import Callable
from types import TracebackType
from typing import TypeVar

from rclpy.impl.rcutils_logger import RcutilsLogger

from flatsat_ros.base.errors import FlatsatError, one_line
from flatsat_ros.nodes.ros.throttle import Throttle

T = TypeVar("T")

# the same is told again after this time at the earliest, s: what was refused, and what failed
_REFUSAL_SILENCE, _SILENCE = 1.0, 10.0
# the innermost calls of a traceback that are shown, and its length in characters
_CALLS, _LENGTH = 12, 4000


class Faults:
    """What failed in a node: counted and told by the name of what failed, such as `cf1/goal_pose`.

    A refusal, a FlatsatError, is told in one line; any other exception is an error of the program and comes with its
    traceback. Each is told at once, and again at most once a second or every ten seconds while it lasts.

    Attributes:
        counts: how often each failed.
    """

    def __init__(self, logger: RcutilsLogger, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without faults.

        Args:
            logger: where they are told.
            clock: s, never set.
        """
        self.counts: Counter[str] = Counter()
        self._logger, self._throttle = logger, Throttle(clock)
        self._newest: dict[str, str] = {}

    def contain(self, name: str) -> Containment:
        """Return a context whose exceptions end with it; they count under a name."""
        return Containment(self, name)

    def contained(self, name: str, callback: Callable[[T], object]) -> Callable[[T], None]:
        """Return a callback whose exceptions end with it.

        What is called when a future is done needs this most: an exception there makes rclpy's executor crash.
        """

        def call(argument: T) -> None:
            with self.contain(name):
                callback(argument)

        return call

    def note(self, name: str, error: Exception) -> None:
        """Count an exception, and tell it unless that name was told a moment ago."""
        self.counts[name] += 1
        refused = isinstance(error, FlatsatError)
        text = one_line(str(error) if refused else f"{type(error).__name__}: {error}")
        self._newest[name.partition("/")[0]] = f"{name}: {text}"
        times = self._throttle.admit(name, _REFUSAL_SILENCE if refused else _SILENCE)
        if times is None:
            return
        if refused:
            self._logger.error(f"{name}: {text}{times}")
        else:
            where = "".join(traceback.format_exception(error, limit=-_CALLS))
            self._logger.error(f"{name} failed: {text}{times}\n{where[-_LENGTH:]}")

    def count(self, robot: str) -> int:
        """Return how many faults have a name below a robot's."""
        return sum(number for name, number in self.counts.items() if name.startswith(f"{robot}/"))

    def newest(self, robot: str) -> str:
        """Return the last fault below a robot's name, empty if there was none."""
        return self._newest.get(robot, "")


class Containment:
    """A context whose exceptions end with it; see `Faults.contain`."""

    __slots__ = ("_faults", "_name")

    def __init__(self, faults: Faults, name: str) -> None:
        self._faults, self._name = faults, name

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, _: type[BaseException] | None, error: BaseException | None, __: TracebackType | None) -> bool:
        """Take an exception; not one that ends the interpreter."""
        if not isinstance(error, Exception):
            return False
        self._faults.note(self._name, error)
        return True
