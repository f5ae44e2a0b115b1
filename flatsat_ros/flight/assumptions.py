"""What a flight certificate takes for granted, as far as a flight can show that it does not hold.

No monitor proves an assumption. One that fails says that the tube is not claimed now, and why.
"""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight import Axis, Flight
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.flight.known import known

# d^ is compared with what it was this time, s, before, which is the bandwidth at which its rate is assumed; how often
_RATE_TIME = 1.0
_REMEMBERED = 0.1
# ticks that are farther apart than so many periods, or nearer together than what that leaves of two
_GAP = 1.5
# a start outside the tube, or an estimate that began anew, counts as forgotten when so much of it is left
_FORGOTTEN = 0.05
# a drone outside its tube for so long, s, although all that can be watched holds, has a fault
_OUTSIDE = 0.5
# a reference that moves on by another way than its velocity, m, or velocity than its acceleration, m/s, has jumped
_JUMP, _JUMP_VELOCITY = 1e-3, 1e-2
# the same assumption is told again after so long, s
_SILENCE = 5.0
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


# of each what is watched, its value in the unit that people read, and that unit
_WORDS = {
    Assumption.POSE_AGE: ("the newest pose is old", 1e3, "ms"),
    Assumption.PERIOD: ("ticks are not even: time between two", 1e3, "ms"),
    Assumption.INNOVATION: ("its poses are not where they are expected", 1e3, "mm"),
    Assumption.DISTURBANCE: ("it is disturbed", 1.0, "m/s^2"),
    Assumption.DISTURBANCE_RATE: ("its disturbance changes within a second", 1.0, "m/s^2"),
    Assumption.REFERENCE: ("its reference asks for more than is assumed", 100.0, "%"),
    Assumption.GAIN: ("its applied gain is outside the interval", 1.0, ""),
    Assumption.TUBE: ("it is outside its tube although all seems to be as assumed", 1e2, "cm"),
}
# the quantities that are watched at each tick, in the order of their columns
_COLUMNS = (
    Assumption.POSE_AGE,
    Assumption.PERIOD,
    *[Assumption.INNOVATION] * 2,
    Assumption.DISTURBANCE,
    *[Assumption.DISTURBANCE_RATE] * 2,
    Assumption.REFERENCE,
    *[Assumption.GAIN] * 2,
)
_WHICH = np.array(_COLUMNS)
_START, _TUBE = Assumption.START.value, Assumption.TUBE.value


class Monitors:
    """Watches N drones.

    Attributes:
        broken: (N,) values of `Assumption`.
        ratio: (N,) distance to the reference over the tube, the larger of horizontal and vertical.
    """

    def __init__(self, flight: Flight, clip: float, count: int) -> None:
        """Watch drones of which nothing holds yet.

        Args:
            flight: what is assumed.
            clip: largest disturbance that is compensated, m/s^2.
            count: N.
        """
        self._count, period = count, flight.horizontal.design.period
        self._period = period
        bounds = [known(axis, flight.gain_min, flight.gain_max, flight.assumptions) for axis in flight.axes]
        tubes = [axis.tube for axis in flight.axes]
        changes = [
            flight.assumptions.rate(axis.design.model, axis.box.low, axis.box.high) / axis.box.low.gain * _RATE_TIME
            + 2.0 * axis.tube.disturbance
            for axis in flight.axes
        ]
        self._bounds = np.array(
            [
                flight.pose_age + _INSTANT, _GAP * period, *(bound.innovation for bound in bounds), clip, *changes, 1.0,
                flight.gain_max, 1.0 / flight.gain_min,
            ]
        )  # fmt: skip
        self._bounds *= 1.0 + _ROUNDING
        self._tube = np.array([tube.position for tube in tubes])
        self._uncertain = np.array([bound.position for bound in bounds])
        # of |e|, |e'| and |v0|, horizontal and vertical
        self._inside = 1.0 / np.array([[getattr(t, n) for t in tubes] for n in ("position", "velocity", "nominal")])
        self._enlarged = np.array([[b.position, b.velocity, 0.0] for b in bounds]).T
        self._back = [axis.back for axis in flight.axes]
        self._settling = max(_settling(axis) for axis in flight.axes)
        self._values = np.zeros((count, len(_COLUMNS)))
        self._remembered: deque[FloatArray] = deque(maxlen=round(_RATE_TIME / _REMEMBERED) + 1)
        self._every, self._ticks = max(1, round(_REMEMBERED / period)), 0
        self._reference = np.zeros((count, 9))
        self._now = -math.inf
        self._settled = np.full(count, np.inf)  # when the estimates are
        self._due = np.full(count, np.inf)  # when the start is forgotten
        self._sizes = np.zeros((count, 2))  # of e
        self._outside = np.zeros(count)  # s for which it has been outside without a reason
        self._told = np.full((count, len(Assumption)), -np.inf)
        self.broken = np.full(count, _START)
        self.ratio = np.zeros(count)

    def look(
        self,
        now: float,
        flying: np.ndarray,
        error: FloatArray,
        reference: FloatArray,
        demand: FloatArray,
        age: FloatArray,
        innovation: FloatArray,
        disturbance: FloatArray,
        gain: FloatArray,
        nominal: FloatArray,
    ) -> None:
        """Look at one tick.

        Args:
            now: s.
            flying: (N,) who is steered.
            error: (N, 6) estimate less reference, m and m/s.
            reference: (N, 9) at the tick.
            demand: (N,) what the reference asks for, over what is assumed; 0 at rest.
            age: (N,) of the pose used, s.
            innovation: (N, 3) m.
            disturbance: (N, 3) estimated, m/s^2.
            gain: (N,) applied.
            nominal: (N, 3) v0, m/s^2.
        """
        elapsed, self._now = now - self._now, now
        values = self._values
        values[:, 0] = age
        values[:, 1] = max(elapsed, (2.0 * self._period - elapsed))
        _norms(innovation, values[:, 2:4])
        values[:, 4] = np.sqrt((disturbance * disturbance).sum(axis=1))
        self._remember(disturbance)
        values[:, 7] = demand
        h, before = self._period, self._reference
        off = reference[:, :6] - before[:, :6] - (h / 2.0) * (reference[:, 3:] + before[:, 3:])
        off[:, 3:] *= _JUMP / _JUMP_VELOCITY
        jumped = np.abs(off).max(axis=1) > _JUMP
        if np.count_nonzero(jumped):
            values[jumped, 7] = np.inf
        self._reference = reference
        values[:, 8], values[:, 9] = gain, 1.0 / np.maximum(gain, 1e-12)

        sizes = np.empty((self._count, 3, 2))
        for entry, part in enumerate((error[:, :3], error[:, 3:], nominal)):
            _norms(part, sizes[:, entry])
        self._sizes = sizes[:, 0]
        ratios = self._sizes / self._tube
        self.ratio = ratios.max(axis=1)
        over = values > self._bounds
        if not np.count_nonzero(over) and flying.all() and now >= self._due.max() and not (ratios > 1.0).any():
            self.broken, self._outside = np.zeros(self._count, dtype=int), np.zeros(self._count)
            return
        self._judge(now, flying, sizes, over)

    def _judge(self, now: float, flying: np.ndarray, sizes: FloatArray, over: np.ndarray) -> None:
        """Find out what does not hold, at a tick at which it may be that something does not.

        Args:
            now: s.
            flying: (N,) who is steered.
            sizes: (N, 3, 2) of e, e' and v0, horizontal and vertical.
            over: (N, K) which quantities exceed their bounds.
        """
        failing = over.any(axis=1)
        anew = failing | ~flying
        if np.count_nonzero(anew):
            back = np.zeros(self._count)  # time in which the start is forgotten, s
            for part, way in enumerate(self._back):
                start = way.position * sizes[:, 0, part] + way.position_velocity * sizes[:, 1, part]
                back = np.maximum(back, np.log(np.maximum(start / (_FORGOTTEN * self._tube[part]), 1.0)) / way.rate)
            self._settled = np.where(anew, now + self._settling, self._settled)
            self._due = np.where(anew, now + np.maximum(back, self._settling), self._due)
        within = ((sizes + self._enlarged) * self._inside <= 1.0).all(axis=(1, 2))
        outside = (sizes[:, 0] - self._uncertain > self._tube).any(axis=1)
        due = now >= self._due
        holds = ~anew & ((within & (now >= self._settled)) | (due & ~outside))
        self.broken = np.where(failing, _WHICH[over.argmax(axis=1)], np.where(due & ~anew, _TUBE, _START) * ~holds)
        self._outside = np.where(~anew & due & outside, self._outside + self._period, 0.0)

    def astray(self) -> list[int]:
        """Return who is outside its tube for longer than noise explains, although all seems to be as assumed."""
        if not np.count_nonzero(self._outside):
            return []
        return [int(index) for index in np.flatnonzero(self._outside >= _OUTSIDE)]

    def reports(self, flying: np.ndarray) -> list[tuple[int, str]]:
        """Return what is to be told of the drones in flight, drone and text, once per event."""
        if not np.count_nonzero(self.broken):
            return []
        found = []
        for index in np.flatnonzero(flying & (self.broken != 0) & (self.broken != _START)):
            which = int(self.broken[index])
            told, self._told[index, which] = self._told[index, which], self._now
            if self._now - told > _SILENCE:
                found.append((int(index), self.sentence(int(index))))
        return found

    def sentence(self, index: int) -> str:
        """Return in words what does not hold for drone index; empty if all does."""
        which = Assumption(int(self.broken[index]))
        if which is Assumption.NONE:
            return ""
        if which is Assumption.START:
            return "tube not claimed yet: it comes from outside"
        text, factor, unit = _WORDS[which]
        if which is Assumption.TUBE:
            part = int((self._sizes[index] / self._tube).argmax())
            value, bound = self._sizes[index, part], self._tube[part]
        else:
            column = int((self._values[index] > self._bounds).argmax())
            value, bound = self._values[index, column], self._bounds[column]
        return f"tube not claimed: {text}, {factor * value:.3g} {unit}, bound {factor * bound:.3g} {unit}"

    def _remember(self, disturbance: FloatArray) -> None:
        """Compare the disturbances (N, 3), m/s^2, with those of some time before."""
        self._ticks += 1
        if self._ticks % self._every:
            return
        self._remembered.append(disturbance.copy())
        _norms(disturbance - self._remembered[0], self._values[:, 5:7])


def _norms(vectors: FloatArray, into: FloatArray) -> None:
    """Write the horizontal and the vertical size of vectors (N, 3) into an array (N, 2)."""
    into[:, 0], into[:, 1] = np.hypot(vectors[:, 0], vectors[:, 1]), np.abs(vectors[:, 2])


def _settling(axis: Axis) -> float:
    """Return after what time, s, the estimator has forgotten how it began."""
    loop = FlightLoop(axis.design, axis.design.model)
    n = loop.plant.size
    errors = np.zeros((3, loop.size))  # of position, velocity and disturbance; those of the rest vanish
    errors[0, [0, n]] = errors[1, [1, n + 1]] = 1.0, -1.0
    errors[2, 2 * n] = 1.0
    radius = float(np.abs(np.linalg.eigvals((errors @ loop.matrix(0.0))[:, [0, 1, 2 * n]])).max())
    return axis.design.period * math.log(_FORGOTTEN) / math.log(radius)
