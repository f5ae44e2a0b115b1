"""Attacks on plans: none succeeds where tubes are proved; a tube that is too small is found out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.falsification import plans
from flatsat_ros.falsification.plans import attack, report, tasks
from flatsat_ros.flight.plausibility import PoseScreen
from flatsat_ros.plans import Curve, Plan, PlannedDrone, Tube
from flatsat_ros.plans.tubes import promise

FLYING = Certificate.from_document(read_yaml(config_path("cf21_flight_50hz")))  # not proved again here


def plan_of(tube: Tube, height: float = 1.0) -> Plan:
    """Two drones that move side by side by 0.2 m in 4 s."""
    bounds, _ = promise(FLYING, [-1.0, -1.0, height - 1.0], [3.0, 1.0, 3.0], downwash=2.0)
    share = np.clip((np.arange(13) - 3) / 6, 0.0, 1.0)[:, np.newaxis]
    moved = share * share * (3 - 2 * share) * np.array([0.0, 0.1, 0.0])
    curves = [Curve.rounded([500_000 * i for i in range(9)], np.array([x, 0.0, height]) + moved) for x in (0.0, 0.5)]
    drones = [PlannedDrone(f"cf{i}", curve, 0.15, tube) for i, curve in enumerate(curves, 1)]
    plan = Plan.of(drones, name="side", certificate=FLYING.name, limits=FLYING.limits, bounds=bounds)
    plan.verify()
    return plan


@pytest.fixture(scope="module")
def tube() -> Tube:
    return promise(FLYING, [-1.0, -1.0, 0.0], [3.0, 1.0, 3.0], downwash=2.0).tube


def test_no_attack_succeeds_and_smaller_tubes_are_left(tube: Tube, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "_DRONES", 4)
    found = attack(plan_of(tube), FLYING, 1)
    assert (found.flights, found.breaches) == (4, 0)
    assert 0.0 < found.outside < 1.0
    assert found.nearest is not None
    assert 0.2 - 2.0 * tube.radius < found.nearest < 0.2 + 2.0 * tube.radius
    assert attack(plan_of(tube), FLYING, 1) == found
    given = attack(plan_of(Tube(tube.radius * found.outside / 2.0)), FLYING, 1)
    assert given.outside == pytest.approx(2.0)
    assert given.breaches > 0
    assert "8 flights of 1 plans in 2 s: " in report([("a", found), ("a", given)], 2.0)


def test_plans_below_the_origin_are_attacked_in_the_air_as_well(tube: Tube, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plans, "_DRONES", 2)
    assert attack(plan_of(tube, -0.3), FLYING, 1).breaches == 0


def test_what_is_not_claimed_is_not_attacked(tube: Tube) -> None:
    with pytest.raises(FlatsatError, match="claims no tubes to attack"):
        attack(plan_of(tube), replace(FLYING, flight=None), 0)


def test_copies_are_apart_and_no_farther_away_than_poses_are_believed() -> None:
    places = np.array(plans._places(plans._DRONES))
    assert len(np.unique(places, axis=0)) == plans._DRONES
    assert np.diff(np.unique(places)).min() == 30.0
    assert PoseScreen(1).refuse(
        0, 0.0, [*places.max(axis=0), 1.0], [0.0, 0.0, 0.0, 1.0], 0.0, -1.0, [0.0] * 3, [0.0] * 9, True, True
    ) is None  # fmt: skip


def test_plans_take_turns() -> None:
    given = tasks(2, 5)
    assert [next(given) for _ in range(4)] == [(0, 5), (1, 5), (0, 6), (1, 6)]
