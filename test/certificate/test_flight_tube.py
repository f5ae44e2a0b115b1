"""The tube: proved bounds against adversaries that know the loop, and against the exact bound where there is one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.enclosures import decimal
from flatsat_ros.certificate.flight_batch import Cells
from flatsat_ros.certificate.flight_cell import Cell, PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant, PlantEquation
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube, cell_bounds, cell_tubes

PERIOD = 0.02
STILL = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=1.0, jerk=0.58, snap=0.66)
FIRST = Design.predicting(PERIOD, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 42.8, 23.6)
SECOND = Design.predicting(
    PERIOD, Plant(0.04, frequency=16.0, damping=0.55, tilt=0.26, drag=0.4), (0.3, 2.6, 7.0), 20.0, 10.0
)
DESIGNS = {"first": FIRST, "second": SECOND}
BOXES = {
    "first": PlantBox(Plant(0.029, 0.136, gain=0.98), Plant(0.031, 0.14, gain=1.0, drag=0.05)),
    "second": PlantBox(
        Plant(0.0405, frequency=15.8, damping=0.545, gain=0.99, tilt=0.255, drag=0.38),
        Plant(0.0415, frequency=16.0, damping=0.55, gain=1.0, tilt=0.26, drag=0.4),
    ),
}


def cell_tube(design: Design, box: PlantBox, *arguments: Any, **named: Any) -> AxisTube:
    (tube,) = cell_tubes(design, [box], *arguments, **named)
    return tube


def some_plant(box: PlantBox, random: np.random.Generator, corner: bool) -> Plant:
    figures = {}
    for name in ("delay", "lag", "frequency", "damping", "gain", "tilt", "drag"):
        low, high = getattr(box.low, name), getattr(box.high, name)
        share = float(random.integers(2)) if corner else float(random.uniform())
        figures[name] = low + share * (high - low)
    return Plant(**figures)


def attacked(design: Design, plant: Plant, assumptions: Assumptions, gains: np.ndarray) -> np.ndarray:
    """Return the largest |e| and |v0| that inputs of the worst signs reach at the end of a sequence of gains.

    Rate and drive are constant on quarters of a period; these are some of the functions of time that they may be.
    """
    loop, model = FlightLoop(design, plant), design.model
    times = PERIOD * (np.arange(4) + 0.5) / 4.0
    nodes, weights = np.polynomial.legendre.leggauss(3)
    quarter, inputs = PERIOD / 8.0, [assumptions.noise * loop.noise_input]
    for column, bound in (
        (loop.rate_input, assumptions.rate(model, plant, plant)),
        (loop.drive_input, plant.gain * assumptions.drive(model, PERIOD, plant, plant)),
        (loop.model_drive_input, assumptions.drive(model, PERIOD, model, model)),
    ):
        for t in times:
            held = sum(w * quarter * column(t + quarter * x) for x, w in zip(nodes, weights, strict=True))
            inputs.append(bound * np.asarray(held))
    for body in (plant, model):
        inputs.append(assumptions.ripple(model) * rippled(loop, body is model, 0.0))  # where it begins is not used
    columns = np.array(inputs).T
    rows, reached = np.array([np.eye(loop.size)[0], loop.feedback]), np.zeros(2)
    steps = {gain: loop.matrix(gain) for gain in set(gains.tolist())}
    for gain in gains[::-1].tolist():
        reached += np.abs(rows @ columns).sum(axis=1)
        rows = rows @ steps[gain]
    return reached


def rippled(loop: FlightLoop, model: bool, begin: float) -> np.ndarray:
    """Return the column of what a held command lacks and then exceeds, per m/s^3, where it begins within the period."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    column, answer = loop.model_drive_input if model else loop.drive_input, np.zeros(loop.size)
    for start, end, first in ((0.0, begin, begin - PERIOD), (begin, PERIOD, begin)):
        for node, weight in zip(nodes, weights, strict=True):
            at = (start + end + node * (end - start)) / 2.0
            answer += weight * (end - start) / 2.0 * (at - first - PERIOD / 2.0) * column(PERIOD - at)
    return answer if model else loop.plant.gain * answer


@pytest.mark.parametrize("order", DESIGNS)
@pytest.mark.parametrize("gain_max", [1.0, 1.5])
def test_no_attack_leaves_the_tube(order: str, gain_max: float) -> None:
    design, box, random = DESIGNS[order], BOXES[order], np.random.default_rng(1)
    tube, reached = cell_tube(design, box, 1.0, gain_max, STILL), np.zeros(2)
    for number in range(24):
        plant = some_plant(box, random, corner=number < 20)
        held = np.full(500, [1.0, gain_max][number % 2])
        gains = random.choice([1.0, gain_max], 500) if number % 4 == 3 else held
        reached = np.maximum(reached, attacked(design, plant, STILL, gains))
    bounds = np.array([tube.position, tube.nominal])
    assert (reached <= bounds).all()
    assert (reached >= (0.9 if gain_max == 1.0 else 0.7) * bounds).all()


@pytest.mark.parametrize("order", DESIGNS)
def test_for_one_plant_and_one_gain_the_tube_is_what_an_attack_reaches(order: str) -> None:
    design, plant = DESIGNS[order], some_plant(BOXES[order], np.random.default_rng(2), corner=False)
    tube = cell_tube(design, PlantBox(plant, plant), 1.2, 1.2, STILL)
    position, nominal = attacked(design, plant, STILL, np.full(1500, 1.2))
    assert position <= tube.position <= 1.02 * position  # what is between the ticks is more, too
    assert nominal <= tube.nominal <= 1.02 * nominal  # of held commands the second order is bounded coarsely


@pytest.mark.parametrize("order", DESIGNS)
def test_commands_that_are_held_while_the_reference_moves_on_do_little(order: str) -> None:
    design, plant = DESIGNS[order], some_plant(BOXES[order], np.random.default_rng(3), corner=False)
    loop = FlightLoop(design, plant)
    _, bounds = next(cell_bounds(design, [PlantBox(plant, plant)], 1.0, 1.0, 0.0, False))
    port = plant.system[1][-1] * plant.gain
    half = PERIOD / 2.0
    for model, held, plain in (
        (False, bounds.held(np.array([port]), 0.0), bounds.amplitudes(port * half)),
        (True, bounds.held(np.zeros(1), 1.0), bounds.amplitudes(0.0, model_drive=half)),
    ):
        worst = np.zeros(4)
        for begin in np.linspace(0.0, PERIOD, 5)[:-1]:  # of what is held, within the period
            answer, total, rows = rippled(loop, model, begin), np.zeros(4), np.zeros((4, loop.size))
            rows[0, 0] = rows[1, 1] = rows[3, plant.size + design.model.size] = 1.0
            rows[2] = loop.feedback
            for _ in range(1500):
                total += np.abs(rows @ answer)
                answer = loop.matrix(1.0) @ answer
            worst = np.maximum(worst, total)
        claimed = bounds.sums[0, :4] @ held[0]
        assert (worst <= claimed).all()
        assert (claimed <= 0.1 * (bounds.sums[0, :4] @ plain[0])).all()  # of inputs that have no mean of 0


@pytest.mark.parametrize("order", DESIGNS)
def test_no_attack_leaves_the_tube_with_poses_of_any_age(order: str) -> None:
    design, box, random = DESIGNS[order], BOXES[order], np.random.default_rng(4)
    assumptions = replace(STILL, noise=2e-3, pose_age=0.006)
    tube, reached = cell_tube(design, box, 1.0, 1.0, assumptions), np.zeros(2)
    assert tube.nominal > 1.05 * cell_tube(design, box, 1.0, 1.0, replace(assumptions, pose_age=0.0)).nominal
    for number in range(12):
        plant = some_plant(box, random, corner=True)
        loops = [FlightLoop(design, plant, age) for age in (0.0, 0.006)]
        rate = assumptions.rate(design.model, plant, plant) * PERIOD
        # D' as an impulse where the period begins, and what a pose of that age says of it
        columns = []
        for loop in loops:
            pushed = np.eye(loop.size)[: plant.size].T @ plant.hold(PERIOD)[2]
            pushed[2] += 1.0
            pushed += loop.noise_input * plant.hold(PERIOD - loop.pose_age)[2][0]
            inputs = [rate * (pushed + loop.share_input / plant.gain), assumptions.noise * loop.noise_input]
            columns.append(np.array(inputs).T)
        rows, total = np.array([np.eye(loops[0].size)[0], loops[0].feedback]), np.zeros(2)
        period = int(random.integers(2, 30))
        for tick in range(500):
            age = (tick // period) % 2 if number % 2 else int(random.integers(2))
            total += np.abs(rows @ columns[age]).sum(axis=1)
            rows = rows @ loops[age].matrix(1.0)
        reached = np.maximum(reached, total)
    assert (reached <= [tube.position, tube.nominal]).all()
    assert reached[1] >= 0.65 * tube.nominal


def test_no_attack_leaves_the_tube_while_the_lag_changes() -> None:
    box, random = BOXES["first"], np.random.default_rng(3)
    tube = cell_tube(FIRST, box, 1.0, 1.5, STILL, lag_varies=True)
    assert tube.position > cell_tube(FIRST, box, 1.0, 1.5, STILL).position
    # rising thrust lags more than falling one, say: the lag is another in every period
    loops = [FlightLoop(FIRST, Plant(0.03, lag, gain=0.99)) for lag in (box.low.lag, box.high.lag)]
    steps = [loop.matrix(gain) for loop in loops for gain in (1.0, 1.5)]
    rate = STILL.rate(FIRST.model, loops[0].plant, loops[0].plant) * PERIOD * loops[0].rate_input(PERIOD / 2.0)
    columns = np.array([rate, STILL.noise * loops[0].noise_input]).T
    for _ in range(10):
        rows, reached = np.array([np.eye(loops[0].size)[0], loops[0].feedback]), np.zeros(2)
        for choice in random.integers(4, size=500):
            reached += np.abs(rows @ columns).sum(axis=1)
            rows = rows @ steps[choice]
        assert reached[0] <= tube.position
        assert reached[1] <= tube.nominal


# a corner of what is known of an identified drone, and a controller for all of that
IDENTIFIED = Design.predicting(
    PERIOD, Plant(0.03353, frequency=15.64, damping=0.6404, tilt=-0.26, drag=0.41), (0.3396, 3.505, 10.08), 37.79, 18.96
)
CORNER = PlantBox(
    Plant(0.0488, frequency=12.5, damping=0.5904, gain=0.7921, tilt=-0.26, drag=0.41),
    Plant(0.05, frequency=12.83, damping=0.6, gain=0.8019, tilt=-0.26, drag=0.41),
)


def test_what_separates_plants_of_the_second_order_is_bounded_by_direction() -> None:
    assumptions, reached = replace(STILL, acceleration=0.4), np.zeros(2)
    exact = cell_tube(IDENTIFIED, PlantBox(*[replace(CORNER.low, delay=0.05, damping=0.6)] * 2), 1.0, 1.5, assumptions)
    tube = cell_tube(IDENTIFIED, CORNER, 1.0, 1.5, assumptions)
    assert exact.position <= tube.position <= 1.1 * exact.position  # by its parts it is 1.15
    random = np.random.default_rng(5)
    for number in range(16):
        plant = some_plant(CORNER, random, corner=number < 12)
        for gain in (1.0, 1.5):
            reached = np.maximum(reached, attacked(IDENTIFIED, plant, assumptions, np.full(500, gain)))
    assert (reached <= [tube.position, tube.nominal]).all()


LEANING = PlantBox(replace(BOXES["second"].low, tilt=-0.3), replace(BOXES["second"].high, frequency=17.0, tilt=-0.05))


@given(seed=st.integers(0, 2**32 - 1), box=st.sampled_from([*BOXES.values(), LEANING]), corner=st.booleans())
@settings(max_examples=20)
def test_every_plant_of_a_box_is_between_the_vertices_of_its_cell(seed: int, box: PlantBox, corner: bool) -> None:
    random = np.random.default_rng(seed)
    cell, plant = Cell(box), some_plant(box, random, corner)
    if corner and plant.frequency > 0.0:  # between corners that differ in the frequency alone there is a curve
        plant = replace(plant, frequency=float(random.uniform(box.low.frequency, box.high.frequency)))
    gain = float(cell.parameters[1] / cell.parameters[0])
    p = np.array(plant.parameters) - np.array(cell.parameters)
    p[1] -= p[0] * cell.parameters[1] / cell.parameters[0]
    if len(p) == 4:
        p[3] -= p[0] * cell.parameters[3] / cell.parameters[0]
    point = np.append(p, decimal(plant.delay) - cell.delay).astype(float)
    vertices = np.array(cell.vertices).astype(float)
    scale, count = np.ptp(vertices, axis=0), len(vertices)
    equations = np.vstack([(vertices / scale).T, np.ones(count)])
    shares = linprog(np.zeros(count), A_eq=equations, b_eq=np.append(point / scale, 1.0), bounds=(0.0, 1.0))
    assert shares.status == 0
    assert plant.parameters[1] <= cell.port_gain
    # the plant is the one in the middle with p'F added to its last row
    x, c = random.standard_normal(plant.size), random.standard_normal()
    design = DESIGNS["second" if box.low.frequency > 0.0 else "first"]
    alone = Cells(design, [cell], Fraction(0))
    if cell.directions:
        z = np.concatenate([x, random.standard_normal(alone.loop.size - len(x) + 1)])
        parts = np.concatenate([stretch.nodes.mid[0] for stretch in alone.stretches]) @ z
        directed = np.array(cell.directions).astype(float) @ parts.reshape(-1, len(p)).T
        np.testing.assert_allclose(alone.pulls.mid[0] @ z, directed.T.ravel(), rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(np.unique(vertices[:, :-1], axis=0), np.unique(alone.directions[0], axis=0))
    signals = alone.on_state.mid[0] @ x + alone.on_command.mid[0, :, 0] * c
    middle = PlantEquation([float(q) for q in cell.parameters], float(cell.drag))
    own, other = (body.system[0] @ x + g * body.system[1] * c for body, g in ((plant, plant.gain), (middle, gain)))
    other[1] += (float(cell.drag) - plant.drag) * x[1]
    np.testing.assert_allclose(own, other + np.eye(plant.size)[-1] * (point[:-1] @ signals), rtol=1e-9, atol=1e-9)
    assert abs(decimal(plant.drag) - cell.drag) <= cell.drag_error


@pytest.mark.parametrize("order", DESIGNS)
def test_the_derivatives_of_a_cell_are_those_of_the_step(order: str) -> None:
    cell = Cell(BOXES[order])
    cells, middle = Cells(DESIGNS[order], [cell], Fraction(0)), [float(q) for q in cell.parameters]
    count = len(middle)

    def moved(p: np.ndarray) -> np.ndarray:
        """The step on (z, c_0) of a plant at a distance from the middle."""
        q = np.array(middle) + p[:count]
        q[1] += middle[1] / middle[0] * p[0]
        delay, drag = float(cell.delay) + p[-1], float(cell.drag)
        plant = Plant(delay, 1.0 / q[0], gain=q[1] / q[0], drag=drag)
        if count == 4:
            q[3] += middle[3] / middle[0] * p[0]
            wn = math.sqrt(q[0])
            plant = Plant(delay, 0.0, wn, q[2] / (2.0 * wn), q[1] / q[0], q[3] / q[0], drag)
        loop = FlightLoop(DESIGNS[order], plant)
        return np.column_stack([loop.matrix(0.0) - np.outer(loop.command_input, loop.compensation), loop.command_input])

    for i in range(count + 1):
        p = np.eye(count + 1)[i] * (1e-5 if i < count else 1e-6)
        difference = (moved(p) - moved(-p)) / (2.0 * p[i])
        np.testing.assert_allclose(cells.derivatives.mid[0, i], difference, rtol=1e-5, atol=1e-7)


def within(box: PlantBox, plant: Plant) -> bool:
    return all(low <= getattr(plant, name) <= high for name, (low, high) in box.spread.items())


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_every_plant_of_a_box_is_in_one_of_its_halves(seed: int) -> None:
    random = np.random.default_rng(seed)
    box = PlantBox(Plant(0.015, 0.1, gain=0.9), Plant(0.045, 0.2, gain=1.1))
    plant = some_plant(box, random, corner=False)
    for name in random.choice(sorted(box.spread), 6):
        inside = [half for half in box.halves(str(name), PERIOD) if within(half, plant)]
        assert inside
        box = inside[0]
    while not box.within_periods(PERIOD):
        box = box.halves("delay", PERIOD)[1]


def test_larger_boxes_gain_intervals_and_inputs_have_larger_tubes() -> None:
    box = BOXES["first"]
    half = box.halves("lag", PERIOD)[0]
    small = cell_tube(FIRST, half, 1.0, 1.2, STILL)
    for larger in (
        cell_tube(FIRST, box, 1.0, 1.2, STILL),
        cell_tube(FIRST, half, 1.0, 1.5, STILL),
        cell_tube(FIRST, half, 1.0, 1.2, Assumptions(0.5, 1e-3, 1.0, 0.58, 0.66)),
    ):
        assert small | larger == larger


def test_what_has_no_bound_is_infinite() -> None:
    plant, none = Plant(0.03, 0.14), AxisTube(math.inf, math.inf, math.inf, math.inf)
    unstable = Design.predicting(PERIOD, plant, (0.357, 3.93, 14.2), 42.8, 120.0)  # beyond 2 / (K2 h)
    assert cell_tube(unstable, PlantBox(plant, plant), 1.0, 1.0, STILL) == none
    wide = PlantBox(Plant(0.021, 0.05, gain=0.5), Plant(0.039, 0.3, gain=1.5))
    assert cell_tube(FIRST, wide, 1.0, 1.5, STILL) == none


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: PlantBox(Plant(0.03, 0.2), Plant(0.03, 0.1)), "low lag = 0.2: must be at most the high one, 0.1"),
        (lambda: PlantBox(Plant(0.03), Plant(0.03)), "size of a plant's state = 2: must be 3 or 4"),
        (
            lambda: PlantBox(Plant(0.03, 0.1, drag=0.2), Plant(0.03, 0.1, drag=0.1)),
            "low drag = 0.2: must be at most the high one, 0.1",
        ),
        (
            lambda: cell_tube(FIRST, PlantBox(Plant(0.03, 0.1), Plant(0.05, 0.1)), 1.0, 1.5, STILL),
            "must have no whole period inside",
        ),
        (
            lambda: cell_tube(FIRST, PlantBox(Plant(3e6, 0.1), Plant(3e6, 0.1)), 1.0, 1.5, STILL),
            "delay = 3000000.0 s: must be at most 0.8 s, 40 periods",
        ),
        (
            lambda: cell_tube(replace(FIRST, model=Plant(3e6, 0.14)), BOXES["first"], 1.0, 1.5, STILL),
            "delay = 3000000.0 s: must be at most 0.8 s, 40 periods",
        ),
        (lambda: cell_tube(FIRST, BOXES["first"], 1.5, 1.0, STILL), "gain_min = 1.5: must be above 0 and at most"),
        (lambda: Assumptions(0.35, -1e-3, 1.0, 0.58, 0.66), "noise = -0.001 m: must be a number from 0"),
    ],
)
def test_impossible_boxes_are_refused(build: Callable[[], object], text: str) -> None:
    with pytest.raises(FlatsatError) as refused:
        build()
    assert text in str(refused.value)
