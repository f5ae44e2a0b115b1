"""What a plan says is proved with integers: limits of references, distances of pairs; and bent plans fail."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.strict_yaml import read_yaml, write_yaml
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.flight.preview import asked_of_the_law
from flatsat_ros.flight.trajectory import nearest
from flatsat_ros.plans import Bounds, Box, Curve, Plan, PlannedDrone, Tube, Waypoint, closest
from flatsat_ros.plans.curve import UNIT
from flatsat_ros.plans.plan import _digest
from flatsat_ros.plans.separation import closest_to_boxes

CERTIFICATE = load_certificate("paper_experiment")
BOUNDS = Bounds(margin=0.85, jerk_max=2.0, snap_max=20.0, lower=[-3.0, -3.0, 0.0], upper=[3.0, 3.0, 2.0])  # type: ignore[arg-type]


def straight(start: Sequence[float], goal: Sequence[float], seconds: float, bend: Sequence[float] = (0, 0, 0)) -> Curve:
    """From rest to rest in 12 spans, with a bend in the middle, m."""
    knots = [round(1e6 * seconds * i / 12) for i in range(13)]
    share = np.clip((np.arange(17) - 3) / 10, 0, 1)[:, np.newaxis]
    way = share**3 * (10 - 15 * share + 6 * share**2)
    points = np.array(start) + way * np.subtract(goal, start) + 16 * (way * (1 - way)) ** 2 * np.array(bend)
    return Curve.rounded(knots, points)


def as_scipy(curve: Curve) -> BSpline:
    knots = np.array(curve.knots) / 1e6
    padded = np.concatenate([[knots[0]] * 5, knots, [knots[-1]] * 5])
    return BSpline(padded, np.array(curve.points) * 1e-9, 5)


def plan_of(curves: Sequence[Curve], tube: float = 0.05, **others: Any) -> Plan:
    drones = [PlannedDrone(f"cf{i + 1}", curve, 0.15, Tube(tube)) for i, curve in enumerate(curves)]
    made = {"name": "test", "certificate": CERTIFICATE.name, "limits": CERTIFICATE.limits, "bounds": BOUNDS}
    return Plan.of(drones, **made | others)


@pytest.fixture(scope="module")
def crossing() -> Plan:
    """Two drones that swap places, one around the other."""
    return plan_of([straight((0, 0, 1), (2, 0, 1), 6.0, (0, 0.5, 0)), straight((2, 0, 1), (0, 0, 1), 6.0)])


@st.composite
def random_curves(draw: st.DrawFn, spans: int | None = None) -> Curve:
    count = draw(st.integers(1, 6)) if spans is None else spans
    lengths = draw(st.lists(st.integers(100_000, 900_000), min_size=count, max_size=count))
    place = st.tuples(*[st.integers(-2_000_000_000, 2_000_000_000)] * 3)
    inner = draw(st.lists(place, min_size=max(0, count - 3), max_size=max(0, count - 3)))
    ends = draw(st.tuples(place, place))
    if count < 3:  # the equal points at both ends overlap
        ends = (ends[0], ends[0])
    points = ([ends[0]] * 4 + inner + [ends[1]] * 4)[: count + 5]
    points[-4:] = [ends[1]] * 4
    return Curve(tuple(np.cumsum([0, *lengths]).tolist()), tuple(points))


@given(random_curves())
@settings(max_examples=30)
def test_the_exact_control_points_are_those_of_scipy(curve: Curve) -> None:
    theirs = as_scipy(curve)
    edges = np.array(curve.knots) / 1e6
    for order in range(5):
        values, divisors = curve.bezier(order)
        points = (values / divisors[:, np.newaxis, np.newaxis]).astype(float)
        scale = 1.0 + np.abs(points).max()
        for span in range(len(edges) - 1):
            for end, index in ((span, 0), (span + 1, -1)):
                expected = theirs(edges[end] + (1e-9, -1e-9)[-index], order)
                assert np.abs(points[span, index] - expected).max() < 1e-4 * scale
        fixed = curve.fixed(order) if np.abs(points).max() < 1000 else None
        assert fixed is None or np.abs(fixed / UNIT - points).max() <= 0.51 / UNIT + 1e-15 * scale


@given(random_curves(), st.floats(0.0, 1.0))
@settings(max_examples=30)
def test_the_trajectory_that_is_flown_is_the_curve(curve: Curve, share: float) -> None:
    t = share * curve.duration
    theirs = as_scipy(curve)
    expected = np.concatenate([theirs(t, order) for order in range(3)])
    assert curve.trajectory().sample(t) == pytest.approx(expected, abs=1e-6 * (1 + np.abs(expected).max()))


def metric(difference: FloatArray, downwash: float) -> FloatArray:
    return np.asarray(np.sqrt((difference[:, :2] ** 2).sum(axis=1) + (difference[:, 2] / downwash) ** 2))


@given(random_curves(), random_curves(), st.sampled_from([1.0, 2.0, 1.7]))
@settings(max_examples=30)
def test_a_certified_distance_is_below_all_samples_and_near_the_smallest(a: Curve, b: Curve, downwash: float) -> None:
    found = closest([a, b], downwash)
    times = np.linspace(0.0, max(a.duration, b.duration), 4001)
    sampled = [curve.trajectory() for curve in (a, b)]
    difference = np.array([sampled[0].sample(t)[:3] - sampled[1].sample(t)[:3] for t in times[::20]])
    smallest = metric(difference, downwash).min()
    assert found.distance[0] / UNIT <= smallest + 1e-9
    splines = [as_scipy(curve)(np.minimum(times, curve.duration)) for curve in (a, b)]
    smallest = metric(splines[0] - splines[1], downwash).min()
    assert smallest - 0.01 < found.distance[0] / UNIT + 2e-4  # a sample may miss the smallest by some millimetres
    assert 0.0 <= found.start[0] <= found.end[0] <= times[-1]


def test_a_plan_is_proved_saved_and_loaded(crossing: Plan, tmp_path: Path) -> None:
    slacks = crossing.verify()
    assert min(slacks.values()) >= 0.0
    pair = crossing.pairs[0]
    assert slacks["cf1, cf2: distance (m)"] == pytest.approx(pair.distance / 1e4 - 0.4, abs=1e-12)
    crossing.save(tmp_path / "plan.yaml")
    again = Plan.load(tmp_path / "plan.yaml")
    assert again.to_document() == crossing.to_document()
    assert "source: given" in (tmp_path / "plan.yaml").read_text()
    assert again.trajectory("cf1").sample(3.0) == pytest.approx(crossing.trajectory("cf1").sample(3.0))


def bent(plan: Plan, name: str, by: Sequence[float], first: int, last: int) -> Plan:
    """The plan with control points of one drone moved, nm, and the distances stated as before."""
    drones = []
    for drone in plan.drones:
        if drone.name == name:
            points = list(drone.curve.points)
            for index in range(first, last):
                x, y, z = (round(value + 1e9 * step) for value, step in zip(points[index], by, strict=True))
                points[index] = (x, y, z)
            drone = replace(drone, curve=Curve(drone.curve.knots, tuple(points)))
        drones.append(drone)
    return replace(plan, drones=tuple(drones))


def nearest_move(plan: Plan, length: float) -> tuple[list[float], int]:
    """By how much, m, cf1 is to move at its nearest to come nearer by `length`, and the span in which that is."""
    pair = plan.pairs[0]
    t = (pair.start + pair.end) / 2e6
    difference = plan.trajectory("cf2").sample(t)[:3] - plan.trajectory("cf1").sample(t)[:3]
    scaled = difference / [1.0, 1.0, plan.downwash]
    span = int(np.searchsorted(plan.drones[0].curve.knots, pair.start, side="right")) - 1
    return (length * scaled / np.linalg.norm(scaled) * [1.0, 1.0, plan.downwash]).tolist(), span


@given(st.floats(1.01, 4.0), st.sampled_from(["cf1", "cf2"]), st.integers(0, 2), st.integers(0, 2))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_bent_plan_is_taken(crossing: Plan, factor: float, name: str, before: int, after: int) -> None:
    slack = crossing.verify()["cf1, cf2: distance (m)"]
    move, span = nearest_move(crossing, factor * slack if name == "cf1" else -factor * slack)
    mutant = bent(crossing, name, move, max(4, span - before), min(13, span + 6 + after))
    loose = replace(BOUNDS, margin=1e-3, jerk_max=100.0, snap_max=1000.0)
    with pytest.raises(FlatsatError, match="'cf1, cf2: distance' is 0"):
        replace(mutant, bounds=loose).verify()


@pytest.mark.parametrize("factor", [1.05, 2.0, 4.0])
def test_a_plan_bent_by_more_than_the_slack_of_its_pair_is_refused(
    crossing: Plan, factor: float, tmp_path: Path
) -> None:
    slack = crossing.verify()["cf1, cf2: distance (m)"]
    move, span = nearest_move(crossing, factor * slack)
    mutant = bent(crossing, "cf1", move, span, span + 6)
    write_yaml(tmp_path / "plan.yaml", mutant.to_document())  # its hash made again
    loose = replace(BOUNDS, margin=1e-3, jerk_max=100.0, snap_max=1000.0)  # the bend may break other limits, too
    with pytest.raises(FlatsatError, match=r"'cf1, cf2: distance' is 0.* at t = .*: must be 0.*"):
        replace(mutant, bounds=loose).verify()
    with pytest.raises(FlatsatError, match=r"plan.yaml: .*plan 'test'"):
        Plan.load(tmp_path / "plan.yaml")
    restated = plan_of([drone.curve for drone in mutant.drones], bounds=loose)
    with pytest.raises(FlatsatError, match=r"distance' is 0\.[23].* m at t = .* must be 0.4 m, both bodies and tubes"):
        restated.verify()


def test_distances_count_tubes_bodies_and_clearance(crossing: Plan) -> None:
    curves = [drone.curve for drone in crossing.drones]
    slack = crossing.verify()["cf1, cf2: distance (m)"]
    plan_of(curves, tube=0.05 + slack / 2 - 1e-4).verify()
    plan_of(curves, clearance=slack - 1e-4).verify()
    for wider in (plan_of(curves, tube=0.05 + slack / 2 + 1e-4), plan_of(curves, clearance=slack + 1e-4)):
        with pytest.raises(FlatsatError, match=r"must be 0.4.* m, both bodies and tubes"):
            wider.verify()


def test_heights_count_by_the_downwash() -> None:
    above = [Curve.rounded([0, 10**6], np.tile([0.0, 0.0, z], (6, 1))) for z in (0.5, 1.3)]
    assert closest(above, 2.0).distance[0] / UNIT == pytest.approx(0.4, abs=1e-5)
    assert closest(above, 1.0).distance[0] / UNIT == pytest.approx(0.8, abs=1e-5)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"margin": 1.2}, "'cf1: margin, tilt_max' fails by .* m/s^2 in the span from t = "),
        ({"jerk_max": 0.5}, "'cf1: jerk' fails by .* m/s^3 in the span from t = "),
        ({"snap_max": 1.0}, "'cf1: snap' fails by .* m/s^4"),
        ({"acceleration_max": 0.1}, "'cf1: acceleration' fails by .* m/s^2 in"),
        ({"speed_max": 0.6}, "'cf1: speed' fails by .* m/s in"),
        ({"upper": [3.0, 0.4, 2.0]}, "'cf1: box, upper y' fails by 0.04.* m "),
        ({"margin": 2.0}, "margin = 2.0 m/s^2: must be below 1.70349 m/s^2"),
    ],
)
def test_a_limit_that_is_not_kept_is_named(crossing: Plan, change: dict[str, Any], text: str) -> None:
    with pytest.raises(FlatsatError, match=text.replace("^", r"\^")):
        replace(crossing, bounds=replace(BOUNDS, **change)).verify()


@pytest.mark.parametrize("name", ["jerk_max", "snap_max", "speed_max", "acceleration_max", "margin"])
def test_a_limit_holds_just_beyond_what_its_slack_leaves_and_not_within(name: str) -> None:
    curve = straight((0, 0, 1), (2, 0, 1), 6.0, (0, 0.5, 0.2))
    bounds = replace(BOUNDS, speed_max=2.0, acceleration_max=2.0)
    claims = {claim.name: claim.slack for claim in bounds.claims(curve, CERTIFICATE.limits)}
    known = {"margin": "margin, tilt_max", "acceleration_max": "acceleration"}
    slack = claims[known.get(name, name.removesuffix("_max"))]
    change = slack if name == "margin" else -slack
    for share, holds in ((0.999, True), (1.001, False)):
        other = replace(bounds, **{name: getattr(bounds, name) + share * change})
        assert all(claim.slack >= 0.0 for claim in other.claims(curve, CERTIFICATE.limits)) == holds


@given(drag=st.floats(-0.5, 1.0), lead=st.floats(0.0, 0.5), other=st.floats(0.0, 0.7))
@settings(max_examples=20)
def test_what_the_law_is_asked_for_keeps_just_the_margin_that_is_proved(drag: float, lead: float, other: float) -> None:
    curve = straight((0, 0, 1), (2, 0, 1.5), 6.0, (0, 0.5, 0.2))
    drags, leads = (drag, other), (lead, lead / 2)
    bounds = replace(BOUNDS, margin=1e-3, drag=drags, lead=leads, thrust_max=12.0, thrust_min=9.0)
    room = bounds.room(CERTIFICATE.limits)
    assert (room.thrust_max, room.thrust_min) == (12.0, 9.0)
    slacks = [claim.slack for claim in bounds.claims(curve, CERTIFICATE.limits) if claim.name.startswith("margin")]
    assert len(slacks) == 3
    spline, t = as_scipy(curve), np.linspace(0.0, 6.0, 997)
    v, a, j = (spline(t, order) for order in (1, 2, 3))
    drag_xyz, lead_xyz = (np.array([pair[0], *pair]) for pair in (drags, leads))
    asked = a + drag_xyz * v + lead_xyz * (j + drag_xyz * a)
    kept = float(room.margin(asked).min()) - bounds.margin
    assert kept - 0.2 < min(slacks) <= kept + 1e-6  # control points lie a little outside
    f = asked_of_the_law(curve.trajectory(), drags, leads)
    assert min(slacks) <= nearest(f, np.array(curve.knots) / 1e6, room).distance - bounds.margin + 1e-6
    exact = curve.fixed_sum(bounds.asked, "f") / UNIT
    assert exact[:, 0] == pytest.approx(f[:, 0], abs=1e-6)
    assert exact[:-1, -1] == pytest.approx(f[1:, 0], abs=1e-6)


def test_all_limits_are_kept_at_samples(crossing: Plan) -> None:
    limits = CERTIFICATE.limits
    for drone in crossing.drones:
        spline = as_scipy(drone.curve)
        t = np.linspace(0.0, 6.0, 997)
        assert limits.margin(spline(t, 2)).min() >= BOUNDS.margin
        for order, most in ((3, BOUNDS.jerk_max), (4, BOUNDS.snap_max)):
            assert np.linalg.norm(spline(t, order), axis=1).max() <= most
        assert (spline(t) >= BOUNDS.lower).all()
        assert (spline(t) <= BOUNDS.upper).all()


def test_waypoints_are_claims(crossing: Plan) -> None:
    drone = crossing.drones[0]
    middle = tuple(round(1e9 * value) for value in drone.curve.trajectory().sample(3.0)[:3])
    stays = replace(drone, waypoints=(Waypoint(0, 0, 0, 10**9), Waypoint(3_000_000, *middle)))  # type: ignore[arg-type]
    replace(crossing, drones=(stays, crossing.drones[1])).verify()
    for waypoint, text in (
        (Waypoint(3_000_000, middle[0] + 2000, *middle[1:]), "distance from its way-point at t = 3.0000 s"),  # type: ignore[arg-type]
        (Waypoint(3_000_001, *middle), "time of a way-point = 3.000001 s: must be one of the knots"),  # type: ignore[arg-type]
    ):
        with pytest.raises(FlatsatError, match=text):
            replace(crossing, drones=(replace(drone, waypoints=(waypoint,)), crossing.drones[1])).verify()


def test_a_certificate_with_another_input_set_is_refused(crossing: Plan) -> None:
    crossing.require_made_for(CERTIFICATE)
    other = replace(CERTIFICATE, limits=replace(CERTIFICATE.limits, thrust_max=13.0))
    with pytest.raises(
        FlatsatError, match=r"thrust_max of certificate .* = 13.0: must be 14.2245 as in the plan 'test'"
    ):
        crossing.require_made_for(other)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("name: test", "name: best", "hash = .*: must be .*, that of the content, which was changed"),
        ("flatsat_plan: 1", "flatsat_plan: 2", "flatsat_plan = 2: must be 1"),
        ("clearance: 0.0", "clear: 0.0", "unknown key 'clear'"),
        ("downwash: 2.0\n", "", "key 'downwash' is missing"),
    ],
)
def test_a_file_that_was_changed_is_refused(crossing: Plan, tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "plan.yaml"
    crossing.save(path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FlatsatError, match=re.escape(str(path)) + ": .*" + text):
        Plan.load(path)


@pytest.mark.parametrize(
    ("place", "old", "new", "text"),
    [
        ("knots", "0.500000", "0.5000001", "line 2 of knots: '0.5000001': must be a decimal with 1 to 6 digits"),
        ("knots", "0.500000", "5e-1", "line 2 of knots: '5e-1': must be a decimal"),
        ("knots", "0.500000", "7.500000", "knots = .* us: must be two or more, increasing from 0"),
        ("control_points", "1.000000000\n", "1.000000000 0.0\n", "line 1 of control_points = .*: must be 3 columns"),
        ("control_points", "0.000000000", "0.000000100", "the first 4 control points differ: must be equal"),
        ("control_points", "0.000000000 0.000000000 1.000000000\n", "", "number of control points = 16: must be 17"),
    ],
)
def test_a_table_is_read_strictly(crossing: Plan, tmp_path: Path, place: str, old: str, new: str, text: str) -> None:
    path = tmp_path / "plan.yaml"
    crossing.save(path)
    document = read_yaml(path, 1 << 20)
    section = document["drones"]["cf1"]
    section[place] = section[place].replace(old, new, 1)
    write_yaml(path, document | {"hash": _digest(document)})
    with pytest.raises(FlatsatError, match=f"drone 'cf1': {text}"):
        Plan.load(path)


def test_another_source_of_a_tube_is_refused() -> None:
    with pytest.raises(FlatsatError, match="source of a tube = 'hope': must be 'given' or 'certificate'"):
        Tube(0.1, "hope")


def test_stated_distances_are_rounded_down(crossing: Plan) -> None:
    found = closest([drone.curve for drone in crossing.drones], crossing.downwash)
    exact = Fraction(int(found.distance[0]), UNIT)
    assert math.floor(exact * 10**4) == crossing.pairs[0].distance


@st.composite
def random_boxes(draw: st.DrawFn) -> Box:
    sides = [
        sorted(draw(st.lists(st.integers(-2 * 10**9, 2 * 10**9), min_size=2, max_size=2, unique=True))) for _ in "xyz"
    ]
    lower, upper = zip(*sides, strict=True)
    return Box("box", lower, upper)


@given(random_curves(), random_boxes(), st.sampled_from([1.0, 2.0, 1.7]))
@settings(max_examples=30)
def test_a_certified_distance_from_a_box_is_below_all_samples_and_near_the_smallest(
    curve: Curve, box: Box, downwash: float
) -> None:
    found = closest_to_boxes([curve], [box], downwash)
    path = as_scipy(curve)(np.linspace(0.0, curve.duration, 4001))
    smallest = metric(path - np.clip(path, *box.corners), downwash).min()
    assert found.distance[0] / UNIT <= smallest + 1e-9
    assert smallest - 0.01 < found.distance[0] / UNIT + 2e-4


@pytest.fixture(scope="module")
def passing() -> Plan:
    """One drone that passes between two boxes, and one that stays away from them."""
    curves = [straight((-1, 0, 1), (1, 0, 1), 20.0, (0, 0.1, 0)), straight((-1, 1.0, 1), (1, 1.0, 1), 20.0)]
    boxes = (Box.between("near", [-0.3, 0.31, 0], [0.3, 0.73, 2]), Box.between("far", [-0.3, -0.9, 0], [0.3, -0.25, 2]))
    return plan_of(curves, obstacles=boxes)


def test_a_plan_with_obstacles_is_proved_saved_and_loaded(passing: Plan, tmp_path: Path) -> None:
    slacks = passing.verify()
    assert [passage[:2] for passage in passing.passages] == [
        ("cf1", "near"), ("cf1", "far"), ("cf2", "near"), ("cf2", "far"),
    ]  # fmt: skip
    assert slacks["cf1, near: distance (m)"] == pytest.approx(passing.passages[0].distance / 1e4 - 0.2, abs=1e-12)
    passing.save(tmp_path / "plan.yaml")
    assert Plan.load(tmp_path / "plan.yaml").to_document() == passing.to_document()


@given(st.floats(1.01, 4.0), st.sampled_from([("cf1", "near"), ("cf1", "far"), ("cf2", "near")]), st.integers(0, 2))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_plan_bent_toward_an_obstacle_is_taken(
    passing: Plan, factor: float, who: tuple[str, str], more: int
) -> None:
    slack = passing.verify()[f"{who[0]}, {who[1]}: distance (m)"]
    (passage,) = (each for each in passing.passages if each[:2] == who)
    (box,) = (each for each in passing.obstacles if each.name == who[1])
    place = passing.trajectory(who[0]).sample((passage.start + passage.end) / 2e6)[:3]
    toward = (np.clip(place, *box.corners) - place) / [1.0, 1.0, passing.downwash]
    move = (factor * slack + 2e-4) * toward / np.linalg.norm(toward) * [1.0, 1.0, passing.downwash]
    span = int(np.searchsorted(passing.drones[0].curve.knots, passage.start, side="right")) - 1
    mutant = bent(passing, who[0], move.tolist(), max(4, span - more), min(13, span + 6 + more))
    loose = replace(BOUNDS, margin=1e-3, jerk_max=1e4, snap_max=1e5)
    with pytest.raises(FlatsatError, match=f"'{who[0]}, {who[1]}: distance' is 0"):
        replace(mutant, bounds=loose, pairs=plan_of([drone.curve for drone in mutant.drones]).pairs).verify()


def test_an_obstacle_counts_body_tube_and_clearance(passing: Plan) -> None:
    slack = passing.verify()["cf1, near: distance (m)"]
    curves = [drone.curve for drone in passing.drones]
    plan_of(curves, tube=0.05 + slack - 1e-4, obstacles=passing.obstacles).verify()
    with pytest.raises(FlatsatError, match=r"'cf1, near: distance' is 0.* must be 0.* m, body and tube"):
        plan_of(curves, tube=0.05 + slack + 1e-4, obstacles=passing.obstacles).verify()
    moved = (replace(passing.obstacles[0], lower=(-(10**9), 3 * 10**8, 0)), passing.obstacles[1])
    with pytest.raises(FlatsatError, match=r"'cf1, near: distance' is 0.* must be 0.* m as stated"):
        replace(passing, obstacles=moved).verify()
    with pytest.raises(FlatsatError, match="passages: must be each drone with each obstacle once"):
        replace(passing, obstacles=moved[:1])
    with pytest.raises(FlatsatError, match=r"names of the obstacles = .*: must be different"):
        plan_of(curves, obstacles=(passing.obstacles[0], passing.obstacles[0]))
