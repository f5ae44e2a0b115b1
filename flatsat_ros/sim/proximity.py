"""What the floor and other drones do to a drone's lift: ground effect and downwash, of identified figures.

Ground effect. A propeller of radius R at the height h above the floor lifts 1 + c (R / (4 h))^2 times as much; c was
identified for the Crazyflie 2.x (J. Panerati et al., Learning to fly, IROS 2021; gnd_eff_coeff of its cf2x.urdf), and
so was the height below which nothing changes any more.

Downwash. Two Crazyflies of 34 g that hover above each other: the lower one is pushed down with 10, 8, 6 and 4 g at
0.2, 0.3, 0.4 and 0.5 m (G. Shi et al., Neural-Swarm, ICRA 2020, figure 3, as public code reads it). So the push falls
linearly, from 14 / 34 of the upper drone's lift at no distance to nothing at 0.7 m; nearer than 0.2 m it stays as it
is there. Sideways it falls as a bell curve, to half at 0.1 m: that code has a cylinder of this radius. Torques are
left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require, require_fields, require_not_negative, require_positive

RADIUS = 0.0231  # m, of a propeller
HEIGHT = 0.03  # m, of the propellers above the feet
_LEAST_HEIGHT = 0.0377  # m, of propellers: nearer to the floor the effect does not grow
_NEAREST = 0.2  # m: drones nearer to each other push as at this distance


@dataclass(frozen=True)
class Proximity:
    """How strong both are; by default as identified.

    Attributes:
        ground_effect: c of the ground effect; 0 is none.
        downwash: push on a drone right below another, over the other's lift, extended to no distance; 0 is none.
        reach: distance below a drone at which its downwash ends, m.
        width: distance sideways at which it is half as strong, m.

    Raises:
        FlatsatError: a value is not a number of its range.
    """

    ground_effect: float = 11.36859
    downwash: float = 14.0 / 34.0
    reach: float = 0.7
    width: float = 0.1

    def __post_init__(self) -> None:
        require_fields(self, require_not_negative, ground_effect="", downwash="")
        require_fields(self, require_positive, reach="m", width="m")
        require(self.reach > _NEAREST, "reach", self.reach, "m", f"above {_NEAREST}")

    @property
    def is_felt(self) -> bool:
        """Whether there is any of both."""
        return self.ground_effect > 0.0 or self.downwash > 0.0

    def lift(self, height: FloatArray) -> FloatArray:
        """Return how many times as much drones lift whose feet are at a height above the floor, (N,), m."""
        ratio = RADIUS / (4.0 * np.maximum(height + HEIGHT, _LEAST_HEIGHT))
        return 1.0 + self.ground_effect * ratio * ratio

    def push(self, position: FloatArray, others: FloatArray, lift: FloatArray) -> FloatArray:
        """Return the force that pushes drones down, (N,), N.

        Args:
            position: (N, 3) m, world, of those that are pushed.
            others: (M, 3) m, world, of those that push, the same drones among them.
            lift: (M,) N, of those that push.
        """
        away = others - position[:, None, :]  # (N, M, 3)
        above = away[..., 2]
        near = (above > 0.0) & (above < self.reach)
        if not near.any():
            return np.zeros(len(position))
        fall = 1.0 - np.maximum(above, _NEAREST) / self.reach
        aside = (away[..., 0] ** 2 + away[..., 1] ** 2) / self.width**2
        push = np.where(near, self.downwash * fall * np.exp(-math.log(2.0) * aside) * lift, 0.0)
        return np.asarray(push.sum(axis=1))


STILL = Proximity(ground_effect=0.0, downwash=0.0)
