"""The whole loop that flies: plant, estimator, predictor, compensation and law, on one axis and sampled.

The plant answers a commanded acceleration u, held for a period h, after a delay d:

    e'' = a + D(t),    a follows g u(t - d)     (`Plant`: first-order lag, or second-order attitude)

with e the distance to the reference. The controller knows a nominal plant of gain 1. Per period it

    estimates      (e^, e^', d^) from positions, L times the innovation, with the nominal plant driven by what was sent,
    predicts       x^ over the time `horizon` with the commands under way and d^,
    commands       u = f - d^ + k v0,   v0 = -K1 p - K2 (v + lead a) at the predicted state,

where f is the reference's acceleration, taken ahead by what the nominal plant needs, and k the applied gain. All
variables are deviations: c = u - f of commands, those of accelerations from what the reference needs, and all from what
would be at rest against the disturbance D_j of the tick, c = -D_j/g, a = -D_j, d^ = D_j/g. So constant disturbances
leave no trace, and the loop z+ = A(k) z + (inputs) has A(k) = A_0 + k A_1 with four inputs, functions of time:

    rate         D', m/s^3, of the disturbance, of (g - 1) times what the reference asks for, and of drag not known
    noise        n, m, of the measured position at the tick
    drive        what f has too much for the reference, at the input of the plant, m/s^2 (docs/mathematics.md)
    model_drive  the same at the input of the nominal plant, m/s^2; the estimator integrates it, the law does not

z = (x, x^, d/g - d^, c_1, ..., c_M): x = (e, e', a[, a']) of the plant, x^ of the nominal one, c_i the command of i
periods ago. The axes share one loop and the same scalar k, so for every unit vector w the projections w'z obey it: all
bounds are bounds of Euclidean norms of vectors over the axes that share their figures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require, require_not_negative
from flatsat_ros.certificate.enclosures import Numbers, concatenate, decimal, filled
from flatsat_ros.certificate.flight_plant import CommandTiming, Design, Pieces, Plant, PlantEquation
from flatsat_ros.certificate.sampled_loop import require_few_under_way


class DesignedLoop(ABC):
    """A design on a plant or, with enclosures for figures, on a batch of plants that differ in figures alone.

    Attributes:
        design: the controller.
        body, believed: the equations of plant and of the nominal plant.
        gain: g.
        timing: what is under way when; times are figures by `figure`.
    """

    design: Design

    @property
    @abstractmethod
    def body(self) -> PlantEquation:
        """The equation of the plant."""

    @property
    @abstractmethod
    def believed(self) -> PlantEquation:
        """The equation of the nominal plant."""

    @property
    @abstractmethod
    def gain(self) -> Numbers:
        """The gain g of the plant."""

    @property
    @abstractmethod
    def timing(self) -> CommandTiming[Any]:
        """Which commands act when; times are figures by `figure`."""

    @abstractmethod
    def figure(self, value: Numbers) -> Numbers:
        """Return a figure, a fraction or one that a decimal stands for, as the loop computes with it."""

    @property
    def depth(self) -> int:
        """M, the number of commands under way that z keeps."""
        return self.timing.depth

    @property
    def size(self) -> int:
        """Number of entries of z."""
        return self.body.size + self.believed.size + 1 + self.depth

    @property
    def _error(self) -> int:
        """Index of D/g - d^ in z."""
        return self.body.size + self.believed.size

    @cached_property
    def commands(self) -> FloatArray:
        """Rows (1 + M, n + 1) that give c_0, ..., c_M from (z, c_0)."""
        n, rows = self.size, np.zeros((1 + self.depth, self.size + 1))
        rows[0, n] = 1.0
        rows[1:, self._error + 1 : n] = np.eye(self.depth)
        return rows

    def driven(
        self, dynamics: PlantEquation, gain: Numbers, begin: int, acting: Pieces[Any], error: bool = False
    ) -> Numbers:
        """Return rows (..., x, n + 1) of a plant's state, which is in z from `begin` on, after commands have acted.

        Args:
            dynamics: of the plant.
            gain: g.
            begin: its place in z.
            acting: which commands, for how long.
            error: whether -(D/g - d^) is a disturbance to it, as to the nominal plant.
        """
        state: Numbers = np.eye(dynamics.size, self.size + 1, begin)
        for index, time in acting:
            phi, drive, push = dynamics.hold(self.figure(time))
            state = phi @ state + (gain * drive[..., None]) * self.commands[index]
            if error:
                state = state + push[..., None] * -np.eye(1, self.size + 1, self._error)
        return state

    @cached_property
    def prediction(self) -> Numbers:
        """Rows (2, n) of the predicted p and v + lead (a + d^) of the nominal plant, at the tick, once corrected."""
        model, n = self.design.model, self.size
        state = self.driven(self.believed, 1.0, self.body.size, self.timing.ahead, error=True)
        rows = state[..., 1:2, :]
        if self.design.lead > 0.0:
            lead = decimal(self.design.lead)
            rows = rows + self.figure(lead) * (state[..., 2:3, :] - np.eye(1, n + 1, self._error))
            if model.frequency > 0.0:  # of e' + model.lead a + a'/wn^2 the derivative is the command, without drag
                q = model.parameters
                rows = rows + self.figure(lead / q[2]) * state[..., 3:4, :]
        return concatenate([state[..., :1, :n], rows[..., :n]], -2)

    @cached_property
    def feedback(self) -> Numbers:
        """Row (n,) of v0 = feedback . z, at the tick, after the correction."""
        stiffness, rate = self.figure(self.design.stiffness), self.figure(self.design.rate)
        return -(stiffness * self.prediction[..., 0, :]) - rate * self.prediction[..., 1, :]

    @property
    def moved(self) -> Numbers:
        """Rows (x, n + 1) of the plant's state a period later, from (z, c_0)."""
        return self.before_correction[..., : self.body.size, :]

    @property
    def estimate(self) -> Numbers:
        """Rows (y, n + 1) of the nominal plant's state before the correction, a period later, from (z, c_0)."""
        return self.before_correction[..., self.body.size : self._error, :]

    @cached_property
    def compensation(self) -> FloatArray:
        """Row (n,) of the part of the command that is not k v0."""
        row = np.zeros(self.size)
        row[self._error] = 1.0
        return row

    @cached_property
    def before_correction(self) -> Numbers:
        """Rows (n, n + 1) that give z at the end of the period, before the correction there, from (z, c_0)."""
        own = self.driven(self.body, self.gain, 0, self.timing.plant)
        nominal = self.driven(self.believed, 1.0, self.body.size, self.timing.model, error=True)
        rest = np.concatenate([np.eye(1, self.size + 1, self._error), self.commands[: self.depth]])
        return concatenate([own, nominal, rest], -2)

    @cached_property
    def _correction(self) -> Numbers:
        """Column (n,) of the correction by a unit innovation."""
        x, observer = self.body.size, [self.figure(gain) for gain in self.design.observer]
        entries: dict[tuple[int, ...], Numbers] = {
            (x,): observer[0],
            (x + 1,): observer[1],
            (self._error,): -observer[2],
        }
        return filled((self.size,), entries)

    @cached_property
    def _innovation(self) -> Numbers:
        """Row (1, n + 1) of what the pose says less what was believed of its time, from (z, c_0)."""
        own = self.driven(self.body, self.gain, 0, self.timing.plant_young)
        nominal = self.driven(self.believed, 1.0, self.body.size, self.timing.model_young, error=True)
        return own[..., :1, :] - nominal[..., :1, :]

    def corrected(self, predicted: Numbers) -> Numbers:
        """Return columns (n, m) of z after a correction by a pose of the tick, from those before it."""
        innovation = predicted[..., :1, :] - predicted[..., self.body.size : self.body.size + 1, :]
        return predicted + self._correction[..., None] * innovation

    def matrix(self, gain: Numbers) -> Numbers:
        """Return A(k) (n, n) of the loop at the applied gain k."""
        step, n = self.before_correction + self._correction[..., None] * self._innovation, self.size
        command = self.compensation + self.figure(gain) * self.feedback
        return step[..., :n] + step[..., n:] * command[..., None, :]

    @cached_property
    def command_input(self) -> Numbers:
        """Column (n,) by which an error of the command c_0 enters z+: A(k) - A(0) = k times its product with v0."""
        n = self.size
        return self.before_correction[..., n] + self._correction * self._innovation[..., 0, n:]

    @property
    def noise_input(self) -> Numbers:
        """Column (n,) of the noise at the tick at the end of the period, m."""
        return self._correction

    def drive_input(self, time: Numbers) -> Numbers:
        """Column (n,) of an impulse of drive error, m/s^2 s, `time` seconds before the end of the period."""
        return self._entered((self.body.hold(time)[0] @ self.body.system[1][..., None]), 0)

    def port_input(self, time: Numbers) -> Numbers:
        """Column (n,) of a unit impulse at the last row, `time` seconds before the end of the period."""
        return self._entered(self.body.hold(time)[0][..., -1:], 0)

    def push_input(self, time: Numbers) -> Numbers:
        """Column (n,) of an impulse of acceleration, m/s^2 s, `time` seconds before the end of the period."""
        return self._entered(self.body.hold(time)[0] @ self.body.system[2][:, None], 0)

    def model_drive_input(self, time: Numbers) -> Numbers:
        """Column (n,) of an impulse at the input of the nominal plant, m/s^2 s, `time` before the end of the period."""
        return self._entered(self.believed.hold(time)[0] @ self.believed.system[1][..., None], self.body.size)

    def rate_input(self, time: Numbers) -> Numbers:
        """Column (n,) of an impulse of D', m/s^2, `time` seconds before the end of the period.

        D moves by one; the rest of the period feels it as it is, and z refers to the new D from the tick on.
        """
        column = self.body.hold(time)[2][..., None]
        if self.body.size > 2:
            column = column + np.eye(self.body.size)[:, 2:3]
        return self._entered(column, 0) + self.share * self.share_input

    @property
    @abstractmethod
    def share(self) -> Numbers:
        """1/g, as (..., 1)."""

    @cached_property
    def share_input(self) -> Numbers:
        """Column (n,) of a step of D/g alone, m/s^2: on all that refers to the command against it."""
        column = np.zeros((self.size, 1))
        if self.believed.size > 2:
            column[self.body.size + 2] = 1.0
        column[self._error :] = 1.0
        return self.corrected(column)[..., 0]

    def unit_inputs(self, body: PlantEquation) -> Numbers:
        """Columns (n, x) of units of the state before the tick, of the plant or the nominal one: body or believed."""
        begin = 0 if body is self.body else self.body.size
        return self.corrected(np.eye(self.size)[:, begin : begin + body.size])

    def entered(self, columns: Numbers, begin: int) -> Numbers:
        """Return columns (n, m) of z after the tick from those of a part of z before it, which begins there."""
        rest = self.size - begin - columns.shape[-2]
        m = columns.shape[-1]
        return self.corrected(concatenate([np.zeros((begin, m)), columns, np.zeros((rest, m))], -2))

    def _entered(self, column: Numbers, begin: int) -> Numbers:
        return self.entered(column, begin)[..., 0]


@dataclass(frozen=True)
class FlightLoop(DesignedLoop):
    """A design on a plant that is known exactly, in floating point.

    Attributes:
        design: the controller.
        plant: what it flies.
        pose_age: age of the pose at every tick, s. The innovation is what it says less what was believed of its time;
            all of it corrects the estimate of the tick.

    Raises:
        FlatsatError: a delay is longer than 40 periods, or the pose older than one.
    """

    design: Design
    plant: Plant
    pose_age: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative("pose_age", self.pose_age, "s")
        period = self.design.period
        require(self.pose_age <= period, "pose_age", self.pose_age, "s", f"at most the period, {period:g} s")
        for delay in (self.plant.delay, self.design.model.delay):
            require_few_under_way("delay", delay, period)

    @property
    def body(self) -> PlantEquation:
        """The equation of the plant."""
        return self.plant.dynamics

    @property
    def believed(self) -> PlantEquation:
        """The equation of the nominal plant."""
        return self.design.model.dynamics

    @property
    def gain(self) -> float:
        """The gain g of the plant."""
        return self.plant.gain

    @property
    def share(self) -> float:
        """1/g."""
        return 1.0 / self.plant.gain

    @cached_property
    def timing(self) -> CommandTiming[Fraction]:
        """Which commands act when."""
        return CommandTiming.of(self.design, decimal(self.plant.delay), decimal(self.pose_age))

    def figure(self, value: Numbers) -> float:
        """Return a figure as a float."""
        return float(value)
