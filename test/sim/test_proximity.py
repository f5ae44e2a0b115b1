"""Ground effect and downwash: the identified figures, their limits, and what they do to drones that fly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.proximity import STILL, Proximity

CF21 = VehicleProfile.load(Path(__file__).parents[2] / "config" / "vehicles" / "cf21.yaml")
GRAM = 9.81e-3  # N
UPPER = 34.0 * GRAM  # N, that a drone of 34 g lifts in a hover


@pytest.mark.parametrize(
    ("distance", "grams"), [(0.2, 10.0), (0.3, 8.0), (0.4, 6.0), (0.5, 4.0), (0.7, 0.0), (0.1, 10.0)]
)
def test_the_downwash_of_one_crazyflie_on_another_is_that_of_the_source(distance: float, grams: float) -> None:
    """Neural-Swarm, figure 3; nearer than 0.2 m as there."""
    where = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0 + distance]])
    push = Proximity().push(where, where, np.full(2, UPPER))
    assert_allclose(push, [grams * GRAM, 0.0], atol=1e-9)


@given(
    drones=st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=1, max_size=5),
    shift=st.tuples(*[st.floats(-5.0, 5.0)] * 3),
)
def test_a_push_is_never_upward_adds_up_and_does_not_ask_where_in_the_room(
    drones: list[tuple[float, float, float]], shift: tuple[float, float, float]
) -> None:
    proximity, where = Proximity(), np.array(drones)
    lift = np.full(len(where), UPPER)
    push = proximity.push(where, where, lift)
    assert (push >= 0.0).all()
    assert push[np.argmax(where[:, 2])] == 0.0, "nobody is above the highest"
    alone = [proximity.push(where, where[k : k + 1], lift[k : k + 1]) for k in range(len(where))]
    assert_allclose(push, np.sum(alone, axis=0), atol=1e-12)
    moved = proximity.push(np.round(where, 6) + shift, np.round(where, 6) + shift, lift)
    assert_allclose(moved, proximity.push(np.round(where, 6), np.round(where, 6), lift), atol=1e-3 * UPPER)


def test_the_ground_effect_is_that_of_the_source_and_fades_with_the_height() -> None:
    """cf2x.urdf: 11.36859 (R / 4 h)^2 of propellers at h, which are 3 cm above the feet; 27 % on the floor."""
    heights = np.array([0.0, 0.07, 0.17, 1.0])
    lift = Proximity().lift(heights)
    assert_allclose(lift, 1.0 + 11.36859 * (0.0231 / (4.0 * np.array([0.0377, 0.1, 0.2, 1.03]))) ** 2)
    assert lift[0] == pytest.approx(1.27, abs=0.005)
    assert (np.diff(lift) < 0.0).all()
    assert (STILL.lift(heights) == 1.0).all()


def test_a_drone_below_another_sinks_and_the_upper_one_does_not() -> None:
    heights = {}
    for proximity in (STILL, Proximity()):
        start = [[0.0, 0.0, 2.0], [0.0, 0.0, 2.5], [1.0, 0.0, 2.0]]
        fleet = SimulatedFleet(CF21, 3, start=start, flying=True, proximity=proximity)
        fleet.advance_to(0.3)
        heights[proximity] = fleet.bodies.position[:, 2]
    lower, upper, aside = heights[STILL] - heights[Proximity()]
    # 4 g of 34 g for 0.3 s, with the drag that the push meets
    assert lower == pytest.approx(0.5 * 4.0 / 34.0 * 9.81 * 0.3**2, rel=0.2)
    assert abs(upper) < 1e-4
    assert abs(aside) < 1e-4


def test_a_fleet_feels_the_drones_of_another() -> None:
    fleet = SimulatedFleet(CF21, 1, start=[[0.0, 0.0, 2.0]], flying=True, proximity=Proximity())
    fleet.neighbours = np.array([[0.0, 0.0, 2.3]]), np.array([UPPER])
    free = SimulatedFleet(CF21, 1, start=[[0.0, 0.0, 2.0]], flying=True, proximity=Proximity())
    for one in (fleet, free):
        one.advance_to(0.2)
    assert free.bodies.position[0, 2] - fleet.bodies.position[0, 2] > 0.02


def test_a_drone_near_the_floor_needs_less_thrust() -> None:
    climbs = []
    for proximity in (STILL, Proximity()):
        fleet = SimulatedFleet(CF21, 1, start=[[0.0, 0.0, 0.02]], flying=True, proximity=proximity)
        fleet.advance_to(0.4)
        climbs.append(fleet.bodies.position[0, 2])
    assert climbs[1] > climbs[0] + 0.02


def test_what_is_no_figure_is_refused() -> None:
    with pytest.raises(FlatsatError, match="ground_effect = -1"):
        Proximity(ground_effect=-1.0)
    with pytest.raises(FlatsatError, match=r"reach = 0\.1 m: must be above 0\.2"):
        Proximity(reach=0.1)
