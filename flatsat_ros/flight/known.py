"""How well the state is known in a flight that keeps a flight certificate's assumptions.

The innovation is what a flight shows of that: as long as the assumptions hold it stays below the sum of the answers to
the worst inputs. The sums are taken for plants at the corners of the certificate's box, at its smallest and largest
gain, and enlarged: they are thresholds of monitors, no part of a proof.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.certificate.flight_tube import Assumptions

# by how much plants inside the box and gains that change may exceed the corners
_ALLOWANCE = 1.25
# periods over which answers are summed; an answer is forgotten after that
_PERIODS = 400
# what varies between corners; other figures are those of the middle
_FIGURES = ("delay", "lag", "frequency", "gain")


class Known(NamedTuple):
    """Bounds over the axes that share a loop.

    Attributes:
        innovation: m.
        position: error of the estimated position at a tick, m.
        velocity: m/s.
    """

    innovation: float
    position: float
    velocity: float


def known(axis: Axis, gain_min: float, gain_max: float, assumptions: Assumptions) -> Known:
    """Return how well the state of some axes is known.

    Args:
        axis: of a flight certificate.
        gain_min: smallest applied gain.
        gain_max: largest applied gain.
        assumptions: of the tube.
    """
    worst = np.zeros(3)
    for plant in _corners(axis.box.low, axis.box.high):
        loop = FlightLoop(axis.design, plant)
        for gain in {gain_min, gain_max}:
            worst = np.maximum(worst, _sums(loop, gain, assumptions, axis.box.low, axis.box.high))
    worst[0] += assumptions.noise / _ALLOWANCE
    return Known(*(_ALLOWANCE * worst).tolist())


def _corners(low: Plant, high: Plant) -> list[Plant]:
    middle = {name: (getattr(low, name) + getattr(high, name)) / 2.0 for name in ("damping", "tilt")}
    choices = [sorted({getattr(low, name), getattr(high, name)}) for name in _FIGURES]
    return [
        replace(low, **middle, **dict(zip(_FIGURES, figures, strict=True))) for figures in itertools.product(*choices)
    ]


def _sums(loop: FlightLoop, gain: float, assumptions: Assumptions, low: Plant, high: Plant) -> FloatArray:
    """Return the largest innovation without the noise of its pose, and errors of position and velocity, (3,)."""
    h, n = loop.design.period, loop.plant.size
    model = loop.design.model
    error = assumptions.drive(model, h, low, high) * loop.plant.gain
    own = assumptions.drive(model, h, model, model)
    rate = assumptions.rate(model, low, high)
    middle = h / 2.0
    inputs = np.stack(
        [
            loop.noise_input * assumptions.noise,
            loop.drive_input(middle) * h * error,
            loop.model_drive_input(middle) * h * own,
            loop.rate_input(middle) * h * rate,
        ],
        axis=1,
    )
    before = loop.estimate  # rows (y, n + 1) of the model's state a period later
    ahead = loop.moved  # rows (x, n + 1) of the plant's
    command = np.vstack([np.eye(loop.size), loop.compensation + gain * loop.feedback])
    rows = np.stack([(ahead[0] - before[0]) @ command, np.zeros(loop.size), np.zeros(loop.size)])
    rows[1, 0] = rows[2, 1] = 1.0
    rows[1, n] = rows[2, n + 1] = -1.0
    matrix, answer, total = loop.matrix(gain), inputs, np.zeros(3)
    for _ in range(_PERIODS):
        total += np.abs(rows @ answer).sum(axis=1)
        answer = matrix @ answer
    return total
