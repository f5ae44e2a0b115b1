"""Why drones must not start their motors, for what is found outside the tick: an empty battery, a second sender."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum

from flatsat_ros.base.errors import FlatsatError


class Cause(Enum):
    """What keeps a drone on the ground."""

    BATTERY = "battery"
    RIVALS = "rivals"


class Clearance:
    """What keeps drones on the ground; nothing at first."""

    def __init__(self) -> None:
        self._reasons: dict[tuple[int, Cause], str] = {}

    def bar(self, index: int, cause: Cause, reason: str) -> None:
        """Let drone index not start for a reason, empty for none: then this cause does not keep it any more."""
        if reason:
            self._reasons[index, cause] = reason
        else:
            self._reasons.pop((index, cause), None)

    def require(self, index: int) -> None:
        """Refuse to start drone index.

        Raises:
            FlatsatError: something keeps it on the ground; the text says what.
        """
        reasons = [reason for barred, reason in self.barred() if barred == index]
        if reasons:
            raise FlatsatError("; ".join(reasons))

    def barred(self) -> Iterator[tuple[int, str]]:
        """Yield who is kept on the ground, and why."""
        for (index, _), reason in self._reasons.items():
            yield index, reason
