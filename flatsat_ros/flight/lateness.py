"""By how much later, or earlier, than a flight certificate's model drones follow their commands, as flights show it.

A drone whose lag and delay together are longer than the model's by s has an acceleration that is the model's of s ago:
less by s times its derivative, in motions that are slow against s. Through the estimator that makes an innovation of

    i = -s C (1 + (F (I - L C)) q + (F (I - L C))^2 q^2 + ...) b w

with w the derivative of the model's acceleration, q the shift by a tick, F and b of the double integrator with a
disturbance that stays. s is fitted to the innovations of some seconds. Another drag than the model's makes such
innovations too, the more the slower a motion is: of models without drag that is taken off, of others, whose drag is
known to a tenth, what is more than a little of it, and motions in which it would be much tell nothing. Lag and delay
apart are not told by that.

The model's acceleration answers to innovations, too: with noise alone the fit would make drones 50 ms too early. So it
is fitted by what is correlated with the same filter of the reference's acceleration (an instrumental variable), which
knows of no noise, and of no disturbance: s is the sum of products with the innovations over that with what s makes of
them.

Disturbances make innovations that stay alike for a second or so, unlike noise. So how sure a fit is follows from how
the parts of the window, half a second each, deviate from it in sum, and not tick by tick.
"""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.flight.assumptions import Seen

# what is looked at, s, and how often
_WINDOW, _EVERY = 10.0, 0.5
# so many parts of it must have shown something: answers to the reference of so much together, m^2
_PARTS, _SHOWN = 8, 1e-6
# standard deviations of the fit by which it must be outside before that is believed
_SURE = 2.5
# a fit that is less sure than this share of half of the interval says nothing: in gusts that change faster than is
# assumed a few parts are all wrong alike, and look surer than they are
_LOOSE = 0.2
# how much drag, 1/s, there may be where the certificate counts all of it among the disturbances
_DRAG = 0.6
# Of drag inside the interval what may be taken for more than the first share of half of the interval of lateness is
# taken off; a motion so slow that it may be taken for the second says nothing.
_SLOWER, _SLOW = 0.5, 0.75
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
        known = _unknown_drag(design.model, box)
        self._drag, self._is_known = known or _DRAG, known > 0.0
        self._length = round(_EVERY / design.period)  # of a part of the window, in ticks
        self._move, self._answer, self._enter = _filter(design.period, design.observer, self._length)
        self._steady, self._ticks = np.ones(count, dtype=bool), 0
        # of this part: innovation, m, accelerations of model and reference, m/s^2; and both before it
        self._seen, self._before = np.zeros((3, self._length, count, 2)), np.zeros((2, count, 2))
        self._states = np.zeros((3, 3, count, 2))  # of the filter, for changes of both accelerations and for drag
        # sums over each part of the window, newest last, of the products of r with a, i, s and itself
        self._sums = np.zeros((round(_WINDOW / _EVERY), 4, count))
        self.excess = np.zeros(count)

    def note(self, seen: Seen, steady: np.ndarray) -> bool:
        """Take in a tick; return whether the fit is a new one.

        Args:
            seen: at it.
            steady: (N,) who is steered, and whose estimate is settled; others begin anew.
        """
        place, kept = self._ticks % self._length, self._seen
        kept[0, place], kept[1, place] = seen.innovation[:, :2], seen.acceleration[:, :2]
        kept[2, place] = seen.reference[:, 6:8]
        if not all_of(steady):
            kept[:, place, ~steady] = 0.0
            ends = self._steady & ~steady
            if any_of(ends):
                for array in (kept, self._states):
                    array[:, :, ends] = 0.0
                self._sums[:, :, ends], self._before[:, ends] = 0.0, 0.0
        self._steady = steady
        self._ticks += 1
        if self._ticks % self._length:
            return False
        self._take(np.where(steady[:, np.newaxis], seen.reference[:, 3:5], 0.0))
        if not any_of(steady):
            return False
        self._fit()
        return True

    def _take(self, velocity: FloatArray) -> None:
        """Add the part of the window that is full to the sums; velocity (N, 2), m/s, is the references' at its end."""
        innovation, acceleration, reference = self._seen.reshape(3, self._length, -1)
        answers, led = (self._changed(kind, values) for kind, values in enumerate((acceleration, reference)))
        gained = self._period * np.cumsum(reference, axis=0)
        slowed = self._answered(2, velocity.reshape(1, -1) - gained[-1] + gained)
        products = led * answers, led * innovation, led * slowed, led * led
        self._sums[:-1] = self._sums[1:]
        self._sums[-1] = [product.sum(axis=0).reshape(-1, 2).sum(axis=1) for product in products]

    def _changed(self, kind: int, accelerations: FloatArray) -> FloatArray:
        """Return the innovations, m, that 1 s of lateness makes, of accelerations (length, 2 N), m/s^2."""
        before = np.concatenate([self._before[kind].reshape(1, -1), accelerations[:-1]])
        self._before[kind] = accelerations[-1].reshape(-1, 2)
        # 0 where nothing was seen
        return self._answered(kind, -np.where(before != 0.0, accelerations - before, 0.0) / self._period)

    def _answered(self, kind: int, inputs: FloatArray) -> FloatArray:
        """Return the innovations, m, that inputs (length, 2 N), m/s^2, make, and move the filter of a kind on."""
        moved = self._enter @ inputs
        state = self._states[kind].reshape(3, -1)
        answers = self._answer @ state + moved[3:]
        self._states[kind] = (self._move @ state + moved[:3]).reshape(3, -1, 2)
        return np.asarray(answers)

    def _fit(self) -> None:
        powers, products, _, led = self._sums.transpose(1, 0, 2)
        power, common, alike, _ = self._sums.sum(axis=0)
        power = np.maximum(power, _TINY)
        late = common / power
        left = products - late * powers  # of each part
        deviation = np.sqrt((left * left).sum(axis=0)) / power
        alike = self._drag * np.abs(alike) / power
        excess = np.abs(late - self._middle) - _SURE * deviation
        told = (np.count_nonzero(led > _SHOWN, axis=0) >= _PARTS) & (deviation < _LOOSE * self.bound)
        if self._is_known:
            told &= alike < _SLOW * self.bound
            alike = np.maximum(alike - _SLOWER * self.bound, 0.0)
        excess -= alike
        self.excess = np.where(told, np.maximum(excess, 0.0), 0.0)


def _unknown_drag(model: Plant, box: PlantBox) -> float:
    """Return by how much drag and tilt of a plant in a box may differ from a model's, 1/s; 0 where it has none."""
    if not (model.drag or model.tilt):
        return 0.0
    ends = box.low, box.high
    return max(abs(end.drag - model.drag) for end in ends) + max(abs(end.tilt - model.tilt) for end in ends)


def _leads(box: PlantBox) -> tuple[float, float]:
    """Return the shortest and the longest lead of the plants of a box, s."""
    low, high = box.low, box.high
    if low.frequency > 0.0:
        return 2.0 * low.damping / high.frequency, 2.0 * high.damping / low.frequency
    return low.lag, high.lag


def _filter(
    period: float, observer: tuple[float, float, float], length: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what makes innovations, m, of accelerations, m/s^2, that the model has not, over some ticks.

    Returns:
        From the filter's state (3,) before them to that after them, (3, 3), and to the innovations, (length, 3); from
        the accelerations to the state and the innovations, (3 + length, length).
    """
    h, entry = period, np.array([period * period / 2.0, period, 0.0])
    F = np.array([[1.0, h, h * h / 2.0], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    step = F @ (np.eye(3) - np.outer(observer, [1.0, 0.0, 0.0]))
    states = [np.linalg.matrix_power(step, number) for number in range(length + 1)]
    lags = np.arange(length)[:, np.newaxis] - np.arange(length)
    kicks = np.array([state[0] @ entry for state in states[:length]])
    kept = np.stack([state @ entry for state in reversed(states[:length])], axis=1)
    enter = np.concatenate([kept, np.where(lags >= 0, kicks[np.abs(lags)], 0.0)])
    return states[length], np.array([state[0] for state in states[1:]]), enter
