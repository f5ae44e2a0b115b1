"""Laps: closed references without a seam, flown from rest to rest along the way that is proved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube, Waypoint
from flatsat_ros.plans.laps import Laps, laps_of, with_ramp
from flatsat_ros.plans.pacing import EXCESS

CERTIFICATE = load_certificate("paper_experiment")
BOUNDS = Bounds(margin=0.85, jerk_max=2.0, snap_max=20.0, lower=[-3.0, -3.0, 0.0], upper=[3.0, 3.0, 2.0])  # type: ignore[arg-type]
LAP = 6.0  # s


def circle(angle: float, radius: float = 0.8, seconds: float = LAP) -> Curve:
    angles = angle + 2 * np.pi * np.arange(12) / 12
    points = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.ones(12)], axis=1)
    return Curve.rounded([round(1e6 * seconds * i / 12) for i in range(13)], points, closed=True)


def plan_of(count: int, curves: list[Curve], ramp: float | None = None) -> Plan:
    laps = [curve.trajectory() for curve in curves]
    found = with_ramp(count, laps, BOUNDS, CERTIFICATE.limits)
    drones = [PlannedDrone(f"cf{i + 1}", curve, 0.15, Tube(0.05)) for i, curve in enumerate(curves)]
    return Plan.of(
        drones, name="round", certificate=CERTIFICATE.name, limits=CERTIFICATE.limits, bounds=BOUNDS,
        laps=found if ramp is None else Laps(count, ramp),
    )  # fmt: skip


@pytest.fixture(scope="module")
def opposite() -> Plan:
    """Two drones that chase each other on a circle."""
    return plan_of(3, [circle(0.0), circle(np.pi)])


@st.composite
def closed_curves(draw: st.DrawFn) -> Curve:
    count = draw(st.integers(6, 9))
    lengths = draw(st.lists(st.integers(100_000, 900_000), min_size=count, max_size=count))
    place = st.tuples(*[st.integers(-2_000_000_000, 2_000_000_000)] * 3)
    points = draw(st.lists(place, min_size=count, max_size=count))
    return Curve(tuple(np.cumsum([0, *lengths]).tolist()), tuple(points), closed=True)


@given(closed_curves())
@settings(max_examples=20)
def test_a_closed_curve_is_scipys_and_has_no_seam_up_to_the_snap(curve: Curve) -> None:
    knots, points = np.array(curve.knots) / 1e6, np.array(curve.points) * 1e-9
    padded = np.concatenate([knots[-6:-1] - knots[-1], knots, knots[1:6] + knots[-1]])
    theirs = BSpline(padded, np.concatenate([points, points[:5]]), 5)
    for order in range(5):
        values, divisors = curve.bezier(order)
        exact = values / divisors[:, np.newaxis, np.newaxis]
        ends = exact.astype(float)
        scale = 1.0 + np.abs(ends).max()
        assert np.abs(ends[:, 0] - theirs(knots[:-1], order)).max() < 1e-6 * scale
        assert np.abs(ends[-1, -1] - ends[0, 0]).max() < 1e-12 * scale
        # as integers, cross-multiplied: where a lap ends is exactly where the next one begins
        assert (values[-1, -1] * divisors[0] == values[0, 0] * divisors[-1]).all()


def test_laps_are_flown_along_the_way_from_rest_to_rest(opposite: Plan) -> None:
    laps = opposite.laps
    assert laps is not None
    flown, lap = opposite.trajectory("cf1"), laps_of(opposite.drones[0].curve.trajectory(), 3)
    assert opposite.duration == pytest.approx(3 * LAP + laps.ramp)
    assert flown.times[[0, -1]] == pytest.approx([0.0, opposite.duration])
    for t in (0.0, opposite.duration):
        assert flown.sample(t)[:3] == pytest.approx(lap.sample(0.0)[:3], abs=1e-6)
        assert np.abs(flown.sample(t)[3:]).max() < 1e-9
    for t in np.linspace(laps.ramp, 3 * LAP, 50):  # at full pace
        assert flown.sample(t) == pytest.approx(lap.sample(t - laps.ramp / 2.0), abs=1e-6)
    assert np.isfinite(flown.demand()).all()  # no jerk jumps
    assert np.hypot(*flown.demand()[1]) <= EXCESS * BOUNDS.jerk_max


def test_all_keep_what_is_proved_while_they_set_out_fly_and_stop(opposite: Plan) -> None:
    (pair,) = opposite.pairs
    first, second = opposite.trajectory("cf1"), opposite.trajectory("cf2")
    apart = [
        np.linalg.norm(first.sample(t)[:3] - second.sample(t)[:3]) for t in np.linspace(0.0, opposite.duration, 400)
    ]
    assert 1.45 < pair.distance * 1e-4 <= min(apart) < pair.distance * 1e-4 + 0.01


def test_a_plan_of_laps_is_proved_saved_and_loaded(opposite: Plan, tmp_path: Path) -> None:
    opposite.save(tmp_path / "a.yaml")
    found = Plan.load(tmp_path / "a.yaml")
    assert (found.laps, found.drones[1].curve, found.pairs) == (opposite.laps, opposite.drones[1].curve, opposite.pairs)


def test_the_ramp_is_the_shortest_that_is_allowed_and_shorter_ones_are_refused(opposite: Plan) -> None:
    wide = [circle(0.0, 2.4, 12.0).trajectory()]
    bounds = replace(BOUNDS, acceleration_max=0.7)
    found = with_ramp(3, wide, bounds, CERTIFICATE.limits)
    assert opposite.laps is not None
    assert opposite.laps.ramp < found.ramp < 20.0
    with pytest.raises(
        FlatsatError, match=r"acceleration of a drone that sets out within 2 s = .*: must be at most 0.77"
    ):
        opposite.laps.require_kept(wide, bounds, CERTIFICATE.limits)
    with pytest.raises(FlatsatError, match=r"of a drone that sets out within 1 s = .*: must be at .*: let it take"):
        plan_of(3, [circle(0.0), circle(np.pi)], 1.0).verify()
    with pytest.raises(FlatsatError, match=r"duration of all laps = 6.0 s: must be at least 9 s"):
        Laps(1, 9.0).flown(circle(0.0).trajectory())


def bent(points: FloatArray, laps: Laps | None) -> None:
    Plan.of(
        [PlannedDrone("cf1", Curve.rounded(circle(0.0).knots, points, closed=True), 0.15, Tube(0.05))],
        name="x", certificate="x", limits=CERTIFICATE.limits, bounds=BOUNDS, laps=laps,
    ).verify()  # fmt: skip


def test_what_is_no_plan_of_laps_is_refused(opposite: Plan) -> None:
    points = np.array(circle(0.0).points) * 1e-9
    bent(points, Laps(2, 8.0))
    points[7] *= 1.5
    with pytest.raises(FlatsatError, match=r"'cf1: .*' fails by"):
        bent(points, Laps(2, 8.0))
    with pytest.raises(FlatsatError, match="references: must be closed if there are laps, and else from rest to rest"):
        bent(points, None)
    with pytest.raises(FlatsatError, match=r"durations of a lap = \[6.0, 9.0\] s: must be the same for all drones"):
        plan_of(2, [circle(0.0), circle(np.pi, seconds=9.0)])
    end = np.rint(1e9 * circle(0.0).trajectory().sample(0.0)[:3]).astype(int).tolist()
    late = Waypoint(round(1e6 * LAP), end[0] + 10_000_000, end[1], end[2])
    wrong = replace(opposite, drones=(replace(opposite.drones[0], waypoints=(late,)), opposite.drones[1]))
    with pytest.raises(FlatsatError, match=r"cf1: distance from its way-point at t = 6.0000 s = 0.0"):
        wrong.verify()
    for count in (0, 1001, 1.5, True):
        with pytest.raises(FlatsatError, match=r"number of laps = .*: must be a whole number from 1 to 1000"):
            Laps(count, 4.0)  # type: ignore[arg-type]
    with pytest.raises(FlatsatError, match="number of spans of a closed curve = 5: must be at least 6"):
        Curve(tuple(range(0, 600, 100)), ((0, 0, 0),) * 5, closed=True)
    with pytest.raises(FlatsatError, match="degree of a closed curve = 7: must be 5"):
        Curve(tuple(range(0, 700, 100)), ((0, 0, 0),) * 24, 7, closed=True)
