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

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_number, require_positive

# Delays this close to whole periods, relative to one, are whole.
_WHOLE = 1e-9

# Commands under way; more make loops that no design is for.
_DEPTH = 40


@dataclass(frozen=True)
class Plant:
    """How one kind of drone answers a commanded acceleration, on one axis.

    First order: lag a' = g u(t - d) - a. Second order: a'' / wn^2 + 2 zeta a' / wn + a = g u(t - d) - tilt e'. Either
    way e'' = a - drag e' + D.

    Attributes:
        delay: d, s, transport delay.
        lag: s; 0 for none, and for the second order.
        frequency: wn, rad/s; 0 for the first order.
        damping: zeta of the second order.
        gain: g, steady acceleration over commanded acceleration.
        tilt: acceleration that attitude makes against the velocity, 1/s (second order only); negative for a drone that
            leans into its motion.
        drag: linear drag divided by the mass, 1/s.

    Raises:
        FlatsatError: a value is not finite or, but for the tilt, negative, or both orders are given.
    """

    delay: float = 0.0
    lag: float = 0.0
    frequency: float = 0.0
    damping: float = 0.0
    gain: float = 1.0
    tilt: float = 0.0
    drag: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_positive, gain="")
        require_fields(self, require_not_negative, delay="s", lag="s", frequency="rad/s", damping="", drag="1/s")
        require_fields(self, require_number, tilt="1/s")
        if self.frequency > 0.0:
            require(self.lag == 0.0, "lag", self.lag, "s", "0 with a frequency (second order)")
            require(self.damping > 0.0, "damping", self.damping, "", "above 0 with a frequency (second order)")
        else:
            require(self.tilt == 0.0, "tilt", self.tilt, "1/s", "0 without a frequency (first order)")
            require(self.damping == 0.0, "damping", self.damping, "", "0 without a frequency (first order)")

    @property
    def size(self) -> int:
        """Number of entries of x = (e, e', a[, a'])."""
        return 2 + (self.lag > 0.0) + 2 * (self.frequency > 0.0)

    @property
    def lead(self) -> float:
        """Mean time between a command, once it has arrived, and the acceleration: lag, or 2 zeta / wn, s."""
        return self.lag if self.frequency == 0.0 else 2.0 * self.damping / self.frequency

    @cached_property
    def system(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A (n, n), B (n,) and E (n,) of x' = A x + B u(t - d) + E D, with B for a gain of 1: B u is g times that."""
        n = self.size
        A, B, E = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        A[0, 1], A[1, 1], E[1] = 1.0, -self.drag, 1.0
        if self.frequency > 0.0:
            square = self.frequency * self.frequency
            A[1, 2] = A[2, 3] = 1.0
            A[3] = [0.0, -self.tilt * square, -square, -2.0 * self.damping * self.frequency]
            B[3] = square
        elif self.lag > 0.0:
            A[1, 2], A[2, 2], B[2] = 1.0, -1.0 / self.lag, 1.0 / self.lag
        else:
            B[1] = 1.0
        return A, B, E

    def hold(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return e^(A t) (n, n) and the responses (n,) to a unit drive and to a unit D, both held for the time, s."""
        A, B, E = self.system
        n = self.size
        held = np.zeros((n + 2, n + 2))
        held[:n, :n], held[:n, n], held[:n, n + 1] = A, B, E
        power = exponential(held * time)
        return power[:n, :n], power[:n, n], power[:n, n + 1]


def exponential(matrix: FloatArray) -> FloatArray:
    """Return e^M of a small square matrix, by its series and squaring."""
    halvings = max(0, math.ceil(math.log2(max(float(np.abs(matrix).sum(axis=-1).max()), 1e-300))) + 3)
    step = matrix / 2.0**halvings
    result = term = np.eye(len(matrix))
    for order in range(1, 15):  # the first one left out is below (1/8)^15 / 15! < 1e-25
        term = term @ step / order
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)


@dataclass(frozen=True)
class Design:
    """The figures of the controller.

    Attributes:
        period: h, s.
        model: the nominal plant that estimator and predictor know; its gain is 1, commands are divided by the real one.
        observer: L, three gains of the innovation: position (), velocity (1/s), disturbance (1/s^2).
        stiffness: K1, 1/s^2.
        rate: K2, 1/s.
        horizon: how far the law predicts, s; 0 for not at all.
        lead: s, of the predicted acceleration in the law.

    Raises:
        FlatsatError: a value is negative or not finite.
    """

    period: float
    model: Plant
    observer: tuple[float, float, float]
    stiffness: float
    rate: float
    horizon: float
    lead: float

    def __post_init__(self) -> None:
        require_fields(self, require_positive, period="s", stiffness="1/s^2", rate="1/s")
        require_fields(self, require_not_negative, horizon="s", lead="s")
        require(self.model.gain == 1.0, "gain of the model", self.model.gain, "", "1, commands are divided by it")
        require(len(self.observer) == 3, "observer", self.observer, "", "three gains")
        for gain in self.observer:
            require_not_negative("observer", gain, "")
        most = self.model.delay
        require(self.horizon <= most, "horizon", self.horizon, "s", f"at most {most:.6g} s, the delay of the model")
        most = self.model.lead
        require(self.lead <= most, "lead", self.lead, "s", f"at most {most:.6g} s, the lag of the model")

    @classmethod
    def predicting(
        cls, period: float, model: Plant, observer: tuple[float, float, float], stiffness: float, rate: float
    ) -> Design:
        """Return the design that predicts over all of the model's delay and lag."""
        return cls(period, model, observer, stiffness, rate, model.delay, model.lead)


def split(delay: float, period: float) -> tuple[int, float]:
    """Return a delay as whole periods and the rest, s."""
    periods = delay / period
    whole = math.floor(periods + _WHOLE)
    rest = periods - whole
    return whole, rest * period if rest > _WHOLE else 0.0


@dataclass(frozen=True)
class FlightLoop:
    """A design on a plant that is known exactly.

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
        most = _DEPTH * self.design.period
        for delay in (self.plant.delay, self.design.model.delay):
            require(delay <= most, "delay", delay, "s", f"at most {most:.6g} s, {_DEPTH} periods")

    @property
    def depth(self) -> int:
        """M, the number of commands under way that z keeps."""
        h = self.design.period
        delays = (self.plant.delay, self.design.model.delay)
        return max(whole + (rest > 0.0) for whole, rest in (split(delay, h) for delay in delays))

    @property
    def size(self) -> int:
        """Number of entries of z."""
        return self.plant.size + self.design.model.size + 1 + self.depth

    @property
    def _error(self) -> int:
        """Index of D/g - d^ in z."""
        return self.plant.size + self.design.model.size

    @cached_property
    def commands(self) -> FloatArray:
        """Rows (1 + M, n + 1) that give c_0, ..., c_M from (z, c_0)."""
        n, rows = self.size, np.zeros((1 + self.depth, self.size + 1))
        rows[0, n] = 1.0
        rows[1:, self._error + 1 : n] = np.eye(self.depth)
        return rows

    @cached_property
    def prediction(self) -> FloatArray:
        """Rows (2, n) of the predicted p and v + lead (a + d^) of the nominal plant, at the tick, once corrected."""
        model, n = self.design.model, self.size
        start = self.plant.size
        state = np.zeros((model.size, n + 1))
        state[:, start : start + model.size] = np.eye(model.size)
        commands = self.commands
        h = self.design.period
        # at time s after the tick the command of i = ceil((d - s)/h) periods ago acts
        delay, elapsed, E = model.delay, 0.0, np.zeros(n + 1)
        E[self._error] = -1.0
        while self.design.horizon - elapsed > _WHOLE * h:
            index = math.ceil((delay - elapsed) / h - _WHOLE)
            until = min(delay - (index - 1) * h, self.design.horizon)
            phi, drive, push = model.hold(until - elapsed)
            state = phi @ state + np.outer(drive, commands[index]) + np.outer(push, E)
            elapsed = until
        velocity = state[1]
        if self.design.lead > 0.0:
            velocity = velocity + self.design.lead * (state[2] + E)
            if model.frequency > 0.0:  # of e' + model.lead a + a'/wn^2 the derivative is the command, without drag
                velocity = velocity + self.design.lead / model.lead / model.frequency**2 * state[3]
        return np.stack([state[0, :n], velocity[:n]])

    @cached_property
    def feedback(self) -> FloatArray:
        """Row (n,) of v0 = feedback . z, at the tick, after the correction."""
        position, velocity = self.prediction
        return np.asarray(-self.design.stiffness * position - self.design.rate * velocity)

    @property
    def moved(self) -> FloatArray:
        """Rows (x, n + 1) of the plant's state a period later, from (z, c_0)."""
        return self._step[0][: self.plant.size]

    @property
    def estimate(self) -> FloatArray:
        """Rows (y, n + 1) of the nominal plant's state before the correction, a period later, from (z, c_0)."""
        return self._step[0][self.plant.size : self._error]

    @cached_property
    def compensation(self) -> FloatArray:
        """Row (n,) of the part of the command that is not k v0."""
        row = np.zeros(self.size)
        row[self._error] = 1.0
        return row

    @cached_property
    def _step(self) -> tuple[FloatArray, FloatArray]:
        """S (n, n + 1) of z before the correction, S (z, c_0), and the correction (n,) by a unit innovation."""
        h, n, error = self.design.period, self.size, self._error
        plant, model = self.plant, self.design.model
        step, commands = np.zeros((n, n + 1)), self.commands
        step[: plant.size] = _drive(plant, h, h, plant.gain, 0, commands, n)
        push = model.hold(h)[2]
        step[plant.size : error] = _drive(model, h, h, 1.0, plant.size, commands, n)
        step[plant.size : error, error] -= push
        step[error, error] = 1.0
        step[error + 1 :] = commands[: self.depth]
        correction = np.zeros(n)
        correction[plant.size : plant.size + 2] = self.design.observer[:2]
        correction[error] = -self.design.observer[2]
        return step, correction

    @cached_property
    def _innovation(self) -> FloatArray:
        """Row (n + 1,) of what the pose says less what was believed of its time, from (z, c_0)."""
        if self.pose_age == 0.0:
            return np.asarray(self._step[0][0] - self._step[0][self.plant.size])
        h, n, plant, model = self.design.period, self.size, self.plant, self.design.model
        time = h - self.pose_age
        row = _drive(plant, h, time, plant.gain, 0, self.commands, n)[0]
        row = row - _drive(model, h, time, 1.0, plant.size, self.commands, n)[0]
        row[self._error] += model.hold(time)[2][0]
        return np.asarray(row)

    @property
    def before_correction(self) -> FloatArray:
        """Rows (n, n + 1) that give z at the end of the period, before the correction there, from (z, c_0)."""
        return self._step[0]

    def corrected(self, predicted: FloatArray) -> FloatArray:
        """Return z after a correction by a pose of the tick, from z before it; (n,), or columns (n, m)."""
        innovation = predicted[0] - predicted[self.plant.size]
        return np.asarray(predicted + np.multiply.outer(self._step[1], innovation))

    def matrix(self, gain: float) -> FloatArray:
        """Return A(k) (n, n) of the loop at the applied gain k."""
        step, n = self._step[0] + np.outer(self._step[1], self._innovation), self.size
        return np.asarray(step[:, :n] + np.outer(step[:, n], self.compensation + gain * self.feedback))

    @cached_property
    def command_input(self) -> FloatArray:
        """Column (n,) by which an error of the command c_0 enters z+: A(k) - A(0) = k times its product with v0."""
        return np.asarray(self._step[0][:, self.size] + self._step[1] * self._innovation[self.size])

    @property
    def noise_input(self) -> FloatArray:
        """Column (n,) of the noise at the tick at the end of the period, m."""
        return self._step[1]

    def drive_input(self, time: float) -> FloatArray:
        """Column (n,) of an impulse of drive error, m/s^2 s, `time` seconds before the end of the period."""
        return self.corrected(self._padded(self.plant.hold(time)[0] @ self.plant.system[1], 0))

    def push_input(self, time: float) -> FloatArray:
        """Column (n,) of an impulse of acceleration, m/s^2 s, `time` seconds before the end of the period."""
        return self.corrected(self._padded(self.plant.hold(time)[0] @ self.plant.system[2], 0))

    def model_drive_input(self, time: float) -> FloatArray:
        """Column (n,) of an impulse at the input of the nominal plant, m/s^2 s, `time` before the end of the period."""
        model = self.design.model
        return self.corrected(self._padded(model.hold(time)[0] @ model.system[1], self.plant.size))

    def rate_input(self, time: float) -> FloatArray:
        """Column (n,) of an impulse of D', m/s^2, `time` seconds before the end of the period.

        D moves by one; the rest of the period feels it as it is, and z refers to the new D from the tick on.
        """
        column = self._padded(self.plant.hold(time)[2], 0)
        if self.plant.size > 2:
            column[2] += 1.0
        return self.corrected(column) + self.share_input / self.plant.gain

    @property
    def share_input(self) -> FloatArray:
        """Column (n,) of a step of D/g alone, m/s^2: on all that refers to the command against it."""
        column = np.zeros(self.size)
        if self.design.model.size > 2:
            column[self.plant.size + 2] = 1.0
        column[self._error :] = 1.0
        return self.corrected(column)

    @property
    def model_unit_inputs(self) -> FloatArray:
        """Columns (n, y) of units of the nominal plant's state before the tick."""
        size = self.design.model.size
        return self.corrected(np.eye(self.size)[:, self.plant.size : self.plant.size + size])

    def _padded(self, part: FloatArray, begin: int) -> FloatArray:
        column = np.zeros(self.size)
        column[begin : begin + len(part)] = part
        return column


def _drive(plant: Plant, h: float, time: float, gain: float, begin: int, commands: FloatArray, n: int) -> FloatArray:
    """Return rows (plant.size, n + 1): x at a time within the period from (z, c_0); x is in z from `begin` on."""
    whole, rest = split(plant.delay, h)
    rows = np.zeros((plant.size, n + 1))
    rows[:, begin : begin + plant.size] = np.eye(plant.size)
    if rest > 0.0:
        phi, drive, _ = plant.hold(min(rest, time))
        rows = phi @ rows + gain * np.outer(drive, commands[whole + 1])
    if time > rest:
        phi, drive, _ = plant.hold(time - rest)
        rows = phi @ rows + gain * np.outer(drive, commands[whole])
    return rows
