"""What a flight certificate takes for granted, as far as a flight can show that it does not hold."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.flight.known import known

# d^ is compared with what it was this time, s, before, which is the bandwidth at which its rate is assumed
RATE_TIME = 1.0
# ticks that are farther apart than so many periods, or nearer together than what that leaves of two
_GAP = 1.5
_ROUNDING = 1e-9
_INSTANT = 1e-6  # s: what stamps are rounded by


class Assumption(IntEnum):
    """What does not hold; of several the first."""

    NONE = 0
    POSE_AGE = 1
    PERIOD = 2
    INNOVATION = 3
    DISTURBANCE = 4
    DISTURBANCE_RATE = 5
    REFERENCE = 6
    GAIN = 7
    START = 8  # all of these hold, but not for long enough to have brought it into the tube
    TUBE = 9  # and for long enough, and still it is outside
    LATENESS = 10


# of each what is watched, its value in the unit that people read, and that unit
_WORDS = {
    Assumption.POSE_AGE: ("the newest pose is old", 1e3, "ms"),
    Assumption.PERIOD: ("ticks are not even: time between two", 1e3, "ms"),
    Assumption.INNOVATION: ("its poses are not where they are expected", 1e3, "mm"),
    Assumption.DISTURBANCE: ("it is disturbed", 1.0, "m/s^2"),
    Assumption.DISTURBANCE_RATE: ("its disturbance changes within a second", 1.0, "m/s^2"),
    Assumption.REFERENCE: ("its reference asks for more than is assumed", 100.0, "%"),
    Assumption.GAIN: ("its applied gain is outside the interval", 1.0, ""),
    Assumption.LATENESS: ("it follows its commands too late or too early, off the middle by", 1e3, "ms"),
    Assumption.TUBE: ("it is outside its tube although all seems to be as assumed", 1e2, "cm"),
}
# the quantities that are watched, in the order of their columns: scalars, then sizes of vectors
COLUMNS = (
    Assumption.POSE_AGE,
    Assumption.PERIOD,
    *[Assumption.INNOVATION] * 2,
    Assumption.DISTURBANCE,
    *[Assumption.DISTURBANCE_RATE] * 2,
    Assumption.REFERENCE,
    *[Assumption.GAIN] * 2,
    Assumption.LATENESS,
)


class Seen(NamedTuple):
    """What a tick shows of N drones.

    Attributes:
        error: (N, 6) estimate less reference, m and m/s.
        reference: (N, 9) at the tick.
        age: (N,) of the pose used, s.
        innovation: (N, 3) m.
        disturbance: (N, 3) estimated, m/s^2.
        gain: (N,) applied.
        nominal: (N, 3) v0, m/s^2.
        acceleration: (N, 3) of the model, m/s^2.
    """

    error: FloatArray
    reference: FloatArray
    age: FloatArray
    innovation: FloatArray
    disturbance: FloatArray
    gain: FloatArray
    nominal: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class Assumed:
    """What a flight shows as long as all holds that is assumed; pairs are horizontal and vertical.

    Attributes:
        most: (K,) of each quantity that is watched, see `COLUMNS`.
        innovations: (2,) m.
        tube: (2,) of |e|, m.
        uncertain: (2,) errors of the estimated position, m.
        inside: (3, 2) of |e|, |e'| and |v0|, as they are estimated: m, m/s, m/s^2; who is inside has reached its tube.
        easy: (6, 2) squares of e, e', v0, innovation, d^ and its change; while these are not exceeded, nothing is.
    """

    most: FloatArray
    innovations: FloatArray
    tube: FloatArray
    uncertain: FloatArray
    inside: FloatArray
    easy: FloatArray

    @classmethod
    def of(cls, flight: FlightSection, clip: float, late: float) -> Assumed:
        """Return those of a flight certificate.

        Args:
            flight: what is assumed.
            clip: largest disturbance that is compensated, m/s^2.
            late: by how much commands may act later or earlier than in the middle, s.
        """
        bounds = [known(axis, flight.gain_min, flight.gain_max, flight.assumptions) for axis in flight.axes]
        changes = [
            flight.assumptions.rate(axis.design.model, axis.box.low, axis.box.high) / axis.box.low.gain * RATE_TIME
            + 2.0 * axis.tube.disturbance
            for axis in flight.axes
        ]
        innovations, period = [bound.innovation for bound in bounds], flight.horizontal.design.period
        most = np.array(
            [
                flight.pose_age + _INSTANT, _GAP * period, *innovations, clip, *changes, 1.0, flight.gain_max,
                1.0 / flight.gain_min, late,
            ]
        ) * (1.0 + _ROUNDING)  # fmt: skip
        tubes = np.array([[getattr(a.tube, n) for a in flight.axes] for n in ("position", "velocity", "nominal")])
        easy = np.array([tubes[0], *tubes[1:] * np.inf, most[2:4], [clip / 2.0] * 2, changes])
        return cls(
            most=most,
            innovations=np.array(innovations),
            tube=tubes[0],
            uncertain=np.array([bound.position for bound in bounds]),
            inside=tubes - np.array([[b.position, b.velocity, 0.0] for b in bounds]).T,
            easy=easy * easy,
        )


def in_words(which: int, value: float, bound: float) -> str:
    """Return in words what does not hold; empty if all does.

    Args:
        which: value of `Assumption`.
        value: what is seen, in SI units.
        bound: of that.
    """
    assumption = Assumption(which)
    if assumption is Assumption.NONE:
        return ""
    if assumption is Assumption.START:
        return "tube not claimed yet: it comes from outside"
    text, factor, unit = _WORDS[assumption]
    return f"tube not claimed: {text}, {factor * value:.3g} {unit}, bound {factor * bound:.3g} {unit}"
