"""From SI set-points to what the Crazyflie's radio link carries, and back: signs, degrees, PWM, clamps.

The contract is crazyswarm2's `cmd_vel_legacy`: roll and pitch in degrees, thrust as PWM from 0 to pwm_max. Its two back
ends disagree on the sign of the pitch (`Backend`); what the yaw means is up to a parameter of the drone (`YawMode`).
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from flatsat_ros.base.errors import refusal
from flatsat_ros.crazyflie.vehicle import VehicleProfile


class Backend(str, Enum):
    """Crazyswarm2's back end that the set-points go to."""

    CPP = "cpp"
    CFLIB = "cflib"

    @property
    def pitch_sign(self) -> float:
        """Sign of the pitch on the wire: cpp takes ours, cflib the opposite."""
        return 1.0 if self is Backend.CPP else -1.0


class YawMode(str, Enum):
    """What the yaw on the wire means: the drone's parameter flightmode.stabModeYaw (crtp_commander_rpyt.c).

    RATE: stabModeYaw 0, a yaw rate in degrees per second, positive CLOCKWISE seen from above.
    ANGLE: stabModeYaw 1, the yaw itself in degrees, positive counter-clockwise.
    """

    RATE = "rate"
    ANGLE = "angle"

    @property
    def sign(self) -> float:
        """Sign of the yaw on the wire, over ours: counter-clockwise."""
        return -1.0 if self is YawMode.RATE else 1.0


class WireSetpoint(NamedTuple):
    """One roll, pitch, yaw and thrust set-point in the units of the link."""

    roll: float  # degrees
    pitch: float  # degrees
    yaw: float  # as YawMode says
    thrust: float  # PWM


def setpoint_from_command(
    thrust: float,
    roll: float,
    pitch: float,
    yaw_rate: float,
    yaw: float,
    vehicle: VehicleProfile,
    backend: Backend = Backend.CPP,
    yaw_mode: YawMode = YawMode.RATE,
) -> WireSetpoint:
    """Return the wire set-point of a command.

    Args:
        thrust: T, m/s^2, normalised by the mass.
        roll: phi, rad.
        pitch: theta, rad.
        yaw_rate: psi rate, rad/s, counter-clockwise; what YawMode.RATE sends.
        yaw: psi, rad, counter-clockwise; what YawMode.ANGLE sends.
        vehicle: mass and thrust map.
        backend: gives the sign of the pitch.
        yaw_mode: what the yaw means.

    Raises:
        FlatsatError: a value is not finite: such a set-point must never reach the radio.
    """
    turn = yaw_rate if yaw_mode is YawMode.RATE else yaw
    if not math.isfinite(thrust + roll + pitch + turn):
        raise refusal("set-point (T, phi, theta, yaw)", (thrust, roll, pitch, turn), "", "finite")
    pwm = min(max(float(vehicle.pwm_from_thrust(thrust)), 0.0), float(vehicle.pwm_max))
    return WireSetpoint(
        math.degrees(roll), backend.pitch_sign * math.degrees(pitch), yaw_mode.sign * math.degrees(turn), pwm
    )


def input_from_setpoint(
    setpoint: WireSetpoint,
    vehicle: VehicleProfile,
    backend: Backend = Backend.CPP,
    yaw_mode: YawMode = YawMode.RATE,
) -> tuple[float, float, float, float]:
    """Return the input of a wire set-point: the inverse of setpoint_from_input but for clipped thrusts.

    Args:
        setpoint: in the units of the link.
        vehicle: mass and thrust map.
        backend: gives the sign of the pitch.
        yaw_mode: what the yaw means.

    Returns:
        Thrust T (m/s^2, normalised by the mass), roll phi (rad), pitch theta (rad), and yaw as a rate (rad/s) or an
        angle (rad), counter-clockwise.
    """
    return (
        float(vehicle.thrust_from_pwm(setpoint.thrust)),
        math.radians(setpoint.roll),
        backend.pitch_sign * math.radians(setpoint.pitch),
        yaw_mode.sign * math.radians(setpoint.yaw),
    )
