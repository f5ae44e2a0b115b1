"""Closed loops by the thousand, driven against their certificates.

A batch is one certificate, `RUNS` starts and everything else drawn by `adversary`; its campaign and its seed determine
it to the last bit. The law is the controller's own. The sampled loop is propagated exactly, with its lag and its delay
and, where the certificate speaks of it, to times between samples; continuous time is integrated by Runge and Kutta's
method, but V' is not: it follows from the command at hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.gain_bounds import sampled_gain_bound
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.certificate.sets import Membership, Place
from flatsat_ros.falsification import adversary
from flatsat_ros.falsification.adversary import Course, Disturbance, Gains, SwingingReferences
from flatsat_ros.falsification.claims import Ledger, Levels, Violation
from flatsat_ros.falsification.loops import runge_kutta
from flatsat_ros.law.controller import Controller, Memory, Output
from flatsat_ros.law.gain import Tuning

# Runs of one batch, and periods (or steps of integration) of one run.
RUNS, STEPS = 1000, 60

CAMPAIGNS = {
    "hold": "command held, without lag and delay; at and between samples",
    "lag": "command held, lag and delay; at samples",
    "robust": "command held, worst disturbances; at samples",
    "continuous": "continuous time",
    "storm": "continuous time, worst disturbances",
    "tracking": "continuous time, moving references",
}

# those with disturbances
DISTURBED = frozenset({"robust", "storm"})

Pool = Mapping[str, Sequence[Certificate]]

# Steps of the integration in the fastest time constant, 1/(gamma P22).
_FINENESS = 5.0

# alpha V, (m/s^2)^2, below which the rounding of v about a reference is no longer small in V'.
_SMALL = 1e-10


@dataclass(frozen=True)
class CampaignOutcome:
    """What a batch came to.

    Attributes:
        certificate: that was flown, wrong if it was tampered with.
        violations: the first of each run.
        tightest: by how much, relatively, each claim failed at worst; negative is to spare.
        history: of the watched run, some named values for each step.
    """

    certificate: Certificate
    violations: list[Violation]
    tightest: dict[str, float]
    history: list[dict[str, FloatArray]]


def run(
    campaign: str,
    seed: int,
    pool: Pool,
    tamper: Callable[[Certificate], Certificate] | None = None,
    watched: int | None = None,
) -> CampaignOutcome:
    """Run one batch.

    Args:
        campaign: one of `CAMPAIGNS`.
        seed: of the batch.
        pool: certificates that need a solver: "lag", whose limits are drawn anew, and "robust".
        tamper: makes the certificate wrong, after it was verified.
        watched: index of the run whose history is wanted.

    Raises:
        FlatsatError: a certificate does not verify.
    """
    random = np.random.default_rng([list(CAMPAIGNS).index(campaign), seed])
    if campaign == "lag":
        proven = adversary.with_limits(pool["lag"][int(random.integers(len(pool["lag"])))], adversary.limits(random))
    elif campaign in DISTURBED:
        proven = pool["robust"][int(random.integers(len(pool["robust"])))]
    else:
        proven = adversary.certificate(random)
    proven.verify()
    ledger = Ledger(proven if tamper is None else tamper(proven), campaign, seed, watched)
    if campaign in ("hold", "lag", "robust"):
        _Sampled(random, ledger).fly()
    else:
        _Continuous(random, ledger, campaign == "tracking").fly()
    return CampaignOutcome(ledger.certificate, list(ledger.violations.values()), ledger.tightest, ledger.history)


class _Loop:
    """What the loops have in common: a certificate, its claims, and a yaw that turns and sways."""

    def __init__(self, random: np.random.Generator, ledger: Ledger) -> None:
        self._random, self._ledger, self._proven = random, ledger, ledger.certificate
        self._sets = self._proven.sets
        self._turn, self._heading = random.uniform(-6.0, 6.0, RUNS), random.uniform(-np.pi, np.pi, RUNS)  # rad/s, rad

    def _yaw(self, time: float) -> FloatArray:
        """Return psi (N,), rad."""
        return np.asarray(self._heading + self._turn * time + np.sin(5.0 * time + self._heading))

    @staticmethod
    def _kappa(where: Membership) -> FloatArray:
        """Return what the certificate says that k is at least, (N,)."""
        return np.where(where.place == Place.ELLIPSOID, 1.0, where.kappa)


class _Sampled(_Loop):
    """The loop that runs: set-points, the command held for a period."""

    def __init__(self, random: np.random.Generator, ledger: Ledger) -> None:
        super().__init__(random, ledger)
        proven, timing = self._proven, self._proven.timing
        self._timings = [timing]
        if timing.immediate and proven.robust is None:
            self._timings += [Timing(proven.period * share) for share in random.uniform(0.02, 0.98, 2)]
        self._tuning = adversary.tuning(random, proven)
        self._controller = Controller(proven, self._tuning)
        self._disturbance = Disturbance(random, proven, RUNS, proven.period)
        lowest = np.where(random.random(RUNS) < 0.5, 1.0, proven.gain_min)
        self._gains = Gains(random, lowest, proven.gain_max)
        self._z = adversary.starts(random, proven, RUNS)
        self._time = 0.0

    def fly(self) -> None:
        proven, ledger, sets, h = self._proven, self._ledger, self._sets, self._proven.period
        adapted = np.full(RUNS, self._tuning.gain_initial[0])
        where, levels = sets.classify(self._z), sets.levels(self._z)
        bound = self._gain_bound(levels)
        for ledger.step in range(STEPS):
            self._time = ledger.step * h
            gamma = self._gains.choose(ledger.step, adapted, self._after)
            memory, output = self._answer(np.arange(RUNS), gamma)
            adapted = memory.gain
            ledger.command(output, self._yaw(self._time), self._yaw(self._time + h))
            ledger.gain(output, self._kappa(where))
            ledger.claim("gamma stays within its bounds", np.maximum(1.0 / adapted, adapted / bound) - 1.0)
            ledger.note(
                t=np.full(RUNS, self._time), V_h=levels[0], V_v=levels[1], place=where.place, kappa=where.kappa,
                gamma=gamma, k=output.applied_gain, u=output.input, v=output.acceleration, xi=output.error,
            )  # fmt: skip
            floor = 0.0 if proven.robust is None else proven.robust.floor
            for shorter in self._timings[1:]:
                passed = _advance(shorter, self._z, output.acceleration)
                ledger.levels("between samples", levels, sets.levels(passed), floor)
            self._z = _advance(proven.timing, self._z, output.acceleration)
            w = self._disturbance.choose(self._z[:, :6])
            self._z[:, :6] += w @ self._disturbance.gathered.T

            before, where = where, sets.classify(self._z)
            earlier, levels = levels, sets.levels(self._z)
            ledger.levels("at samples", earlier, levels, floor)
            ledger.place(before.place, where.place, where.guaranteed)

    def _answer(self, rows: np.ndarray, gamma: FloatArray) -> tuple[Memory, Output]:
        """Return the controller's answer for some runs."""
        state, yaw = self._z[rows, :6], self._yaw(self._time)[rows]
        return self._controller.step(Memory(gamma), state, yaw, np.zeros((len(rows), 9)))

    def _after(self, rows: np.ndarray, gamma: FloatArray) -> Levels:
        """Return where some gains would bring some runs."""
        return self._sets.levels(_advance(self._timings[0], self._z[rows], self._answer(rows, gamma)[1].acceleration))

    def _gain_bound(self, levels: Levels) -> FloatArray:
        """Return what gamma (N,) stays below: gain_max, or what is proved of the law where k >= 1."""
        proven, bound = self._proven, np.full(RUNS, self._proven.gain_max)
        rows = (self._gains.course == Course.LAW) & (self._sets.scale_larger(self._z) <= 1.0)
        if proven.timing.immediate and proven.robust is None and rows.any():
            tuning, start = self._tuning, float((levels[0] + levels[1])[rows].max())
            initial, rate, threshold = (
                float(value[0]) for value in (tuning.gain_initial, tuning.adaptation_rate, tuning.threshold)
            )
            law = sampled_gain_bound(initial, rate, start, threshold, proven.block, proven.period)
            bound[rows] = min(law, proven.gain_max)
        return bound


class _Continuous(_Loop):
    """The loop of the paper: the command follows the state at once; set-points, or references that move."""

    def __init__(self, random: np.random.Generator, ledger: Ledger, moving: bool) -> None:
        super().__init__(random, ledger)
        proven = self._proven
        highest = 50.0 ** random.random()
        self._dt = 1.0 / (_FINENESS * highest * max(float(block[1, 1]) for block in proven.blocks))
        self._controller = Controller(proven, Tuning(*np.ones((4, 1))))
        self._disturbance = Disturbance(random, proven, RUNS, self._dt)
        self._gains = Gains(random, np.ones(RUNS), highest)
        self._moving, radius = moving, proven.limits.inner_radius
        margin, xi = np.full(RUNS, radius), adversary.starts(random, proven, RUNS)[:, :6]
        if moving:
            margin = radius * 1e-3 ** random.random(RUNS)
            # inside { V <= m^2/alpha }, the set of a margin m, on its boundary, and beyond, where k >= kappa > 1/2
            size = random.choice([0.5, 1.0 - 1e-9, 1.9], RUNS) * margin / radius
            xi *= (size / self._sets.scale_ellipsoid(xi))[:, np.newaxis]
        self._references = SwingingReferences.draw(random, proven, margin)
        self._xi = xi

    def fly(self) -> None:
        ledger, sets, dt, every = self._ledger, self._sets, self._dt, np.arange(RUNS)
        floor = 0.0 if self._proven.robust is None else 1.0  # E_w
        where, levels = sets.classify(self._xi), sets.levels(self._xi)
        for ledger.step in range(STEPS):
            time = ledger.step * dt
            self._psi = self._yaw(time)
            self._stages = [self._references.at(time + share * dt) for share in (0.0, 0.5, 1.0)]
            gamma = self._gains.choose(ledger.step, np.ones(RUNS), self._after)
            w = self._disturbance.choose(self._xi)
            output = self._answer(every, gamma, 0, self._xi)
            kappa = self._kappa_moving(levels) if self._moving else self._kappa(where)
            ledger.command(output, self._psi, self._yaw(time + dt))
            ledger.gain(output, kappa)
            self._check_rate(output, w, kappa, levels[0] + levels[1])
            ledger.note(
                t=np.full(RUNS, time), V_h=levels[0], V_v=levels[1], place=where.place, kappa=kappa,
                gamma=gamma, k=output.applied_gain, u=output.input, v=output.acceleration, xi=self._xi,
            )  # fmt: skip
            self._xi = self._integrate(every, gamma, w)
            before, where = where, sets.classify(self._xi)
            earlier, levels = levels, sets.levels(self._xi)
            ledger.levels("in continuous time", earlier, levels, floor)
            if not self._moving:
                ledger.place(before.place, where.place, where.guaranteed)

    def _answer(self, rows: np.ndarray, gamma: FloatArray, part: int, xi: FloatArray) -> Output:
        """Return the controller's answer for some runs at their errors xi; part counts half steps from now."""
        _, output = self._controller.step(Memory(gamma), xi, self._psi[rows], self._stages[part][rows])
        return output

    def _integrate(self, rows: np.ndarray, gamma: FloatArray, w: FloatArray) -> FloatArray:
        """Return the errors of some runs a step later, under a constant gain and disturbance."""
        shake = w @ self._disturbance.matrix

        def slope(part: int, xi: FloatArray) -> FloatArray:
            v = self._answer(rows, gamma, part, xi).acceleration - self._stages[part][rows, 6:]
            return np.asarray(np.concatenate([xi[:, 3:], v], axis=1) + shake)

        return runge_kutta(slope, self._xi[rows], self._dt)

    def _after(self, rows: np.ndarray, gamma: FloatArray) -> Levels:
        """Return where some gains would bring some runs."""
        return self._sets.levels(self._integrate(rows, gamma, np.zeros((len(rows), 6))))

    def _kappa_moving(self, levels: Levels) -> FloatArray:
        """Return what the margin of the references at this moment says that k is at least, (N,)."""
        margin = self._proven.limits.margin(self._stages[0][:, 6:])
        return np.minimum(1.0, margin / np.sqrt(self._proven.rate * (levels[0] + levels[1])))

    def _check_rate(self, output: Output, w: FloatArray, kappa: FloatArray, level: FloatArray) -> None:
        """Check V' <= alpha (w'w - (2 kappa - 1) V), without disturbance w = 0."""
        rate, gradient = self._proven.rate, 2.0 * self._xi @ self._proven.matrix
        effort = (w * w).sum(axis=1) * (self._proven.robust is not None)
        v = output.acceleration - self._stages[0][:, 6:]
        slope = np.concatenate([self._xi[:, 3:], v], axis=1) + w @ self._disturbance.matrix
        growth = (gradient * slope).sum(axis=1) - rate * (effort - (2.0 * kappa - 1.0) * level)
        scale = np.maximum(rate * np.maximum(level, effort), _SMALL)
        self._ledger.claim("V' <= alpha (w'w - (2 kappa - 1) V)", growth / scale)


def _advance(timing: Timing, z: FloatArray, command: FloatArray) -> FloatArray:
    """Return the states (N, 3 n) a period on."""
    return timing.advance(z.reshape(len(z), timing.size, 3), command).reshape(z.shape)
