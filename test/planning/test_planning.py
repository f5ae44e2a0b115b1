"""Plans are found, proved and as short as they can be; what cannot be planned is refused by name."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asked_missions import BOUNDS, CERTIFICATE, DRAGGED, LIMITS, WAY, antipodal, mission, written
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.planning import Asked, Mission, Round, Wishes, plan, read_mission, rounds
from flatsat_ros.planning.descent import descend
from flatsat_ros.planning.planner import finished
from flatsat_ros.planning.program import Program
from flatsat_ros.planning.reference import shapes_of, shortest
from flatsat_ros.planning.search import Search, Swarm
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.planning.trade import trade
from flatsat_ros.plans import Curve, Plan, Tube
from flatsat_ros.plans.pacing import have_room
from flatsat_ros.plans.tubes import RESERVE, require_tubes


def after(count: int, asked: Mission) -> Plan:
    """Return the plan after so many rounds, or all there are, however long they take."""
    *_, last = islice(rounds(asked, lambda: False), count)
    return finished(asked, last)


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
        assert other.duration > 0.999 * alone.duration


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
    assert drone.curve.duration == pytest.approx(best.duration, rel=5e-3)


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
