"""Vehicle profiles: whatever is loaded flies, and turns every thrust into a command that the firmware takes."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.base.resources import config_path
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile
from flatsat_ros.crazyflie.wire import Backend, YawMode, setpoint_from_command
from flatsat_ros.sim.fleet import SimulatedFleet
from fuzzing.damage import damaged
from fuzzing.kind import of_file


def _law(profile: VehicleProfile) -> None:
    assert 9.81 < profile.thrust_max < np.inf
    for thrust in (0.0, 9.81, profile.thrust_max, 1e12):
        setpoint = setpoint_from_command(thrust, 0.1, -0.1, 1.0, 2.0, profile, Backend.CPP, YawMode.RATE)
        assert np.isfinite(setpoint).all()
        assert 0.0 <= setpoint.thrust <= profile.pwm_max <= PWM_FULL
    fleet = SimulatedFleet(profile, 1, flying=True)
    fleet.command(0, 3.0, -3.0, 10.0, profile.pwm_max)
    fleet.advance_to(0.01)
    assert all(np.isfinite(values).all() for values in fleet.poses())


VEHICLE = of_file(
    st.one_of(
        damaged(config_path(name, "vehicles").read_text(encoding="utf-8")) for name in ("cf21_plus", "brushless")
    ),
    VehicleProfile.load,
    _law,
    "profile.yaml",
)
