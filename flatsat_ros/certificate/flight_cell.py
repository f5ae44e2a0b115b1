"""Boxes of plants, and the differences between the plants of a small box and the plant in its middle.

The last row of a plant's equation x' = A x + b c is affine in its parameters q,

    a' = -q_0 a + q_1 c                           q = (1/lag, g/lag)
    a'' = -q_0 a + q_1 c - q_2 a' - q_3 e'        q = (wn^2, wn^2 g, 2 zeta wn, wn^2 tilt)

so the plant q is the plant q^ in the middle with the further input sum_i p_i F_i at its last row,

    F = (g^ c - a - tilt^ e', c, -a', -e'),   p = (q_0 - q^_0, q_1 - q^_1 - g^ p_0, q_2 - q^_2, q_3 - q^_3 - tilt^ p_0),

and with a delay that is longer by s each command begins s seconds later: during that time the last row gets the further
input q_1 (command before - command now). Another drag is a further input at the acceleration, (drag^ - drag) e'.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property

from flatsat_ros.base.errors import require
from flatsat_ros.certificate.enclosures import decimal
from flatsat_ros.certificate.flight_plant import CommandTiming, Design, Plant


@dataclass(frozen=True)
class PlantBox:
    """All plants between two, figure by figure.

    Attributes:
        low, high: the corners, of the same order.

    Raises:
        FlatsatError: they are not, they have neither lag nor frequency, or a figure of `low` is above that of `high`.
    """

    low: Plant
    high: Plant

    def __post_init__(self) -> None:
        for name, (low, high) in self._pairs().items():
            require(low <= high, f"low {name}", low, "", f"at most the high one, {high:g}")
        for plant in (self.low, self.high):
            require(
                plant.size == self.low.size > 2, "size of a plant's state", plant.size, "", "3 or 4, of both the same"
            )

    def _pairs(self) -> dict[str, tuple[float, float]]:
        names = [figure.name for figure in fields(Plant)]
        return {name: (getattr(self.low, name), getattr(self.high, name)) for name in names}

    @property
    def spread(self) -> dict[str, tuple[float, float]]:
        """The figures that vary, and between which values."""
        return {name: pair for name, pair in self._pairs().items() if pair[0] < pair[1]}

    def constants(self, lag_varies: bool) -> tuple[str, ...]:
        """Return the figures that are between two values and do not change in flight."""
        changing = ("lag", "frequency", "damping") if lag_varies else ()
        return tuple(name for name in self.spread if name not in changing)

    def halves(self, name: str, period: float) -> tuple[PlantBox, PlantBox]:
        """Cut the box in two across one figure; a delay is cut at a whole period if there is one inside.

        Args:
            name: of the figure.
            period: h, s.
        """
        low, high = self._pairs()[name]
        middle = (low + high) / 2.0
        if name == "delay" and not self.within_periods(period):
            middle = float((math.floor(decimal(low) / decimal(period)) + 1) * decimal(period))
        return PlantBox(self.low, replace(self.high, **{name: middle})), PlantBox(
            replace(self.low, **{name: middle}), self.high
        )

    def within_periods(self, period: float) -> bool:
        """Whether no whole period lies inside the interval of the delay."""
        h = decimal(period)
        return decimal(self.high.delay) <= (math.floor(decimal(self.low.delay) / h) + 1) * h

    def middle(self, name: str) -> Fraction:
        """Return the middle between the two values of a figure."""
        return (decimal(getattr(self.low, name)) + decimal(getattr(self.high, name))) / 2


class Cell:
    """The middle of a box without a whole period inside its delays, and distances from it, in rational numbers.

    Attributes:
        box: the plants.
        delay, drag: of the middle.
        parameters: q^ of the middle, in the order of `Plant.parameters`.
        vertices: distances (p_1, ..., p_m, s) of plants of which all those of the box are convex combinations; s is
            that of the delay.
        directions: the same (p_1, ..., p_m), each once, if they are the last row's of the second order; else none.
        steady: if lag, frequency and damping change in flight, the distances that do not, of the first order
            (0, (g - g^) q^_0, s).
        changing: and bounds (p_1, ..., p_m) of the rest.
        port_gain: largest q_1.
        port_gain_error: largest |q_1 - q^_1|.
        share_error: largest |1/g - 1/g^|.
        drag_error: largest |drag - drag^|, 1/s.
    """

    def __init__(self, box: PlantBox) -> None:
        self.box = box
        low, high = box.low, box.high
        second = low.frequency > 0.0
        self.delay, self.drag = box.middle("delay"), box.middle("drag")
        # q_0, or (q_0, q_2), in a polygon; whatever they are, q_1 and q_3 are between two multiples of q_0
        polygon = _second_order(low, high) if second else [(1 / decimal(lag),) for lag in _ends(low.lag, high.lag)]
        gains, tilts = (
            [decimal(value) for value in _ends(*ends)] for ends in ((low.gain, high.gain), (low.tilt, high.tilt))
        )
        corners = [
            (q0, g * q0, *rest, *([tilt * q0] if second else []))
            for (q0, *rest), g, tilt in itertools.product(polygon, gains, tilts)
        ]
        q = [(min(values) + max(values)) / 2 for values in zip(*corners, strict=True)]
        self.parameters = tuple(q)
        gain, tilt = q[1] / q[0], q[3] / q[0] if second else Fraction(0)
        late = (decimal(high.delay) - decimal(low.delay)) / 2
        self._delays, self.vertices = sorted({-late, late}), []
        for corner in corners:
            p = [value - mean for value, mean in zip(corner, q, strict=True)]
            p[1] -= gain * p[0]
            if second:
                p[3] -= tilt * p[0]
            self.vertices += [[*p, s] for s in self._delays]
        self.directions = [p for *p, _ in self.vertices[:: len(self._delays)]] if second else []
        self._errors = [Fraction(0)] if second else [decimal(g) - gain for g in _ends(low.gain, high.gain)]
        self.port_gain = max(corner[1] for corner in corners)
        self.port_gain_error = max(abs(corner[1] - q[1]) for corner in corners)
        self.drag_error = (decimal(high.drag) - decimal(low.drag)) / 2
        self.share_error = max(abs(1 / decimal(g) - 1 / gain) for g in (low.gain, high.gain))

    @cached_property
    def steady(self) -> list[list[Fraction]]:
        """Distances that stay."""
        rest = [Fraction(0)] * (len(self.parameters) - 2)
        every = itertools.product(self._errors, self._delays)
        return [[Fraction(0), error * self.parameters[0], *rest, s] for error, s in every]

    @cached_property
    def changing(self) -> list[Fraction]:
        """Bounds of the rest."""
        bounds = [max(abs(vertex[i]) for vertex in self.vertices) for i in range(len(self.parameters))]
        if not self.directions:  # of first order p_1 = (g - g^) q_0
            bounds[1] = bounds[0] * max(abs(error) for error in self._errors)
        return bounds

    def kind(self, design: Design, pose_age: Fraction) -> object:
        """Return what is the same for cells that can be computed side by side."""
        timing = CommandTiming.of(design, self.delay, pose_age)
        acting = [tuple(index for index, _ in part) for part in (timing.plant, timing.plant_young)]
        counts = len(self.vertices), len(self.directions), len(self._errors), len(self._delays)
        return len(self.parameters), *counts, timing.depth, *acting


def _second_order(low: Plant, high: Plant) -> list[tuple[Fraction, Fraction]]:
    """Return the corners of a polygon that holds all (wn^2, 2 zeta wn).

    At a fixed zeta they are on a parabola, concave in wn^2: its chord bounds them from below, its tangents at both ends
    from above, and they meet where wn^2 is the product of the frequencies and wn stands for their mean.
    """
    first, last = decimal(low.frequency), decimal(high.frequency)
    least, most = 2 * decimal(low.damping), 2 * decimal(high.damping)
    ends = [(wn * wn, zeta * wn) for wn, zeta in itertools.product((first, last), (least, most))]
    return sorted({*ends, (first * last, most * (first + last) / 2)})


def _ends(low: float, high: float) -> list[float]:
    return sorted({low, high})
