"""Medians, quartiles, targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Quartiles(NamedTuple):
    """The spread of one figure over the rounds."""

    median: float
    lower: float
    upper: float

    def __str__(self) -> str:
        return f"{self.median:.4g} [{self.lower:.4g}, {self.upper:.4g}]"


class Target(NamedTuple):
    """A promise about a ratio, and what was measured."""

    what: str
    at_most: float
    measured: Quartiles

    @property
    def met(self) -> bool:
        """Whether the median keeps the promise."""
        return self.measured.median <= self.at_most


def quartiles(values: Sequence[float]) -> Quartiles:
    """Return median, lower and upper quartile."""
    lower, median, upper = np.quantile(values, [0.25, 0.5, 0.75])
    return Quartiles(float(median), float(lower), float(upper))


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return the rows in columns, the first one flush left."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = [header, ["-" * width for width in widths], *rows]
    return "\n".join(
        "  ".join([line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    )
