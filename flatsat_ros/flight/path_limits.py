"""What a path to rest may ask for, so that the drone can follow, and the room that it stays in."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.law.input_set import InputSet

# the axes that are planned together
HORIZONTAL, VERTICAL = slice(0, 2), slice(2, 3)

# of the radius of the ball of accelerations around hover, a path may use this share; the rest is left to the law
_SHARE = 0.5
# of that share, what the vertical part may use; the horizontal one gets what the input set then leaves
_VERTICAL = 0.5

# paths keep this share of what is assumed of references: their limits are looked at in points
_KEPT = 0.97

_TOLERANCE = 0.02  # relative: their limits are looked at in points


class Demand(NamedTuple):
    """What the law may be asked for by the motion of some axes: f = r + lead r', r = a + drag v (`flight.preview`).

    Attributes:
        most: largest |f|, m/s^2.
        drag: 1/s.
        lead: s.
    """

    most: float
    drag: float = 0.0
    lead: float = 0.0

    def of(self, velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray) -> FloatArray:
        """Return f of a motion, m/s^2."""
        return np.asarray(self.drag * velocity + (1.0 + self.lead * self.drag) * acceleration + self.lead * jerk)


@dataclass(frozen=True)
class PathLimits:
    """What a path may ask for, each of its horizontal and of its vertical part.

    Attributes:
        horizontal: what the law may be asked for; without drag and lead that is the acceleration.
        vertical: likewise.
        speed: m/s.
        jerk: m/s^3.
        snap: m/s^4.
        acceleration: m/s^2, beside what the law may be asked for.
    """

    horizontal: Demand
    vertical: Demand
    speed: float = 1.0
    jerk: float = 2.0
    snap: float = 20.0
    acceleration: float = math.inf

    @classmethod
    def within(cls, limits: InputSet, speed: float, margin: float | None = None) -> PathLimits:
        """Return limits that leave a margin everywhere on a path.

        Args:
            limits: V_c.
            speed: m/s.
            margin: m/s^2; None for half of the input set's inner radius.
        """
        g, tilt = limits.gravity, limits.tilt_max
        if margin is None:
            margin = (1.0 - _SHARE) * limits.inner_radius
        vertical = _VERTICAL * (limits.inner_radius - margin)
        cone = ((g - vertical) * math.sin(tilt) - margin) / math.cos(tilt)
        sphere = math.sqrt((limits.thrust_max - margin) ** 2 - (g + vertical) ** 2)
        return cls(Demand(min(cone, sphere)), Demand(vertical), speed)

    @classmethod
    def assumed(cls, limits: InputSet, speed: float, flight: FlightSection) -> PathLimits:
        """Return limits within what a flight section assumes of references."""
        found, most = cls.within(flight.room(limits), speed, flight.margin), flight.assumptions
        sides, upright = (axis.design.model for axis in flight.axes)
        return cls(
            Demand(_KEPT * found.horizontal.most, sides.drag + sides.tilt, sides.lead),
            Demand(_KEPT * found.vertical.most, upright.drag + upright.tilt, upright.lead),
            speed,
            _KEPT * most.jerk,
            _KEPT * most.snap,
            _KEPT * flight.acceleration,
        )

    def led_to(self, motion: FloatArray) -> bool:
        """Tell whether a path within these limits can have led to a motion (4, 3), see `path_to`."""
        motion = motion[1:] / (1.0 + _TOLERANCE)
        return all(
            np.linalg.norm(asked.of(*motion[:, axes])) <= asked.most
            and np.linalg.norm(motion[1, axes]) <= self.acceleration
            and np.linalg.norm(motion[2, axes]) <= self.jerk
            for axes, asked in ((HORIZONTAL, self.horizontal), (VERTICAL, self.vertical))
        )

    def slower(self, speed: float) -> PathLimits:
        """Return the same limits with a speed, m/s, that is at most this."""
        return replace(self, speed=min(self.speed, speed))


class ReferenceBox(NamedTuple):
    """The room for references: low <= position <= high, (3,) each, m, world frame."""

    low: FloatArray
    high: FloatArray
