"""Laps of closed references: all drones set out along their ways, at a pace from 0 to 1, and stop in the same way.

Their progress is one number, as in every change of pace (`pacing`), so that distances that are proved for one lap hold
from the first place to the last. A plan of laps rests at the place where they begin, at both ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flatsat_ros.base.errors import FlatsatError, refusal, require, require_fields, require_positive
from flatsat_ros.base.strict_yaml import section
from flatsat_ros.certificate.lyapunov import bernstein_coefficients
from flatsat_ros.flight.preview import asked_of_the_law
from flatsat_ros.flight.trajectory import SIZE, Trajectory, nearest
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.pacing import EXCESS, braked, resumed

LAPS_MAX = 1000
_LAPS = ("count", "ramp")
_RAMPS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 30.0)  # s, that are tried


@dataclass(frozen=True)
class Laps:
    """How often closed references are flown.

    Attributes:
        count: of laps.
        ramp: how long setting out takes, and stopping, s.
    """

    count: int
    ramp: float

    def __post_init__(self) -> None:
        require_laps(self.count)
        require_fields(self, require_positive, ramp="s")

    def duration(self, lap: float) -> float:
        """Return the time from rest to rest, s, of laps that last so long, s, at full pace."""
        return self.count * lap + self.ramp

    def flown(self, lap: Trajectory) -> Trajectory:
        """Return the trajectory of all laps from rest to rest, from time 0 on.

        Args:
            lap: one of them, at full pace.

        Raises:
            FlatsatError: they take less time than a ramp.
        """
        length = self.count * float(lap.times[-1])
        if length < self.ramp:
            raise refusal(
                "duration of all laps", length, "s", f"at least {self.ramp:g} s, that of a ramp: fly more laps"
            )
        going = resumed(laps_of(lap, self.count), 0.0, 0.0, self.ramp)
        return braked(going, length, self.ramp)

    def require_kept(self, laps: Sequence[Trajectory], bounds: Bounds, limits: InputSet) -> None:
        """Refuse ramps that ask for more than changes of pace may: a tenth above the bounds of the plan.

        Args:
            laps: one lap of each drone.
            bounds: of the plan.
            limits: the input set.

        Raises:
            FlatsatError: they do; the text names the limit.
        """
        for lap in laps:
            ramps = Laps(math.ceil(2.0 * self.ramp / float(lap.times[-1])), self.ramp).flown(lap)
            names = ("acceleration", "jerk", "snap")
            most = (bounds.acceleration_max or math.inf, bounds.jerk_max, bounds.snap_max)
            for name, asked, bound in zip(names, _largest(ramps), most, strict=True):
                if asked > EXCESS * bound:
                    what = f"{name} of a drone that sets out within {self.ramp:g} s"
                    raise refusal(what, asked, "in SI units", f"at most {EXCESS * bound:.6g}: let it take longer")
            room = bounds.room(limits)
            least = room.inner_radius - EXCESS * (room.inner_radius - bounds.margin)
            found = nearest(asked_of_the_law(ramps, bounds.drag, bounds.lead), ramps.times, room).distance
            if found < least:
                what = f"margin of a drone that sets out within {self.ramp:g} s"
                raise refusal(what, found, "m/s^2", f"at least {least:.6g}: let it take longer")

    @classmethod
    def from_document(cls, document: object) -> Laps | None:
        """Build it from its part of the document of a plan; None for references from rest to rest."""
        return None if document is None else cls(**section("laps", document, _LAPS))

    def to_document(self) -> dict[str, Any]:
        """Return its part of the document of a plan."""
        return {"count": self.count, "ramp": self.ramp}


def require_laps(count: object) -> None:
    """Refuse what is no number of laps.

    Raises:
        FlatsatError: it is not.
    """
    valid = isinstance(count, int) and not isinstance(count, bool) and 1 <= count <= LAPS_MAX
    require(valid, "number of laps", count, "", f"a whole number from 1 to {LAPS_MAX}")


def with_ramp(count: int, laps: Sequence[Trajectory], bounds: Bounds, limits: InputSet) -> Laps:
    """Return laps with the shortest ramp that keeps what changes of pace may ask for.

    Args:
        count: of laps.
        laps: one lap of each drone.
        bounds: of the plan.
        limits: the input set.

    Raises:
        FlatsatError: there is none.
    """
    for ramp in _RAMPS:
        found = Laps(count, ramp)
        try:
            found.require_kept(laps, bounds, limits)
        except FlatsatError:
            if ramp == _RAMPS[-1]:
                raise
            continue
        found.flown(laps[0])
        return found
    raise AssertionError


def laps_of(lap: Trajectory, count: int) -> Trajectory:
    """Return a number of laps at full pace, one after the other."""
    length = lap.times[-1]
    starts = (lap.times[:-1] + length * np.arange(count)[:, np.newaxis]).ravel()
    return Trajectory(np.append(starts, count * length), np.tile(lap.coefficients, (count, 1, 1)), lap.yaw)


def _largest(path: Trajectory) -> list[float]:
    """Return upper bounds of the norms of acceleration, jerk and snap, m/s^2 and so on, by their control points."""
    span = np.diff(path.times)[:, np.newaxis, np.newaxis]
    rate, found = path.coefficients, []
    for order in range(1, 5):
        rate = rate[:, 1:] * np.arange(1.0, SIZE - order + 1.0)[:, np.newaxis]
        if order > 1:
            powers = (rate * span ** np.arange(rate.shape[1])[:, np.newaxis]).transpose(1, 0, 2)
            found.append(float(np.linalg.norm(bernstein_coefficients(powers, 0.0, 1.0), axis=-1).max()))
    return found
