"""Cells of the same structure, computed side by side: enclosures of the loops in their middles, and of one period.

What separates the other plants of a cell from the middle (`flight_cell`) acts on these loops as further inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from flatsat_ros.base.arrays import FloatArray
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
from flatsat_ros.certificate.flight_cell import Cell, PlantBox
from flatsat_ros.certificate.flight_loop import DesignedLoop
from flatsat_ros.certificate.flight_plant import CommandTiming, Design, Pieces, PlantEquation

# Nodes of each stretch of constant command at which signals are bounded; between them by their slope.
_NODES = 2


def side_by_side(
    design: Design, boxes: Sequence[PlantBox], pose_age: Fraction, coarse: bool = False
) -> list[tuple[list[int], Cells]]:
    """Return boxes as cells, grouped by their structure; with each group the places of its cells among the boxes.

    Args:
        design: the controller.
        boxes: none with a whole period inside the delays.
        pose_age: of the loops in the middle, s.
        coarse: whether bounds need not be close.
    """
    cells = [Cell(box) for box in boxes]
    kinds: dict[object, list[int]] = {}
    for i, cell in enumerate(cells):
        kinds.setdefault(cell.kind(design, pose_age), []).append(i)
    return [(places, Cells(design, [cells[i] for i in places], pose_age, coarse)) for places in kinds.values()]


class Loops(DesignedLoop):
    """Enclosures of a design on the middles of B cells of one structure; what depends on the cell has shape (B, ...).

    Attributes:
        design: the controller.
        period: h, s.
        pose_age: s.
    """

    def __init__(self, design: Design, cells: Sequence[Cell], pose_age: Fraction) -> None:
        self.design = design
        self.period, self.pose_age = decimal(design.period), pose_age
        timings = [CommandTiming.of(design, cell.delay, pose_age) for cell in cells]
        parameters = enclosed_fractions([cell.parameters for cell in cells])
        drag = enclosed_fractions([cell.drag for cell in cells])
        self._body = PlantEquation([parameters[:, i] for i in range(parameters.shape[1])], drag)
        model = design.model
        self._believed = PlantEquation([enclosed(q) for q in model.parameters], enclosed(decimal(model.drag)))
        gains = [cell.parameters[1] / cell.parameters[0] for cell in cells]
        self._gain = enclosed_fractions(gains)[:, None, None]
        self._share = enclosed_fractions([1 / gain for gain in gains])[:, None]
        first = timings[0]

        self._timing = CommandTiming(
            plant=_together([timing.plant for timing in timings]),
            model=first.model,
            plant_young=_together([timing.plant_young for timing in timings]),
            model_young=first.model_young,
            ahead=first.ahead,
            depth=first.depth,
        )

    @property
    def body(self) -> PlantEquation:
        """The equations of the plants."""
        return self._body

    @property
    def believed(self) -> PlantEquation:
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
    def timing(self) -> CommandTiming[list[Fraction]]:
        """Which commands act when; of the plants one time per cell."""
        return self._timing

    def figure(self, value: Numbers) -> Enclosure:
        """Return an enclosure of a figure, or of one per cell."""
        if isinstance(value, list):
            return enclosed_fractions(value)
        return enclosed(value if isinstance(value, Fraction) else decimal(value))


def _together(parts: Sequence[Pieces[Fraction]]) -> Pieces[list[Fraction]]:
    """Return pieces of the same commands as one, whose times are one per cell."""
    return [(pieces[0][0], [time for _, time in pieces]) for pieces in zip(*parts, strict=True)]


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
        vertices: (B, V, m + 1), and directions: (B, U, m), as of a `Cell`, nearest floats; rounded by a share of u.
        port_gain, port_gain_error, share_error, drag_error: (B,) as of a `Cell`.
        pulse: (B, n, 1) column of an impulse at the last row where the command changes.
        difference: row (1, n + 1) of the command before the change less the one after it.
        on_state, on_command: (B, m, x) and (B, m, 1) of F.
        period: h, s.
        coarse: whether bounds may be some hundredths too large, which takes half of the time.
        rough: whether, for coarse bounds, one node and one piece of a period are enough, as for plants of first order.
    """

    def __init__(self, design: Design, cells: Sequence[Cell], pose_age: Fraction, coarse: bool = False) -> None:
        self.coarse, self.rough = coarse, coarse and len(cells[0].parameters) == 2
        self.loop = Loops(design, cells, pose_age)
        self._cells = cells
        self.vertices, self.directions = self._distances("vertices"), self._distances("directions")
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

    def _distances(self, name: str) -> FloatArray:
        """Return those of all cells."""
        return np.array([getattr(cell, name) for cell in self._cells], dtype=object).astype(np.float64)

    @cached_property
    def steady(self) -> FloatArray:
        """(B, V, m + 1) distances that stay; computed when they are asked for, as of few cells."""
        return self._distances("steady")

    @cached_property
    def changing(self) -> FloatArray:
        """(B, m) bounds of the distances that change."""
        return self._distances("changing") * UP

    @cached_property
    def growth(self) -> FloatArray:
        """(B, x, x) e^(|A| h), a bound of the transition within a period."""
        return exponential_norm(self.loop.body, self.period)

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
        n, A, count = loop.body.size, loop.body.system[0], 1 if self.rough else _NODES
        state: Numbers = np.eye(n, loop.size + 1)
        for index, time in loop.timing.plant:
            command, nodes = loop.commands[index], []

            def later(state: Numbers, times: list[Fraction], command: FloatArray = command) -> Numbers:
                phi, drive, _ = loop.body.hold(loop.figure(times))
                return phi @ state + (loop.gain * drive[..., None]) * command

            for number in range(count):
                there = later(state, [(2 * number + 1) * t / (2 * count) for t in time])
                nodes.append(self.on_state @ there + self.on_command * command)
            slope = A @ state + (self.middle_port_gain * np.eye(n)[:, -1:]) * command
            radius = np.array([upper(t / (2 * count)) for t in time])
            found.append(Stretch(radius, concatenate(nodes, -2), slope))
            state = later(state, time)
        return found

    @cached_property
    def pulls(self) -> Enclosure:
        """Rows (B, k U, n + 1) of p'F in each direction p, at the nodes of the stretches."""
        found, m = [], self.on_state.shape[1]
        for stretch in self.stretches:
            mid, rad = (a.reshape(len(a), -1, m, a.shape[-1]) for a in (stretch.nodes.mid, stretch.nodes.rad))
            pulls = self.directions[:, None] @ Enclosure(mid, rad)
            shape = len(mid), -1, mid.shape[-1]
            found.append(Enclosure(pulls.mid.reshape(shape), pulls.rad.reshape(shape)))
        return enclosed(concatenate(found, -2))

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


def exponential_norm(dynamics: PlantEquation, time: float) -> FloatArray:
    """Return an upper bound (..., n, n) of e^(|A| t), entry by entry."""
    return np.asarray(enclosed(exponential(Enclosure(enclosed(dynamics.system[0]).size) * time)).size)
