"""From the thrust command to the force: battery, voltage compensation, rounding of the motor command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import BoolArray, FloatArray
from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_positive
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile
from flatsat_ros.sim.dynamics import STEP

# the firmware low-passes the battery voltage with 0.01 per millisecond (stabilizer.c, batteryCompensation)
_SUPPLY_FILTER = 1.0 - 0.99 ** (STEP / 0.001)

BATTERY_PERIOD = 1.0  # s, between two battery messages of a drone, as crazyswarm2's server sends them by default
_SUPPLY_MIN = 2.0  # V: below it the firmware takes the battery for broken (motors.c, motorsCompensateBatteryVoltage)


@dataclass(frozen=True)
class Battery:
    """A battery; by default one that never changes.

    Attributes:
        voltage: open-circuit voltage at the start, V; by default that of a half-charged LiPo cell.
        sag: drop under load, V at full force.
        drain: fall of the open-circuit voltage, V/s at full force.

    Raises:
        FlatsatError: a value is not a number of its range, or the sag is not below the voltage.
    """

    voltage: float = 3.8
    sag: float = 0.0
    drain: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_positive, voltage="V")
        require_fields(self, require_not_negative, sag="V", drain="V/s")
        require(self.sag < self.voltage, "sag", self.sag, "V", f"below the voltage, {self.voltage} V")


class PowerTrain:
    """Battery and motors as the firmware drives them.

    The firmware makes the force linear in PWM: it inverts the motor's force curve, divides by the (low-passed) battery
    voltage and rounds down to the resolution of the motor command (motors.c, motorsCompensateBatteryVoltage and
    motorsConv16ToBits). So the force falls with the battery only where the motor command would have to exceed 1, and by
    what the profile says with `thrust_voltage` is left of the battery nevertheless.

    Attributes:
        voltage: (N,) battery voltage under load, V.
        ratio: (N,) motor command, 0..1, before rounding.
    """

    def __init__(self, profile: VehicleProfile, battery: Battery, count: int) -> None:
        """Charge the batteries.

        Args:
            profile: the drones' kind.
            battery: of each drone.
            count: N.
        """
        self._profile = profile
        self._battery = battery
        self._open = np.full(count, battery.voltage)
        self._supply = self._open.copy()
        self.voltage = self._open.copy()
        self.ratio = np.zeros(count)

    def step(self, pwm: FloatArray, running: BoolArray) -> FloatArray:
        """Advance by STEP.

        Args:
            pwm: (N,) thrust command, 0..65535.
            running: (N,) whether the motors are allowed to turn.

        Returns:
            (N,) total force, N.
        """
        self._supply += _SUPPLY_FILTER * (self.voltage - self._supply)
        force = np.where(running, self._force(pwm), 0.0)
        if self._profile.thrust_voltage != 0.0:
            force *= self._profile.voltage_factor(self.voltage)
        self.ratio = np.where(running, self.ratio, 0.0)
        load = force / self._profile.force_max
        self._open -= self._battery.drain * load * STEP
        self.voltage = self._open - self._battery.sag * load
        return force

    def _force(self, pwm: FloatArray) -> FloatArray:
        """Return the force of a running drone, N, and keep the motor command."""
        motors = self._profile.motors
        wanted = self._wanted(pwm)
        off = (wanted < motors.force_min) | (self._supply < _SUPPLY_MIN)
        ratio = np.where(off, 0.0, self._voltage(wanted) / np.maximum(self._supply, _SUPPLY_MIN))
        self.ratio = np.minimum(np.maximum(ratio, motors.idle_pwm / PWM_FULL), 1.0)
        # the upper bits of the 16-bit ratio, out of a period of 2^bits: full scale is one count short of always on
        command = np.floor(self.ratio * PWM_FULL * 2.0 ** (motors.bits - 16)) * 2.0**-motors.bits
        applied = command * self.voltage
        c0, c1, c2, c3 = motors.voltage_to_force
        force = 4.0 * (c0 + applied * (c1 + applied * (c2 + applied * c3)))
        return np.where(command > 0.0, np.maximum(force, 0.0), 0.0)

    def _wanted(self, pwm: FloatArray) -> FloatArray:
        """Return the force, N, that one motor shall give."""
        if self._profile.thrust_slope == 1.0:
            return pwm * (self._profile.force_max / PWM_FULL / 4.0)
        return self._profile.force_from_pwm(pwm) / 4.0

    def _voltage(self, force: FloatArray) -> FloatArray:
        """Return the motor voltage, V, of one motor's force, N: the real root of the force curve (Cardano)."""
        c0, c1, c2, c3 = self._profile.motors.voltage_to_force
        p, r = -c2 / (3.0 * c3), c1 / (3.0 * c3)
        q = p**3 + (c2 * c1 - 3.0 * c3 * (c0 - force)) / (6.0 * c3 * c3)
        root = np.sqrt(np.maximum(q * q + (r - p * p) ** 3, 0.0))
        return np.cbrt(q + root) + np.cbrt(q - root) + p


class IdealPowerTrain(PowerTrain):
    """Force exactly as the profile maps PWM and voltage to it."""

    def _force(self, pwm: FloatArray) -> FloatArray:
        """Return the force of a running drone, N, and keep the motor command."""
        self.ratio = pwm / PWM_FULL
        if self._profile.thrust_slope == 1.0:
            return self.ratio * self._profile.force_max
        return self._profile.force_from_pwm(pwm)
