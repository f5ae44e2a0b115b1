"""The way back into the tube: starts of random plants and gains decay as is claimed, and one as slowly as that."""

from __future__ import annotations

import math
from dataclasses import astuple
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
import pytest

from flatsat_ros.certificate import flight_return
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_return import Return, box_claims, cell_claims
from flatsat_ros.certificate.flight_tube import Assumptions, box_tube, cells

PERIOD, RATE = 0.02, 0.6
DESIGN = Design.predicting(PERIOD, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 20.0, 12.0)
BOX = PlantBox(Plant(0.028, 0.136, gain=0.98), Plant(0.032, 0.144, gain=1.02))
CUTS = ("delay", "lag", "", "", "lag", "", "")
STILL = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=1.0, jerk=0.58, snap=0.66)


def decayed(plant: Plant, gains: np.ndarray, entry: int) -> np.ndarray:
    """Return the largest e^(rate t) |e|, and |v0| and |D/g - d^| together, at ticks after a start of 1 in e or e'."""
    loop = FlightLoop(DESIGN, plant)
    z, largest = np.zeros(loop.size), np.zeros(3)
    z[[entry, plant.size + entry]] = 1.0
    for j, gain in enumerate(gains.tolist()):
        seen = np.abs([z[0], loop.feedback @ z, loop.compensation @ z])
        largest = np.maximum(largest, math.exp(RATE * j * PERIOD) * seen)
        z = loop.matrix(gain) @ z
    return np.array([largest[0], largest[1] + largest[2]])


@pytest.fixture(scope="module")
def returned() -> Return:
    tube, back = box_claims(DESIGN, BOX, CUTS, 1.0, 1.5, RATE, STILL)
    assert astuple(tube) == pytest.approx(astuple(box_tube(DESIGN, BOX, CUTS, 1.0, 1.5, STILL)), rel=1e-12)
    return back


def test_it_is_the_largest_of_all_cells_although_most_are_bounded_coarsely(monkeypatch: pytest.MonkeyPatch) -> None:
    box = PlantBox(Plant(0.022, 0.11, gain=0.98), Plant(0.038, 0.17, gain=1.02))
    cuts: tuple[str, ...] = ("",)
    for name in ("delay", "lag", "delay", "lag"):
        cuts = (name, *cuts, *cuts)
    parts = cells(box, cuts, PERIOD, False)
    alone = cell_claims(DESIGN, parts, 1.0, 1.2, RATE, STILL)
    largest = reduce(or_, (tube for tube, _ in alone)), reduce(or_, (back for _, back in alone))
    coarse = cell_claims(DESIGN, parts, 1.0, 1.2, RATE, STILL, coarse=True)
    for above, below in zip(coarse, alone, strict=True):
        for more, less in zip(above, below, strict=True):
            assert (np.array(astuple(more)) >= astuple(less)).all()
    closely: list[int] = []

    def counted(*args: Any, **named: Any) -> Any:
        if not args[-1]:
            closely.append(len(args[1]))
        return cell_claims(*args, **named)

    monkeypatch.setattr(flight_return, "cell_claims", counted)
    for near in (1.001, 1.03, 2.0):  # however many are bounded closely at first
        monkeypatch.setattr(flight_return, "_NEAR", near)
        found = box_claims(DESIGN, box, cuts, 1.0, 1.2, RATE, STILL)
        for whole, most in zip(found, largest, strict=True):
            assert astuple(whole) == pytest.approx(astuple(most), rel=1e-10)
        assert 0 < sum(closely) <= len(parts)
        if near == 1.03:
            assert sum(closely) <= len(parts) / 2
        closely.clear()
    monkeypatch.setattr(flight_return, "_LONG", PERIOD / 2.0)  # loops of longer periods are bounded closely at once
    box_claims(DESIGN, box, cuts, 1.0, 1.2, RATE, STILL)
    assert closely == [len(parts)]


def test_starts_decay_as_is_claimed(returned: Return) -> None:
    random = np.random.default_rng(5)
    claims = np.array([[returned.position, returned.nominal], [returned.position_velocity, returned.nominal_velocity]])
    for number in range(20):
        ends = random.integers(2, size=3) if number % 2 else random.uniform(size=3)
        plant = Plant(0.028 + 0.004 * ends[0], 0.136 + 0.008 * ends[1], gain=0.98 + 0.04 * ends[2])
        gains = random.choice([1.0, 1.5], 200) if number % 3 else np.full(200, 1.0)
        for entry in (0, 1):
            assert (decayed(plant, gains, entry) <= claims[entry]).all()


def test_for_one_plant_and_one_gain_it_is_what_happens() -> None:
    plant = Plant(0.031, 0.142, gain=0.99)
    _, found = cell_claims(DESIGN, [PlantBox(plant, plant)], 1.2, 1.2, RATE, STILL)[0]
    for entry, claims in enumerate(
        ((found.position, found.nominal), (found.position_velocity, found.nominal_velocity))
    ):
        position, nominal = decayed(plant, np.full(600, 1.2), entry)
        assert nominal <= claims[1] <= nominal * 1.001
        assert position <= claims[0] <= position * math.exp(RATE * PERIOD) * 1.01


def test_faster_returns_are_less_certain_and_none_is_faster_than_the_loop(returned: Return) -> None:
    _, slower = box_claims(DESIGN, BOX, CUTS, 1.0, 1.5, 0.2, STILL)
    assert slower.nominal < returned.nominal
    assert slower.position < returned.position
    tube, none = box_claims(DESIGN, BOX, CUTS, 1.0, 1.5, 60.0, STILL)
    assert none == Return(60.0, *[math.inf] * 4)
    assert astuple(tube) == pytest.approx(astuple(box_tube(DESIGN, BOX, CUTS, 1.0, 1.5, STILL)), rel=1e-12)
