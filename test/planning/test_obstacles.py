"""Plans around boxes: an opening for many drones, and ways that a search begins with."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.planning import Asked, Mission, Round, improvement, plan
from flatsat_ros.planning.detours import along, around
from flatsat_ros.plans import Bounds, Box, Plan, Tube

CERTIFICATE = load_certificate("paper_experiment")
LOWER, UPPER = np.array([-3.0, -2.0, 0.0]), np.array([3.0, 2.0, 2.5])
BOUNDS = Bounds(0.85, 2.0, 20.0, LOWER, UPPER)
# a wall with an opening of 1 x 1 m
WALL = tuple(
    Box.between(name, [-0.1, *low], [0.1, *high])
    for name, low, high in (
        ("left", [-2.0, 0.0], [-0.5, 2.5]), ("right", [0.5, 0.0], [2.0, 2.5]),
        ("below", [-0.5, 0.0], [0.5, 0.5]), ("above", [-0.5, 1.5], [0.5, 2.5]),
    )
)  # fmt: skip


def mission(count: int, obstacles: tuple[Box, ...] = WALL) -> Mission:
    """Drones on a grid to one side of the wall, each of which wants to another place of the same grid beyond."""
    grid = [[-x, y, 1.0] for x in (1.2, 2.4) for y in (-1.4, -0.7, 0.0, 0.7, 1.4)]
    order = np.random.default_rng(1).permutation(len(grid))
    ways = [[grid[i], [-grid[j][0], *grid[j][1:]]] for i, j in enumerate(order.tolist())]
    drones = tuple(Asked(f"cf{i}", np.array(way)) for i, way in enumerate(ways[:count], 1))
    return Mission("opening", drones, CERTIFICATE.name, CERTIFICATE.limits, BOUNDS, Tube(0.05), obstacles=obstacles)


def first_only(_: Round) -> None:
    raise KeyboardInterrupt


@pytest.fixture(scope="module")
def opening() -> Plan:
    return plan(mission(4), 600.0, first_only)


def test_drones_pass_an_opening_with_bodies_and_tubes(opening: Plan) -> None:
    slacks = opening.verify()
    assert (
        len([name for name in slacks if name.partition(", ")[2].startswith(("left", "right", "below", "above"))]) == 16
    )
    assert min(slacks.values()) >= 0.0
    times = np.linspace(0.0, opening.duration, 400)
    for drone in opening.drones:
        path = np.array([opening.trajectory(drone.name).sample(t)[:3] for t in times])
        for passage in (each for each in opening.passages if each.first == drone.name):
            (box,) = (box for box in WALL if box.name == passage.second)
            away = (path - np.clip(path, *box.corners)) / [1.0, 1.0, 2.0]
            assert np.linalg.norm(away, axis=1).min() >= passage.distance / 1e4 >= 0.2


def test_one_drone_goes_around_a_box_it_would_hit() -> None:
    box = (Box.between("pillar", [-0.2, -0.4, 0.0], [0.2, 0.6, 2.5]),)
    found = plan(mission(3, box), 600.0, first_only)
    assert min(found.verify().values()) >= 0.0


def test_a_closed_wall_is_refused_with_who_what_and_when(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(improvement, "_LONGER", (1.2,))
    closed = (Box.between("wall", [-0.1, -2.0, 0.0], [0.1, 2.0, 2.5]),)
    with pytest.raises(
        FlatsatError, match=r"no plan found in up to 1.2 times the .* s of the slowest drone alone: cf1.* at about t = "
    ):
        plan(mission(1, closed), 600.0)


def test_what_takes_too_long_is_refused_in_the_given_time() -> None:
    with pytest.raises(
        FlatsatError, match=r"no plan found in the given time, with durations up to .* times that of the slowest"
    ):
        plan(mission(2), 1e-9)


places = st.tuples(*(st.floats(low + 0.01, high - 0.01) for low, high in zip(LOWER, UPPER, strict=True))).map(np.array)


@st.composite
def boxes(draw: st.DrawFn) -> FloatArray:
    found = []
    for _ in range(draw(st.integers(1, 3))):
        a, b = draw(places), draw(places)
        found.append([np.minimum(a, b), np.maximum(a, b) + 1e-3])
    return np.array(found)


@given(places, places, boxes())
@settings(max_examples=60)
def test_a_way_around_keeps_its_distance_from_all_boxes(start: FloatArray, goal: FloatArray, walls: FloatArray) -> None:
    way = around(start, goal, walls, 0.1, LOWER, UPPER)
    inside = [
        bool(((place > walls[:, 0] - 0.1) & (place < walls[:, 1] + 0.1)).all(axis=1).any()) for place in (start, goal)
    ]
    if way is None or any(inside):
        return
    assert (way[[0, -1]] == [start, goal]).all()
    points = along(way, np.linspace(0.0, 1.0, 500))
    depth = np.minimum(points[:, np.newaxis] - walls[:, 0], walls[:, 1] - points[:, np.newaxis]).min(axis=2)
    assert depth.max() <= -0.1 + 1e-9


def test_no_opening_is_too_narrow_to_be_found() -> None:
    walls = np.array([box.corners for box in WALL])
    way = around(np.array([-2.0, 1.5, 0.3]), np.array([2.0, -1.5, 2.2]), walls, 0.499 - 1e-3, LOWER, UPPER)
    assert way is not None
    assert around(np.array([-2.0, 1.5, 0.3]), np.array([2.0, -1.5, 2.2]), walls, 0.5, LOWER, UPPER) is None
