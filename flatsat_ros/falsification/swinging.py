"""References that ask for as much jerk and snap as a flight section assumes, all the time."""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.flight.trajectory import SIZE, Trajectory

_EDGE = 1.0 - 1e-9

# Snap, in turn: the jerk swings to one side and to the other, so that the acceleration comes and goes once; then
# everything with the other sign, which stops the motion; then back.
_ONCE = np.array([1.0, -1.0, -1.0, 1.0])
_SWINGS = np.concatenate([_ONCE, -_ONCE, -_ONCE, _ONCE])


def amplitudes(flight: FlightSection) -> tuple[float, float, float, float]:
    """Return the largest speed, acceleration, jerk and snap of the references, m/s and so on."""
    assumed = flight.assumptions
    snap = _EDGE * assumed.snap
    jerk = min(_EDGE * assumed.jerk, math.sqrt(snap * _EDGE * flight.acceleration))
    quarter = jerk / snap if snap > 0.0 else 0.0
    acceleration = jerk * quarter
    return 2.0 * acceleration * quarter, acceleration, jerk, snap


def swinging(flight: FlightSection, place: FloatArray, line: FloatArray, begin: float, end: float) -> Trajectory:
    """Return a reference that rests at a place until a time and then swings along a line, at least until the end.

    Args:
        flight: what is assumed of it.
        place: (3,) m.
        line: (3,) of length 1.
        begin: s.
        end: s.
    """
    _, _, jerk, snap = amplitudes(flight)
    quarter = jerk / snap
    count = len(_SWINGS) * math.ceil((end - begin) / quarter / len(_SWINGS))  # it ends at rest
    state, rows = np.zeros(4), np.zeros((count, 5))  # position, velocity, acceleration and jerk along the line
    for number in range(count):
        own = snap * _SWINGS[number % len(_SWINGS)]
        rows[number] = [*(state / (1.0, 1.0, 2.0, 6.0)), own / 24.0]
        derivatives = [*state, own]
        state = np.array(
            [
                sum(derivatives[i] * quarter ** (i - order) / math.factorial(i - order) for i in range(order, 5))
                for order in range(4)
            ]
        )
    coefficients = np.zeros((count, SIZE, 3))
    coefficients[:, :5] = rows[..., np.newaxis] * line
    coefficients[:, 0] += place
    return Trajectory(begin + quarter * np.arange(count + 1.0), coefficients)
