"""Boxes of plants in cells: nothing is left out, and the tube is near that of the worst corner."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions, box_tube, cell_tubes
from flatsat_ros.synthesis.flight_cover import Cover, CoverError, cover, extreme_boxes
from flatsat_ros.synthesis.flight_design import AxisDesign
from flatsat_ros.synthesis.flight_trade import narrower

DESIGN = Design.predicting(0.02, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 42.8, 23.6)
BOX = PlantBox(Plant(0.024, 0.14 * 0.9), Plant(0.036, 0.14 * 1.1))
LARGE = PlantBox(Plant(0.024, 0.14 * 0.7), Plant(0.036, 0.14 * 1.3))
ACROSS = PlantBox(Plant(0.018, 0.14), Plant(0.022, 0.14))  # delays with a whole period between them
STILL = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66)


@pytest.fixture(scope="module")
def covered() -> Cover:
    return cover(DESIGN, BOX, 1.0, 1.5, STILL, excess=0.1)


def test_the_tube_is_near_that_of_the_worst_corner(covered: Cover) -> None:
    assert covered.corners.position <= covered.tube.position <= 1.1 * covered.corners.position


def test_every_plant_of_the_box_has_a_smaller_tube(covered: Cover) -> None:
    random = np.random.default_rng(0)
    for _ in range(12):
        plant = Plant(random.uniform(0.024, 0.036), 0.14 * random.uniform(0.9, 1.1))
        (own,) = cell_tubes(DESIGN, [PlantBox(plant, plant)], 1.0, 1.5, STILL)
        assert own | covered.tube == covered.tube


def test_the_cuts_are_all_that_the_proof_needs(covered: Cover) -> None:
    assert box_tube(DESIGN, BOX, covered.cuts, 1.0, 1.5, STILL) == covered.tube
    assert len(covered.cuts) == 2 * covered.cuts.count("") - 1


def test_a_delay_is_cut_where_a_period_is_whole() -> None:
    across = cover(DESIGN, ACROSS, 1.0, 1.5, STILL, excess=0.1)
    assert across.cuts[0] == "delay"
    assert ACROSS.halves("delay", 0.02)[0].high.delay == 0.02


def test_corners() -> None:
    plants = [Plant(d, lag) for d in (0.024, 0.036) for lag in (0.14 * 0.9, 0.14 * 1.1)]
    assert extreme_boxes(BOX) == [PlantBox(plant, plant) for plant in plants]
    assert extreme_boxes(BOX, lag_varies=True) == [PlantBox(plants[i], plants[i + 1]) for i in (0, 2)]


@pytest.mark.parametrize(
    ("cuts", "text"),
    [
        (("lag", ""), "number of cuts = 2: must be more, 1 parts are left"),
        (("lag", "", "", ""), "number of cuts = 4: must be no more than there are parts"),
        (("gain", "", ""), "a cut = 'gain': must be one of delay, lag, the figures"),
        ((), "number of cuts = 0: must be more, 1 parts are left"),
    ],
)
def test_cuts_that_leave_something_out_are_refused(cuts: tuple[str, ...], text: str) -> None:
    with pytest.raises(FlatsatError) as refused:
        box_tube(DESIGN, BOX, cuts, 1.0, 1.0, STILL)
    assert text in str(refused.value)


def test_what_cannot_be_covered_is_refused() -> None:
    with pytest.raises(FlatsatError, match="tube of a corner of the box = inf m: must be bounded"):
        cover(DESIGN, PlantBox(Plant(0.03, 0.04), Plant(0.03, 0.5)), 1.0, 3.0, STILL)
    with pytest.raises(CoverError, match="cells = more than 2: must be fewer") as refused:
        cover(DESIGN, LARGE, 1.0, 1.5, STILL, cells_max=2)
    assert (refused.value.box, refused.value.figure) == (LARGE, "delay")


@pytest.mark.parametrize("cells", [1, 2, 5])
def test_few_cells_are_where_they_matter(covered: Cover, cells: int) -> None:
    coarse = cover(DESIGN, BOX, 1.0, 1.5, STILL, excess=0.1, cells_max=cells)
    assert coarse.cuts.count("") == cells
    assert covered.tube.position < coarse.tube.position < math.inf
    assert box_tube(DESIGN, BOX, coarse.cuts, 1.0, 1.5, STILL) == coarse.tube


def test_narrower_intervals_are_named_of_which_there_is_a_proof() -> None:
    known = narrower(AxisDesign(LARGE, False, DESIGN, 0.1), "lag", 1.0, 1.5, STILL, cells_max=2)
    low, high = known["lag"]
    assert 0.14 * 0.7 < low < high < 0.14 * 1.3
    assert low + high == pytest.approx(0.28)
    box = PlantBox(
        *(
            replace(plant, **{name: ends[i] for name, ends in known.items()})
            for i, plant in enumerate((LARGE.low, LARGE.high))
        )
    )
    assert cover(DESIGN, box, 1.0, 1.5, STILL, excess=0.1, cells_max=2).tube.position < math.inf


def test_a_lag_that_changes_in_flight_has_a_larger_tube_and_is_never_cut() -> None:
    box = PlantBox(Plant(0.03, 0.125, gain=0.97), Plant(0.03, 0.135, gain=1.03))
    steady = cover(DESIGN, box, 1.0, 1.2, STILL)
    varying = cover(DESIGN, box, 1.0, 1.2, STILL, lag_varies=True, excess=0.01)
    assert steady.tube.position < varying.tube.position <= 1.6 * steady.tube.position
    assert set(varying.cuts) == {"gain", ""}
    with pytest.raises(FlatsatError, match="a cut = 'lag': must be one of gain, the figures"):
        box_tube(DESIGN, box, ("lag", "", ""), 1.0, 1.2, STILL, lag_varies=True)
