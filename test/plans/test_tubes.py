"""Tubes of plans that a certificate proves, and plans whose tubes it does not prove."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube
from flatsat_ros.plans.tubes import RESERVE, certified_tube, default_bounds, require_tubes

FLYING = Certificate.from_document(read_yaml(config_path("cf21_flight_50hz")))  # not proved again here
FLIGHT = FLYING.flight
assert FLIGHT is not None
MARGIN, JERK, SNAP, ACCELERATION, _ = default_bounds(FLYING)
RADIUS = math.hypot(FLIGHT.horizontal.tube.position, FLIGHT.vertical.tube.position / 2.0)


def plan_of(tube: Tube, seconds: int = 12, **changes: float) -> Plan:
    """One drone that flies a metre."""
    points = np.array([[0.0, 0.0, 1.0]] * 4 + [[0.5, 0.0, 1.0]] * 3 + [[1.0, 0.0, 1.0]] * 4)
    curve = Curve.rounded([seconds * 1_000_000 * i // 6 for i in range(7)], points)
    figures = {"margin": MARGIN, "jerk_max": JERK, "snap_max": SNAP, "acceleration_max": ACCELERATION} | changes
    bounds = Bounds(**figures, lower=np.array([-1.0, -1.0, 0.0]), upper=np.array([2.0, 1.0, 2.0]))
    drones = [PlannedDrone("cf1", curve, 0.1, tube)]
    plan = Plan.of(drones, name="way", certificate=FLYING.name, limits=FLYING.limits, bounds=bounds)
    plan.verify()
    return plan


def test_usual_bounds_have_the_tube_of_the_certificate() -> None:
    tube = certified_tube(FLIGHT, FLYING.limits, JERK, SNAP, 2.0)
    assert tube.source == "certificate"
    assert RADIUS <= tube.radius <= RADIUS + 1e-4
    require_tubes(plan_of(tube), FLYING)


def test_usual_bounds_leave_room_for_changes_of_pace() -> None:
    assert pytest.approx(FLIGHT.assumptions.jerk) == RESERVE * JERK
    assert pytest.approx(FLIGHT.assumptions.snap) == RESERVE * SNAP
    assert FLIGHT.margin < MARGIN < FLYING.limits.inner_radius


def test_wider_bounds_have_a_larger_tube_and_wild_ones_none() -> None:
    wide = certified_tube(FLIGHT, FLYING.limits, 2.0 * JERK, 2.0 * SNAP, 2.0)
    assert wide.radius > RADIUS
    with pytest.raises(
        FlatsatError, match=r"tube of cf1 = .*: must be at least .*certificate 'cf21_flight_50hz' proves"
    ):
        require_tubes(plan_of(Tube(RADIUS, "certificate"), jerk_max=2.0 * JERK, snap_max=2.0 * SNAP), FLYING)
    with pytest.raises(FlatsatError, match=r"jerk_max 30 m/s\^3, snap_max 400 m/s\^4: need = .*: must be less"):
        certified_tube(FLIGHT, FLYING.limits, 30.0, 400.0, 2.0)


def test_what_differs_is_named() -> None:
    good = plan_of(Tube(RADIUS + 1e-3, "certificate"))
    require_tubes(good, FLYING)
    with pytest.raises(FlatsatError, match="has no flight section"):
        require_tubes(good, replace(FLYING, flight=None))
    with pytest.raises(FlatsatError, match="must be at least 0"):
        require_tubes(plan_of(Tube(RADIUS - 1e-3, "certificate")), FLYING)
    with pytest.raises(FlatsatError, match=r"margin = 1.0.*must be at least 2.6"):
        require_tubes(plan_of(Tube(RADIUS + 1e-3, "certificate"), margin=1.0), FLYING)
    with pytest.raises(FlatsatError, match="tilt_max of certificate"):
        require_tubes(good, load_certificate("paper_experiment"))


def test_given_tubes_are_nobodys_business() -> None:
    require_tubes(plan_of(Tube(1e-3)), replace(FLYING, flight=None))


def test_certificates_without_a_flight_section_have_the_bounds_of_before() -> None:
    paper = load_certificate("paper_experiment")
    assert default_bounds(paper) == (paper.limits.inner_radius / 2.0, 2.0, 20.0, None, None)


def test_a_plan_that_asks_the_law_for_more_than_its_accelerations_is_refused() -> None:
    flying = Certificate.from_document(read_yaml(config_path("cf21_adaptive_50hz")))  # not proved again here
    assert flying.flight is not None
    usual = default_bounds(flying)
    tube = certified_tube(flying.flight, flying.limits, usual.jerk, usual.snap, 2.0)
    places = 60.0 * np.clip((np.arange(45) - 11) / 22, 0.0, 1.0)
    places = np.convolve(np.pad(places, 7, mode="edge"), np.ones(15) / 15.0, mode="valid")
    points = np.column_stack([places, np.zeros(45), np.ones(45)])

    def flown(seconds: int) -> Plan:
        curve = Curve.rounded([seconds * 1_000_000 * i // 40 for i in range(41)], points)
        box = {"lower": np.array([-1.0, -1.0, 0.0]), "upper": np.array([61.0, 1.0, 2.0])}
        bounds = Bounds(flying.flight.margin, usual.jerk, usual.snap, **box, acceleration_max=usual.acceleration)
        drones = [PlannedDrone("cf1", curve, 0.1, tube)]
        plan = Plan.of(drones, name="way", certificate=flying.name, limits=flying.limits, bounds=bounds)
        plan.verify()
        return plan

    require_tubes(flown(60), flying)
    with pytest.raises(FlatsatError, match=r"margin of what the reference of cf1 asks the law for.* must be at least"):
        require_tubes(flown(28), flying)


def test_usual_speeds_leave_what_the_law_is_asked_for_the_margin() -> None:
    flying = Certificate.from_document(read_yaml(config_path("cf21_adaptive_50hz")))
    flight, usual = flying.flight, default_bounds(flying)
    assert flight is not None
    assert usual.speed is not None
    model, away = flight.horizontal.design.model, np.array([1.0, 0.0, 0.0])
    # the largest acceleration that the margin leaves along x, at the largest speed and jerk
    most = max(a for a in np.linspace(0.0, 1.0, 2001) if flying.limits.margin(a * away) >= usual.margin)
    f = most + model.drag * usual.speed + model.lead * (usual.jerk + model.drag * most)
    assert flight.room(flying.limits).margin(RESERVE * f * away) >= flight.margin
    with pytest.raises(FlatsatError, match=r"speed_max = 9.0 m/s: must be below 1\."):
        default_bounds(flying, 9.0)
