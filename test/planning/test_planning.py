"""Plans are found, proved and as short as they can be; what cannot be planned is refused by name."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.planning import Asked, Mission, Round, Wishes, plan, read_mission, rounds
from flatsat_ros.planning.descent import descend
from flatsat_ros.planning.planner import finished
from flatsat_ros.planning.program import ORDERS, Derivatives, Program, Retimed, bezier_matrices
from flatsat_ros.planning.reference import _linear_step, shapes_of, shortest, shortest_legs, smoothest
from flatsat_ros.planning.search import Search, Swarm
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.planning.trade import trade
from flatsat_ros.plans import Bounds, Curve, Plan, Tube
from flatsat_ros.plans.pacing import have_room
from flatsat_ros.plans.tubes import RESERVE, require_tubes

CERTIFICATE = load_certificate("paper_experiment")
LIMITS = CERTIFICATE.limits
BOUNDS = Bounds(0.85, 2.0, 20.0, np.array([-3.0, -3.0, 0.0]), np.array([3.0, 3.0, 2.0]))
DRAGGED = replace(BOUNDS, drag=(0.9, 0.6), lead=(0.2, 0.3))
WAY = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.2, 0.5, 1.0], [1.0, -0.7, 0.6]])


def mission(*ways: Sequence[Sequence[float]], **others: Any) -> Mission:
    drones = tuple(Asked(f"cf{i + 1}", np.array(way, dtype=float)) for i, way in enumerate(ways))
    asked: dict[str, Any] = {
        "name": "test", "certificate": CERTIFICATE.name, "limits": LIMITS, "bounds": BOUNDS, "tube": Tube(0.05)
    }  # fmt: skip
    return Mission(drones=drones, **asked | others)


def antipodal(count: int, radius: float = 1.5) -> list[list[list[float]]]:
    angles = 2 * np.pi * np.arange(count) / count
    places = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.ones(count)], axis=1)
    return [[place.tolist(), (place * [-1, -1, 1]).tolist()] for place in places]


def after(count: int, asked: Mission) -> Plan:
    """Return the plan after so many rounds, or all there are, however long they take."""
    *_, last = islice(rounds(asked, lambda: False), count)
    return finished(asked, last)


def test_a_straight_way_takes_what_jerk_alone_allows() -> None:
    # rest to rest with jerk J only: at best T = (32 L / J)^(1/3); a spline with few spans comes near
    shapes = Shapes(np.ones(24, dtype=np.int64), np.array([0, 24]))
    way = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]])
    bounds = replace(BOUNDS, margin=0.01, snap_max=1e4)
    found = shortest(shapes, Asked("cf1", way), LIMITS, bounds)
    assert found is not None
    least = (32 * 0.3 / bounds.jerk_max) ** (1 / 3)
    assert least < found[1] < 1.15 * least


@pytest.mark.parametrize("bounds", [BOUNDS, DRAGGED], ids=["acceleration", "drag"])
def test_the_shortest_duration_is_that_below_which_no_reference_is_found(bounds: Bounds) -> None:
    shapes = shapes_of(np.array([2.0, 2.5, 2.0]))
    found = shortest(shapes, Asked("cf1", WAY), LIMITS, bounds)
    assert found is not None
    _, duration = found
    smooth = smoothest(shapes, Asked("cf1", WAY), 1.001 * duration, LIMITS, bounds)
    assert smooth is not None
    knots = np.rint(shapes.knots * 1.001e6 * duration).astype(int).tolist()
    slacks = [claim.slack for claim in bounds.claims(Curve.rounded(knots, smooth), LIMITS)]
    assert min(slacks) >= 0.0
    assert smoothest(shapes, Asked("cf1", WAY), 0.995 * duration, LIMITS, bounds) is None


@pytest.fixture(scope="module")
def alone() -> Plan:
    return plan(mission(WAY.tolist()))


def test_one_drone_passes_all_waypoints_in_a_proved_plan(alone: Plan) -> None:
    assert min(alone.verify().values()) >= 0.0
    (drone,) = alone.drones
    assert [waypoint[1:4] for waypoint in drone.waypoints] == [tuple(np.rint(1e9 * p).astype(int)) for p in WAY]
    trajectory = alone.trajectory("cf1")
    for waypoint, place in zip(drone.waypoints, WAY, strict=True):
        assert trajectory.sample(waypoint.time / 1e6)[:3] == pytest.approx(place, abs=1e-6)
    for t in (0.0, alone.duration):
        assert np.abs(trajectory.sample(t)[3:]).max() < 1e-9
    assert trajectory.require_margin(LIMITS) >= 0.999 * BOUNDS.margin


def test_a_waypoint_is_passed_within_its_radius_and_not_closer_than_is_worth_it(alone: Plan) -> None:
    (drone,) = mission(WAY.tolist()).drones
    radii = np.array([0.0, 0.1, 0.2, 0.0])
    found = plan(replace(mission(WAY.tolist()), drones=(replace(drone, radii=radii),)))
    assert found.duration < 0.97 * alone.duration
    assert [waypoint.radius for waypoint in found.drones[0].waypoints] == [0, 100_000_000, 200_000_000, 0]
    for waypoint, place, radius in zip(found.drones[0].waypoints, WAY, radii, strict=True):
        offset = float(np.linalg.norm(found.trajectory("cf1").sample(waypoint.time / 1e6)[:3] - place))
        assert 0.9 * radius < offset + 1e-9 < radius + 1e-5  # a shorter way passes at the edge
    narrow = tuple(waypoint._replace(radius=waypoint.radius // 2) for waypoint in found.drones[0].waypoints)
    with pytest.raises(FlatsatError, match=r"distance from its way-point at t = .*: must be at most 0.05"):
        replace(found, drones=(replace(found.drones[0], waypoints=narrow),)).verify()


def test_legs_are_timed_better_than_in_proportions_near_by(alone: Plan) -> None:
    knots = np.array(alone.drones[0].curve.knots) / 1e6
    legs = np.diff(knots[::8])
    for factors in np.random.default_rng(0).uniform(0.85, 1.15, size=(6, 3)):
        other = shortest(shapes_of(legs * factors), Asked("cf1", WAY), LIMITS, BOUNDS)
        assert other is not None
        assert other[1] > 0.999 * alone.duration


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6))
def test_limits_are_linearised_in_legs_and_control_points_to_first_order(seed: int) -> None:
    random = np.random.default_rng(seed)
    spans, legs = 3, random.uniform(0.5, 2.0, 4)
    points = random.normal(size=(4 * spans + 5, 3))
    moved, longer = 1e-5 * random.normal(size=points.shape), 1e-5 * random.normal(size=4)
    retimed = Retimed(points, legs, spans)
    unknowns = np.concatenate([(points + moved).T.ravel(), legs + longer])
    knots = np.concatenate([[0.0], np.cumsum(np.repeat((legs + longer) / spans, spans))])
    for order, matrix in enumerate(bezier_matrices(knots)):
        own = np.arange(matrix.shape[0]) // (spans * (6 - order))
        exact = ((1.0 + longer / legs)[own] ** order)[:, np.newaxis] * (matrix @ (points + moved))
        linear = np.stack([rows @ unknowns + constant for rows, constant in retimed.axes(order)], axis=1)
        assert linear == pytest.approx(exact, abs=1e-6 * np.abs(exact).max())
        exact *= ((1.0 + longer / legs)[own] ** (2 - order))[:, np.newaxis]
        linear = np.stack([rows @ unknowns + constant for rows, constant in retimed.axes(order, 2)], axis=1)
        assert linear == pytest.approx(exact, abs=1e-6 * np.abs(exact).max())
        if order > 0:
            rows, constant = retimed.power(order, 2.0, np.arange(4 * spans))
            assert rows @ unknowns + constant == pytest.approx(np.repeat(2.0 * (1.0 + longer / legs) ** order, spans))


def test_no_bezier_point_is_left_out_that_is_not_another_spans() -> None:
    random = np.random.default_rng(0)
    derivatives = Derivatives(np.concatenate([[0.0], np.cumsum(random.uniform(0.5, 1.5, 7))]))
    points = random.normal(size=derivatives.count)
    for order in range(ORDERS):
        values = derivatives._matrices[order] @ points
        kept = values[derivatives.distinct(order)]
        assert len(kept) == 7 * (5 - order) + 1
        assert np.abs(values[:, np.newaxis] - kept).min(axis=1).max() < 1e-9 * np.abs(values).max()


def test_what_a_step_of_the_legs_hopes_for_is_about_what_it_gains() -> None:
    way = np.random.default_rng(4).uniform(-1.5, 1.5, (12, 3)) + np.array([0.0, 0.0, 1.5])
    bounds = replace(BOUNDS, upper=np.array([3.0, 3.0, 4.0]))
    drone, legs = Asked("cf1", way), np.sqrt(np.linalg.norm(np.diff(way, axis=0), axis=1) + 0.1)
    first = shortest(shapes_of(legs), drone, LIMITS, bounds)
    assert first is not None
    points, duration = first
    step = _linear_step(legs * (duration / legs.sum()), points, drone, 0.25, LIMITS, bounds)
    assert step is not None
    second, best = shortest(shapes_of(step), drone, LIMITS, bounds), shortest_legs(drone, LIMITS, bounds, lambda: False)
    assert second is not None
    assert best is not None
    assert duration - second[1] > 0.8 * (duration - step.sum()) > 0.05 * duration
    assert best[1] <= second[1]


SQUARE = [[1, 0, 1], [0, 1, 1.2], [-1, 0, 1], [0, -1, 0.8], [1, 0, 1]]


def test_a_loop_is_flown_faster_in_laps_than_from_rest_to_rest(alone: Plan) -> None:
    found = plan(mission(SQUARE, laps=2))
    (drone,) = found.drones
    assert drone.curve.closed
    assert min(found.verify().values()) >= 0.0
    assert [waypoint[1:4] for waypoint in drone.waypoints] == [tuple(round(1e9 * x) for x in p) for p in SQUARE]
    lap = drone.curve.trajectory()
    assert float(np.linalg.norm(lap.sample(0.0)[3:6])) > 0.3
    assert drone.curve.duration < 0.8 * plan(mission(SQUARE)).duration
    shapes = shapes_of(np.ones(4), closed=True)
    best = shortest(shapes, Asked("cf1", np.array(SQUARE)), LIMITS, BOUNDS)  # by symmetry legs are about equal
    assert best is not None
    assert drone.curve.duration == pytest.approx(best[1], rel=5e-3)


def test_many_fly_laps_at_once() -> None:
    asked = mission(SQUARE, [[-x, -y, z] for x, y, z in SQUARE], laps=3)
    first = next(rounds(asked, lambda: False))
    assert all(curve.closed for curve in first.curves)


def test_laps_of_what_does_not_close_are_refused() -> None:
    for way, laps, text in (
        (WAY.tolist(), 2, r"distance of the last way-point of cf1 from the first = 1.3\d* m: must be 0 for laps"),
        ([[0, 0, 1], [0, 0, 1]], 2, "number of way-points of laps = 2: must be at least 3"),
        (SQUARE, 0, "number of laps = 0: must be a whole number from 1 to 1000"),
    ):
        with pytest.raises(FlatsatError, match=text):
            mission(way, laps=laps)


def test_given_times_are_kept_or_refused_with_what_would_do(alone: Plan) -> None:
    found = plan(mission(WAY.tolist(), times=np.array([0.0, 4.0, 9.0, 13.0])))
    assert [waypoint.time for waypoint in found.drones[0].waypoints] == pytest.approx([0, 4e6, 9e6, 13e6], abs=20)
    assert found.trajectory("cf1").sample(9.0)[:3] == pytest.approx(WAY[2], abs=1e-4)
    with pytest.raises(
        FlatsatError, match=r"times of way-points of cf1: must be at least (\d\.\d+) times as long"
    ) as refused:
        plan(mission(WAY.tolist(), times=np.array([0.0, 1.0, 2.2, 3.2])))
    assert "breaks cf1: margin, tilt_max by" in str(refused.value)
    factor = float(str(refused.value).partition("at least ")[2].partition(" ")[0])
    assert plan(mission(WAY.tolist(), times=factor * np.array([0.0, 1.0, 2.2, 3.2]))).duration < alone.duration * 1.6
    with pytest.raises(FlatsatError, match=r"times of way-points of cf1: must be at least .* breaks all of them"):
        plan(mission(WAY.tolist(), times=np.array([0.0, 1e-3, 2e-3, 3e-3])))


def test_one_drone_is_content_with_the_legs_that_are_found_in_time(alone: Plan) -> None:
    asked = mission(WAY.tolist())
    found = finished(asked, next(rounds(asked, lambda: True)))
    assert alone.duration < found.duration < 1.5 * alone.duration


@pytest.fixture(scope="module")
def circle() -> tuple[Plan, list[Round]]:
    """Four drones that all cross the same point, symmetrically."""
    told: list[Round] = []

    def tell(proved: Round) -> None:
        told.append(proved)
        if proved.bound is not None and proved.duration < 1.1 * proved.bound:
            raise KeyboardInterrupt  # ends the search as Ctrl-C does, however fast the machine is

    return plan(mission(*antipodal(4)), 600.0, tell), told


def test_a_symmetric_exchange_is_resolved_and_proved(circle: tuple[Plan, list[Round]]) -> None:
    found, _ = circle
    slacks = found.verify()
    assert min(slacks.values()) >= 0.0
    times = np.linspace(0.0, found.duration, 150)
    flown = np.array([[found.trajectory(drone.name).sample(t)[:3] for t in times] for drone in found.drones])
    for pair in found.pairs:
        i, j = (int(name[2:]) - 1 for name in (pair.first, pair.second))
        apart = np.linalg.norm((flown[i] - flown[j]) / [1.0, 1.0, 2.0], axis=1)
        assert apart.min() >= pair.distance / 1e4 >= 0.4


def test_rounds_get_shorter_never_below_the_bound_and_the_last_is_kept(circle: tuple[Plan, list[Round]]) -> None:
    found, told = circle
    durations = [proved.duration for proved in told]
    assert durations == sorted(durations, reverse=True)
    assert found.duration == durations[-1]
    assert told[0].bound is not None
    assert told[0].bound <= found.duration < 1.1 * told[0].bound
    for proved in told:
        assert all(claim.slack >= 0 for curve in proved.curves for claim in BOUNDS.claims(curve, LIMITS))


def test_the_same_mission_gives_the_same_rounds() -> None:
    first, again = (next(rounds(mission(*antipodal(3)), lambda: False)) for _ in range(2))
    assert first.curves == again.curves


def stop_at_once(_: Round) -> None:
    raise KeyboardInterrupt


def test_many_drones_meet_at_waypoints_on_common_times() -> None:
    ways = [[[0.0, y, 1.0], [1.5, -y, 1.0], [0.0, y, 1.0]] for y in (-0.5, 0.5)]
    found = plan(mission(*ways), 600.0, stop_at_once)
    assert {tuple(w.time for w in drone.waypoints) for drone in found.drones} == {
        tuple(waypoint.time for waypoint in found.drones[0].waypoints)
    }
    timed = after(1, mission(*ways, times=np.array([0.0, 5.0, 10.0])))
    assert timed.duration == pytest.approx(10.0, abs=1e-3)


@given(st.integers(0, 2**31))
@settings(max_examples=8)
def test_the_penalty_has_the_gradient_it_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ways = rng.uniform(-0.6, 0.6, size=(3, 2, 3)) + [0.0, 0.0, 1.0]
    shapes = Shapes(np.ones(8, dtype=np.int64), np.array([0, 8]))
    bounds = replace(DRAGGED, speed_max=0.5, upper=np.array([0.7, 0.7, 1.5]))
    boxes = np.array([[[-0.2, -0.3, 0.0], [0.1, 0.1, 1.2]], [[0.3, 0.3, 0.8], [0.5, 0.9, 2.0]]])
    search = Search(Swarm(shapes, ways, 0.5 * (1 - np.eye(3)), 2.0, LIMITS, bounds, boxes, np.full(3, 0.2)))
    modes = search.begin(0.3, seed)
    direction = rng.normal(size=modes.shape)
    _, gradient, _ = search._cost(modes, 2.0, 3.0, 2.0)
    step = 1e-6
    above, below = (search._cost(modes + sign * step * direction, 2.0, 3.0, 2.0)[0] for sign in (1, -1))
    slope = float(gradient @ direction.ravel())
    assert (above - below) / (2 * step) == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.linalg.norm(gradient))


def test_descent_finds_the_minimum_of_rosenbrocks_function() -> None:
    def function(x: FloatArray) -> tuple[float, FloatArray]:
        a, b = x[1:] - x[:-1] ** 2, 1.0 - x[:-1]
        gradient = np.zeros_like(x)
        gradient[1:] += 200.0 * a
        gradient[:-1] += -400.0 * a * x[:-1] - 2.0 * b
        return float(100.0 * a @ a + b @ b), gradient

    assert descend(function, np.full(6, -0.5), 500, 0.0) == pytest.approx(np.ones(6), abs=1e-4)


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ([[[0, 0, 1], [1, 0, 1]], [[0.3, 0, 1], [1, 1, 1]]], r"distance of cf1 and cf2 at way-point 1 = 0.3 m: must"),
        ([[[0, 0, 1], [1, 0, 1]], [[0, 2, 1], [1, 0, 1.7]]], r"cf1 and cf2 at way-point 2 = 0.35 m: must be at least"),
        ([[[0, 0, 1], [1, 0, 2.5]]], r"z of way-point 2 of cf1 = 2.5 m: must be from 0 to 2 m, in the box"),
        ([[[0, 0, 1], [1, 0, 1], [1, 0, 1]]], r"way-point 3 of cf1 from the one before = 0.0 m: must be at least"),
        ([[[0, 0, 1], [1, 0, 1]], [[2, 2, 1]] * 3], r"number of way-points of cf2 = 3: must be 2 as of cf1"),
        ([[[0, 0, 1]]], r"shape of the way-points of cf1 = \(1, 3\): must be"),
    ],
)  # fmt: skip
def test_what_cannot_be_planned_is_refused_by_name(asked: list[Any], text: str) -> None:
    with pytest.raises(FlatsatError, match=text):
        mission(*asked)


def test_a_solver_that_fails_is_not_taken_for_the_proof_that_there_is_no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Program, "minimised", lambda *_: None)
    with pytest.raises(FlatsatError, match="found no reference through them"):
        plan(mission(WAY.tolist()))


def test_a_margin_beyond_the_input_set_is_refused() -> None:
    with pytest.raises(FlatsatError, match=r"margin = 2.0 m/s\^2: must be below 1.70"):
        mission(WAY.tolist(), bounds=replace(BOUNDS, margin=2.0))


def test_a_downwash_that_lets_drones_nearer_above_each_other_is_refused() -> None:
    with pytest.raises(FlatsatError, match=r"downwash = 0.5: must be a number from 1 to 10"):
        mission(WAY.tolist(), downwash=0.5)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


BOXED = "drones: {{a: [[0, 0, 1], [1, 0, 1]]}}\nobstacles: {{wall: {{type: {}}}}}\n"
JSON = {
    "quadrotors": {"crazyflie": {"radius": 0.1, "downwash": 3.0, "max_vel": [1, 1, 1]}},
    "world": [{"dimension": [-2, -2, 0.2, 2, 2, 2.5]}],
    "agents": [
        {"type": "crazyflie", "cid": 7, "start": [0, 0, 1], "goal": [1, 0, 1]},
        {"type": "crazyflie", "start": [1, 1, 1], "goal": [0, 1, 1]},
    ],
    "obstacles": [],
}


def test_files_say_what_is_asked(tmp_path: Path) -> None:
    table = "x,y,z,yaw,t\n0,0,-0.2,1.5,3\n0,0,1,1.5,7\n"
    one = read_mission(written(tmp_path, "a.csv", table), CERTIFICATE, Wishes(), "a")
    assert one.bounds.lower.tolist() == [-0.5, -0.5, -0.2]  # the floor is at the first row's height
    assert one.drones[0].yaw == 1.5
    assert one.times is not None
    assert one.times.tolist() == [0.0, 4.0]
    assert one.bounds.margin == LIMITS.inner_radius / 2
    many = "drones: {a: [[0, 0, 1], [1, 0, 1]], b: [[0, 1, 1], [1, 1, 1]]}\nbody: 0.1\ntimes: [0, 5]\n"
    two = read_mission(written(tmp_path, "b.yaml", many), CERTIFICATE, Wishes(floor=0.1, tube=0.07), "b")
    assert [drone.name for drone in two.drones] == ["a", "b"]
    assert two.distances.tolist() == [[0.0, pytest.approx(0.34)], [pytest.approx(0.34), 0.0]]
    assert two.bounds.lower[2] == 0.1
    assert two.laps is None
    loop = written(tmp_path, "d.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 1]]}\nlaps: 4\n")
    assert read_mission(loop, CERTIFICATE, Wishes(), "d").laps == 4
    assert read_mission(loop, CERTIFICATE, Wishes(laps=2), "d").laps == 2
    three = read_mission(written(tmp_path, "c.json", json.dumps(JSON)), CERTIFICATE, Wishes(), "c")
    assert [drone.name for drone in three.drones] == ["cf7", "cf2"]
    assert (three.downwash, three.bounds.upper.tolist()) == (3.0, [2.0, 2.0, 2.5])


def test_goals_are_gone_to_from_present_places(tmp_path: Path) -> None:
    places = {"a": [0.0, 0.0, 1.5], "b": [1.0, 0.0, 0.4]}

    def present(names: Sequence[str]) -> dict[str, list[float]]:
        assert list(names) == ["a", "b"]
        return places

    goals = written(tmp_path, "a.yaml", "drones: {a: [[1, 1, 1]], b: [0, 1, 0.5]}\n")
    found = read_mission(goals, CERTIFICATE, Wishes(), "a", present)
    assert found.waypoints.tolist() == [[[0, 0, 1.5], [1, 1, 1]], [[1, 0, 0.4], [0, 1, 0.5]]]
    assert found.bounds.lower.tolist() == [-0.5, -0.5, 0.4]  # the lowest place of all
    near = written(tmp_path, "b.yaml", "drones: {a: [[1, 1, 1]], b: [0, 1, 0.5]}\nbody: 0.6\n")
    for path, text in (
        (near, "distance of a and b at way-point 2 = 1.03"),
        (
            written(tmp_path, "c.yaml", "drones: {a: pp1.csv, b: [0, 1, 1]}\n"),
            "goals of a = 'pp1.csv': must be a place",
        ),
        (written(tmp_path, "d.csv", "x,y,z\n0,0,1\n0,1,1\n"), "must be one whose name ends in .yaml: goals of drones"),
    ):
        with pytest.raises(FlatsatError, match=text):
            read_mission(path, CERTIFICATE, Wishes(), "a", present)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.csv", "0,0,1\n1,1,1\n", "first line = '0,0,1': must be the names of the columns"),
        ("a.csv", "x,y,z\n0,0,1\n1,one,1\n", "way-point 2 = '1,one,1': must be numbers"),
        ("a.csv", "x,y,z\n0,0,1\n1,1\n", "way-point 2 = '1,1': must be 3 numbers"),
        ("a.csv", "x,y,z\n0,0,1\n1,1,nan\n", "way-point 2 = '1,1,nan': must be finite numbers"),
        ("a.csv", "x,y,z,yaw\n0,0,1,0\n1,1,1,1\n", r"yaw = \[0.0, 1.0\] rad: must be the same in all lines"),
        ("a.csv", "x,y,z\n0,0,1\n0,0,0.9\n", "z of way-point 2 of cf1 = 0.9 m: must be from 1 to 1.5 m"),
        ("a.csv", "x,y,z,t\n0,0,1,2\n0,0,1.2,2\n", "times of way-points = .* s: must be increasing from 0"),
        (
            "a.csv",
            "x,y,z,radius\n0,0,1,0.1\n0,0,1.2,0\n",
            r"radii of start and goal of cf1 = \[0.1, 0.0\] m: must be 0",
        ),
        (
            "a.csv",
            "x,y,z,radius\n0,0,1,0\n0,1,1,-1\n0,0,1.2,0\n",
            "smallest radius of cf1 = -1.0 m: must be at least 0",
        ),
        ("a.csv", "x,y,z\n0,0,1\n1e308,0,1\n", r"a way-point of cf1 = 1e\+308 m: must be within 500 m"),
        (
            "a.csv",
            "x,y,z\n0,0,1\n0,0,1\n",
            "distance of way-point 2 of cf1 from the one before = 0.0 m: must be at least",
        ),
        ("a.yaml", "drones: [1]", "drones = .*: must be a mapping from names"),
        ("a.yaml", "drones: {}", "drones = {}: must be a mapping from names"),
        ("a.yaml", "drones: {a b: [[0, 0, 1], [1, 0, 1]]}", "name of a drone = 'a b': must be a letter, then letters"),
        ("a.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1]]}\nbody: -1", "body = -1 m: must be a number above 0"),
        ("a.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1]]}\nspeed: 1.0", "unknown key 'speed'"),
        ("a.json", "{", "cannot be read"),
        (
            "a.json",
            json.dumps(JSON | {"obstacles": [{"type": "chasing"}]}),
            "type of obstacle obstacle1 = 'chasing': must be 'box'",
        ),
        ("a.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1]]}\nobstacles: [1]", r"obstacles = \[1\]: must be a mapping from"),
        ("a.yaml", BOXED.format("mesh, file: a.stl"), "type of obstacle wall = 'mesh': must be 'box'"),
        ("a.yaml", BOXED.format("box, lower: [0, 0, 0], upper: [1, 0, 1]"), "upper y of wall = 0.0 m: must be above"),
        ("a.yaml", BOXED.format("box, lower: [0, 0, 0]"), "obstacle wall: key 'upper' is missing"),
        (
            "a.yaml",
            BOXED.format("box, lower: [1.1, -1, 0], upper: [1.3, 1, 2]"),
            "distance of a from wall at way-point 2 = 0.1 m: must be at least 0.2 m, body, tube",
        ),
        ("a.json", json.dumps(JSON | {"agents": [{"type": "crazyflie", "start": [0, 0, 1]}]}), "goal is missing"),
        ("a.json", json.dumps(JSON | {"agents": [{"type": 10**400, "start": 0, "goal": 0}]}), "quadrotors: must be"),
        ("a.json", json.dumps(JSON).replace("{", '{"agents": 0, ', 1), "key 'agents' stands there twice"),
        (
            "a.yaml",
            f"drones: {{a: [[0, 0, 1], [1, 0, 1]]}}\nobstacles: {{{'w' * 600}: {{type: box, lower: 1, upper: 2}}}}",
            r"w\.\.\. = \(\): must be",
        ),
        ("a.txt", "", "must be one whose name ends in .csv, .yaml, .json"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, name: str, text: str, reason: str) -> None:
    path = written(tmp_path, name, text)
    with pytest.raises(FlatsatError, match=reason) as refused:
        read_mission(path, CERTIFICATE, Wishes(), "a")
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < len(str(path)) + 500


def test_curves_of_a_plan_have_the_spans_of_their_legs(alone: Plan) -> None:
    curve: Curve = alone.drones[0].curve
    assert len(curve.knots) == 3 * 8 + 1


def test_larger_bounds_are_traded_for_larger_tubes(tmp_path: Path) -> None:
    flying = Certificate.from_document(read_yaml(config_path("cf21_flight_50hz")))  # not proved again here
    path = written(tmp_path, "a.csv", "x,y,z\n0,0,1\n1,0,1\n")
    asked = read_mission(path, flying, Wishes(), "a")
    assert asked.tube.source == "certificate"
    found = list(trade(asked, flying))
    durations = [choice.bound for choice in found if choice.bound is not None]
    tubes = [choice.tube for choice in found if choice.tube is not None]
    assert len(durations) > 2
    assert durations == sorted(durations, reverse=True)
    assert tubes == sorted(set(tubes))
    assert min(tubes) < asked.tube.radius < max(tubes)
    assert all(choice.refused for choice in found if choice.bound is None)
    with pytest.raises(FlatsatError, match="has no flight section"):
        next(trade(asked, CERTIFICATE))


def test_a_plan_that_asks_for_less_than_it_may_has_the_smaller_tube_that_is_proved_for_it(tmp_path: Path) -> None:
    flying = Certificate.from_document(read_yaml(config_path("cf21_flight_50hz")))  # not proved again here
    slow, quick = (written(tmp_path, f"{t}.csv", f"x,y,z,t\n0,0,1,0\n1,0,1,{t}\n") for t in (20, 7))
    own = plan(read_mission(slow, flying, Wishes(), "slow"))
    require_tubes(own, flying)
    (tube,), usual = {drone.tube for drone in own.drones}, read_mission(quick, flying, Wishes(), "quick")
    assert tube.source == "certificate"
    assert tube.radius < usual.tube.radius - 1e-3
    assert have_room([own.trajectory("cf1")], own.bounds, own.limits)  # for pauses
    assert {drone.tube for drone in plan(usual).drones} == {usual.tube}
    wished = plan(read_mission(slow, flying, Wishes(tube=0.06), "wished"))
    assert {drone.tube for drone in wished.drones} == {Tube(0.06, "certificate")}
    require_tubes(wished, flying)


@pytest.mark.parametrize("count", [1, 2])
def test_references_accelerate_no_more_than_the_certificate_of_their_tubes_assumes(tmp_path: Path, count: int) -> None:
    flying = Certificate.from_document(read_yaml(config_path("cf21_tight_50hz")))  # not proved again here
    assert flying.flight is not None
    ways = [[[0.0, k, 0.5], [1.5, k, 1.5], [0.0, k, 2.0]] for k in map(float, range(count))]
    text = json.dumps({"drones": {f"cf{k + 1}": way for k, way in enumerate(ways)}})
    found = after(2, read_mission(written(tmp_path, "climbs.yaml", text), flying, Wishes(), "climbs"))
    require_tubes(found, flying)
    asked = [float(drone.curve.trajectory().demand()[0].max()) for drone in found.drones]
    assert 0.8 * flying.flight.acceleration < max(asked) <= flying.flight.acceleration / RESERVE
