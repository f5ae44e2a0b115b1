"""Flight certificates are refused for vehicles that are not among the plants of their proof."""

from __future__ import annotations

from dataclasses import replace

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
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
        (load_vehicle("cf21_markers"), 0.028, "has a damping of"),
    ):
        with pytest.raises(FlatsatError) as refused:
            require_fit(certificate, other, delay, "cf1")
        assert text in str(refused.value)
    require_fit(load_certificate("cf21_50hz"), slow(vehicle), 0.1, "cf1")  # the old kinds say nothing of that
