"""From SI set-points to what the Crazyflie's radio link carries, and back: signs, degrees, PWM, clamps.

The contract is crazyswarm2's `cmd_vel_legacy`: roll and pitch in degrees, yaw rate in degrees per second positive
CLOCKWISE, thrust as PWM from 0 to pwm_max. Its two back ends disagree on the sign of the pitch: cpp takes ours, cflib
the opposite.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flatsat_ros.core.errors import FlatsatError
from flatsat_ros.core.vehicle import VehicleProfile

# sign of the pitch by crazyswarm2 back end
PITCH_SIGN = {"cpp": 1.0, "cflib": -1.0}


class WireSetpoint(NamedTuple):
    """One roll, pitch, yaw rate and thrust set-point in the units of the link."""

    roll: float  # degrees
    pitch: float  # degrees
    yaw_rate: float  # degrees per second, positive clockwise seen from above
    thrust: float  # PWM


def setpoint_from_input(
    thrust: float, roll: float, pitch: float, yaw_rate: float, vehicle: VehicleProfile, backend: str = "cpp"
) -> WireSetpoint:
    """Return the wire set-point of an input.

    Args:
        thrust: T, m/s^2, normalised by the mass.
        roll: phi, rad.
        pitch: theta, rad.
        yaw_rate: psi rate, rad/s, counter-clockwise.
        vehicle: mass and thrust map.
        backend: a key of PITCH_SIGN.

    Raises:
        FlatsatError: a value is not finite; such a set-point must never reach the radio.
    """
    if not math.isfinite(thrust + roll + pitch + yaw_rate):
        raise FlatsatError(
            f"set-point (T, phi, theta, yaw rate) = ({thrust}, {roll}, {pitch}, {yaw_rate}): must be finite"
        )
    pwm = min(max(float(vehicle.pwm_from_thrust(thrust)), 0.0), float(vehicle.pwm_max))
    return WireSetpoint(math.degrees(roll), PITCH_SIGN[backend] * math.degrees(pitch), -math.degrees(yaw_rate), pwm)


def input_from_setpoint(
    setpoint: WireSetpoint, vehicle: VehicleProfile, backend: str = "cpp"
) -> tuple[float, float, float, float]:
    """Return (T m/s^2, phi rad, theta rad, yaw rate rad/s counter-clockwise) of a wire set-point."""
    return (
        float(vehicle.thrust_from_pwm(setpoint.thrust)),
        math.radians(setpoint.roll),
        PITCH_SIGN[backend] * math.radians(setpoint.pitch),
        -math.radians(setpoint.yaw_rate),
    )
