"""By how much later, or earlier, than a flight certificate's model drones follow their commands, as flights show it.

A drone whose lag and delay together are longer than the model's by s has an acceleration that is the model's of s ago:
less by s times its derivative, in motions that are slow against s. Through the estimator that makes an innovation of

    i = -s C (1 + (F (I - L C)) q + (F (I - L C))^2 q^2 + ...) b w

with w the derivative of the model's acceleration, q the shift by a tick, F and b of the double integrator with a
disturbance that stays. s is fitted to the innovations of some seconds. Another drag than the model's makes such
innovations too: of models without drag that is taken off, of others, whose drag is known to a tenth, it is left in. Lag
and delay apart are not told by that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.certificate.flight_cell import Box

if TYPE_CHECKING:
    from flatsat_ros.flight.assumptions import Seen

# what is looked at, s, and how often
_WINDOW, _EVERY = 4.0, 0.5
# standard deviations of the fit by which it must be outside before that is believed
_SURE = 3.0
# a fit that is less sure than this share of the interval says nothing
_LOOSE = 1.0 / 3.0
# how much drag, 1/s, there may be where the certificate counts all of it among the disturbances
_DRAG = 0.6
_TINY = 1e-9  # m^2: who moves no more tells nothing


class Lateness:
    """Fits the lateness of N drones in x and y.

    Attributes:
        excess: (N,) by how much the lateness is surely off the middle of the certificate's interval, s.
        bound: half of that interval, s.
    """

    def __init__(self, axis: Axis, count: int) -> None:
        """Begin with nothing seen.

        Args:
            axis: of x and y.
            count: N.
        """
        design, box = axis.design, axis.box
        own = design.model.delay + design.model.lead
        low, high = (plant.delay + lead - own for plant, lead in zip((box.low, box.high), _leads(box), strict=True))
        self._middle, self.bound = (low + high) / 2.0, (high - low) / 2.0
        self._period, self._count = design.period, count
        self._drag = 0.0 if design.model.drag + design.model.tilt else _DRAG
        length = round(_WINDOW / design.period)
        answer = _answer(design.period, design.observer, length)
        lags = np.arange(length)[:, np.newaxis] - np.arange(length)
        self._filter = np.where(lags >= 0, answer[np.abs(lags)], 0.0)
        self._seen = np.zeros((3, length, count, 2))  # innovation, m, acceleration of the model, m/s^2, velocity, m/s
        self._ticks, self._every = 0, round(_EVERY / design.period)
        self.excess = np.zeros(count)

    def note(self, seen: Seen, steady: np.ndarray) -> bool:
        """Take in a tick; return whether the fit is a new one.

        Args:
            seen: at it.
            steady: (N,) who is steered, and whose estimate is settled; others begin anew.
        """
        place, kept = self._ticks % self._seen.shape[1], self._seen
        kept[0, place], kept[1, place] = seen.innovation[:, :2], seen.acceleration[:, :2]
        if self._drag > 0.0:
            kept[2, place] = seen.error[:, 3:5] + seen.reference[:, 3:5]
        if np.count_nonzero(steady) < self._count:
            kept[:, :, ~steady] = 0.0
        self._ticks += 1
        if self._ticks % self._every or not np.count_nonzero(steady):
            return False
        self._fit()
        return True

    def _fit(self) -> None:
        innovation, acceleration, velocity = np.roll(self._seen, -self._ticks % self._seen.shape[1], axis=1)
        before = np.roll(acceleration, 1, axis=0)
        before[0] = 0.0
        changes = np.where(before != 0.0, acceleration - before, 0.0) / self._period  # 0 where nothing was seen
        makes = np.stack([-changes, velocity], axis=1)
        answers, slowed = np.moveaxis((self._filter @ makes.reshape(len(makes), -1)).reshape(makes.shape), 1, 0)
        power = (answers * answers).sum(axis=(0, 2)) + _TINY
        late = (innovation * answers).sum(axis=(0, 2)) / power
        left = innovation - late[:, np.newaxis] * answers
        deviation = np.sqrt((left * left).mean(axis=(0, 2)) / power)
        alike = self._drag * np.abs((slowed * answers).sum(axis=(0, 2))) / power
        excess = np.maximum(np.abs(late - self._middle) - _SURE * deviation - alike, 0.0)
        told = (power > 2.0 * _TINY) & (deviation < _LOOSE * self.bound)
        self.excess = np.where(told, excess, 0.0)


def _leads(box: Box) -> tuple[float, float]:
    """Return the shortest and the longest lead of the plants of a box, s."""
    low, high = box.low, box.high
    if low.frequency > 0.0:
        return 2.0 * low.damping / high.frequency, 2.0 * high.damping / low.frequency
    return low.lag, high.lag


def _answer(period: float, observer: tuple[float, float, float], length: int) -> FloatArray:
    """Return (length,) innovations, m, after a period with a unit of acceleration, m/s^2, that the model has not."""
    h, state = period, np.array([period * period / 2.0, period, 0.0])
    F = np.array([[1.0, h, h * h / 2.0], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    found = []
    for _ in range(length):
        found.append(state[0])
        state = F @ (state - np.array(observer) * state[0])
    return np.array(found)
