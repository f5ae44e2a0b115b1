"""N drones as bodies in the air: how thrust and attitude follow their commands, and how the bodies move.

Attitude is ZYX Euler angles (roll, pitch, yaw), body -> world = Rz(psi) Ry(theta) Rx(phi), rad; world ENU, body FLU.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_positive
from flatsat_ros.crazyflie.vehicle import AttitudeResponse, Dynamics
from flatsat_ros.law.flatness import acceleration_from_finite

STEP = 0.002  # s: 500 Hz, the rate of the firmware's attitude loop
# rad/s^2, of an axis that nobody controls: its pairs of motors differ by 2 % at hover, 0.002 N at 0.06 m, 1.7e-5 kg m^2
UNBALANCE = 7.0
STANDING = 0.5  # cosine of the largest tilt that the legs catch at touch-down, 60 degrees


class Response(Protocol):
    """How thrust and attitude follow their commands.

    Attributes:
        drag: (3,) linear drag against air velocity, world frame, 1/s.
        order: number of states of an axis of the attitude; the first three are angle, rate and acceleration.
        velocity_tilt: the tilt into the motion that the drone holds besides its command, rad s/m.
    """

    drag: FloatArray
    order: int
    velocity_tilt: float

    def thrust(self, thrust: FloatArray, command: FloatArray) -> FloatArray:
        """Return the thrust (N,), m/s^2, one STEP after `thrust`, under a command (N,), m/s^2."""

    def attitude(self, attitude: FloatArray, command: FloatArray) -> FloatArray:
        """Return the attitude (3, N, order) one STEP after `attitude`, under a command (3, N), rad."""


class Ideal:
    """The double integrator of the theorems: thrust and attitude follow their commands at once, without drag."""

    order = 3
    velocity_tilt = 0.0

    def __init__(self) -> None:
        self.drag = np.zeros(3)

    def thrust(self, thrust: FloatArray, command: FloatArray) -> FloatArray:
        """Return the command."""
        return command

    def attitude(self, attitude: FloatArray, command: FloatArray) -> FloatArray:
        """Return the commanded angles, with rates and accelerations of 0."""
        return np.stack([command, np.zeros_like(command), np.zeros_like(command)], axis=-1)


class IdentifiedResponse:
    """The response that a vehicle profile describes, discretised exactly.

    Attitude of third order, or of fourth where the profile has integral terms, first-order thrust, linear drag.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self.drag = np.array([dynamics.drag_xy, dynamics.drag_xy, dynamics.drag_z])
        self.velocity_tilt = dynamics.velocity_tilt
        self._thrust_gain = dynamics.thrust_gain
        self._keep_up = np.exp(-STEP / dynamics.thrust_lag_up)
        self._keep_down = np.exp(-STEP / dynamics.thrust_lag_down)
        axes = [(dynamics.attitude, dynamics.attitude_gain)] * 2 + [(dynamics.yaw, 1.0)]
        self.order = 4 if any(response.integral_pole for response, _ in axes) else 3
        steps = [_attitude_step(response, gain, self.order) for response, gain in axes]
        self._transition = np.stack([a.T for a, _ in steps])  # (3, order, order), for row vectors
        self._input = np.stack([b for _, b in steps])[:, None, :]  # (3, 1, order)

    def thrust(self, thrust: FloatArray, command: FloatArray) -> FloatArray:
        """Return the thrust, m/s^2, one STEP later, on its way to the command."""
        goal = self._thrust_gain * command
        return goal + (thrust - goal) * np.where(goal > thrust, self._keep_up, self._keep_down)

    def attitude(self, attitude: FloatArray, command: FloatArray) -> FloatArray:
        """Return the attitude one STEP later, on its way to the command."""
        return attitude @ self._transition + self._input * command[:, :, None]


def _attitude_step(response: AttitudeResponse, gain: float, order: int) -> tuple[FloatArray, FloatArray]:
    """Return the zero-order-hold transition (order, order) and input (order,) of an axis over STEP.

    The states are angle, rate, acceleration and, for order 4, x of the slow factor: x' = p (c - x) for a command c, and
    (1 + s/z) / (1 + s/p) c = (p/z) c + (1 - p/z) x.
    """
    wn, zeta, tau = response.natural_frequency, response.damping, response.actuator_lag
    pole = response.integral_pole
    direct = pole / response.integral_zero if pole else 1.0
    block = np.zeros((order + 1, order + 1))  # [[A, B], [0, 0]]
    block[0, 1] = 1.0
    highest = np.zeros(order + 1)
    highest[:3] = -wn * wn, -2.0 * zeta * wn, -1.0
    highest[-1] = gain * wn * wn * direct
    if order == 4:
        highest[3] = gain * wn * wn * (1.0 - direct)
        block[3, 3:] = -pole, pole
    if tau > 0:
        block[1, 2] = 1.0
        block[2] = highest / tau
    else:
        block[1] = highest
        block[1, 2] = 0.0
    exponential = _matrix_exponential(block * STEP)
    return exponential[:order, :order], exponential[:order, order]


def _matrix_exponential(matrix: FloatArray) -> FloatArray:
    """Return exp(matrix) by scaling, a Taylor series, and squaring."""
    halvings = max(0, math.ceil(math.log2(float(np.linalg.norm(matrix)))) + 3)
    scaled = matrix / 2.0**halvings
    term = np.eye(len(matrix))
    result = term
    for order in range(1, 16):
        term = term @ scaled / order
        result = result + term
    return np.linalg.matrix_power(result, 2**halvings)


@dataclass(frozen=True)
class Wind:
    """The motion of the air, the same for all drones: a constant velocity and first-order Gauss-Markov gusts.

    Attributes:
        mean: (3,) air velocity, world frame, m/s.
        gust: standard deviation of the gusts per axis, m/s.
        gust_time: correlation time of the gusts, s.

    Raises:
        FlatsatError: a value is not a number of its range, or mean is not (3,).
    """

    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust: float = 0.0
    gust_time: float = 1.0

    def __post_init__(self) -> None:
        require(finite_array("mean", self.mean).shape == (3,), "mean", self.mean, "m/s", "three velocities")
        require_fields(self, require_not_negative, gust="m/s")
        require_fields(self, require_positive, gust_time="s")

    def next_gust(self, gust: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the deviation of the air velocity from its mean, (3,), m/s, one STEP later; exact for any STEP.

        Args:
            gust: (3,) the present deviation, m/s, world frame.
            generator: of the random numbers.
        """
        if self.gust == 0.0:
            return gust
        keep = math.exp(-STEP / self.gust_time)
        return gust * keep + generator.normal(0.0, self.gust * math.sqrt(1.0 - keep * keep), 3)


class Bodies:
    """N drones above a level floor.

    Attributes:
        position: (N, 3) m, world.
        velocity: (N, 3) m/s, world.
        acceleration: (N, 3) m/s^2, world; 0 on the floor.
        attitude: (3, N, order), by axis (roll, pitch, yaw), drone, and derivative (rad, rad/s, rad/s^2, then the states
            that the response adds); yaw is not wrapped.
        thrust: (N,) achieved thrust divided by the mass, m/s^2.
        grounded: (N,) whether the drone is on the floor.
        capsized: (N,) whether it fell over at touch-down and lies there.
        floor: height of the floor, m, world; may be changed between two steps while all are higher: a table below them.
    """

    def __init__(
        self, response: Response, position: FloatArray, yaw: FloatArray, *, thrust: float, floor: float
    ) -> None:
        """Place the bodies.

        Args:
            response: how thrust and attitude follow their commands.
            position: (N, 3) m, world.
            yaw: (N,) rad, counter-clockwise.
            thrust: achieved thrust of each at the beginning, divided by the mass, m/s^2.
            floor: height of the floor, m, world.
        """
        self._response = response
        self.floor = floor
        self.position = position.copy()
        count = len(self.position)
        self.velocity = np.zeros((count, 3))
        self.acceleration = np.zeros((count, 3))
        self.attitude = np.zeros((3, count, response.order))
        self.attitude[2, :, 0] = yaw
        self.thrust = np.full(count, thrust)
        self.grounded = self.position[:, 2] <= floor
        self.position[self.grounded, 2] = floor
        self.capsized = np.zeros(count, dtype=bool)
        # v' = c - D v has v(t) = v e^(-D t) + c f1 and p(t) = p + v f1 + c f2; without drag f1 = t and f2 = t^2 / 2
        drag = response.drag
        moving = np.where(drag > 0, drag, 1.0)
        self._keep = np.exp(-drag * STEP)
        self._f1 = np.where(drag > 0, -np.expm1(-drag * STEP) / moving, STEP)
        self._f2 = np.where(drag > 0, (STEP - self._f1) / moving, 0.5 * STEP**2)

    @property
    def angles(self) -> FloatArray:
        """Roll, pitch, yaw, (N, 3), rad."""
        return self.attitude[:, :, 0].T

    @property
    def quaternion(self) -> FloatArray:
        """Attitude as quaternions x, y, z, w, (N, 4), body -> world."""
        (cr, cp, cy), (sr, sp, sy) = np.cos(self.attitude[..., 0] / 2), np.sin(self.attitude[..., 0] / 2)
        x = sr * cp * cy - cr * sp * sy
        y = cr * sp * cy + sr * cp * sy
        z = cr * cp * sy - sr * sp * cy
        w = cr * cp * cy + sr * sp * sy
        return np.stack([x, y, z, w], axis=-1)

    @property
    def specific_force(self) -> FloatArray:
        """What the accelerometers read, (N, 3), body frame, in units of g: (0, 0, 1) for a drone that stands level."""
        return self._in_body(self.acceleration / GRAVITY + (0.0, 0.0, 1.0))

    @property
    def body_velocity(self) -> FloatArray:
        """Velocity in the body frame, (N, 3), m/s."""
        return self._in_body(self.velocity)

    @property
    def body_rates(self) -> FloatArray:
        """Angular velocity in the body frame, (N, 3), rad/s: what gyroscopes read."""
        (roll, pitch, _), (p, q, r) = self.attitude[..., 0], self.attitude[..., 1]
        cr, sr, cp = np.cos(roll), np.sin(roll), np.cos(pitch)
        return np.stack([p - r * np.sin(pitch), q * cr + r * sr * cp, r * cr * cp - q * sr], axis=-1)

    def _in_body(self, vectors: FloatArray) -> FloatArray:
        """Return (N, 3) world vectors in the body frames."""
        x, y, z = vectors.T
        (cr, cp, cy), (sr, sp, sy) = np.cos(self.attitude[..., 0]), np.sin(self.attitude[..., 0])
        x, y = cy * x + sy * y, cy * y - sy * x  # into the frame turned by yaw, then by pitch, then by roll
        x, z = cp * x - sp * z, sp * x + cp * z
        y, z = cr * y + sr * z, cr * z - sr * y
        return np.stack([x, y, z], axis=-1)

    def step(self, thrust: FloatArray, angles: FloatArray, wind: FloatArray, push: FloatArray | None = None) -> None:
        """Advance by STEP.

        Args:
            thrust: (N,) commanded thrust, m/s^2.
            angles: (3, N) commanded roll, pitch, yaw, rad; NaN for an axis that nobody controls.
            wind: (3,) air velocity, world frame, m/s.
            push: (N,) acceleration downward by the air of other drones, m/s^2; None: none.
        """
        place, attitude = self.position, self.attitude
        self.thrust = self._response.thrust(self.thrust, thrust)
        self.attitude = self._next_attitude(self._leaning(angles))

        u = np.array([self.thrust, *self.attitude[:2, :, 0]]).T
        driven = acceleration_from_finite(u, self.attitude[2, :, 0], GRAVITY) + self._response.drag * wind
        if push is not None:
            driven[:, 2] -= push
        self.position = self.position + self.velocity * self._f1 + driven * self._f2
        self.velocity = self.velocity * self._keep + driven * self._f1
        self.acceleration = driven - self._response.drag * self.velocity
        self._touch_floor(place, attitude)

    def _leaning(self, command: FloatArray) -> FloatArray:
        """Return the attitude (3, N) that the drone holds for a command: tilted into its motion."""
        tilt = self._response.velocity_tilt
        if tilt == 0.0:
            return command
        (x, y, _), yaw = self.velocity.T, self.attitude[2, :, 0]
        ahead, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
        return np.stack([command[0] - tilt * left, command[1] + tilt * ahead, command[2]])

    def _next_attitude(self, command: FloatArray) -> FloatArray:
        """Return the attitude one STEP later: controlled, or drifting away where the command is NaN."""
        lost = np.isnan(command)
        if not lost.any():
            return self._response.attitude(self.attitude, command)
        drift = self.attitude.copy()
        drift[..., 0] += drift[..., 1] * STEP
        drift[..., 1] += UNBALANCE * STEP
        drift[..., 2] = UNBALANCE
        controlled = self._response.attitude(self.attitude, np.where(lost, 0.0, command))
        return np.where(lost[..., None], drift, controlled)

    def _touch_floor(self, place: FloatArray, attitude: FloatArray) -> None:
        """Stop what touches the floor: it does not sink, slide or turn; upright it stands level, else it lies.

        Args:
            place: (N, 3) position one STEP ago.
            attitude: (3, N, order) attitude one STEP ago.
        """
        falling = (self.position[:, 2] <= self.floor) & (self.velocity[:, 2] <= 0.0)
        self.grounded = falling | self.capsized
        if not self.grounded.any():
            return
        upright = np.cos(self.attitude[0, :, 0]) * np.cos(self.attitude[1, :, 0])
        self.capsized = self.capsized | (falling & (upright < STANDING))
        down = self.grounded
        self.position[down] = place[down]
        self.position[down, 2] = self.floor
        self.velocity[down] = 0.0
        self.acceleration[down] = 0.0
        self.attitude[:, down, 0] = attitude[:, down, 0]
        self.attitude[:, down, 1:] = 0.0
        self.attitude[:2, down & ~self.capsized, 0] = 0.0

    def set_upright(self, index: int) -> None:
        """Put a drone that lies on the floor back on its feet."""
        self.capsized[index] = False
        self.attitude[:2, index, 0] = 0.0
