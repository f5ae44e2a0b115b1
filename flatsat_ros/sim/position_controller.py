"""From a goal of position or velocity to roll, pitch and thrust: the Crazyflie's position controller, for N drones.

A restatement of bitcraze/crazyflie-firmware, release 2026.08, position_controller_pid.c. The on-board estimate of
position, velocity and yaw is the truth. Not modelled: other controllers than the default one, PID.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import BoolArray, FloatArray, finite_array
from flatsat_ros.base.errors import require, require_number
from flatsat_ros.sim.high_level import HIGH_LEVEL_PERIOD

# platform_defaults_cf2.h, platform_defaults_cf21bl.h; no derivative gains, so their filters do nothing
POSITION_GAIN = 2.0  # 1/s; PID_POS_X_KP, PID_POS_Y_KP, PID_POS_Z_KP
HEIGHT_INTEGRAL_GAIN = 0.5  # 1/s^2; PID_POS_Z_KI, the others are 0
VELOCITY_MAX = 1.1  # m/s; PID_POS_VEL_*_MAX times position_controller_pid.c velMaxOverhead
VELOCITY_GAIN = 25.0  # deg or 1000 PWM per m/s; PID_VEL_X_KP, PID_VEL_Y_KP, PID_VEL_Z_KP
VELOCITY_INTEGRAL_GAIN = np.array([[1.0], [1.0], [15.0]])  # deg or 1000 PWM per m; PID_VEL_X_KI, .._Y_KI, .._Z_KI
TILT_MAX = 20.0  # deg; PID_VEL_ROLL_MAX, PID_VEL_PITCH_MAX
THRUST_SCALE = 1000.0  # PWM; position_controller_pid.c thrustScale
CLIMB_MAX = 32.767  # 1000 PWM; position_controller_pid.c velocityController, UINT16_MAX / 2 / thrustScale
THRUST_LEAST, THRUST_MOST = 20000.0, 65535.0  # PWM; PID_VEL_THRUST_MIN, UINT16_MAX


class SetpointMode(IntEnum):
    """What a set-point speaks of, stabilizer_types.h setpoint_t.mode: when it changes, all PIDs are reset."""

    ATTITUDE = 0  # roll, pitch, yaw or its rate, thrust; or nothing
    LEVEL = 1  # of any other kind while the drone levels out: height or climb alone
    POSITION = 2  # place and yaw
    FULL_STATE = 3  # place and attitude, of which this controller takes the yaw
    VELOCITY = 4  # velocity and yaw rate
    HOVER = 5  # velocity along the heading, height and yaw rate


class PositionSetpoint(NamedTuple):
    """A set-point that the position controller follows: crtp_commander_generic.c.

    Attributes:
        mode: what it speaks of; the rest of the values is 0.
        place: (3,) m, world.
        velocity: (3,) m/s, world; for HOVER ahead and left.
        yaw: rad, or for VELOCITY and HOVER rad/s, counter-clockwise.
    """

    mode: SetpointMode
    place: FloatArray
    velocity: FloatArray
    yaw: float

    @classmethod
    def of(cls, mode: SetpointMode, place: ArrayLike, velocity: ArrayLike, yaw: float) -> PositionSetpoint:
        """Return a checked set-point. The drone itself checks nothing; its link could not send every value.

        Raises:
            FlatsatError: a value is not finite, or not three make a vector.
        """
        where, rate = _vector("position", place), _vector("velocity", velocity)
        require_number("yaw", yaw, "rad" if mode in (SetpointMode.POSITION, SetpointMode.FULL_STATE) else "rad/s")
        return cls(mode, where, rate, float(yaw))


def _vector(name: str, value: ArrayLike) -> FloatArray:
    """Return a copy of three finite numbers."""
    array = finite_array(name, value, 3)
    require(array.shape == (3,), f"shape of {name}", array.shape, "", "(3,)")
    return array.copy()


class Velocities(NamedTuple):
    """What takes the place of the position loop where velocities are told.

    Attributes:
        told: (3, N) m/s, ahead, left, up.
        level: (N,) whether those ahead and left are told.
        upward: (N,) whether that up is told.
    """

    told: FloatArray
    level: BoolArray
    upward: BoolArray


class PositionController:
    """A position loop around a velocity loop, both along the drone's heading: position_controller_pid.c.

    Its goal is the position alone: the planned velocity is not fed forward (kff is 0; mode modeAbs), so a drone stays
    behind a moving goal by the way that the goal covers in half a second.
    """

    def __init__(self, count: int, thrust_base: float) -> None:
        """Boot.

        Args:
            count: N.
            thrust_base: PWM at which the controller takes every drone to hover; in flight the integral of the velocity
                error makes up for a wrong one.
        """
        self._base = thrust_base
        # height error, m s; velocity errors ahead, left and up, m. Their limit of 5000 is out of reach (pid.h)
        self._integral = np.zeros((4, count))

    def control(
        self,
        goal: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        yaw: FloatArray,
        fresh: BoolArray,
        velocities: Velocities | None = None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Run once, every HIGH_LEVEL_PERIOD: positionController, velocityController, pid.c pidUpdate.

        Args:
            goal: (3, N) m, world.
            position: (3, N) m, world.
            velocity: (3, N) m/s, world.
            yaw: (N,) rad.
            fresh: (N,) whether to begin with integrals of 0 (controller_pid.c setpointModeChanged).
            velocities: what is told in place of a goal; None if nothing is.

        Returns:
            (N,) roll and pitch, rad, and (N,) thrust, PWM.
        """
        dt = HIGH_LEVEL_PERIOD * 1e-3
        self._integral[:, fresh] = 0.0
        error = along_heading(goal - position, yaw)
        if velocities is not None:
            error[2, velocities.upward] = 0.0
        self._integral[0] += error[2] * dt
        wanted = POSITION_GAIN * error
        wanted[2] += HEIGHT_INTEGRAL_GAIN * self._integral[0]
        wanted = np.clip(wanted, -VELOCITY_MAX, VELOCITY_MAX)
        if velocities is not None:
            wanted[:2] = np.where(velocities.level, velocities.told[:2], wanted[:2])
            wanted[2] = np.where(velocities.upward, velocities.told[2], wanted[2])
        error = wanted - along_heading(velocity, yaw)
        self._integral[1:] += error * dt
        ahead, left, up = VELOCITY_GAIN * error + VELOCITY_INTEGRAL_GAIN * self._integral[1:]
        roll, pitch = np.deg2rad(np.clip((-left, ahead), -TILT_MAX, TILT_MAX))
        thrust = self._base + THRUST_SCALE * np.clip(up, -CLIMB_MAX, CLIMB_MAX)
        return roll, pitch, np.clip(thrust, THRUST_LEAST, THRUST_MOST)


def along_heading(vector: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return a (3, N) world vector as ahead, left, up."""
    x, y, up = vector
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([cos * x + sin * y, cos * y - sin * x, up])
