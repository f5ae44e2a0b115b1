"""The demo flies plan files: from the floor below their first points, by the certificate that proves their tubes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.demo import exchange, headless
from flatsat_ros.demo.record import RobotRecord, failures
from flatsat_ros.demo.scenario import planned_flight, record_of
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.planning import Round
from flatsat_ros.plans import Curve, Plan, PlannedDrone
from flatsat_ros.plans.tubes import promise

CERTIFICATE = load_certificate(DEFAULT_CERTIFICATE)


@pytest.fixture(autouse=True)
def loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its proof takes seconds: once is enough."""
    found = CERTIFICATE, config_path(DEFAULT_CERTIFICATE)
    monkeypatch.setattr("flatsat_ros.demo.scenario.default_certificate", lambda: found)
    monkeypatch.setattr("flatsat_ros.demo.exchange.default_certificate", lambda: found)


def save(path: Path, *places: tuple[float, float, float]) -> Path:
    """A plan in which drones move by 0.3 m along y in 6 s."""
    bounds, tube = promise(CERTIFICATE, [-1.0, -1.0, -0.5], [30.0, 1.0, 3.0], downwash=2.0)
    share = np.clip((np.arange(13) - 3) / 6, 0.0, 1.0)[:, np.newaxis]
    moved = share * share * (3 - 2 * share) * np.array([0.0, 0.3, 0.0])
    curves = [Curve.rounded([750_000 * i for i in range(9)], np.array(place) + moved) for place in places]
    drones = [PlannedDrone(f"cf{i}", curve, 0.1, tube) for i, curve in enumerate(curves, 1)]
    Plan.of(drones, name="b", certificate=CERTIFICATE.name, limits=CERTIFICATE.limits, bounds=bounds).save(path)
    return path


def test_two_drones_exchange_their_places_in_wind_inside_their_tubes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange, "SECONDS", 0.0)  # the first plan will do
    found: list[Round] = []
    scenario = exchange.exchange(tmp_path, 2, 0.4, found.append)
    assert scenario.duration == found[-1].duration
    flown = headless.fly(scenario)
    summary = flown.summary()
    assert failures(summary) == []
    assert summary["plan"]["certificate"] == CERTIFICATE.name
    assert all(0.0 < share < 1.0 for share in summary["plan"]["tube_share_max"].values())
    (pair,) = summary["plan"]["pairs"]
    assert pair["certified_m"] >= 0.3  # both bodies
    # they are where their references are, give or take both tubes
    tubes = sum(drone.tube.radius for drone in flown.plan.drones)  # type: ignore[union-attr]
    assert pair["certified_m"] < pair["measured_m"] < pair["certified_m"] + 2.0 * tubes
    assert summary["separation_min_m"] >= pair["measured_m"]


def test_what_a_plan_proves_and_its_flight_broke_is_named(tmp_path: Path) -> None:
    scenario = planned_flight(save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6), (0.6, 0.0, 0.6)))
    assert scenario.plan is not None
    tube = scenario.plan.plan.drones[0].tube.radius
    times = np.arange(0.0, scenario.duration + 0.1, 0.01)
    ticks = np.zeros((2, 1 + len(FIELDS)))
    ticks[:, 1 + FIELDS.index("mode")] = Mode.FLY, Mode.IDLE
    robots = {}
    for name, swap, off in zip(scenario.robots, scenario.swaps, (0.1, -0.05), strict=True):
        poses = np.array([[t, *(swap.sample(t)[:3] + (off, 0.0, 0.0))] for t in times])
        poses[-1, 3] = 0.0  # landed
        robots[name] = RobotRecord(poses, ticks, np.empty((0, 5)), swap)
    summary = record_of(scenario, robots, 0.0).summary()
    plan = summary["plan"]
    assert plan["tube_share_max"] == pytest.approx({"cf1": 0.1 / tube, "cf2": 0.05 / tube})
    assert plan["pairs"] == [
        {
            "first": "cf1",
            "second": "cf2",
            "certified_m": pytest.approx(0.6 - 2.0 * tube, abs=1e-4),
            "measured_m": pytest.approx(0.45),
        }
    ]
    assert any("cf1: 1.1" in sentence and "promised to stay inside" in sentence for sentence in failures(summary))
    plan["pairs"][0]["certified_m"] = 0.5
    assert failures(summary)[-1] == "cf1, cf2: 0.450 m apart, proved 0.500 m"


@given(count=st.integers(2, exchange.ROBOTS_MAX))
def test_drones_of_an_exchange_stand_apart_and_go_to_the_other_side(count: int) -> None:
    mission = exchange.mission_of(CERTIFICATE, count)
    starts, goals = mission.waypoints[:, 0], mission.waypoints[:, 1]
    assert np.allclose(goals[:, :2], -starts[:, :2])
    apart = np.linalg.norm(starts[:, np.newaxis] - starts, axis=2) + 10.0 * np.eye(count)
    assert apart.min() > 0.74


def test_a_plan_that_begins_on_the_floor_is_flown_above_a_lower_one(tmp_path: Path) -> None:
    scenario = planned_flight(save(tmp_path / "plan.yaml", (0.0, 0.0, -0.22)))
    assert scenario.floor == -0.8
    assert scenario.height == pytest.approx(0.58)
    summary = headless.fly(scenario).summary()
    assert failures(summary) == []
    assert summary["robots"]["cf1"]["landed"]
    assert planned_flight(save(tmp_path / "higher.yaml", (0.0, 0.0, 0.3))).floor == 0.0


@pytest.mark.parametrize("wind", [-0.1, 1.2, float("nan")])
def test_wind_that_the_certificate_does_not_assume_is_refused(wind: float, tmp_path: Path) -> None:
    path = save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6))
    with pytest.raises(FlatsatError, match=r"--wind = .* m/s: must be from 0 to 1\.096 m/s"):
        planned_flight(path, wind)


def test_drones_that_would_stand_too_near_to_each_other_are_named(tmp_path: Path) -> None:
    path = save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6), (0.1, 0.0, 2.0))
    with pytest.raises(FlatsatError, match=r"distance of cf1 and cf2 on the floor below their first .* = 0.1 m: must"):
        planned_flight(path)


def test_small_drones_stand_as_near_to_each_other_as_their_plan_leads_them(tmp_path: Path) -> None:
    scenario = planned_flight(save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6), (0.38, 0.0, 0.6)))
    assert scenario.plan is not None
    first, second = scenario.plan.plan.drones
    assert 0.3 < scenario.policy.separation < float(first.radius + second.radius) < 0.37
    far = planned_flight(save(tmp_path / "far.yaml", (0.0, 0.0, 0.6)))
    assert far.policy.separation == Policy().separation


def test_a_plan_that_leaves_the_room_is_refused_before_anything_flies(tmp_path: Path) -> None:
    path = save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6), (25.0, 0.0, 0.6))
    with pytest.raises(FlatsatError, match=r"x of the reference of cf2 = 25\.0 m: must be from -20 to 20 m"):
        planned_flight(path)
