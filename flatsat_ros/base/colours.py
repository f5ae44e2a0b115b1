"""The colours of drones and curves: the same on pages, in RViz and in pictures, which are legible in print."""

from __future__ import annotations

from typing import Any

import numpy as np

# Okabe and Ito's colours, which colour-blind people can tell apart, but for yellow and black, which no background bears
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8a00", "#7f7f7f")

# how matplotlib draws pictures; the salt makes SVG files that are the same in every run
PICTURES: dict[Any, Any] = {
    "axes.prop_cycle": f"cycler('color', {list(COLOURS)})",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "legend.framealpha": 0.9,
    "svg.hashsalt": "flatsat_ros",
}
# a limit, and what a proof asks for
LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": "--", "linewidth": 1.0}


def colour_of(index: int) -> str:
    """Return the colour of a drone by its index; from the ninth on they come again."""
    return COLOURS[index % len(COLOURS)]


def widths(count: int) -> list[float]:
    """Return widths, points, of curves that are drawn one after the other: where they coincide, all are seen."""
    return [float(width) for width in np.linspace(2.2, 1.0, count)]
