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
MARGIN, JERK, SNAP, ACCELERATION = default_bounds(FLYING)
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
    tube = certified_tube(FLIGHT, JERK, SNAP, 2.0)
    assert tube.source == "certificate"
    assert RADIUS <= tube.radius <= RADIUS + 1e-4
    require_tubes(plan_of(tube), FLYING)


def test_usual_bounds_leave_room_for_changes_of_pace() -> None:
    assert pytest.approx(FLIGHT.assumptions.jerk) == RESERVE * JERK
    assert pytest.approx(FLIGHT.assumptions.snap) == RESERVE * SNAP
    assert FLIGHT.margin < MARGIN < FLYING.limits.inner_radius


def test_wider_bounds_have_a_larger_tube_and_wild_ones_none() -> None:
    wide = certified_tube(FLIGHT, 2.0 * JERK, 2.0 * SNAP, 2.0)
    assert wide.radius > RADIUS
    with pytest.raises(
        FlatsatError, match=r"tube of cf1 = .*: must be at least .*certificate 'cf21_flight_50hz' proves"
    ):
        require_tubes(plan_of(Tube(RADIUS, "certificate"), jerk_max=2.0 * JERK, snap_max=2.0 * SNAP), FLYING)
    with pytest.raises(FlatsatError, match=r"jerk_max 30 m/s\^3, snap_max 400 m/s\^4: need = .*: must be less"):
        certified_tube(FLIGHT, 30.0, 400.0, 2.0)


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
    assert default_bounds(paper) == (paper.limits.inner_radius / 2.0, 2.0, 20.0, None)
