"""How well an identified vehicle is known: an interval for each figure that its flight logs support."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from flatsat_ros.base.errors import require, require_number

Interval = tuple[float, float]

_UNITS = {
    "natural_frequency": "rad/s",
    "damping": "",
    "attitude_gain": "",
    "lag_and_delay": "s",
    "velocity_tilt": "rad s/m",
    "drag_xy": "1/s",
    "drag_z": "1/s",
    "thrust_lag": "s",
    "thrust_slope": "",
    "thrust_voltage": "",
    "thrust_available": "m/s^2",
}


@dataclass(frozen=True, kw_only=True)
class Intervals:
    """The least and the largest value, of the same drone in other flights, of what was identified; None: not known.

    Attributes:
        natural_frequency: wn of the attitude loop, rad/s.
        damping: zeta of the attitude loop, dimensionless.
        attitude_gain: steady angle over commanded angle, dimensionless.
        lag_and_delay: mean lag of the attitude and everything that delayed it in the logs, s; a log tells their sum.
        velocity_tilt: as in `Dynamics`, rad s/m.
        drag_xy: as in `Dynamics`, 1/s.
        drag_z: likewise, 1/s.
        thrust_lag: first-order lag of the thrust, rising or falling, s.
        thrust_slope: as in `VehicleProfile`, dimensionless.
        thrust_voltage: likewise.
        thrust_available: mass-normalised thrust at pwm_max, m/s^2.

    Raises:
        FlatsatError: an end is not a number, or the first is above the second.
    """

    natural_frequency: Interval | None = None
    damping: Interval | None = None
    attitude_gain: Interval | None = None
    lag_and_delay: Interval | None = None
    velocity_tilt: Interval | None = None
    drag_xy: Interval | None = None
    drag_z: Interval | None = None
    thrust_lag: Interval | None = None
    thrust_slope: Interval | None = None
    thrust_voltage: Interval | None = None
    thrust_available: Interval | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            interval = getattr(self, field.name)
            if interval is not None:
                unit = _UNITS[field.name]
                least, most = (require_number(field.name, value, unit) for value in interval)
                require(least <= most, field.name, interval, unit, "an interval, the smaller end first")
