"""Cut a box of plants into cells until the tube proved of it is hardly larger than that of its worst corner."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube, cell_tubes

# How much one figure matters against another, per width relative to its value; only the number of cells depends on it.
_WEIGHTS = {"lag": 1.0, "gain": 1.25, "frequency": 3.5, "damping": 1.0, "tilt": 0.1, "drag": 0.05}

# At least so many parts are cut in a round, if there are as many; only the time depends on it.
_ROUND = 64


@dataclass(frozen=True)
class Cover:
    """A box in cells.

    Attributes:
        cuts: the figures across which the box is cut, as `box_tube` reads them.
        tube: what is proved of all of it.
        corners: the tube of the worst corners, each known exactly: no cover has a smaller one.
    """

    cuts: tuple[str, ...]
    tube: AxisTube
    corners: AxisTube


def extreme_boxes(box: PlantBox, lag_varies: bool = False) -> list[PlantBox]:
    """Return the boxes in which every figure that does not change in flight is the least or the largest of a box.

    Args:
        box: the plants.
        lag_varies: whether lag, frequency and damping change in flight.
    """
    names, spread = box.constants(lag_varies), box.spread
    values = [dict(zip(names, ends, strict=True)) for ends in itertools.product(*(spread[name] for name in names))]
    return [PlantBox(replace(box.low, **ends), replace(box.high, **ends)) for ends in values]


def corner_tube(
    design: Design, box: PlantBox, gain_min: float, gain_max: float, assumptions: Assumptions, lag_varies: bool = False
) -> AxisTube:
    """Return the tube of the corners of a box alone; of the plants between it says nothing.

    The arguments are those of `cover`.
    """
    tube = AxisTube(0.0, 0.0, 0.0, 0.0)
    for corner in cell_tubes(design, extreme_boxes(box, lag_varies), gain_min, gain_max, assumptions, lag_varies):
        tube |= corner
    return tube


class CoverError(FlatsatError):
    """The refusal of a box that cannot be covered with so many cells.

    Attributes:
        box: the plants.
        figure: the one across which most parts were cut.
    """

    def __init__(self, text: str, box: PlantBox, figure: str) -> None:
        """Take over the text, the box and the figure."""
        super().__init__(text)
        self.box, self.figure = box, figure


_UNBOUNDED = AxisTube(math.inf, math.inf, math.inf, math.inf)


@dataclass
class _Part:
    """A part of a box: its tube, the figure across which it is cut, "" for a cell, and its halves."""

    box: PlantBox
    tube: AxisTube = _UNBOUNDED
    cut: str = ""
    halves: tuple[_Part, ...] = ()

    def cuts(self) -> Iterator[str]:
        """Yield the cuts as `box_tube` reads them."""
        yield self.cut
        for half in self.halves:
            yield from half.cuts()


def cover(
    design: Design,
    box: PlantBox,
    gain_min: float,
    gain_max: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
    excess: float = 0.05,
    cells_max: int = 2000,
) -> Cover:
    """Cut a box until every cell has a position tube of at most (1 + excess) times that of the worst corner.

    Where that needs more cells than are made, the worst are cut first, and their tube is whatever comes of it.

    Args:
        design: the controller.
        box: the plants.
        gain_min: smallest applied gain.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: whether lag, frequency and damping change in flight.
        excess: relative.
        cells_max: more are not made.

    Raises:
        FlatsatError: a corner has no tube.
        CoverError: so many cells do not do for a bounded tube.
    """
    worst = corner_tube(design, box, gain_min, gain_max, assumptions, lag_varies)
    aim = worst.position * (1.0 + excess)
    if not worst.position < math.inf:
        raise FlatsatError("tube of a corner of the box = inf m: must be bounded, with other gains or a smaller box")
    proved, root = AxisTube(0.0, 0.0, 0.0, 0.0), _Part(box)
    count, new, wide, cut = 1, [root], list[_Part](), Counter[str]()
    while new:
        whole = [part for part in new if part.box.within_periods(design.period)]
        tubes = cell_tubes(design, [part.box for part in whole], gain_min, gain_max, assumptions, lag_varies)
        for part, tube in zip(whole, tubes, strict=True):
            part.tube = tube
        for part in new:
            if part.tube.position <= aim or not _next_cut(part.box, design.period, lag_varies):
                proved |= part.tube
            else:
                wide.append(part)
        # the worst ones, so that what more cells can do is done where it matters most
        wide.sort(key=lambda part: part.tube.position)
        room = min(cells_max - count, max(_ROUND, (len(wide) + 1) // 2), len(wide))
        parts, wide = wide[len(wide) - room :], wide[: len(wide) - room]
        for part in parts:
            part.cut = _next_cut(part.box, design.period, lag_varies)
            cut[part.cut] += 1
            first, second = part.box.halves(part.cut, design.period)
            part.halves = _Part(first), _Part(second)
        count += len(parts)
        new = [half for part in parts for half in part.halves]
    for part in wide:
        proved |= part.tube
    if not proved.position < math.inf:
        figure = max(cut, key=lambda name: cut[name], default=_next_cut(box, design.period, lag_varies))
        text = f"cells = more than {cells_max}: must be fewer, with narrower intervals of the plants"
        raise CoverError(text, box, figure)
    return Cover(tuple(root.cuts()), proved, worst)


def _next_cut(box: PlantBox, period: float, lag_varies: bool) -> str:
    """Return the figure across which a cell is widest, in what it does to the loop; empty for a single plant."""
    if not box.within_periods(period):
        return "delay"
    widths = {}
    for name in box.constants(lag_varies):
        low, high = box.spread[name]
        size = period if name == "delay" else max(abs(low), abs(high))
        widths[name] = (high - low) / size * _WEIGHTS.get(name, 1.0)
    return max(widths, key=lambda name: widths[name], default="")
