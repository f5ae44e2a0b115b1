"""The vehicle profile: what one kind of drone weighs, lifts and how fast it answers, read from config/vehicles/*.yaml.

A profile serves three readers: synthesis takes `thrust_max`, `lag` and `delay` from it, the wire conversion takes the
linear thrust map, and the simulated drone takes everything.
"""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import (
    FlatsatError,
    require,
    require_fields,
    require_not_negative,
    require_number,
    require_positive,
    require_zero_or_positive,
)
from flatsat_ros.base.files import located
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.crazyflie.fields import build, without_empty
from flatsat_ros.crazyflie.intervals import Intervals

PWM_FULL = 65535  # the 16-bit thrust command that stands for force_max
_WARNING_LEAD = 0.1  # V, by which a warning comes before the landing


@dataclass(frozen=True, kw_only=True)
class AttitudeResponse:
    """One axis of the closed attitude loop: wn^2 / (tau_a s^3 + s^2 + 2 zeta wn s + wn^2) (1 + s/z) / (1 + s/p).

    Attributes:
        natural_frequency: wn, rad/s.
        damping: zeta, dimensionless.
        actuator_lag: tau_a, s; 0 leaves a second-order response.
        integral_zero: z, rad/s, of the slow factor that the integral terms of the attitude controller add; 0: none.
        integral_pole: p, rad/s, likewise; the response overshoots by about p/z - 1 for a time of 1/p.

    Raises:
        FlatsatError: a value is not a number of its range, only one of z and p is 0, or tau_a makes the loop unstable.
    """

    natural_frequency: float
    damping: float
    actuator_lag: float
    integral_zero: float = 0.0
    integral_pole: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_positive, natural_frequency="rad/s", damping="")
        require_fields(self, require_zero_or_positive, actuator_lag="s", integral_zero="rad/s", integral_pole="rad/s")
        one_sided = (self.integral_zero > 0.0) != (self.integral_pole > 0.0)
        require(not one_sided, "integral_pole", self.integral_pole, "rad/s", "above 0 with integral_zero, 0 without")
        bound = 2.0 * self.damping / self.natural_frequency  # Routh-Hurwitz: tau_a wn < 2 zeta
        require(
            self.actuator_lag < bound, "actuator_lag", self.actuator_lag, "s", f"below {bound:.4g} s (a stable loop)"
        )

    @property
    def mean_delay(self) -> float:
        """2 zeta / wn, s: the mean of the impulse response, whatever tau_a is and without the slow factor."""
        return 2.0 * self.damping / self.natural_frequency


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    """The identified response of the flying drone to its commands.

    Attributes:
        attitude: roll and pitch.
        yaw: yaw.
        attitude_gain: steady angle over commanded angle, roll and pitch.
        thrust_gain: steady thrust over commanded thrust.
        thrust_lag_up: first-order lag of rising thrust, s.
        thrust_lag_down: first-order lag of falling thrust, s.
        drag_xy: linear drag against horizontal air velocity, divided by the mass, 1/s.
        drag_z: the same against vertical air velocity, 1/s.
        dead_time: from a command's arrival to the first effect, s.
        velocity_tilt: k, rad s/m: besides its command the drone leans into its motion by k times its velocity, which an
            on-board estimate does that takes drag for tilt (then 0 < k < drag / g). 0: none.

    Raises:
        FlatsatError: a value is not a number of its range.
    """

    attitude: AttitudeResponse
    yaw: AttitudeResponse
    attitude_gain: float
    thrust_gain: float
    thrust_lag_up: float
    thrust_lag_down: float
    drag_xy: float
    drag_z: float
    dead_time: float
    velocity_tilt: float = 0.0

    def __post_init__(self) -> None:
        units = {"attitude_gain": "", "thrust_gain": "", "thrust_lag_up": "s", "thrust_lag_down": "s"}
        require_fields(self, require_positive, **units)
        require_fields(self, require_zero_or_positive, drag_xy="1/s", drag_z="1/s", dead_time="s")
        require_fields(self, partial(require_number, least=-1.0, most=1.0), velocity_tilt="rad s/m")


@dataclass(frozen=True, kw_only=True)
class Motors:
    """How the firmware turns a force into motor voltage, so that force is linear in PWM whatever the battery.

    Attributes:
        voltage_to_force: c0..c3 of one motor's force c0 + c1 U + c2 U^2 + c3 U^3, N/V^k, U the motor voltage.
        force_min: one motor's smallest force, N; less is commanded as zero.
        bits: resolution of the motor command.
        idle_pwm: smallest motor command while armed, 0..65535.
        arming_required: whether the drone flies only after an arming request.
        hover_pwm: thrust command that the on-board position controller takes for a hover, 0..65535.

    Raises:
        FlatsatError: a value is not a number of its range, or the force does not rise with the voltage.
    """

    voltage_to_force: tuple[float, float, float, float]
    force_min: float
    bits: int
    idle_pwm: float
    arming_required: bool
    hover_pwm: float

    def __post_init__(self) -> None:
        require_fields(self, require_not_negative, force_min="N", idle_pwm="", hover_pwm="")
        for order, value in enumerate(self.voltage_to_force):
            check = require_positive if order in (1, 3) else require_number
            check(f"voltage_to_force[{order}]", value, f"N/V^{order}")
        _, c1, c2, c3 = self.voltage_to_force
        increasing = c2 >= 0 or c2 * c2 < 3.0 * c1 * c3
        cubic = "coefficients of a cubic that increases from 0 V on"
        require(increasing, "voltage_to_force", self.voltage_to_force, "N/V^k", cubic)
        require(1 <= self.bits <= 16, "bits", self.bits, "", "from 1 to 16")
        for name in ("idle_pwm", "hover_pwm"):
            require(getattr(self, name) <= PWM_FULL, name, getattr(self, name), "", f"at most {PWM_FULL}")


@dataclass(frozen=True, kw_only=True)
class BatteryLimits:
    """The voltages at which the firmware warns and switches off, and those at which the controller warns and lands.

    Attributes:
        low_voltage: V, warning of the firmware below it.
        critical_voltage: V, shutdown by the firmware below it.
        landing_voltage: V, at which the controller lands the drone; left out or 0: low_voltage.
        warning_voltage: V, at which the controller warns, and up to which no drone takes off; left out or 0: 0.1 V
            above landing_voltage.

    Raises:
        FlatsatError: a value is not a number of its range, or they are not in their order.
    """

    low_voltage: float
    critical_voltage: float
    landing_voltage: float = 0.0
    warning_voltage: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_positive, low_voltage="V", critical_voltage="V")
        require_fields(self, require_zero_or_positive, landing_voltage="V", warning_voltage="V")
        low, critical = self.low_voltage, self.critical_voltage
        require(critical <= low, "critical_voltage", critical, "V", f"at most low_voltage, {low} V")
        landing = self.landing_voltage or low
        warning = self.warning_voltage or landing + _WARNING_LEAD
        require(critical <= landing, "landing_voltage", landing, "V", f"at least critical_voltage, {critical} V")
        require(landing < warning, "warning_voltage", warning, "V", f"above landing_voltage, {landing} V")
        object.__setattr__(self, "landing_voltage", landing)
        object.__setattr__(self, "warning_voltage", warning)


@dataclass(frozen=True, kw_only=True)
class VehicleProfile:
    """One kind of drone.

    Attributes:
        name: the profile's name.
        mass: take-off mass, kg.
        force_max: total force at PWM 65535, N.
        pwm_max: largest thrust command the firmware accepts, 0..65535.
        dynamics: identified response.
        motors: force to motor command.
        battery: voltage limits.
        thrust_slope: s of force = force_max (PWM / 65535)^s, the relative change of the force over that of the command:
            1 is the linear map that the firmware means to have, below it a change of the command does less.
        thrust_voltage: n of the factor (V / voltage)^n of that force, V the battery's voltage under load: what is left
            of the battery when the firmware has corrected its commands; 0: the force is the same at any voltage.
        voltage: V, under load, for which force_max is meant; it counts with thrust_voltage alone.
        intervals: how well the figures are known, of a profile that was identified; None: not known.

    Raises:
        FlatsatError: a value is not a number of its range, or the mass is more than the motors lift.
    """

    name: str
    mass: float
    force_max: float
    pwm_max: float
    dynamics: Dynamics
    motors: Motors
    battery: BatteryLimits
    thrust_slope: float = 1.0
    thrust_voltage: float = 0.0
    voltage: float = 3.7
    intervals: Intervals | None = None

    def __post_init__(self) -> None:
        require_fields(self, require_positive, mass="kg", force_max="N", pwm_max="")
        require_fields(self, partial(require_number, least=0.25, most=4.0), thrust_slope="")
        require_fields(self, partial(require_number, least=-4.0, most=4.0), thrust_voltage="")
        require_fields(self, require_positive, voltage="V")
        require(self.pwm_max <= PWM_FULL, "pwm_max", self.pwm_max, "", f"at most {PWM_FULL}")
        heaviest = self.mass * self.thrust_max / GRAVITY
        lifts = f"below {heaviest:.4g} kg, which is all that the motors lift"
        require(self.mass < heaviest, "mass", self.mass, "kg", lifts)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> VehicleProfile:
        """Read a profile from YAML.

        Args:
            path: a file like those in config/vehicles.

        Raises:
            FlatsatError: the file cannot be read, is no YAML mapping, a key is unknown or missing, or a value is out of
                its bounds.
        """
        content = read_yaml(path)
        try:
            return build(cls, content, "profile")
        except FlatsatError as error:
            raise located(path, error) from error

    @property
    def thrust_max(self) -> float:
        """Largest mass-normalised thrust, at pwm_max, m/s^2."""
        if self.thrust_slope == 1.0:
            return self.force_max * self.pwm_max / PWM_FULL / self.mass
        return float(self.thrust_from_pwm(self.pwm_max))

    def mass_for(self, thrust: float) -> float:
        """Return the take-off mass, kg, with which its motors just make a mass-normalised thrust, m/s^2."""
        return self.mass * self.thrust_max / thrust

    def voltage_for(self, thrust: float) -> float | None:
        """Return the voltage under load, V, from which its motors make a mass-normalised thrust, m/s^2.

        None: its flights do not tell that more voltage makes more thrust.
        """
        known = None if self.intervals is None else self.intervals.thrust_voltage
        least = self.thrust_voltage if known is None else known[0]
        if not min(least, self.thrust_voltage) > 0.0:
            return None
        return float(self.voltage * (thrust / self.thrust_max) ** (1.0 / self.thrust_voltage))

    def voltage_factor(self, voltage: ArrayLike) -> FloatArray:
        """Return the force at voltages under load, V, of any shape, over that at `voltage`; 0 V and less make none."""
        return np.maximum(np.asarray(voltage, dtype=np.float64) / self.voltage, 0.0) ** self.thrust_voltage

    @property
    def lag(self) -> float:
        """First-order lag tau of the achieved acceleration, s: the slowest of attitude (mean delay) and thrust."""
        dynamics = self.dynamics
        return max(dynamics.attitude.mean_delay, dynamics.thrust_lag_up, dynamics.thrust_lag_down)

    @property
    def delay(self) -> float:
        """Dead time d on board, s; a radio and a motion capture add their own."""
        return self.dynamics.dead_time

    def pwm_from_thrust(self, thrust: ArrayLike) -> FloatArray:
        """Return the thrust command of a mass-normalised thrust.

        Args:
            thrust: T, m/s^2, any shape.

        Returns:
            PWM of the same shape, not clipped: T = thrust_max is pwm_max. It has the sign of the thrust.
        """
        asked = np.asarray(thrust, dtype=np.float64)
        if self.thrust_slope == 1.0:
            return asked * (self.mass * PWM_FULL / self.force_max)
        return np.sign(asked) * (np.abs(asked) * (self.mass / self.force_max)) ** (1.0 / self.thrust_slope) * PWM_FULL

    def thrust_from_pwm(self, pwm: ArrayLike) -> FloatArray:
        """Return the mass-normalised thrust of a thrust command: the inverse of pwm_from_thrust.

        Args:
            pwm: any shape, PWM_FULL for force_max.

        Returns:
            T, m/s^2, of the same shape.
        """
        if self.thrust_slope == 1.0:
            return np.asarray(pwm, dtype=np.float64) * (self.force_max / (self.mass * PWM_FULL))
        return self.force_from_pwm(pwm) / self.mass

    def force_from_pwm(self, pwm: ArrayLike) -> FloatArray:
        """Return the force, N, of thrust commands pwm, any shape, from 0 to PWM_FULL: force_max (pwm / 65535)^slope."""
        command = np.asarray(pwm, dtype=np.float64)
        if self.thrust_slope == 1.0:
            return command * (self.force_max / PWM_FULL)
        return np.sign(command) * (np.abs(command) / PWM_FULL) ** self.thrust_slope * self.force_max


def load_vehicle(name_or_path: str | os.PathLike[str]) -> VehicleProfile:
    """Read a vehicle profile that the package ships, by its name, or one of the user's own.

    Args:
        name_or_path: such as `cf21`, or a path; see `base.resources.config_path`.

    Raises:
        FlatsatError: there is none, the text lists the names that exist; or as `VehicleProfile.load`.
    """
    return VehicleProfile.load(config_path(name_or_path, "vehicles"))


def profile_document(profile: VehicleProfile) -> dict[str, Any]:
    """Return a profile as what its YAML file says: mappings, lists, numbers; what is not known is left out."""
    return cast("dict[str, Any]", without_empty(dataclasses.asdict(profile)))
