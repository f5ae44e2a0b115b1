"""The flight section of a certificate: strict, the same after a round trip, and every claim is proved again."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from small_flight import BACK, NONE, certificate_of, flight_of

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_return import Return
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube
from flatsat_ros.law.input_set import InputSet

ASSUMPTIONS = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66, pose_age=0.004)


@pytest.fixture(scope="module")
def certificate() -> Certificate:
    design = Design.predicting(0.02, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 30.0, 18.0)
    sides = Axis(PlantBox(Plant(0.029, 0.138), Plant(0.031, 0.142)), False, design, ("lag", "", ""), NONE, BACK)
    softer = replace(design, stiffness=25.0, rate=16.0)
    upright = Axis(PlantBox(Plant(0.03, 0.135), Plant(0.03, 0.14)), True, softer, ("",), NONE, BACK)
    return certificate_of(flight_of(sides, upright, ASSUMPTIONS, 1.5, 2.2, 0.3), 1.4, {"by": "a test"})


@pytest.fixture(scope="module")
def flight(certificate: Certificate) -> FlightSection:
    assert certificate.flight is not None
    return certificate.flight


def test_a_round_trip_changes_nothing(certificate: Certificate, flight: FlightSection, tmp_path: Path) -> None:
    certificate.save(tmp_path / "small.yaml")
    loaded = Certificate.load(tmp_path / "small.yaml")
    assert loaded.flight == flight
    assert loaded.to_document() == certificate.to_document()
    loaded.save(tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "small.yaml").read_bytes()


def test_every_claim_is_checked_without_tolerance(certificate: Certificate, flight: FlightSection) -> None:
    axes = []
    for axis in flight.axes:
        less = {f: v * (1.0 - 1.01e-3) for f, v in asdict(axis.tube).items()}
        back = {f: v * (1.0 - 1.01e-3 * (f != "rate")) for f, v in asdict(axis.back).items()}
        axes.append(replace(axis, tube=AxisTube(**less), back=Return(**back)))
    smaller = replace(certificate, flight=replace(flight, horizontal=axes[0], vertical=axes[1]))
    claims = {name: margin for name, margin in smaller.margins().items() if " tube, " in name or " way back, " in name}
    assert len(claims) == 16
    assert -1e-4 < min(claims.values()) <= max(claims.values()) < 0.0
    with pytest.raises(FlatsatError, match="'flight: horizontal tube, position' fails by"):
        smaller.verify()


@pytest.mark.parametrize("part", ["gain_max", "lag", "delay", "noise", "pose_age", "observer", "back"])
def test_what_is_claimed_for_more_than_is_proved_is_refused(certificate: Certificate, part: str) -> None:
    document = certificate.to_document()
    flight = copy.deepcopy(document["flight"])
    sides = flight["horizontal"]
    if part == "gain_max":
        flight[part] *= 1.02
    elif part in ("noise", "pose_age"):
        flight["assumptions"][part] *= 1.03
    elif part == "observer":
        sides["observer"][2] *= 1.03
    elif part == "back":
        sides["back"]["rate"] *= 1.03
    else:
        sides["high"][part] *= 1.01
    with pytest.raises(FlatsatError, match=r"'flight: .* fails by"):
        Certificate.from_document(document | {"flight": flight}).verify()


def test_the_cap_of_the_gain_must_be_in_the_interval(certificate: Certificate) -> None:
    with pytest.raises(FlatsatError, match="'flight: the cap of the gain is in the interval' fails by"):
        replace(certificate, gain_max=1.6).verify()


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("stiffness", 31.0, "stiffness and rate = (31.0, 18.0): must be (30.0, 18.0), the lower row of the block of P"),
        ("rate", 17.0, "stiffness and rate = (30.0, 17.0): must be (30.0, 18.0)"),
        ("period", 0.01, "period of the flight section = 0.02 s: must be 0.01, that of the law"),
        ("lag", 0.1, "loop is missing"),
    ],
)
def test_a_section_of_another_loop_is_refused(
    certificate: Certificate, flight: FlightSection, key: str, value: float, text: str
) -> None:
    design = replace(flight.horizontal.design, **({key: value} if key in ("stiffness", "rate") else {}))
    other = replace(flight, horizontal=replace(flight.horizontal, design=design))
    with pytest.raises(FlatsatError) as refused:
        replace(certificate, flight=other, **({key: value} if key in ("period", "lag") else {}))
    assert text in str(refused.value)


def started(flight: FlightSection, name: str, distance: float) -> FlightSection:
    """A section whose claims are what a start at a distance, m, adds to them."""
    axis = getattr(flight, name)
    tube = replace(axis.tube, nominal=axis.tube.nominal + axis.back.nominal * distance)
    return replace(flight, **{name: replace(axis, tube=tube)})


def test_starts_within_the_certified_distance_use_no_more_than_what_is_left(
    certificate: Certificate, flight: FlightSection
) -> None:
    limits = certificate.limits
    sides, upright = flight.certified_start(limits)
    assert sides > 0.0
    assert upright > 0.0
    assert float(min(started(flight, "horizontal", sides).left(limits))) == pytest.approx(0.0, abs=1e-9)
    assert float(min(started(flight, "vertical", upright).left(limits))) > -1e-9
    assert replace(flight, disturbance=4.0).certified_start(limits)[0] < 0.0


angles = st.floats(0.0, 2.0 * math.pi)
sizes = st.floats(0.0, 0.6)


@given(
    tilt=st.floats(0.1, 0.6),
    thrust=st.floats(1.3, 1.6),
    claims=st.tuples(sizes, sizes, sizes, sizes, sizes),
    turned=st.tuples(angles, angles, angles),
    shares=st.tuples(*[st.sampled_from([-1.0, 1.0]) | st.floats(-1.0, 1.0)] * 3),
    asked=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
)
def test_with_the_margin_nothing_within_the_claims_brings_the_gain_below_one(
    flight: FlightSection,
    tilt: float,
    thrust: float,
    claims: tuple[float, ...],
    turned: tuple[float, ...],
    shares: tuple[float, ...],
    asked: tuple[float, ...],
) -> None:
    limits, (across, wrong_across, along, wrong_along, most) = InputSet(thrust * GRAVITY, tilt), claims
    sides = replace(flight.horizontal, tube=AxisTube(1.0, 1.0, across, wrong_across))
    upright = replace(flight.vertical, tube=AxisTube(1.0, 1.0, along, wrong_along))
    section = replace(flight, disturbance=most, horizontal=sides, vertical=upright)
    section = replace(section, margin=float(section.taken(limits).tilt_max) + 1e-9)
    assume(min(section.left(limits)) > 1e-3)
    # what a reference asks for, at its margin
    f = np.array(asked)
    f *= float(section.left(limits).tilt_max)
    room = section.room(limits)
    for _ in range(40):
        f *= 1.1 if room.margin(1.1 * f) >= section.margin else 1.0
    assume(room.margin(f) >= section.margin)

    def turned_by(angle: float, radius: float, height: float) -> np.ndarray:
        return np.array([radius * math.cos(angle), radius * math.sin(angle), height])

    nominal = turned_by(turned[0], across, shares[0] * along)
    wrong = turned_by(turned[1], wrong_across, shares[1] * wrong_along)
    disturbance = most * turned_by(turned[2], math.cos(math.pi / 2.0 * shares[2]), math.sin(math.pi / 2.0 * shares[2]))
    assert limits.exit_factor(f - (disturbance - wrong), nominal) >= 1.0 - 1e-12


def test_what_is_taken_of_the_tilt_is_taken_by_something(certificate: Certificate, flight: FlightSection) -> None:
    limits, (sides, upright) = certificate.limits, (axis.tube for axis in flight.axes)
    out = np.array([math.cos(limits.tilt_max), -math.sin(limits.tilt_max)])  # of the cone
    taken = np.array([sides.nominal + sides.disturbance, -upright.nominal - upright.disturbance])
    taken += flight.disturbance * out
    across, up = out * (float(flight.left(limits).tilt_max) + 1e-6) + taken
    assert not limits.contains([across, 0.0, up], 0.0)
    across, up = out * (float(flight.left(limits).tilt_max) - 1e-6) + taken
    assert limits.contains([across, 0.0, up], 0.0)


def test_a_disturbance_that_leaves_no_room_is_refused(certificate: Certificate, flight: FlightSection) -> None:
    with pytest.raises(FlatsatError, match="every applied gain is at least 1' fails by"):
        replace(certificate, flight=replace(flight, disturbance=1.5)).verify()
    with pytest.raises(FlatsatError, match="margin is one that a hovering drone has' fails by"):
        replace(certificate, flight=replace(flight, margin=4.0)).verify()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda d: d.update(more=1), "flight: unknown key 'more'"),
        (lambda d: d.pop("vertical"), "flight: key 'vertical' is missing"),
        (lambda d: d["horizontal"].pop("lead"), "lead"),
        (lambda d: d["horizontal"]["low"].update(mass=1.0), "mass"),
        (lambda d: d["horizontal"].update(lag_varies=1), "flight.horizontal.lag_varies = 1: must be true or false"),
        (
            lambda d: d["horizontal"].update(cuts=[""]),
            "flight.horizontal.cuts = ['']: must be names of figures and '-'",
        ),
        (
            lambda d: d["horizontal"].update(observer=0.3),
            "flight.horizontal.observer = 0.3: must be a list of three gains",
        ),
        (lambda d: d["horizontal"].update(observer=[0.3, 1.0]), "observer = (0.3, 1.0): must be three gains"),
        (
            lambda d: d["vertical"]["tube"].update(position=0.0),
            "flight.vertical.tube.position = 0.0: must be a number above 0",
        ),
        (lambda d: d.update(gain_min=-1.0), "gain_min = -1.0: must be a number above 0"),
        (lambda d: d["assumptions"].update(pose_age=-1.0), "pose_age = -1.0 s: must be a number from 0"),
    ],
)
def test_other_forms_are_refused(certificate: Certificate, change: Callable[[Any], Any], text: str) -> None:
    document = copy.deepcopy(certificate.to_document())
    change(document["flight"])
    with pytest.raises(FlatsatError) as refused:
        Certificate.from_document(document)
    assert text in str(refused.value)


def test_a_file_of_version_1_has_no_flight_section_and_one_of_version_2_has(certificate: Certificate) -> None:
    document = certificate.to_document()
    assert document["flatsat_certificate"] == 2
    with pytest.raises(FlatsatError, match="unknown key 'flight'"):
        Certificate.from_document(document | {"flatsat_certificate": 1})
    del document["flight"]
    with pytest.raises(FlatsatError, match="key 'flight' is missing"):
        Certificate.from_document(document)
    assert replace(certificate, flight=None).to_document()["flatsat_certificate"] == 1


def test_cuts_must_make_cells_of_all_of_the_box(certificate: Certificate) -> None:
    document = copy.deepcopy(certificate.to_document())
    document["flight"]["horizontal"]["cuts"] = "lag -"
    with pytest.raises(FlatsatError, match="number of cuts = 2: must be more, 1 parts are left"):
        Certificate.from_document(document).verify()
