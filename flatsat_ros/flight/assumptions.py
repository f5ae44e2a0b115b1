"""What a flight certificate takes for granted, as far as a flight can show that it does not hold.

A monitor proves no assumption. One that fails says that the tube is not claimed now, and why.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import Flight
from flatsat_ros.flight.known import known

# d^ now is compared with that of this time, s, before: the bandwidth at which its rate is assumed
_RATE_TIME = 1.0
# how often, s, d^ is remembered for that
_REMEMBER = 0.1
# ticks that are farther apart than this many periods, or nearer together than the rest of two, are told
_GAP = 1.5
# a start outside counts as forgotten when it adds no more than this share of the tube
_FORGOTTEN = 0.05
# a drone that is outside the tube for so long, s, although everything else seems to hold, has a fault
_OUTSIDE_TIME = 0.5
# an applied gain is in its interval up to rounding
_ROUNDING = 1e-9


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
    START = 8  # all hold, but not for long enough to have brought it back into the tube
    TUBE = 9  # all seem to hold, and still it is outside


_SENTENCES = {
    Assumption.POSE_AGE: ("age of the newest pose", 1e3, "ms"),
    Assumption.PERIOD: ("time between two ticks", 1e3, "ms"),
    Assumption.INNOVATION: ("surprise of the newest pose", 1e3, "mm"),
    Assumption.DISTURBANCE: ("disturbance", 1.0, "m/s^2"),
    Assumption.DISTURBANCE_RATE: (f"change of the disturbance in {_RATE_TIME:g} s", 1.0, "m/s^2"),
    Assumption.REFERENCE: ("demand of the reference", 100.0, "% of the assumed"),
    Assumption.GAIN: ("applied gain", 1.0, ""),
    Assumption.TUBE: ("distance to the reference", 1e2, "cm"),
}


class Monitors:
    """Watches N drones.

    Attributes:
        broken: (N,) values of `Assumption`.
        value: (N,) of what is broken, bound (N,) that it exceeds, in SI units.
        ratio: (N,) distance to the reference over the tube, the larger of horizontal and vertical.
    """

    def __init__(self, flight: Flight, count: int) -> None:
        """Watch drones of which nothing holds yet."""
        self._flight = flight
        axes = flight.horizontal, flight.vertical
        self._known = [known(axis, flight.gain_min, flight.gain_max, flight.assumptions) for axis in axes]
        self._tubes = [axis.tube for axis in axes]
