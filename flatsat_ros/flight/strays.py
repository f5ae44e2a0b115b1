"""Who does not move as commanded, by whatever detector that was found, and what people are told of it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flatsat_ros.base.arrays import any_of


class Strays:
    """Those of N drones that do not move as commanded.

    Attributes:
        who: (N,) that was found to be astray, until it is down.
    """

    def __init__(self, count: int) -> None:
        """Begin with nobody astray."""
        self.who = np.zeros(count, dtype=bool)
        self._reports: list[tuple[int, str]] = []

    def add(self, found: np.ndarray) -> list[int]:
        """Take some drones, (N,), for astray; return for whom of them that is new."""
        anew = found & ~self.who
        if not any_of(anew):
            return []
        self.who = self.who | anew
        return [int(index) for index in np.flatnonzero(anew)]

    def tell(self, reports: Iterable[tuple[int, str]]) -> None:
        """Let people be told of drones, of each a text."""
        self._reports += reports

    def reports(self) -> list[tuple[int, str]]:
        """Return what is to be told, drone and text, once."""
        reports, self._reports = self._reports, []
        return reports
