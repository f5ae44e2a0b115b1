"""Lines of the log that are told at once, and then not too often."""

from __future__ import annotations

import time
from collections.abc import Callable


class Throttle:
    """Decides what is told, by name."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin with nothing told; the clock shows s and is never set."""
        self._clock = clock
        self._told: dict[str, tuple[float, int]] = {}  # when, and how often it has happened since

    def admit(self, name: str, silence: float) -> str | None:
        """Return what to add to the line if it is to be told now: how often it has happened since the last time.

        Args:
            name: of what happens, such as a robot and what it did.
            silence: the same name is told again after so many s at the earliest.

        Returns:
            None if it is not to be told.
        """
        now = self._clock()
        before, missed = self._told.get(name, (-silence, 0))
        if now - before < silence:
            self._told[name] = (before, missed + 1)
            return None
        self._told[name] = (now, 0)
        return f" ({missed + 1} times)" if missed else ""
