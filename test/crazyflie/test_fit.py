"""Flight certificates are refused for vehicles that are not among the plants of their proof."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.crazyflie.fit import require_fit
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle


def slow(vehicle: VehicleProfile) -> VehicleProfile:
    return replace(vehicle, dynamics=replace(vehicle.dynamics, thrust_lag_up=0.2))


def test_a_vehicle_fits_or_the_figure_is_named_that_does_not() -> None:
    certificate, vehicle = load_certificate("cf21_flight_50hz"), load_vehicle("cf21")
    require_fit(certificate, vehicle, 0.028, "cf1")
    for other, delay, text in (
        (vehicle, 0.1, "a delay (dead time and link_delay) of 0.102 s: must be from"),
        (slow(vehicle), 0.028, "a lag of rising thrust of 0.2 s: must be from"),
        (load_vehicle("cf21_markers"), 0.028, "has a damping of 0.452"),
    ):
        with pytest.raises(FlatsatError) as refused:
            require_fit(certificate, other, delay, "cf1")
        assert text in str(refused.value)
    for name in ("cf21_plus", "cf2x_2025", "thrust_kit", "brushless"):
        with pytest.raises(FlatsatError, match=f"; {name}_adaptive_50hz is packaged for this vehicle$"):
            require_fit(load_certificate("cf21_adaptive_50hz"), load_vehicle(name), 0.028, "cf1")
    require_fit(load_certificate("cf21_adaptive_50hz"), vehicle, 0.028, "cf1")
    require_fit(load_certificate("cf21_50hz"), slow(vehicle), 0.1, "cf1")  # the old kinds say nothing of that


CONFIG = Path(__file__).parents[2] / "config"
# what is said of its plants' vehicle in its name: <vehicle>_<kind>_<rate>hz
NAMES = sorted(path.stem for path in CONFIG.glob("*_*_*hz.yaml"))


def test_of_each_vehicle_that_can_fly_one_there_are_tight_and_adaptive_certificates_at_two_rates() -> None:
    vehicles = {path.stem for path in (CONFIG / "vehicles").glob("*.yaml")} - {
        "cf21_markers",
        "cf21_markers_light",
    }  # they lack the thrust
    assert set(NAMES) >= {
        f"{v}_{kind}_{rate}hz" for v in vehicles for kind in ("tight", "adaptive") for rate in (50, 100)
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_packaged_flight_certificate_is_for_its_vehicle_link_and_rate(name: str) -> None:
    vehicle, kind, rate = name.rsplit("_", 2)
    certificate = Certificate.from_document(read_yaml(CONFIG / f"{name}.yaml"))  # not proved again here
    for link_delay in (0.028,) if kind == "flight" else (0.022, 0.028, 0.034):  # the demo's link, and around it
        require_fit(certificate, load_vehicle(vehicle), link_delay, "cf1")
    assert certificate.name == name
    assert certificate.period == pytest.approx(1.0 / float(rate.removesuffix("hz")))
    assert certificate.gain_max == (1.5 if kind in ("tight", "soft") else 4.0)
    assert certificate.limits.thrust_max <= load_vehicle(vehicle).thrust_max
    flight = certificate.flight
    assert flight is not None
    assert flight.margin + 0.4 <= certificate.limits.inner_radius  # what is left for references
    assert flight.horizontal.tube.position < 0.13
