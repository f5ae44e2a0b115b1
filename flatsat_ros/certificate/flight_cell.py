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
from dataclasses import dataclass, fields, replace

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require
from flatsat_ros.certificate.flight_loop import Design, FlightLoop, Plant, exponential, split

# A whole period this near, relative to one, is no cut.
_WHOLE = 1e-9

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
            middle = (math.floor(low / period + _WHOLE) + 1) * period
        return Box(self.low, replace(self.high, **{name: middle})), Box(replace(self.low, **{name: middle}), self.high)

    def within_periods(self, period: float) -> bool:
        """Whether no whole period lies inside the interval of the delay."""
        return self.high.delay <= (math.floor(self.low.delay / period + _WHOLE) + 1 + _WHOLE) * period


def figures(plant: Plant) -> tuple[float, ...]:
    """Return the parameters q of the last row, two or four."""
    if plant.frequency > 0.0:
        square = plant.frequency * plant.frequency
        return square, square * plant.gain, 2.0 * plant.damping * plant.frequency, square * plant.tilt
    return 1.0 / plant.lag, plant.gain / plant.lag


@dataclass(frozen=True)
class Stretch:
    """A part of a period in which the command does not change.

    Attributes:
        radius: how far from a node the times are that it stands for, s.
        nodes: rows (k, m, n + 1) of F at k times.
        slope: rows (x, n + 1) of x' at its beginning.
    """

    radius: float
    nodes: FloatArray
    slope: FloatArray


class Cell:
    """A box without a whole period inside its delays, as its middle and distances from it.

    Rows are on (z, c_0), n + 1 entries, of the loop in the middle.

    Attributes:
        loop: of the plant in the middle.
        vertices: (V, m + 1) distances (p_1, ..., p_m, s) of plants of which all those of the box are convex
            combinations; s is that of the delay.
        steady, changing: if lag, frequency and damping change in flight, (V', m + 1) the distances that do not, of the
            first order (0, (g - g^) q^_0, s), and (m,) bounds of the rest.
        port_gain: largest q_1.
        port_gain_error: largest |q_1 - q^_1|.
        share_error: largest |1/g - 1/g^|.
        drag_error: largest |drag - drag^|, 1/s.
        derivatives: m + 1 matrices (n, n + 1): the step's derivatives by p_i and by s.
        pulse: (n,) column of an impulse at the last row where the command changes.
        difference: row of the command before the change less the one after it.
        stretches: of a period, with one command each.
        growth: (x, x) e^(|A| h): bounds what a state does within a period.
        lateness: rows (2, n + 1) of the error of the estimated velocity, at the tick and before the correction at the
            next one.
        model_slopes: rows (k, y, n + 1) of x^' of the nominal plant where its command changes and at the tick.
        on_state: (m, x) of F.
    """

    def __init__(self, design: Design, box: Box, pose_age: float = 0.0) -> None:
        low, high = box.low, box.high
        second, delay, drag = low.frequency > 0.0, (low.delay + high.delay) / 2.0, (low.drag + high.drag) / 2.0
        name = "frequency" if second else "lag"
        ends = [
            figures(replace(low, **{name: value, "gain": gain}))[:2]
            for value, gain in itertools.product((getattr(low, name), getattr(high, name)), (low.gain, high.gain))
        ]
        # of (q_0, q_1) four corners, and each of the others an interval
        names = "frequency", "damping", "tilt"
        extremes = [
            figures(replace(low, **dict(zip(names, values, strict=True))))[2:]
            for values in itertools.product(*((getattr(low, name), getattr(high, name)) for name in names))
        ]
        others = [[min(values), max(values)] for values in zip(*extremes, strict=True)]
        q = [(min(values) + max(values)) / 2.0 for values in (*zip(*ends, strict=True), *others)]
        gain, tilt = q[1] / q[0], q[3] / q[0] if second else 0.0
        if second:
            frequency = math.sqrt(q[0])
            middle = Plant(delay, 0.0, frequency, q[2] / (2.0 * frequency), gain, tilt, drag)
        else:
            middle = Plant(delay, 1.0 / q[0], gain=gain, drag=drag)
        self.loop = FlightLoop(design, middle, pose_age)

        late = (high.delay - low.delay) / 2.0
        vertices = []
        for end, rest, s in itertools.product(ends, itertools.product(*others), (-late, late)):
            p = [value - mean for value, mean in zip((*end, *rest), q, strict=True)]
            p[1] -= gain * p[0]
            if second:
                p[3] -= tilt * p[0]
            vertices.append([*p, s])
        self.vertices = np.unique(np.array(vertices), axis=0)
        gains = (0.0,) if second else (low.gain - gain, high.gain - gain)
        steady = np.zeros((2 * len(gains), self.vertices.shape[1]))
        for row, (error, s) in zip(steady, itertools.product(gains, (-late, late)), strict=True):
            row[1], row[-1] = error * q[0], s
        self.steady = np.unique(steady, axis=0)
        self.changing = np.abs(self.vertices[:, :-1]).max(axis=0)
        if not second:  # p_1 = (g - g^) q_0
            self.changing[1] = self.changing[0] * max(abs(error) for error in gains)
        self.port_gain = max(q1 for _, q1 in ends)
        self.port_gain_error = max(abs(q1 - q[1]) for _, q1 in ends)
        self.drag_error = (high.drag - low.drag) / 2.0
        self.share_error = max(abs(1.0 / low.gain - 1.0 / gain), abs(1.0 / high.gain - 1.0 / gain))
        self._derive(q[1])

    def _derive(self, port_gain: float) -> None:
        """Compute what the attributes say of rows, for a middle of input gain q^_1."""
        loop, plant = self.loop, self.loop.plant
        n, size, h = plant.size, loop.size, loop.design.period
        A, port = plant.system[0], np.eye(n)[-1]
        whole, rest = split(plant.delay, h)
        stretches = [(h - rest, loop.commands[whole])]
        if rest > 0.0:
            stretches.insert(0, (rest, loop.commands[whole + 1]))

        count = 4 if plant.frequency > 0.0 else 2
        self.on_state, on_command = np.zeros((count, n)), np.zeros(count)
        self.on_state[0, 1:3] = -plant.tilt, -1.0
        on_command[:2] = plant.gain, 1.0
        if count == 4:
            self.on_state[2, 3] = self.on_state[3, 1] = -1.0
        self.growth = exponential(np.abs(A) * h)

        self.derivatives = []
        for on_state, command_gain in zip(self.on_state, on_command, strict=True):
            block = np.zeros((2 * n + 1, 2 * n + 1))  # x, its derivative by p_i, and the command
            block[:n, :n] = block[n:-1, n:-1] = A
            block[n:-1, :n] = np.outer(port, on_state)
            block[n - 1, -1], block[2 * n - 1, -1] = port_gain, command_gain
            both = np.eye(2 * n, size + 1)
            both[n:] = 0.0
            for time, command in stretches:
                power = exponential(block * time)
                both = power[:-1, :-1] @ both + np.outer(power[:-1, -1], command)
            self.derivatives.append(self._input(both[n:]))
        self.pulse = self._input(plant.hold(h - rest)[0][:, -1])
        self.difference = stretches[0][1] - stretches[-1][1]
        self.derivatives.append(port_gain * np.outer(self.pulse, self.difference))

        self._follow_the_model()
        self.stretches, state = [], np.eye(n, size + 1)
        for time, command in stretches:
            radius, nodes = time / (2 * _NODES), []
            for number in range(_NODES):
                phi, drive, _ = plant.hold((2 * number + 1) * radius)
                there = phi @ state + plant.gain * np.outer(drive, command)
                nodes.append(self.on_state @ there + np.outer(on_command, command))
            self.stretches.append(Stretch(radius, np.array(nodes), A @ state + port_gain * np.outer(port, command)))
            phi, drive, _ = plant.hold(time)
            state = phi @ state + plant.gain * np.outer(drive, command)

    def _follow_the_model(self) -> None:
        """Compute rows of what the estimator believes within a period."""
        loop, model = self.loop, self.loop.design.model
        h, start, size = loop.design.period, loop.plant.size, loop.size
        A, B, E = model.system
        error = -np.eye(1, size + 1, start + model.size)[0]
        whole, rest = split(model.delay, h)
        stretches = [(rest, whole + 1), (h - rest, whole)] if rest > 0.0 else [(h, whole)]
        state, slopes = np.eye(model.size, size + 1, start), []
        for time, index in stretches:
            slopes.append(A @ state + np.outer(B, loop.commands[index]) + np.outer(E, error))
            phi, drive, push = model.hold(time)
            state = phi @ state + np.outer(drive, loop.commands[index]) + np.outer(push, error)
        self.model_slopes = np.array(slopes)
        before = loop.before_correction
        now = np.eye(1, size + 1, 1)[0] - np.eye(1, size + 1, start + 1)[0]
        self.lateness = np.array([now, before[1] - before[start + 1]])

    def _input(self, part: FloatArray) -> FloatArray:
        """Columns (n, ...) of z after the tick, from those of x before it."""
        columns = np.zeros((self.loop.size, *part.shape[1:]))
        columns[: len(part)] = part
        return self.loop.corrected(columns)

    @property
    def unit_inputs(self) -> FloatArray:
        """Columns (n, x) of units of the plant's state before the tick."""
        return self._input(np.eye(self.loop.plant.size))
