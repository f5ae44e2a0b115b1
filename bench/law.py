"""The law against solvers: the whole step and the whole tick of N drones beside the rivals' saturation alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import cycle, islice
from time import process_time

import numpy as np
from rivals import CvxpyAtOnce, CvxpyEach, Osqp16, RawClarabel
from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.controller import Controller, Memory
from flatsat_ros.law.gain import Tuning

SIZES = (1, 10, 100, 1000)
STEP, TICK, BASELINE = "whole step", "whole tick", CvxpyEach.name

_POOL = max(SIZES)
_ROUNDS = 25
# work of one round, some 10 ms of each: calls of the step, ticks, drones given to each rival
_STEPS, _TICKS, _SOLVED = 100, 20, 20
# the largest relative difference from ours; Clarabel stops at 1e-8 and OSQP at 1e-6
_TOLERANCE = 1e-6
_TOLERANCE_OSQP = 1e-5
_ROUNDING = 1e-12
# poses without noise are those of drones that stand, s; those that begin to repeat in flight are refused
_STANDS = 1.2

Saturation = Callable[[slice], FloatArray]


class Drones:
    """A thousand drones at one instant, tracking references that accelerate; the saturation acts on most of them."""

    def __init__(self, certificate: Certificate) -> None:
        rng = np.random.default_rng(2308)
        self.state = rng.normal(size=(_POOL, 6)) * np.repeat([1.0, 0.7], 3)
        self.reference = np.hstack([np.zeros((_POOL, 6)), rng.uniform(-0.5, 0.5, (_POOL, 3))])
        self.yaw = rng.uniform(-np.pi, np.pi, _POOL)
        self.gain = rng.uniform(1.0, 5.0, _POOL)
        # what the step computes before it saturates, and all that the rivals are given
        self.base = self.reference[:, 6:]
        self.v0 = -(self.state @ certificate.matrix)[:, 3:]


class Contest:
    """All contenders on the same drones."""

    def __init__(self, certificate: Certificate) -> None:
        self._certificate, self._drones = certificate, Drones(certificate)
        self._polytope = Osqp16(certificate.limits)
        self._alone = {
            rival.name: self._solved_by(rival.solve)
            for rival in (CvxpyEach(certificate.limits), RawClarabel(certificate.limits), self._polytope)
        }

    def check(self) -> dict[str, float]:
        """Compare all answers; return the largest relative difference of each contender from the step for all drones.

        Raises:
            FlatsatError: an answer differs by more than its solver's tolerance, OSQP's by more than the polytope does.
        """
        drones, limits = self._drones, self._certificate.limits
        ours = self._step(_POOL)(slice(0, _POOL))
        widest = np.minimum(drones.gain, self._polytope.around.exit_factor(drones.base, drones.v0))
        found = {}
        answers = [(f"{STEP}, N = {size}", size, self._step(size), _ROUNDING) for size in SIZES]
        answers += [(f"{CvxpyAtOnce.name}, N = {size}", size, self._at_once(size), _TOLERANCE) for size in SIZES[1:]]
        answers += [(name, _POOL, solve, _TOLERANCE) for name, solve in self._alone.items()]
        for name, size, solve, tolerance in tqdm(answers, desc="agreement", leave=False):
            factors = np.concatenate([solve(batch) for batch in _batches(size)])
            highest = ours
            if name == Osqp16.name:
                highest, tolerance = widest, _TOLERANCE_OSQP
            if not ((factors >= ours * (1.0 - tolerance)) & (factors <= highest * (1.0 + tolerance))).all():
                raise FlatsatError(f"{name} and the step disagree by {_difference(factors, ours):.3g} (relative)")
            found[name] = _difference(factors, ours)
        if not limits.contains(drones.base + ours[:, np.newaxis] * drones.v0).all():
            raise FlatsatError("the step leaves the input set")
        return found | {"polytope's own bound": _difference(widest, ours)}

    def saturated(self) -> float:
        """Return the share of drones on which the saturation acts."""
        return float((self._step(_POOL)(slice(0, _POOL)) < self._drones.gain).mean())

    def time(self, size: int) -> dict[str, list[float]]:
        """Return the processor time per drone, s, of each contender in each round; in a round all have their turn."""
        turns = {STEP: _turn(self._step(size), size, _STEPS), TICK: Flight(self._certificate, size).turn}
        turns |= {name: _turn(solve, _SOLVED, 1) for name, solve in self._alone.items()}
        if size > 1:
            turns[CvxpyAtOnce.name] = _turn(self._at_once(size), size, max(1, _SOLVED // size))
        for warm_up in turns.values():
            warm_up()
        times: dict[str, list[float]] = {name: [] for name in turns}
        rng = np.random.default_rng(size)
        for _ in tqdm(range(_ROUNDS), desc=f"N = {size}", leave=False):
            for name in rng.permutation(list(turns)):
                times[name].append(turns[name]())
        return times

    def _step(self, size: int) -> Saturation:
        drones, controller = self._drones, Controller(self._certificate, _tuning(self._certificate, size))

        def step(batch: slice) -> FloatArray:
            inputs = drones.state[batch], drones.yaw[batch], drones.reference[batch]
            return controller.step(Memory(drones.gain[batch]), *inputs)[1].applied_gain

        return step

    def _at_once(self, size: int) -> Saturation:
        return self._solved_by(CvxpyAtOnce(self._certificate.limits, size).solve)

    def _solved_by(self, solve: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]) -> Saturation:
        drones = self._drones
        return lambda batch: solve(drones.base[batch], drones.v0[batch], drones.gain[batch])


class Flight:
    """`Pilot.tick` with all drones in the air; a pose of each comes in before each tick, outside the measured time."""

    def __init__(self, certificate: Certificate, size: int) -> None:
        self._pilot = Pilot(certificate, _tuning(certificate, size), Policy(), size)
        self._period, self._now = certificate.period, 0.0
        # a metre apart: drones that come nearer are kept apart
        self._positions = [(float(i % 32 - 16), float(i // 32 - 16), 1.0) for i in range(size)]
        self._calls = max(1, _TICKS * 50 // (50 + size))
        for _ in range(math.ceil(_STANDS / self._period)):
            self._tick()
        for index, (x, y, z) in enumerate(self._positions):
            self._pilot.set_reference(index, Trajectory.hold([x + 0.5, y, z]))
        for _ in range(20):
            self._tick()
        if not (self._pilot.mode == Mode.FLY).all():
            raise FlatsatError("the pilot has poses and references and does not fly")

    def turn(self) -> float:
        """Return the seconds per drone of a tick, the mean of one round."""
        return sum(self._tick() for _ in range(self._calls)) / (self._calls * len(self._positions))

    def _tick(self) -> float:
        self._now += self._period
        for index, position in enumerate(self._positions):
            self._pilot.measure(index, self._now, position, (0.0, 0.0, 0.0, 1.0), self._now)
        begin = process_time()
        self._pilot.tick(self._now)
        return process_time() - begin


def _turn(solve: Saturation, size: int, calls: int) -> Callable[[], float]:
    """Return what a contender does in one round: so many calls, each with the next drones; it returns s per drone."""
    batches = cycle(_batches(size))

    def turn() -> float:
        chosen = list(islice(batches, calls))
        begin = process_time()
        for batch in chosen:
            solve(batch)
        return (process_time() - begin) / (calls * size)

    return turn


def _batches(size: int) -> list[slice]:
    return [slice(begin, begin + size) for begin in range(0, _POOL, size)]


def _tuning(certificate: Certificate, size: int) -> Tuning:
    return Tuning(*(np.full(size, value) for value in (2.0, 0.05, 1.0, certificate.gain_max)))


def _difference(factors: FloatArray, ours: FloatArray) -> float:
    return float(np.abs(factors / ours - 1.0).max())
