"""What a tick of the flight layer says: a command for each drone, the modes, what changed and what to tell people."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.guarantee import Assessment
from flatsat_ros.flight.modes import Mode, Transition
from flatsat_ros.law.controller import Output

_IDLE = Mode.IDLE.value


class Command(NamedTuple):
    """What one drone is told.

    Attributes:
        thrust: T, m/s^2, over the thrust scale: what the motors are asked for.
        roll: phi, rad.
        pitch: theta, rad.
        yaw_rate: psi rate, rad/s, counter-clockwise.
        yaw: psi, rad, for drones that take an angle.
    """

    thrust: float
    roll: float
    pitch: float
    yaw_rate: float
    yaw: float


class Report(NamedTuple):
    """Something that people should know of one drone.

    Attributes:
        drone: its index.
        text: what, with the value and the limit.
    """

    drone: int
    text: str


class Tick(NamedTuple):
    """The outcome of one tick for N drones.

    Attributes:
        mode: (N,) values of `Mode`.
        input: (N, 3) commanded (T, phi, theta): m/s^2, rad, rad; level in LEVEL and DESCEND, zero thrust in all other
            modes but FLY.
        yaw_rate: (N,) commanded psi rate, rad/s, counter-clockwise.
        yaw: (N,) commanded psi in [-pi, pi], rad, for drones that take an angle; it leads them by a limited angle.
        output: the law's output; it is the command in FLY only.
        reference: (N, 9) position, velocity, acceleration.
        error: (N, 6) estimate less reference at the tick, m and m/s; the law may act on a prediction.
        disturbance: (N, 3) compensated disturbance, m/s^2, world frame.
        thrust_scale: (N,) estimated actual thrust over the thrust that is asked for.
        assessment: where the drones are in the certified sets; of meaning for drones in FLY only.
        transitions: the changes of modes since the tick before, and why.
        reports: what else people should know, once per event.
        duration: computation time of the tick, s.
    """

    mode: np.ndarray
    input: FloatArray
    yaw_rate: FloatArray
    yaw: FloatArray
    output: Output
    reference: FloatArray
    error: FloatArray
    disturbance: FloatArray
    thrust_scale: FloatArray
    assessment: Assessment
    transitions: tuple[Transition, ...]
    reports: tuple[Report, ...]
    duration: float

    def command(self, index: int) -> Command | None:
        """Return what drone index is told, None in IDLE: then it is left to whoever flies it."""
        if self.mode[index] == _IDLE:
            return None
        thrust, roll, pitch = self.input[index].tolist()
        scale = float(self.thrust_scale[index])
        return Command(thrust / scale, roll, pitch, float(self.yaw_rate[index]), float(self.yaw[index]))
