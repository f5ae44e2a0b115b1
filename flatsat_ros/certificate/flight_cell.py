"""Boxes of plants, and what separates the plants of a small one from the plant in its middle.

The last row of a plant's equation x' = A x + b c is affine in its parameters q,

    a' = -q_0 a + q_1 c                           q = (1/lag, g/lag)
    a'' = -q_0 a + q_1 c - q_2 a' - q_3 e'        q = (wn^2, wn^2 g, 2 zeta wn, wn^2 tilt)

so the plant q is the plant q^ in the middle with the further input sum_i p_i F_i at its last row,

    F = (g^ c - a - tilt^ e', c, -a', -e'),   p = (q_0 - q^_0, q_1 - q^_1 - g^ p_0, q_2 - q^_2, q_3 - q^_3 - tilt^ p_0),

and a delay that is longer by s hands the command on s seconds later: for so long the last row gets q_1 times the
command before less the command now. Another drag is a further input at the acceleration, (drag^ - drag) e'.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require
from flatsat_ros.certificate.enclosures import (
    UP,
    Enclosure,
    Numbers,
    concatenate,
    decimal,
    enclosed,
    enclosed_fractions,
    exponential,
    upper,
)
from flatsat_ros.certificate.flight_loop import Loop
from flatsat_ros.certificate.flight_plant import Design, Dynamics, Pieces, Plant, Timing

# Nodes of each stretch of constant command at which signals are bounded; between them by their slope.
_NODES = 2


@dataclass(frozen=True)
class Box:
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

    def halves(self, name: str, period: float) -> tuple[Box, Box]:
        """Cut the box in two across one figure; a delay is cut at a whole period if there is one inside.

        Args:
            name: of the figure.
            period: h, s.
        """
        low, high = self._pairs()[name]
        middle = (low + high) / 2.0
        if name == "delay" and not self.within_periods(period):
            middle = float((math.floor(decimal(low) / decimal(period)) + 1) * decimal(period))
        return Box(self.low, replace(self.high, **{name: middle})), Box(replace(self.low, **{name: middle}), self.high)

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
        steady: if lag, frequency and damping change in flight, the distances that do not, of the first order
            (0, (g - g^) q^_0, s).
        changing: and bounds (p_1, ..., p_m) of the rest.
        port_gain: largest q_1.
        port_gain_error: largest |q_1 - q^_1|.
        share_error: largest |1/g - 1/g^|.
        drag_error: largest |drag - drag^|, 1/s.
    """

    def __init__(self, box: Box) -> None:
        self.box = box
        low, high = box.low, box.high
        second = low.frequency > 0.0
        self.delay, self.drag = box.middle("delay"), box.middle("drag")
        name = "frequency" if second else "lag"
        # of (q_0, q_1) four corners, and each of the others an interval
        ends = [
            replace(low, **{name: value, "gain": gain}).parameters[:2]
            for value, gain in itertools.product(
                _ends(getattr(low, name), getattr(high, name)), _ends(low.gain, high.gain)
            )
        ]
        names = "frequency", "damping", "tilt"
        extremes = [
            replace(low, **dict(zip(names, values, strict=True))).parameters[2:]
            for values in itertools.product(*(_ends(getattr(low, name), getattr(high, name)) for name in names))
        ]
        others = [sorted({min(values), max(values)}) for values in zip(*extremes, strict=True)]
        q = [(min(values) + max(values)) / 2 for values in (*zip(*ends, strict=True), *others)]
        self.parameters = tuple(q)
        gain, tilt = q[1] / q[0], q[3] / q[0] if second else Fraction(0)
        late = (decimal(high.delay) - decimal(low.delay)) / 2
        delays, self.vertices = sorted({-late, late}), []
        for end, rest, s in itertools.product(ends, itertools.product(*others), delays):
            p = [value - mean for value, mean in zip((*end, *rest), q, strict=True)]
            p[1] -= gain * p[0]
            if second:
                p[3] -= tilt * p[0]
            self.vertices.append([*p, s])
        errors = [Fraction(0)] if second else [decimal(g) - gain for g in _ends(low.gain, high.gain)]
        self.steady = []
        for error, s in itertools.product(errors, delays):
            self.steady.append([Fraction(0), error * q[0], *[Fraction(0)] * (len(q) - 2), s])
        self.changing = [max(abs(vertex[i]) for vertex in self.vertices) for i in range(len(q))]
        if not second:  # p_1 = (g - g^) q_0
            self.changing[1] = self.changing[0] * max(abs(error) for error in errors)
        self.port_gain = max(q1 for _, q1 in ends)
        self.port_gain_error = max(abs(q1 - q[1]) for _, q1 in ends)
        self.drag_error = (decimal(high.drag) - decimal(low.drag)) / 2
        self.share_error = max(abs(1 / decimal(g) - 1 / gain) for g in (low.gain, high.gain))

    def kind(self, design: Design, pose_age: Fraction) -> object:
        """Return what is the same for cells that can be computed side by side."""
        timing = Timing.of(design, self.delay, pose_age)
        acting = [tuple(index for index, _ in part) for part in (timing.plant, timing.plant_young)]
        return len(self.parameters), len(self.vertices), len(self.steady), timing.depth, *acting


def side_by_side(design: Design, boxes: Sequence[Box], pose_age: Fraction) -> list[tuple[list[int], Cells]]:
    """Return boxes as cells, those that are alike together, each with their places among the boxes.

    Args:
        design: the controller.
        boxes: none with a whole period inside the delays.
        pose_age: of the loops in the middle, s.
    """
    cells = [Cell(box) for box in boxes]
    kinds: dict[object, list[int]] = {}
    for i, cell in enumerate(cells):
        kinds.setdefault(cell.kind(design, pose_age), []).append(i)
    return [(places, Cells(design, [cells[i] for i in places], pose_age)) for places in kinds.values()]


def _ends(low: float, high: float) -> list[float]:
    return sorted({low, high})


class Loops(Loop):
    """A design on the middles of cells that are alike, enclosed; what depends on the cell has their number B in front.

    Attributes:
        design: the controller.
        period: h, s.
        pose_age: s.
    """

    def __init__(self, design: Design, cells: Sequence[Cell], pose_age: Fraction) -> None:
        self.design = design
        self.period, self.pose_age = decimal(design.period), pose_age
        timings = [Timing.of(design, cell.delay, pose_age) for cell in cells]
        parameters = enclosed_fractions([cell.parameters for cell in cells])
        drag = enclosed_fractions([cell.drag for cell in cells])
        self._body = Dynamics([parameters[:, i] for i in range(parameters.shape[1])], drag)
        model = design.model
        self._believed = Dynamics([enclosed(q) for q in model.parameters], enclosed(decimal(model.drag)))
        gains = [cell.parameters[1] / cell.parameters[0] for cell in cells]
        self._gain = enclosed_fractions(gains)[:, None, None]
        self._share = enclosed_fractions([1 / gain for gain in gains])[:, None]
        first = timings[0]

        def together(name: str) -> Pieces:
            """Pieces, whose times are one per cell."""
            parts = [getattr(timing, name) for timing in timings]
            return [
                (index, [part[i][1] for part in parts])  # type: ignore[misc]
                for i, (index, _) in enumerate(getattr(first, name))
            ]

        self._timing = replace(first, plant=together("plant"), plant_young=together("plant_young"))

    @property
    def body(self) -> Dynamics:
        """The equations of the plants."""
        return self._body

    @property
    def believed(self) -> Dynamics:
        """The equation of the nominal plant."""
        return self._believed

    @property
    def gain(self) -> Enclosure:
        """The gains g of the plants, (B, 1, 1)."""
        return self._gain

    @property
    def share(self) -> Enclosure:
        """1/g, (B, 1)."""
        return self._share

    @property
    def timing(self) -> Timing:
        """Which commands act when; of the plants one time per cell."""
        return self._timing

    def figure(self, value: Numbers) -> Enclosure:
        """Return an enclosure of a figure, or of one per cell."""
        if isinstance(value, list):
            return enclosed_fractions(value)
        return enclosed(value if isinstance(value, Fraction) else decimal(value))


@dataclass(frozen=True)
class Stretch:
    """A part of a period in which the command does not change.

    Attributes:
        radius: (B,) how far from a node the times are that it stands for, s.
        nodes: rows (B, k m, n + 1) of F at k times.
        slope: rows (B, x, n + 1) of x' at its beginning.
    """

    radius: FloatArray
    nodes: Enclosure
    slope: Enclosure


class Cells:
    """Cells that are alike: of the same plants' order and the same commands at work, with the same figures in doubt.

    Rows are on (z, c_0), n + 1 entries, of the loop in the middle; B is the number of cells. Bounds are rounded up.

    Attributes:
        loop: of the plants in the middle.
        vertices, steady: (B, V, m + 1), and changing: (B, m), as of a `Cell`, nearest floats; rounded by a share of u.
        port_gain, port_gain_error, share_error, drag_error: (B,) as of a `Cell`.
        pulse: (B, n, 1) column of an impulse at the last row where the command changes.
        difference: row (1, n + 1) of the command before the change less the one after it.
        on_state, on_command: (B, m, x) and (B, m, 1) of F.
        period: h, s.
    """

    def __init__(self, design: Design, cells: Sequence[Cell], pose_age: Fraction) -> None:
        self.loop = Loops(design, cells, pose_age)
        self.vertices, self.steady, self.changing = (
            np.array([getattr(cell, name) for cell in cells], dtype=object).astype(np.float64)
            for name in ("vertices", "steady", "changing")
        )
        self.changing = self.changing * UP
        self.port_gain, self.port_gain_error, self.share_error, self.drag_error = (
            np.array([upper(getattr(cell, name)) for cell in cells])
            for name in ("port_gain", "port_gain_error", "share_error", "drag_error")
        )
        self.period = upper(self.loop.period)
        loop, x, m = self.loop, self.loop.body.size, len(cells[0].parameters)
        q = enclosed_fractions([cell.parameters for cell in cells])
        self.middle_port_gain = q[:, 1, None, None]
        on_state, on_command = Enclosure(np.zeros((len(cells), m, x))), Enclosure(np.zeros((len(cells), m, 1)))
        on_state.mid[:, 0, 2], on_command.mid[:, 1] = -1.0, 1.0
        on_command.mid[:, 0], on_command.rad[:, 0] = loop.gain.mid[:, 0], loop.gain.rad[:, 0]
        if m == 4:
            tilt = enclosed_fractions([cell.parameters[3] / cell.parameters[0] for cell in cells])
            on_state.mid[:, 0, 1], on_state.rad[:, 0, 1] = -tilt.mid, tilt.rad
            on_state.mid[:, 2, 3] = on_state.mid[:, 3, 1] = -1.0
        self.on_state, self.on_command = on_state, on_command
        acting = loop.timing.plant
        first, last = loop.commands[acting[0][0]], loop.commands[acting[-1][0]]
        self.difference = (first - last)[np.newaxis]
        after = loop.figure(acting[-1][1])
        self.pulse = loop.entered(loop.body.hold(after)[0][..., -1:], 0)

    @cached_property
    def growth(self) -> FloatArray:
        """(B, x, x) e^(|A| h): bounds what a state does within a period."""
        return growth(self.loop.body, self.period)

    @cached_property
    def derivatives(self) -> Enclosure:
        """(B, m + 1, n, n + 1): the step's derivatives by p_i and by s."""
        loop = self.loop
        n, size, A = loop.body.size, loop.size, loop.body.system[0]
        port = np.eye(n)[:, -1:]
        found = []
        for i in range(self.on_state.shape[1]):
            turned = port * self.on_state[:, i : i + 1]
            # x, its derivative by p_i, and the command
            above = concatenate([A, np.zeros((n, n)), self.middle_port_gain * port], -1)
            below = concatenate([turned, A, self.on_command[:, i : i + 1] * port], -1)
            block = concatenate([above, below, np.zeros((1, 2 * n + 1))], -2)
            both: Numbers = np.eye(2 * n, size + 1)
            both[n:] = 0.0
            for index, time in loop.timing.plant:
                power = exponential(block * loop.figure(time)[:, None, None])
                both = power[:, :-1, :-1] @ both + power[:, :-1, -1:] * loop.commands[index]
            found.append(loop.entered(both[:, n:], 0))
        found.append(self.middle_port_gain * self.pulse * self.difference)
        return Enclosure(np.stack([part.mid for part in found], 1), np.stack([part.rad for part in found], 1))

    @cached_property
    def stretches(self) -> list[Stretch]:
        """The parts of a period with one command each."""
        loop, found = self.loop, []
        n, A = loop.body.size, loop.body.system[0]
        state: Numbers = np.eye(n, loop.size + 1)
        for index, time in loop.timing.plant:
            command, nodes = loop.commands[index], []

            def later(state: Numbers, times: list[Fraction], command: FloatArray = command) -> Numbers:
                phi, drive, _ = loop.body.hold(loop.figure(times))
                return phi @ state + (loop.gain * drive[..., None]) * command

            for number in range(_NODES):
                there = later(state, [(2 * number + 1) * t / (2 * _NODES) for t in time])  # type: ignore[attr-defined]
                nodes.append(self.on_state @ there + self.on_command * command)
            slope = A @ state + (self.middle_port_gain * np.eye(n)[:, -1:]) * command
            radius = np.array([upper(t / (2 * _NODES)) for t in time])  # type: ignore[attr-defined]
            found.append(Stretch(radius, concatenate(nodes, -2), slope))
            state = later(state, time)  # type: ignore[arg-type]
        return found

    @cached_property
    def model_slopes(self) -> Enclosure:
        """Rows (k y, n + 1) of x^' of the nominal plant where its command changes and at the tick."""
        loop = self.loop
        believed, start = loop.believed, loop.body.size
        A, B, E = believed.system
        error, found, acting = -np.eye(1, loop.size + 1, start + believed.size), [], loop.timing.model
        for number, (index, _) in enumerate(acting):
            state = loop.driven(believed, 1.0, start, acting[:number], error=True)
            found.append(A @ state + B[..., None] * loop.commands[index] + E[:, None] * error)
        return enclosed(concatenate(found, -2))

    @cached_property
    def lateness(self) -> Enclosure:
        """Rows (B, 2, n + 1) of the estimated velocity's error, at a tick and before the correction at the next."""
        before, start, n = self.loop.before_correction, self.loop.body.size, self.loop.size
        now = np.eye(1, n + 1, 1) - np.eye(1, n + 1, start + 1)
        return enclosed(concatenate([now, before[..., 1:2, :] - before[..., start + 1 : start + 2, :]], -2))


def growth(dynamics: Dynamics, time: float) -> FloatArray:
    """Return a bound of e^(|A| t)."""
    return np.asarray(enclosed(exponential(Enclosure(enclosed(dynamics.system[0]).size) * time)).size)
