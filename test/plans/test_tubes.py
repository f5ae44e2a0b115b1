"""Tubes of plans that a certificate proves, and plans whose tubes it does not prove."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.flight.preview import needed_margin
from flatsat_ros.plans import Curve, Plan, PlannedDrone, Tube
from flatsat_ros.plans.tubes import RESERVE, promise, require_tubes

FLYING = Certificate.from_document(read_yaml(config_path("cf21_flight_50hz")))  # not proved again here
FLIGHT = FLYING.flight
assert FLIGHT is not None
BOX = {"lower": np.array([-1.0, -1.0, 0.0]), "upper": np.array([61.0, 1.0, 2.0])}
BOUNDS, TUBE = promise(FLYING, **BOX, downwash=2.0)
ADAPTIVE = Certificate.from_document(read_yaml(config_path("cf21_adaptive_50hz")))  # likewise
NARROWED = ("margin", "jerk_max", "snap_max", "thrust_max", "thrust_min")  # what goes with a tube
RADIUS = math.hypot(FLIGHT.horizontal.tube.position, FLIGHT.vertical.tube.position / 2.0)


def plan_of(tube: Tube, seconds: int = 12, **changes: Any) -> Plan:
    """One drone that flies a metre."""
    points = np.array([[0.0, 0.0, 1.0]] * 4 + [[0.5, 0.0, 1.0]] * 3 + [[1.0, 0.0, 1.0]] * 4)
    curve = Curve.rounded([seconds * 1_000_000 * i // 6 for i in range(7)], points)
    bounds = replace(BOUNDS, **changes)
    drones = [PlannedDrone("cf1", curve, 0.1, tube)]
    plan = Plan.of(drones, name="way", certificate=FLYING.name, limits=FLYING.limits, bounds=bounds)
    plan.verify()
    return plan


def test_usual_bounds_have_the_tube_of_the_certificate() -> None:
    assert TUBE.source == "certificate"
    assert RADIUS <= TUBE.radius <= RADIUS + 1e-4
    require_tubes(plan_of(TUBE), FLYING)


@pytest.mark.parametrize("certificate", [FLYING, ADAPTIVE], ids=lambda each: each.name)
def test_usual_bounds_leave_room_for_changes_of_pace(certificate: Certificate) -> None:
    flight, (bounds, _) = certificate.flight, promise(certificate, **BOX, downwash=2.0)
    assert flight is not None
    assert pytest.approx(flight.assumptions.jerk) == RESERVE * bounds.jerk_max
    assert pytest.approx(flight.assumptions.snap) == RESERVE * bounds.snap_max
    room = bounds.room(certificate.limits)
    assert room == flight.room(certificate.limits)
    for way in ([1.0, 0.0, 0.0], [-0.6, 0.8, 0.0]):  # how far f may go along it, and a tenth farther
        most = max(f for f in np.linspace(0.0, 3.0, 3001) if room.margin(f * np.array(way)) >= bounds.margin)
        assert room.margin(RESERVE * most * np.array(way)) >= flight.margin


def test_wider_bounds_have_a_larger_tube_and_wild_ones_none() -> None:
    twice = {"jerk_max": 2.0 * BOUNDS.jerk_max, "snap_max": 2.0 * BOUNDS.snap_max}
    assert promise(FLYING, **BOX, downwash=2.0, **twice).tube.radius > RADIUS
    with pytest.raises(
        FlatsatError, match=r"tube of cf1 = .*: must be at least .*certificate 'cf21_flight_50hz' proves"
    ):
        require_tubes(
            plan_of(Tube(RADIUS, "certificate"), **twice, margin=2.8, thrust_max=13.5, thrust_min=1.0), FLYING
        )
    with pytest.raises(FlatsatError, match=r"jerk_max 30 m/s\^3, snap_max 400 m/s\^4: need = .*: must be less"):
        promise(FLYING, **BOX, downwash=2.0, jerk_max=30.0, snap_max=400.0)


def test_smaller_bounds_have_smaller_tubes_that_plans_may_state() -> None:
    bounds, tube = promise(FLYING, **BOX, downwash=2.0, jerk_max=0.2, snap_max=0.1)
    assert tube.radius < RADIUS
    kept = {name: getattr(bounds, name) for name in NARROWED}
    require_tubes(plan_of(tube, 30, **kept), FLYING)
    closer, looser = plan_of(Tube(tube.radius - 1e-4, "certificate"), 30, **kept), plan_of(tube, 30)
    for wrong in (closer, looser):  # a smaller one, and one that is not proved for what the references may ask
        with pytest.raises(FlatsatError, match=r"tube of cf1 = .*: must be at least"):
            require_tubes(wrong, FLYING)


def test_a_wanted_tube_is_proved_for_slower_references_or_is_the_users_word() -> None:
    usual, wanted = BOUNDS.jerk_max, math.floor(1e4 * (RADIUS - 0.001)) / 1e4
    bounds, tube = promise(FLYING, **BOX, downwash=2.0, tube=wanted)
    assert tube == Tube(wanted, "certificate")
    assert 0.0 < bounds.jerk_max < usual
    require_tubes(plan_of(tube, 30, **{name: getattr(bounds, name) for name in NARROWED}), FLYING)
    larger = promise(FLYING, **BOX, downwash=2.0, tube=0.1)
    assert (larger.bounds.jerk_max, larger.tube) == (usual, Tube(0.1, "certificate"))
    for none in ({"tube": 0.01}, {"tube": wanted, "jerk_max": 30.0}):
        assert promise(FLYING, **BOX, downwash=2.0, **none).tube == Tube(none["tube"])


@pytest.mark.parametrize("radius", [math.nan, math.inf, -0.1, "wide"])
def test_a_wanted_tube_that_is_no_distance_is_refused(radius: Any) -> None:
    with pytest.raises(FlatsatError, match=r"radius = .* m: must be a number from 0"):
        promise(FLYING, **BOX, downwash=2.0, tube=radius)


def test_what_differs_is_named() -> None:
    good = plan_of(Tube(RADIUS + 1e-3, "certificate"))
    require_tubes(good, FLYING)
    with pytest.raises(FlatsatError, match="has no flight section"):
        require_tubes(good, replace(FLYING, flight=None))
    with pytest.raises(FlatsatError, match="must be at least 0"):
        require_tubes(plan_of(Tube(RADIUS - 1e-3, "certificate")), FLYING)
    for changes, text in (
        ({"margin": 1.0}, r"margin = 1.0 m/s\^2: must be at least 2.*, of which the certificate needs 2.6"),
        ({"margin": math.nextafter(BOUNDS.margin, 0.0)}, "margin = .* of which the certificate needs 2.6"),
        ({"drag": (0.1, 0.2)}, r"drag = \(0.1, 0.2\): must be .*, of certificate 'cf21_flight_50hz'"),
        ({"lead": (0.0, 0.0)}, r"lead = \(0.0, 0.0\): must be .*, of certificate 'cf21_flight_50hz'"),
    ):
        with pytest.raises(FlatsatError, match=text):
            require_tubes(plan_of(TUBE, **changes), FLYING)
    with pytest.raises(FlatsatError, match="tilt_max of certificate"):
        require_tubes(good, load_certificate("paper_experiment"))


def test_given_tubes_are_nobodys_business() -> None:
    require_tubes(plan_of(Tube(1e-3)), replace(FLYING, flight=None))


def test_certificates_without_a_flight_section_have_the_bounds_of_before() -> None:
    paper = load_certificate("paper_experiment")
    bounds, tube = promise(paper, **BOX, downwash=2.0)
    assert (bounds.margin, bounds.jerk_max, bounds.snap_max) == (paper.limits.inner_radius / 2.0, 2.0, 20.0)
    assert bounds.asked == {2: [1, 1, 1]}
    assert (tube.radius, tube.source) == (0.05, "given")


def far(seconds: int, **changes: Any) -> Plan:
    """One drone that flies 60 m, most of them at one speed."""
    bounds, tube = promise(ADAPTIVE, **BOX, downwash=2.0)
    places = 60.0 * np.clip((np.arange(45) - 11) / 22, 0.0, 1.0)
    places = np.convolve(np.pad(places, 7, mode="edge"), np.ones(15) / 15.0, mode="valid")
    points = np.column_stack([places, np.zeros(45), np.ones(45)])
    curve = Curve.rounded([seconds * 1_000_000 * i // 40 for i in range(41)], points)
    drones = [PlannedDrone("cf1", curve, 0.1, tube)]
    bounds = replace(bounds, **changes)
    return Plan.of(drones, name="way", certificate=ADAPTIVE.name, limits=ADAPTIVE.limits, bounds=bounds)


def test_a_plan_that_asks_the_law_for_more_than_its_accelerations_is_refused() -> None:
    slow, fast = far(60), far(28)
    slow.verify()
    require_tubes(slow, ADAPTIVE)
    with pytest.raises(FlatsatError, match=r"'cf1: margin, tilt_max' fails by .*"):
        fast.verify()
    calm = far(28, drag=(0.0, 0.0), lead=(0.0, 0.0))  # its accelerations alone have the margin
    calm.verify()
    with pytest.raises(FlatsatError, match=r"drag = \(0.0, 0.0\): must be \(0.456, 0.424\)"):
        require_tubes(calm, ADAPTIVE)


def test_what_a_plan_proves_is_what_the_flight_section_needs_in_flight() -> None:
    plan = far(58)  # just slow enough
    plan.verify()
    flight, path = ADAPTIVE.flight, plan.trajectory("cf1")
    assert flight is not None
    demand = flight.demanded(path.demand(), needed_margin(path, ADAPTIVE.limits, flight))
    assert 0.9 < demand <= 1.0


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"acceleration_max": None}, "acceleration_max = None m/s.2: must be at most 0.81"),
        ({"acceleration_max": 0.9}, "acceleration_max = 0.9 m/s.2: must be at most 0.81"),
        ({"thrust_max": None}, "thrust_max = 14.2.* m/s.2: must be 14.0.*, which the certificate leaves to references"),
    ],
)
def test_what_a_flight_section_with_drag_assumes_is_asked_of_plans(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(FlatsatError, match=text):
        require_tubes(far(60, **changes), ADAPTIVE)
