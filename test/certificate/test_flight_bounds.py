"""What separates plants of second order from the middle of their cell: its bound against what it really becomes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from flatsat_ros.certificate.enclosures import decimal
from flatsat_ros.certificate.flight_bounds import Drives
from flatsat_ros.certificate.flight_cell import Cell, PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant, PlantEquation, pieces
from flatsat_ros.certificate.flight_tube import cell_bounds
from flatsat_ros.falsification.worst_gains import extreme_plants

# Within so short a period signals hardly move: what is added for all times between the nodes is a hundredth.
PERIOD, GAIN, NOISE = 0.004, 1.2, 1e-3
DESIGN = Design.predicting(
    PERIOD, Plant(0.01, frequency=16.0, damping=0.6, tilt=-0.26, drag=0.41), (0.1, 1.2, 3.0), 35.0, 15.0
)
LOW = Plant(0.0105, frequency=15.0, damping=0.55, gain=0.9, tilt=-0.3, drag=0.4)


def separated(plant: Plant, cell: Cell) -> float:
    """Return how large noise makes the last row of x' on a plant differ from that of the middle, on the same x and c.

    It is looked for at four times of a period, of which one is that when the command changes.
    """
    loop, middle = FlightLoop(DESIGN, plant), PlantEquation([float(q) for q in cell.parameters], float(cell.drag))
    h, delay, gain = decimal(PERIOD), decimal(plant.delay), float(cell.parameters[1] / cell.parameters[0])
    command, rows = loop.compensation + GAIN * loop.feedback, []
    older, younger = pieces(delay, h, h)
    for time in (Fraction(0), older[1] / 2, older[1], (older[1] + h) / 2):
        state = loop.driven(loop.body, loop.gain, 0, pieces(delay, h, time))
        acting = loop.commands[older[0] if time < older[1] else younger[0]]
        own, other = ((A[-1], B[-1]) for A, B, _ in (loop.body.system, middle.system))
        row = (own[0] - other[0]) @ state + (plant.gain * own[1] - gain * other[1]) * acting
        rows.append(row[:-1] + row[-1] * command)
    answer, step, total = NOISE * loop.noise_input, loop.matrix(GAIN), np.zeros(len(rows))
    for _ in range(1000):
        total += np.abs(rows @ answer)
        answer = step @ answer
    return float(total.max())


@pytest.mark.parametrize("seed", range(4))
def test_what_separates_plants_is_bounded_by_what_it_becomes_at_the_worst_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    spread = dict(zip(("frequency", "damping", "gain", "tilt"), 10 ** random.uniform(-5, -4, 4), strict=True))
    widths = {"frequency": 15.0, "damping": 1.0, "gain": 1.0, "tilt": 10.0}
    high = {name: getattr(LOW, name) + widths[name] * share for name, share in spread.items()}
    box = PlantBox(LOW, replace(LOW, **high))
    cell, plants = Cell(box), extreme_plants(box)
    for _ in range(4):
        plants.append(replace(LOW, **{name: float(random.uniform(getattr(LOW, name), high[name])) for name in high}))
    worst = max(separated(plant, cell) for plant in plants)

    _, bounds = next(cell_bounds(DESIGN, [box], GAIN, GAIN, 0.0, False))
    noise, none = bounds.amplitudes(0.0, noise=NOISE), np.zeros(1)
    still, effect = Drives(none, none, 0.0, 0.0), bounds.sums @ bounds.amplitudes(1.0)[0]
    own, at_vertices, _ = bounds.answered(noise)
    # of so small a cell the small gains are one step: what is above the own answer is that to what separates alone,
    # by plain sums, and with noise as an input that is not followed to first order, by what is left to these
    plain, _ = bounds.settled(own, np.full_like(at_vertices, np.inf), 0.0 * noise, still)
    left, _ = bounds.settled(3.0 * own, np.zeros_like(at_vertices), noise, still)
    for found in (plain, left):
        bound = (found[0] - own[0, :4]) / effect[0, :4]
        assert (worst <= bound).all()
        assert (bound <= 1.03 * worst).all()
