"""Flights that several tests identify."""

import dataclasses

import pytest
from flown import fly

from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.identification.identified import Identified, identify
from flatsat_ros.identification.log import FlightLog
from flatsat_ros.identification.screening import screen


@pytest.fixture(scope="session")
def weak() -> VehicleProfile:
    """A drone with a second-order attitude whose figures differ from those of all packaged profiles."""
    base = load_vehicle("cf2x_2025")
    dynamics = dataclasses.replace(
        base.dynamics, attitude_gain=0.8, velocity_tilt=0.02, thrust_gain=1.0, thrust_lag_up=0.1, thrust_lag_down=0.1
    )
    return dataclasses.replace(base, name="weak", thrust_slope=0.8, dynamics=dynamics)


@pytest.fixture(scope="session")
def logs(weak: VehicleProfile) -> list[FlightLog]:
    """Two flights of it: 30 ms of delay, 0.3 mm of noise, markers askew by 0.01 and -0.02 rad, 90 % of its force."""
    return fly(weak, range(2), seconds=12.0, noise=3e-4, frame=(0.01, -0.02), weight=0.9)


@pytest.fixture(scope="session")
def found(logs: list[FlightLog]) -> Identified:
    """What they tell, with cf21 as the base."""
    return identify([screen(log) for log in logs], load_vehicle("cf21"))
