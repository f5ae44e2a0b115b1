"""What the references need of the drones, ahead of time: a command acts later, and attitude and thrust follow slowly.

The nominal plant of a flight certificate follows a reference whose drag it knows if it is commanded f = r + lead r' at
the time at which the command acts, r = a_ref + (drag + tilt) v_ref (docs/mathematics.md, "The loop that flies"). A
command acts for a period from its delay on, so f is that of the middle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.flight_plant import Design
from flatsat_ros.certificate.lyapunov import bernstein_coefficients
from flatsat_ros.flight.references import References
from flatsat_ros.flight.trajectory import SIZE, Trajectory, nearest
from flatsat_ros.law.input_set import InputSet

_DERIVATIVE = np.diag(np.arange(1.0, SIZE), 1)  # row of powers -> row of their derivatives


class Preview:
    """Looks ahead along the references of N drones."""

    def __init__(self, references: References, horizontal: Design, vertical: Design) -> None:
        """Look at some references.

        Args:
            references: of N drones.
            horizontal: for x and y.
            vertical: for z.
        """
        self._references = references
        self._parts = [
            (axes, references.cursor(), design.model.delay + design.period / 2.0, _needed_by(design))
            for axes, design in ((slice(0, 2), horizontal), (slice(2, 3), vertical))
        ]

    def needed(self, now: float) -> FloatArray:
        """Return f (N, 3), m/s^2, of the commands at now, s."""
        references = self._references
        f = np.zeros((len(references.at_rest), 3))
        if all_of(references.at_rest):
            return f
        for axes, cursor, ahead, needed in self._parts:
            references.seek(cursor, now + ahead)
            powers = np.power((now + ahead - cursor.origin)[:, np.newaxis], _EXPONENTS)
            f[:, axes] = ((powers @ needed)[:, np.newaxis] @ cursor.coefficients[..., axes])[:, 0]
        return f


_EXPONENTS = np.arange(SIZE)


def needed_margin(path: Trajectory, limits: InputSet, flight: FlightSection) -> float:
    """Return a lower bound of the distance of f to the boundary of `FlightSection.room` along a trajectory, m/s^2.

    With the margin of the certificate every applied gain is at least 1. f is a polynomial on each segment, so that
    control points bound it as they bound accelerations. Where the models' delays differ, the vertical part is of
    another time than the horizontal one: by how much it can have moved in between is taken off.

    Args:
        path: the reference.
        limits: V_c.
        flight: section of the certificate, whose models the reference is led for.
    """
    sides, upright = (axis.design for axis in flight.axes)
    f = asked_of_the_law(path, *led_for(flight))
    apart, moving = abs(sides.model.delay - upright.model.delay), 0.0
    span = np.diff(path.times)
    if apart > 0.0 and span.size:
        powers = f[..., 2].T * np.power(span, _EXPONENTS[:, np.newaxis])
        steps = np.diff(bernstein_coefficients(powers, 0.0, 1.0), axis=0) * (SIZE - 1) / span
        moving = float(np.abs(steps).max())
    return nearest(f, path.times, flight.room(limits)).distance - apart * moving


def asked_of_the_law(path: Trajectory, drag: Sequence[float], lead: Sequence[float]) -> FloatArray:
    """Return the coefficients of f (M - 1, 8, 3), m/s^2, of the powers of the time on each segment of a trajectory.

    Args:
        path: the trajectory.
        drag: 1/s, horizontal and vertical.
        lead: s, likewise.
    """
    f = np.empty_like(path.coefficients)
    for axes, own_drag, own_lead in zip((slice(0, 2), slice(2, 3)), drag, lead, strict=True):
        f[..., axes] = _needed(own_drag, own_lead) @ path.coefficients[..., axes]
    return f


def led_for(flight: FlightSection) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return drag, 1/s, and lead, s, of the models that references are led for, horizontal and vertical."""
    sides, upright = (axis.design.model for axis in flight.axes)
    return (sides.drag + sides.tilt, upright.drag + upright.tilt), (sides.lead, upright.lead)


def _needed_by(design: Design) -> FloatArray:
    return _needed(design.model.drag + design.model.tilt, design.model.lead)


def _needed(drag: float, lead: float) -> FloatArray:
    """Return (8, 8) from the powers of the time to the factors of a polynomial's coefficients in f."""
    asked = _DERIVATIVE @ _DERIVATIVE + drag * _DERIVATIVE
    # a row of powers (t^0 .. t^7) times _DERIVATIVE is the row of derivatives
    return np.asarray(asked + lead * asked @ _DERIVATIVE)
