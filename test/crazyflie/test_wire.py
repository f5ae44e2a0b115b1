"""The wire: signs, degrees and PWM as golden values, and there and back."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import Backend, YawMode, input_from_setpoint, setpoint_from_command

CF21 = VehicleProfile.load(Path(__file__).parents[2] / "config" / "vehicles" / "cf21.yaml")

angles = st.floats(-1.5, 1.5)


def test_hover_with_every_sign() -> None:
    setpoint = setpoint_from_command(GRAVITY, math.radians(5.0), math.radians(-3.0), math.radians(20.0), 0.0, CF21)
    assert setpoint.roll == pytest.approx(5.0)
    assert setpoint.pitch == pytest.approx(-3.0)
    assert setpoint.yaw == pytest.approx(-20.0)
    assert setpoint.thrust == pytest.approx(0.029 * GRAVITY / 0.480 * 65535)
    assert setpoint.thrust == pytest.approx(38841.8, abs=0.1)


def test_the_cflib_back_end_turns_the_pitch_around_and_nothing_else() -> None:
    cpp = setpoint_from_command(12.0, 0.1, 0.2, 0.3, 0.4, CF21, Backend.CPP)
    cflib = setpoint_from_command(12.0, 0.1, 0.2, 0.3, 0.4, CF21, Backend.CFLIB)
    assert cflib == cpp._replace(pitch=-cpp.pitch)
    assert cflib.pitch == pytest.approx(-math.degrees(0.2))


def test_a_yaw_angle_keeps_its_sign_a_rate_turns_and_nothing_else_changes() -> None:
    rate = setpoint_from_command(12.0, 0.1, 0.2, 0.3, 0.4, CF21)
    angle = setpoint_from_command(12.0, 0.1, 0.2, 0.3, 0.4, CF21, yaw_mode=YawMode.ANGLE)
    assert angle == rate._replace(yaw=angle.yaw)
    assert rate.yaw == pytest.approx(-math.degrees(0.3))
    assert angle.yaw == pytest.approx(math.degrees(0.4))


@pytest.mark.parametrize(("thrust", "pwm"), [(0.0, 0.0), (-5.0, 0.0), (1e6, 60000.0), (15.2, 60000.0)])
def test_thrust_is_clipped_to_what_the_firmware_takes(thrust: float, pwm: float) -> None:
    assert setpoint_from_command(thrust, 0.0, 0.0, 0.0, 0.0, CF21).thrust == pwm


@pytest.mark.parametrize(
    ("position", "yaw_mode"),
    [(0, YawMode.RATE), (1, YawMode.RATE), (2, YawMode.RATE), (3, YawMode.RATE), (4, YawMode.ANGLE)],
)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_never_reaches_the_radio(position: int, yaw_mode: YawMode, bad: float) -> None:
    values = [GRAVITY, 0.0, 0.0, 0.0, 0.0]
    values[position] = bad
    with pytest.raises(FlatsatError, match=f"{bad}.*must be finite"):
        setpoint_from_command(*values, CF21, yaw_mode=yaw_mode)


@given(
    thrust=st.floats(0.0, CF21.thrust_max),
    roll=angles,
    pitch=angles,
    yaw=angles,
    back_end=st.sampled_from(Backend),
    yaw_mode=st.sampled_from(YawMode),
)
def test_there_and_back(
    thrust: float, roll: float, pitch: float, yaw: float, back_end: Backend, yaw_mode: YawMode
) -> None:
    setpoint = setpoint_from_command(thrust, roll, pitch, yaw, yaw, CF21, back_end, yaw_mode)
    again = input_from_setpoint(setpoint, CF21, back_end, yaw_mode)
    assert again == pytest.approx((thrust, roll, pitch, yaw), rel=1e-12, abs=1e-12)
