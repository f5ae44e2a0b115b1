"""The flight certificate's file: strict, the same after a round trip, and every claim is proved again."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.flight_cell import Box
from flatsat_ros.certificate.flight_certificate import Axis, FlightCertificate
from flatsat_ros.certificate.flight_loop import Design, Plant
from flatsat_ros.certificate.flight_return import Return
from flatsat_ros.certificate.flight_tube import Assumptions, Tube
from flatsat_ros.law.input_set import InputSet

ASSUMPTIONS = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66)
NONE, BACK = Tube(1.0, 1.0, 1.0, 1.0), Return(0.5, 1.0, 1.0, 1.0, 1.0)


def certificate_of(horizontal: Axis, vertical: Axis) -> FlightCertificate:
    """A certificate whose claims are what is proved, a little enlarged."""
    proved = []
    for axis in (horizontal, vertical):
        tube = axis.proved(1.0, 1.5, ASSUMPTIONS)
        back = {f: v * (1.001 if f != "rate" else 1.0) for f, v in asdict(axis.returned(1.0, 1.5)).items()}
        larger = Tube(**{f: 1.001 * v for f, v in asdict(tube).items()})
        proved.append(replace(axis, tube=larger, back=Return(**back)))
    return FlightCertificate(
        "small", InputSet(14.2, 0.262, 9.81), 1.0, 1.5, 2.0, 0.3, ASSUMPTIONS, *proved, {"by": "a test"}
    )


@pytest.fixture(scope="module")
def certificate() -> FlightCertificate:
    design = Design.predicting(0.02, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 30.0, 18.0)
    sides = Axis(Box(Plant(0.029, 0.138), Plant(0.031, 0.142)), False, design, ("lag", "", ""), NONE, BACK)
    upright = Axis(Box(Plant(0.03, 0.135), Plant(0.03, 0.14)), True, design, ("",), NONE, BACK)
    return certificate_of(sides, upright)


def test_a_round_trip_changes_nothing(certificate: FlightCertificate, tmp_path: Path) -> None:
    certificate.save(tmp_path / "small.yaml")
    loaded = FlightCertificate.load(tmp_path / "small.yaml")
    assert loaded == certificate
    loaded.save(tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_bytes() == (tmp_path / "small.yaml").read_bytes()


def test_every_claim_is_checked_without_tolerance(certificate: FlightCertificate) -> None:
    assert min(certificate.verify().values()) >= 0.0
    axes = {}
    for name in ("horizontal", "vertical"):
        axis: Axis = getattr(certificate, name)
        less = {f: v * (1.0 - 1.01e-3) for f, v in asdict(axis.tube).items()}
        back = {f: v * (1.0 - 1.01e-3 * (f != "rate")) for f, v in asdict(axis.back).items()}
        axes[name] = replace(axis, tube=Tube(**less), back=Return(**back))
    weaker = replace(certificate, **axes)
    claims = {name: margin for name, margin in weaker.margins().items() if " tube, " in name or " way back, " in name}
    assert len(claims) == 16
    assert -1e-4 < min(claims.values()) <= max(claims.values()) < 0.0
    with pytest.raises(FlatsatError, match="'horizontal tube, position' fails by"):
        weaker.verify()


@pytest.mark.parametrize("part", ["gain_max", "lag", "delay", "noise", "observer", "rate", "back"])
def test_what_is_claimed_for_more_than_is_proved_is_refused(certificate: FlightCertificate, part: str) -> None:
    document = certificate.to_document()
    sides = document["horizontal"]
    if part == "gain_max":
        document["sampling"][part] *= 1.03
    elif part == "noise":
        document["assumptions"][part] *= 1.03
    elif part == "observer":
        sides["observer"][2] *= 1.03
    elif part == "back":
        sides["back"]["rate"] *= 1.03
    elif part == "rate":
        sides["rate"] *= 1.03
    else:
        sides["high"][part] *= 1.01
    with pytest.raises(FlatsatError, match="fails by"):
        FlightCertificate.from_document(document).verify()


def test_starts_within_the_certified_distance_use_no_more_than_the_room(certificate: FlightCertificate) -> None:
    room = certificate.margin - certificate.disturbance
    room -= math.hypot(certificate.horizontal.tube.disturbance, certificate.vertical.tube.disturbance)
    axes = (certificate.horizontal, certificate.vertical)
    for start, axis, other in zip(certificate.certified_start(), axes, axes[::-1], strict=True):
        assert start > 0.0
        assert math.hypot(axis.tube.nominal + axis.back.nominal * start, other.tube.nominal) == pytest.approx(room)
    assert replace(certificate, margin=0.5).certified_start()[0] < 0.0


def test_a_disturbance_that_leaves_no_room_is_refused(certificate: FlightCertificate) -> None:
    with pytest.raises(FlatsatError, match="every applied gain is at least 1' fails by"):
        replace(certificate, disturbance=1.5).verify()
    with pytest.raises(FlatsatError, match="margin is one that a hovering drone has' fails by"):
        replace(certificate, margin=4.0).verify()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda d: d.update(flatsat_certificate=1), "flatsat_certificate = 1: must be 2, that of flight certificates"),
        (lambda d: d.update(more=1), "more"),
        (lambda d: d.pop("vertical"), "vertical"),
        (lambda d: d["horizontal"].pop("lead"), "lead"),
        (lambda d: d["horizontal"]["low"].update(mass=1.0), "mass"),
        (lambda d: d["horizontal"].update(lag_varies=1), "horizontal.lag_varies = 1: must be true or false"),
        (lambda d: d["horizontal"].update(cuts=[""]), "horizontal.cuts = ['']: must be names of figures and '-'"),
        (lambda d: d["horizontal"].update(observer=0.3), "horizontal.observer = 0.3: must be a list of three gains"),
        (lambda d: d["horizontal"].update(observer=[0.3, 1.0]), "observer = (0.3, 1.0): must be three gains"),
        (
            lambda d: d["vertical"]["tube"].update(position=0.0),
            "vertical.tube.position = 0.0: must be a number above 0",
        ),
        (lambda d: d["sampling"].update(gain_min=-1.0), "gain_min = -1.0: must be a number above 0"),
        (lambda d: d.update(name=""), "name = '': must be a non-empty string"),
    ],
)
def test_other_forms_are_refused(certificate: FlightCertificate, change: Callable[[Any], Any], text: str) -> None:
    document = copy.deepcopy(certificate.to_document())
    change(document)
    with pytest.raises(FlatsatError) as refused:
        FlightCertificate.from_document(document)
    assert text in str(refused.value)


def test_cuts_must_make_cells_of_all_of_the_box(certificate: FlightCertificate) -> None:
    document = certificate.to_document()
    document["horizontal"]["cuts"] = "lag -"
    with pytest.raises(FlatsatError, match="number of cuts = 2: must be more, 1 parts are left"):
        FlightCertificate.from_document(document).verify()
