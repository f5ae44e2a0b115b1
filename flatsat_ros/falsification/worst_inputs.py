"""The worst inputs of a flight loop: signs of the impulse response, back from the tick at which a signal is wanted.

For a known sequence of gains the loop is linear, and the inputs that lift a signal most at a tick have the sign of what
they do to it: backward in time, a row of the signal times the matrices of the periods (docs/mathematics.md, "The
tube"). Where gains or ages of poses are the adversary's, each is chosen on the way back, greedily, for what the inputs
of the periods before could do then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.certificate.flight_tube import Assumptions

SIGNALS = ("position", "velocity", "nominal", "disturbance")

# ticks before at which greedy choices look for what inputs could do
_LOOK = (0, 1, 2, 4, 7, 11, 16, 24, 36, 54)
# pieces of a period over which the exact bound is summed
_PIECES = 4


class Schedule(NamedTuple):
    """What an adversary does in T periods to N drones.

    Attributes:
        gains: (T, N) applied.
        ages: (T, N) of the pose at the end: 0 for a new one, 1 for the oldest.
        signs: (T, N, 3) of noise, rate and drive.
    """

    gains: FloatArray
    ages: np.ndarray
    signs: FloatArray


class WorstInputs:
    """The loops of some plants with one controller.

    Attributes:
        bounds: (P, 3) of noise m, rate m/s^3 and drive m/s^2.
    """

    def __init__(
        self, axis: Axis, plants: Sequence[Plant], assumptions: Assumptions, gains: tuple[float, float], age: float
    ) -> None:
        """Prepare.

        Args:
            axis: its controller.
            plants: P of them.
            assumptions: bounds of the inputs.
            gains: least and largest applied gain.
            age: of the oldest poses, s.
        """
        self._gains = gains
        loops = [[FlightLoop(axis.design, plant, each) for plant in plants] for each in (0.0, age)]
        size, plant_size = max(loop.size for loop in loops[0]), loops[0][0].plant.size
        model_size = axis.design.model.size

        def padded(values: FloatArray) -> FloatArray:
            """Commands under way beyond a plant's own are never looked at."""
            shape = [(0, size - length if length > 3 else 0) for length in values.shape]
            return np.pad(values, shape)

        h = axis.design.period
        nodes, weights = np.polynomial.legendre.leggauss(3)
        times, weights = h / 2.0 * (1.0 + nodes), h / 2.0 * weights
        self._free = np.array([[padded(loop.matrix(0.0)) for loop in each] for each in loops])
        self._command = np.array([[padded(loop.command_input) for loop in each] for each in loops])
        self._feedback = np.array([padded(loop.feedback) for loop in loops[0]])
        self.bounds = np.array([input_bounds(axis, plant, assumptions) for plant in plants])
        columns = []
        for loop, bound in zip(loops[0], self.bounds, strict=True):
            held = [
                sum(w * column(t) for t, w in zip(times, weights, strict=True))
                for column in (loop.rate_input, loop.drive_input)
            ]
            inputs = [loop.noise_input, held[0], loop.plant.gain * np.asarray(held[1])]
            columns.append(np.array([b * padded(np.asarray(column)) for b, column in zip(bound, inputs, strict=True)]))
        self._inputs = np.array(columns).transpose(0, 2, 1)
        units = np.eye(size)
        error = plant_size + model_size
        self._rows = np.array([[units[0], units[1], row, units[error]] for row in self._feedback])
        self._reach = self._looked_ahead()

    def _looked_ahead(self) -> FloatArray:
        """Return (P, n, m) what inputs some periods before do, at the smallest gain and with new poses."""
        matrix = self._free[0] + self._gains[0] * self._command[0][..., np.newaxis] * self._feedback[:, np.newaxis]
        answer, found = self._inputs, []
        for period in range(_LOOK[-1] + 1):
            if period in _LOOK:
                found.append(answer)
            answer = matrix @ answer
        return np.concatenate(found, axis=2)

    def plan(
        self, plants: np.ndarray, signals: np.ndarray, gains: FloatArray, ages: np.ndarray, greedy: np.ndarray
    ) -> Schedule:
        """Return what lifts a signal of each drone most after T periods.

        Args:
            plants: (N,) of the drones.
            signals: (N,) which, numbers of `SIGNALS`.
            gains: (T, N) given.
            ages: (T, N) given.
            greedy: (N,) whose gains and ages are chosen here; the gain of the first period is given to all.
        """
        every = np.arange(len(plants))
        free, command = self._free[:, plants], self._command[:, plants]
        feedback, inputs, reach = self._feedback[plants], self._inputs[plants], self._reach[plants]
        ahead = (feedback[:, np.newaxis] @ reach)[:, 0]
        row = self._rows[plants, signals]
        gains, ages, signs = gains.copy(), ages.copy(), np.empty((*gains.shape, inputs.shape[2]))
        ends = np.array(self._gains)[:, np.newaxis]
        choosing = np.count_nonzero(greedy) > 0
        for period in range(len(gains) - 1, -1, -1):
            signs[period] = np.sign((row[:, np.newaxis] @ inputs)[:, 0])
            passed = (row[:, np.newaxis] @ free)[:, :, 0]  # (2, N, n), by age
            kick = (row * command).sum(axis=2)  # (2, N)
            if choosing:
                seen = (passed[:, :, np.newaxis] @ reach)[:, :, 0]
                sizes = np.array(
                    [np.abs(seen + gain * kick[..., np.newaxis] * ahead).sum(axis=2) for gain in self._gains]
                )  # gain, age, drone
                best = sizes.reshape(4, -1).argmax(axis=0)
                ages[period] = np.where(greedy, best % 2, ages[period])
                if period:
                    gains[period] = np.where(greedy, ends[best // 2, 0], gains[period])
            age = ages[period]
            row = passed[age, every] + (gains[period] * kick[age, every])[:, np.newaxis] * feedback
        return Schedule(gains, ages, signs)


def input_bounds(axis: Axis, plant: Plant, assumptions: Assumptions) -> tuple[float, float, float]:
    """Return the largest noise, m, rate, m/s^3, and drive, m/s^2, of one plant."""
    model, period = axis.design.model, axis.design.period
    rate, drive = assumptions.rate(model, plant, plant), assumptions.drive(model, period, plant, plant)
    return assumptions.noise, rate, drive


def exact_bound(
    axis: Axis, plant: Plant, gain: float, assumptions: Assumptions, age: float, model_drive: bool, periods: int = 1500
) -> FloatArray:
    """Return the largest values (4,) of `SIGNALS` at ticks that inputs can reach on one plant, at a gain that rests.

    Args:
        axis: its controller.
        plant: which.
        gain: applied.
        assumptions: bounds of the inputs.
        age: of all poses, s.
        model_drive: with what the controller's own model makes of references, which no disturbance can imitate.
        periods: that are summed up.
    """
    loop = FlightLoop(axis.design, plant, age)
    inputs = entering(axis, plant, loop, assumptions, model_drive)
    units = np.eye(loop.size)
    rows = np.array([units[0], units[1], loop.feedback, units[plant.size + axis.design.model.size]])
    matrix, total = loop.matrix(gain), np.zeros(4)
    for _ in range(periods):
        total += np.abs(rows @ inputs).sum(axis=1)
        rows = rows @ matrix
    return total


def entering(axis: Axis, plant: Plant, loop: FlightLoop, assumptions: Assumptions, model_drive: bool) -> FloatArray:
    """Return the columns (n, m) by which the largest inputs of a period enter z; those of one piece have one sign.

    Args:
        axis: its controller.
        plant: which.
        loop: of both.
        assumptions: bounds of the inputs.
        model_drive: as for `exact_bound`.
    """
    h, model = loop.design.period, axis.design.model
    noise, rate, drive = input_bounds(axis, plant, assumptions)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    half, columns = h / _PIECES / 2.0, [noise * loop.noise_input]
    given = [(rate, loop.rate_input), (plant.gain * drive, loop.drive_input)]
    if model_drive:
        given.append((assumptions.drive(model, h, model, model), loop.model_drive_input))
    for bound, column in given:
        for middle in half * (2.0 * np.arange(_PIECES) + 1.0):
            held = sum(half * w * column(middle + half * x) for x, w in zip(nodes, weights, strict=True))
            columns.append(bound * np.asarray(held))
    return np.array(columns).T
