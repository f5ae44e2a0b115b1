"""What a drone with given figures would have done in a flight: attitude, thrust and acceleration from its commands.

    theta'' = wn^2 (g c(t - d) + k v - theta) - 2 zeta wn theta'        attitude, each of roll and pitch
    T' = (T_full (PWM(t - d) / 65535)^s (V / V0)^n - T) / tau_T         thrust over mass
    p'' = T R(theta, psi) e3 - g e3 - D p'

The attitude is simulated from the commands alone, from the beginning of the log on. The measured velocity enters the
small terms k v and D v, the measured yaw the direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.crazyflie.vehicle import PWM_FULL
from flatsat_ros.identification.screening import STEP, Samples, smooth_velocity


@dataclass(frozen=True)
class Figures:
    """What is to be found of a drone.

    Attributes:
        attitude_gain: g.
        natural_frequency: wn, rad/s.
        damping: zeta.
        velocity_tilt: k, rad s/m.
        thrust_slope: s.
        thrust_lag: tau_T, s.
        drag_xy: 1/s.
        drag_z: 1/s.
        delay: d, s: on board, on the way, and between the clocks of the log.
        thrust_voltage: n, for the battery's voltage V, where it was logged; V0 is its mean over the flight.
    """

    attitude_gain: float
    natural_frequency: float
    damping: float
    velocity_tilt: float
    thrust_slope: float
    thrust_lag: float
    drag_xy: float
    drag_z: float
    delay: float
    thrust_voltage: float = 0.0

    @property
    def lag_and_delay(self) -> float:
        """2 zeta / wn + d, s: what delays the attitude in the mean."""
        return 2.0 * self.damping / self.natural_frequency + self.delay


@dataclass(frozen=True, eq=False)
class Motion:
    """The measured motion of a flight, as the simulation of its attitude needs it.

    Attributes:
        samples: the flight.
        velocity: (M, 3) m/s, world, smoothed.
        heading: (M, 2) cosine and sine of yaw.
        lean: (M, 2) velocity to the right and ahead, m/s: where positive roll and pitch accelerate to.
    """

    samples: Samples
    velocity: FloatArray
    heading: FloatArray
    lean: FloatArray


def motion_of(samples: Samples) -> Motion:
    """Return the motion of a flight; yaw counts as 0 where it was not measured."""
    velocity, yaw = smooth_velocity(samples.position), np.nan_to_num(samples.angles[:, 2])
    cos, sin = np.cos(yaw), np.sin(yaw)
    lean = [sin * velocity[:, 0] - cos * velocity[:, 1], cos * velocity[:, 0] + sin * velocity[:, 1]]
    return Motion(samples, velocity, np.stack([cos, sin], axis=-1), np.stack(lean, axis=-1))


def respond(motion: Motion, figures: Figures) -> tuple[FloatArray, FloatArray]:
    """Return how a drone with these figures answers the commands of a flight: tilt (M, 2), rad, and T / T_full (M,)."""
    command = delayed_mean(motion.samples.command, figures.delay)
    goal = figures.attitude_gain * command[:, :2] + figures.velocity_tilt * motion.lean
    numerator, denominator = _second_order(figures.natural_frequency, figures.damping)
    tilt = lfilter(numerator, denominator, goal, axis=0)
    thrust = lagging(command[:, 2] / PWM_FULL, figures)
    if len(motion.samples.voltage):  # it changes slowly: the lag of the thrust is nothing to it
        thrust = thrust * (motion.samples.voltage / motion.samples.mean_voltage) ** figures.thrust_voltage
    return np.asarray(tilt), thrust


def lift(motion: Motion, tilt: FloatArray, thrust: FloatArray) -> FloatArray:
    """Return the thrust vector (M, 3), world, of tilt (M, 2), rad, and thrust (M,) in any unit."""
    (sr, sp), (cr, cp) = np.sin(tilt).T, np.cos(tilt).T
    cos, sin = motion.heading.T
    along, across = cr * sp * thrust, -sr * thrust
    return np.stack([cos * along - sin * across, sin * along + cos * across, cr * cp * thrust], axis=-1)


def lagging(command: FloatArray, figures: Figures) -> FloatArray:
    """Return T / T_full at V0 (M,) for thrust commands (M,) over PWM_FULL."""
    relative = np.clip(command, 0.0, None) ** figures.thrust_slope
    keep = math.exp(-STEP / figures.thrust_lag)
    start = [relative[0]]  # as if the first command had held for long
    thrust, _ = lfilter([0.0, 1.0 - keep], [1.0, -keep], relative, zi=start)
    return np.asarray(thrust)


def delayed_mean(command: FloatArray, delay: float) -> FloatArray:
    """Return held commands (M, 3) a time later, s, as the mean over a STEP of what was held then."""
    whole = math.floor(delay / STEP)
    share = delay / STEP - whole
    last = np.concatenate([np.repeat(command[:1], whole + 1, axis=0), command[: len(command) - whole]])
    return np.asarray(last[1:] * (1.0 - share) + last[:-1] * share)


def _second_order(wn: float, zeta: float) -> tuple[FloatArray, FloatArray]:
    """Return numerator and denominator in z^-1 of wn^2 / (s^2 + 2 zeta wn s + wn^2) under a hold of STEP."""
    block = np.zeros((3, 3))
    block[0, 1], block[1] = 1.0, (-wn * wn, -2.0 * zeta * wn, wn * wn)
    (a, b, f), (c, d, h) = expm(block * STEP)[:2]
    return np.array([0.0, f, b * h - d * f]), np.array([1.0, -a - d, a * d - b * c])
