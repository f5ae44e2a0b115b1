"""What a certificate claims about every moment of a closed loop, checked for many runs at once."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.law.controller import Output
from flatsat_ros.law.flatness import acceleration_from_input

# By how much, relatively, a claim may fail: the rounding that `Certificate.verify` grants to a tight inequality.
ROUNDING = 1e-9

Levels = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Violation:
    """A claim that failed.

    Attributes:
        campaign, seed, index: which run.
        step: when, in periods or steps of integration from 0.
        claim: what failed first.
        excess: by how much, relatively.
    """

    campaign: str
    seed: int
    index: int
    step: int
    claim: str
    excess: float


@dataclass
class Ledger:
    """The claims of one batch of runs, and how they fared.

    Attributes:
        certificate: whose claims.
        campaign, seed: of the batch.
        watched: index of the run whose history is kept; None for none.
        step: the present one.
        violations: the first of each run.
        tightest: by how much, relatively, each claim failed at worst; negative is to spare.
        history: of the watched run, some named values for each step.
    """

    certificate: Certificate
    campaign: str
    seed: int
    watched: int | None
    step: int = 0
    violations: dict[int, Violation] = field(default_factory=dict)
    tightest: dict[str, float] = field(default_factory=dict)
    history: list[dict[str, FloatArray]] = field(default_factory=list)

    def claim(self, text: str, excess: FloatArray) -> None:
        """Check what holds if excess (N,), relative, is at most rounding; NaN does not hold."""
        excess = np.where(np.isnan(excess), np.inf, excess)
        self.tightest[text] = max(self.tightest.get(text, -np.inf), float(excess.max()))
        for row in map(int, np.flatnonzero(excess > ROUNDING)):
            if row not in self.violations:
                value = float(excess[row])
                self.violations[row] = Violation(self.campaign, self.seed, row, self.step, text, value)

    def note(self, **values: FloatArray) -> None:
        """Keep the watched run's entries of some arrays (N, ...)."""
        if self.watched is not None:
            self.history.append({name: value[self.watched] for name, value in values.items()})

    def command(self, output: Output, yaw: FloatArray, later: FloatArray) -> None:
        """Check the limits of v and of u, also when the yaw (N,) moves on to `later` while u is held."""
        bounds, (thrust, roll, pitch) = self.certificate.limits, output.input.T
        self.claim("v lies in the input set", bounds.gauge(output.acceleration) - 1.0)
        self.claim("T <= T_max", thrust / bounds.thrust_max - 1.0)
        self.claim("T >= T_min", (bounds.thrust_min - thrust) / bounds.gravity)
        self.claim("|phi|, |theta| <= eps_max", np.maximum(np.abs(roll), np.abs(pitch)) / bounds.tilt_max - 1.0)
        back = acceleration_from_input(output.input, yaw, bounds.gravity)
        self.claim("f(Phi(v)) = v", np.abs(back - output.acceleration).max(axis=-1) / bounds.thrust_max)
        turned = acceleration_from_input(output.input, later, bounds.gravity)
        self.claim("f(u) lies in the input set as the yaw moves on", bounds.gauge(turned) - 1.0)

    def gain(self, output: Output, kappa: FloatArray) -> None:
        """Check that the applied gain is at least kappa (N,), or gamma if that is less."""
        self.claim("k >= min(gamma, kappa)", np.minimum(output.gain, kappa) / output.applied_gain - 1.0)

    def levels(self, when: str, before: Levels, after: Levels, floor: float) -> None:
        """Check that V_h, V_v and their sum do not grow beyond what they were or what a disturbance lifts them to."""
        names = ("V_h", "V_v", "V") if self.certificate.loop is None else ("W_h", "W_v", "W")
        parts = (*zip(before, after, strict=True), (before[0] + before[1], after[0] + after[1]))
        for name, (old, new) in zip(names, parts, strict=True):
            allowed = np.maximum(old, floor)
            self.claim(f"{name} does not grow {when}", (new - allowed) / np.where(allowed > 0.0, allowed, 1.0))

    def place(self, before: FloatArray, after: FloatArray, guaranteed: np.ndarray) -> None:
        """Check that no run leaves the set that it is in (values of `certificate.sets.Place`)."""
        self.claim("no set is left", np.maximum(before - after, 1.0 - guaranteed))
