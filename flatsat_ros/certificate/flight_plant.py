"""Plants that the loop which flies may have, the controller's figures, and which commands act on either when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Generic, TypeVar

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_number, require_positive
from flatsat_ros.certificate.enclosures import Enclosure, Numbers, concatenate, decimal, exponential, filled


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
    def parameters(self) -> tuple[Fraction, ...]:
        """The parameters q of the last row: none, (1/lag, g/lag), or (wn^2, wn^2 g, 2 zeta wn, wn^2 tilt)."""
        gain = decimal(self.gain)
        if self.frequency > 0.0:
            frequency = decimal(self.frequency)
            square = frequency * frequency
            return square, square * gain, 2 * decimal(self.damping) * frequency, square * decimal(self.tilt)
        return (1 / decimal(self.lag), gain / decimal(self.lag)) if self.lag > 0.0 else ()

    @cached_property
    def dynamics(self) -> PlantEquation:
        """The equation, in floating point."""
        return PlantEquation([float(q) for q in self.parameters], self.drag)

    @property
    def system(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A (n, n), B (n,) and E (n,) of x' = A x + B u(t - d) + E D, with B for a gain of 1: B u is g times that."""
        A, B, E = self.dynamics.system
        return A, B, E

    def hold(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return e^(A t) (n, n) and the responses (n,) to a unit drive and to a unit D, both held for the time, s."""
        phi, drive, push = self.dynamics.hold(time)
        return phi, drive, push


class PlantEquation:
    """The equation of one plant or, with enclosures, of a batch, at a gain of 1.

    Attributes:
        size: n, of x = (e, e', a[, a']).
        system: A (..., n, n), B (..., n) and E (n,) of x' = A x + B c + E D.
    """

    def __init__(self, parameters: Sequence[Numbers], drag: Numbers) -> None:
        """Take over the parameters q of the last row and the drag."""
        n = self.size = 2 + len(parameters) // 2
        entries: dict[tuple[int, ...], Numbers] = {(0, 1): 1.0, (1, 1): -drag}
        E = np.zeros(n)
        E[1] = 1.0
        B: Numbers = E
        if parameters:
            entries |= {(i, i + 1): 1.0 for i in range(1, n - 1)} | {(n - 1, 2): -parameters[0]}
            B = filled((n,), {(n - 1,): parameters[0]})
        if n == 4:
            entries |= {(3, 3): -parameters[2], (3, 1): -parameters[3]}
        self.system: tuple[Numbers, Numbers, FloatArray] = filled((n, n), entries), B, E
        self._held: dict[object, tuple[Numbers, Numbers, Numbers]] = {}

    def hold(self, time: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Return e^(A t) (..., n, n) and the responses (..., n) to a unit drive and to a unit D held for a time, s."""
        key = time.mid.tobytes() if isinstance(time, Enclosure) else time
        if key not in self._held:
            A, B, E = self.system
            n = self.size
            whole = concatenate([concatenate([A, B[..., None], E[:, None]], -1), np.zeros((2, n + 2))], -2)
            power = exponential(whole * (time[..., None, None] if isinstance(time, Enclosure) else time))
            self._held[key] = power[..., :n, :n], power[..., :n, n], power[..., :n, n + 1]
        return self._held[key]


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


Time = TypeVar("Time")
# How many periods old a command is that acts, and how long it does, in the order in which they act.
Pieces = list[tuple[int, Time]]


def split(delay: float, period: float) -> tuple[int, float]:
    """Return a delay as whole periods and the rest, s."""
    whole = math.floor(decimal(delay) / decimal(period))
    return whole, float(decimal(delay) - whole * decimal(period))


def pieces(delay: Fraction, period: Fraction, until: Fraction) -> Pieces[Fraction]:
    """Return which commands act from a tick on until a time within the period: how many periods old, and how long."""
    whole = math.floor(delay / period)
    rest, found = delay - whole * period, []
    if rest > 0 and until > 0:
        found.append((whole + 1, min(rest, until)))
    if until > rest:
        found.append((whole, until - rest))
    return found


def _ahead(delay: Fraction, period: Fraction, horizon: Fraction) -> Pieces[Fraction]:
    """Return which commands act while a delay passes, from a tick on: how many periods old, and how long."""
    found, elapsed = [], Fraction(0)
    while elapsed < horizon:
        index = math.ceil((delay - elapsed) / period)
        until = min(delay - (index - 1) * period, horizon)
        found.append((index, until - elapsed))
        elapsed = until
    return found


@dataclass(frozen=True)
class CommandTiming(Generic[Time]):
    """Which commands act when, on a plant and on the nominal one: how many periods old, and for how long, s.

    Attributes:
        plant, model: within a period.
        plant_young, model_young: from the tick to the time of the next pose.
        ahead: while the law predicts.
        depth: M, the number of commands under way that z keeps.
    """

    plant: Pieces[Time]
    model: Pieces[Fraction]
    plant_young: Pieces[Time]
    model_young: Pieces[Fraction]
    ahead: Pieces[Fraction]
    depth: int

    @staticmethod
    @lru_cache(maxsize=1024)  # many cells have the same delay
    def of(design: Design, delay: Fraction, pose_age: Fraction) -> CommandTiming[Fraction]:
        """Return it for a delay of the plant and an age of poses, s."""
        h, nominal = decimal(design.period), decimal(design.model.delay)
        return CommandTiming(
            plant=pieces(delay, h, h),
            model=pieces(nominal, h, h),
            plant_young=pieces(delay, h, h - pose_age),
            model_young=pieces(nominal, h, h - pose_age),
            ahead=_ahead(nominal, h, decimal(design.horizon)),
            depth=max(math.ceil(delay / h), math.ceil(nominal / h)),
        )
