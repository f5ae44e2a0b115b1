"""From SI set-points to what the Crazyflie's radio link carries, and back: signs, degrees, PWM, clamps.

The contract is crazyswarm2's `cmd_vel_legacy`: roll and pitch in degrees, thrust as PWM from 0 to pwm_max. Its two back
ends disagree on the sign of the pitch: cpp takes ours, cflib the opposite. What the yaw means is up to the drone's
parameter flightmode.stabModeYaw: 0, a rate in degrees per second positive CLOCKWISE; 1, an angle in degrees positive
counter-clockwise (crtp_commander_rpyt.c).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile

# sign of the pitch by crazyswarm2 back end
PITCH_SIGN = {"cpp": 1.0, "cflib": -1.0}
# sign of the yaw by what it means: rate for flightmode.stabModeYaw 0, angle for 1
YAW_SIGN = {"rate": -1.0, "angle": 1.0}


class WireSetpoint(NamedTuple):
    """One roll, pitch, yaw and thrust set-point in the units of the link."""

    roll: float  # degrees
    pitch: float  # degrees
    yaw: float  # degrees per second, positive clockwise seen from above; or degrees, positive counter-clockwise
    thrust: float  # PWM


def setpoint_from_input(
    thrust: float,
    roll: float,
    pitch: float,
    yaw: float,
    vehicle: VehicleProfile,
    backend: str = "cpp",
    yaw_mode: str = "rate",
) -> WireSetpoint:
    """Return the wire set-point of an input.

    Args:
        thrust: T, m/s^2, normalised by the mass.
        roll: phi, rad.
        pitch: theta, rad.
        yaw: psi rate, rad/s, or psi, rad; counter-clockwise.
        vehicle: mass and thrust map.
        backend: a key of PITCH_SIGN.
        yaw_mode: a key of YAW_SIGN.

    Raises:
        FlatsatError: a value is not finite, for such a set-point must never reach the radio, or there is no such back
            end or yaw mode.
    """
    if not math.isfinite(thrust + roll + pitch + yaw):
        raise FlatsatError(f"set-point (T, phi, theta, yaw) = ({thrust}, {roll}, {pitch}, {yaw}): must be finite")
    pwm = min(max(float(vehicle.pwm_from_thrust(thrust)), 0.0), float(vehicle.pwm_max))
    signs = _signs(backend, yaw_mode)
    return WireSetpoint(math.degrees(roll), signs[0] * math.degrees(pitch), signs[1] * math.degrees(yaw), pwm)


def input_from_setpoint(
    setpoint: WireSetpoint, vehicle: VehicleProfile, backend: str = "cpp", yaw_mode: str = "rate"
) -> tuple[float, float, float, float]:
    """Return (T m/s^2, phi rad, theta rad, yaw) of a wire set-point; yaw as a rate, rad/s, or an angle, rad.

    Raises:
        FlatsatError: there is no such back end or yaw mode.
    """
    signs = _signs(backend, yaw_mode)
    return (
        float(vehicle.thrust_from_pwm(setpoint.thrust)),
        math.radians(setpoint.roll),
        signs[0] * math.radians(setpoint.pitch),
        signs[1] * math.radians(setpoint.yaw),
    )


def _signs(backend: str, yaw_mode: str) -> tuple[float, float]:
    """Return the signs of pitch and yaw on the wire."""
    try:
        return PITCH_SIGN[backend], YAW_SIGN[yaw_mode]
    except KeyError as error:
        valid = f"{' or '.join(PITCH_SIGN)}, and {' or '.join(YAW_SIGN)}"
        raise FlatsatError(f"back end {backend!r}, yaw mode {yaw_mode!r}: must be {valid}") from error
