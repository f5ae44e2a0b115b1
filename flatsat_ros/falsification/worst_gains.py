"""The worst plant of a flight certificate, and gains and ages of poses that are as bad as a search finds them.

For a known sequence of gains and ages the largest value of a signal is exact, a sum of absolute answers. As a function
of one gain it is convex, so that ends of the interval are worst. The search goes backward from the tick at which the
signal is wanted and keeps the sequences with which it would be largest if one gain and one age were held before.
"""

from __future__ import annotations

import itertools
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.falsification.worst_inputs import entering, exact_bound

# Sequences that are kept, periods that are searched, and periods before in which one gain and one age are held.
_WIDTH, _DEPTH, _BEFORE = 100, 60, 400

# Sequences whose values differ by less, relatively, are taken for one.
_SAME = 1e-9


class WorstGains(NamedTuple):
    """How large the distance to the reference can become on one plant.

    Attributes:
        plant: at the corner of the box where gains that rest do most.
        resting: m, the most at the smallest gain, with poses of one age.
        any: m, the most found with gains and ages that change, at least nearly `resting`.
        gains: applied, from the last period back, that do it.
    """

    plant: Plant
    resting: float
    any: float
    gains: tuple[float, ...]


def worst_gains(flight: FlightSection, axis: Axis, gain_max: float) -> WorstGains:
    """Return what gains can do to the axes that share a loop.

    Args:
        flight: the section.
        axis: of it.
        gain_max: largest applied gain.
    """
    age = min(flight.pose_age, axis.design.period)

    def resting(plant: Plant) -> float:
        held = (exact_bound(axis, plant, flight.gain_min, flight.assumptions, a, True, _BEFORE) for a in (0.0, age))
        return max(float(bound[0]) for bound in held)

    bounds = {plant: resting(plant) for plant in extreme_plants(axis.box)}
    worst = max(bounds, key=lambda plant: bounds[plant])
    most, gains = _search(flight, axis, worst, gain_max, age)
    return WorstGains(worst, bounds[worst], most, gains)


def extreme_plants(box: PlantBox) -> list[Plant]:
    """Return the plants all of whose figures are at an end of their intervals."""
    ends = [sorted({getattr(box.low, f.name), getattr(box.high, f.name)}) for f in fields(Plant)]
    return [Plant(*figures) for figures in itertools.product(*ends)]


def _search(
    flight: FlightSection, axis: Axis, plant: Plant, gain_max: float, age: float
) -> tuple[float, tuple[float, ...]]:
    loops, ends = [FlightLoop(axis.design, plant, a) for a in (0.0, age)], (flight.gain_min, gain_max)
    steps = np.array([loop.matrix(gain) for loop in loops for gain in ends])
    inputs = entering(axis, plant, loops[0], flight.assumptions, True)
    held = []
    for step in steps:
        answers = [inputs]
        for _ in range(_BEFORE):
            answers.append(step @ answers[-1])
        held.append(np.concatenate(answers, axis=1))

    def before(rows: FloatArray) -> FloatArray:
        """What inputs do at most in all periods before, if one gain and one age are held."""
        return np.asarray(np.max([np.abs(rows @ answer).sum(axis=1) for answer in held], axis=0))

    rows, done = np.eye(1, loops[0].size), np.zeros(1)
    sequences: list[tuple[float, ...]] = [()]
    most, best = float(before(rows)[0]), sequences[0]
    for _ in range(_DEPTH):
        done = np.repeat(done + np.abs(rows @ inputs).sum(axis=1), len(steps))
        rows = np.einsum("si,kij->skj", rows, steps).reshape(len(done), -1)
        values = done + before(rows)
        order = np.argsort(-values)
        kept = values[order]
        fresh = np.concatenate([[True], kept[:-1] - kept[1:] > _SAME * kept[1:]])
        chosen = order[fresh][:_WIDTH]
        sequences = [(*sequences[number // len(steps)], ends[number % 2]) for number in chosen.tolist()]
        rows, done = rows[chosen], done[chosen]
        if values[chosen[0]] > most:
            most, best = float(values[chosen[0]]), sequences[0]
    return most, best
