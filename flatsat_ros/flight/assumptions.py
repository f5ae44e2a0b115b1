"""What a flight certificate takes for granted, as far as a flight can show that it does not hold.

No monitor proves an assumption. One that fails says that the tube is not claimed now, and why.
"""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.flight.known import known
from flatsat_ros.flight.lateness import Lateness
from flatsat_ros.flight.references import References

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
# what is broken again is told again once it has held for so long, s; a disturbance that becomes so many times as large,
# as well
_SILENCE, _LARGER = 1.0, 2.0
# a pose so far, m, from where the model expects it is not the model's: its estimate begins anew
_LOST = 0.15
_ROUNDING = 1e-9
_TINY = 1e-12
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
_COLUMNS = (
    Assumption.POSE_AGE,
    Assumption.PERIOD,
    *[Assumption.INNOVATION] * 2,
    Assumption.DISTURBANCE,
    *[Assumption.DISTURBANCE_RATE] * 2,
    Assumption.REFERENCE,
    *[Assumption.GAIN] * 2,
    Assumption.LATENESS,
)
_WHICH = np.array(_COLUMNS)
_OF_DISTURBANCE = _COLUMNS.index(Assumption.DISTURBANCE)
_OF_RATE = Assumption.DISTURBANCE_RATE.value == _WHICH
_START, _TUBE, _REFERENCE = Assumption.START.value, Assumption.TUBE.value, Assumption.REFERENCE.value


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


class Monitors:
    """Watches N drones.

    Attributes:
        broken: (N,) values of `Assumption`.
        ratio: (N,) distance to the reference over the tube, the larger of horizontal and vertical.
        quiet: whether nothing that is watched was beyond its bounds, for any drone.
        innovations: bounds of the innovation, horizontal and vertical, (2,), m.
        lost: (N,) whose poses are so far from where they are expected that its estimate is wrong.
    """

    def __init__(self, flight: FlightSection, clip: float, references: References) -> None:
        """Watch drones of which nothing holds yet.

        Args:
            flight: what is assumed.
            clip: largest disturbance that is compensated, m/s^2.
            references: of N drones, and what they ask for.
        """
        self._references, self._count = references, len(references.at_rest)
        self._period = flight.horizontal.design.period
        bounds = [known(axis, flight.gain_min, flight.gain_max, flight.assumptions) for axis in flight.axes]
        self._lateness, self._late = Lateness(flight.horizontal, self._count), False
        changes = [
            flight.assumptions.rate(axis.design.model, axis.box.low, axis.box.high) / axis.box.low.gain * _RATE_TIME
            + 2.0 * axis.tube.disturbance
            for axis in flight.axes
        ]
        self._bounds = np.array(
            [
                flight.pose_age + _INSTANT, _GAP * self._period, *(bound.innovation for bound in bounds), clip,
                *changes, 1.0, flight.gain_max, 1.0 / flight.gain_min, self._lateness.bound,
            ]
        ) * (1.0 + _ROUNDING)  # fmt: skip
        self.innovations, self.quiet = np.array([bound.innovation for bound in bounds]), False
        self._tube = np.array([axis.tube.position for axis in flight.axes])
        self._uncertain = np.array([bound.position for bound in bounds])
        # of |e|, |e'| and |v0|, horizontal and vertical
        inside = np.array([[getattr(a.tube, n) for a in flight.axes] for n in ("position", "velocity", "nominal")])
        self._inside = inside - np.array([[b.position, b.velocity, 0.0] for b in bounds]).T
        self._back = [axis.back for axis in flight.axes]
        self._settling = max(_settling(axis) for axis in flight.axes)
        # e, e', v0, innovation, d^ and its change; while these squares are not exceeded, nothing is
        self._vectors = np.zeros((self._count, 6, 3))
        easy = np.array([self._tube, *inside[1:] * np.inf, self._bounds[2:4], [clip / 2.0] * 2, changes])
        self._easy = easy * easy
        self._remembered: deque[FloatArray] = deque(maxlen=round(_RATE_TIME / _REMEMBERED) + 1)
        self._every, self._ticks = max(1, round(_REMEMBERED / self._period)), 0
        self._reference, self._assigned = np.zeros((self._count, 9)), 0
        self._now = -math.inf
        self._settled = np.full(self._count, -np.inf)  # when the estimates are
        self._due = np.full(self._count, np.inf)  # when the start is forgotten
        # when each was not steered last, and when the estimates of all are settled
        self._grounded, self._ready = np.full(self._count, -np.inf), -math.inf
        self._sizes, self._values = np.zeros((self._count, 3, 2)), np.zeros((self._count, len(_COLUMNS)))
        self._outside = np.zeros(self._count)  # s for which it has been outside without a reason
        self._told = np.full((self._count, len(Assumption)), -np.inf)
        self._least = np.zeros(self._count)  # disturbance since one was told of, m/s^2
        self._nothing, self._nobody = np.zeros(self._count, dtype=int), np.zeros(self._count, dtype=bool)
        self.broken, self.lost = np.full(self._count, _START), self._nobody
        self.ratio = np.zeros(self._count)

    def look(self, now: float, flying: np.ndarray, seen: Seen) -> None:
        """Look at one tick.

        Args:
            now: s.
            flying: (N,) who is steered.
            seen: at it.
        """
        before, self._now = self._now, now
        elapsed = now - before
        vectors = self._vectors
        vectors[:, :2] = seen.error.reshape(-1, 2, 3)
        vectors[:, 2], vectors[:, 3], vectors[:, 4] = seen.nominal, seen.innovation, seen.disturbance
        self._ticks += 1
        if self._ticks % self._every == 0:
            self._remembered.append(seen.disturbance.copy())
            np.subtract(seen.disturbance, self._remembered[0], out=vectors[:, 5])
        squares = vectors * vectors
        squares[..., 0] += squares[..., 1]
        squares = squares[..., ::2]
        shares = squares[:, 0] / self._easy[0]
        self.ratio = np.sqrt(np.maximum(shares[:, 0], shares[:, 1]))
        steady, all_fly = flying, all_of(flying)
        if not all_fly:
            np.copyto(self._grounded, now, where=~flying)
            self._ready = now + self._settling
        if now < self._ready:
            steady = flying & (self._grounded <= now - self._settling)
        if self._lateness.note(seen, steady):
            self._late = float(self._lateness.excess.max()) > self._bounds[10]
        even = max(elapsed, 2.0 * self._period - elapsed)
        jumped = self._jumped(seen.reference, elapsed)
        bounds = self._bounds
        if (
            even <= bounds[1]
            and jumped is None
            and not self._late
            and all_fly
            and all_of(squares <= self._easy)
            and all_of(seen.age <= bounds[0])
            and all_of(self._references.demand <= bounds[7])
            and all_of(seen.gain <= bounds[8])
            and all_of(seen.gain * bounds[9] >= 1.0)
            and all_of(self._due <= now)
        ):
            self.broken, self.lost, self.quiet = self._nothing, self._nobody, True
            if np.count_nonzero(self._outside):
                self._outside = np.zeros(self._count)
            return
        sizes, self.quiet = np.sqrt(squares), False
        self.lost = np.maximum(sizes[:, 3, 0], sizes[:, 3, 1]) > _LOST
        gain, demand = np.maximum(seen.gain, _TINY), self._references.demand
        if jumped is not None:
            demand = np.where(jumped, np.inf, demand)
        self._sizes = sizes[:, :3]
        values = self._values
        values[:, 0], values[:, 1], values[:, 2:4] = seen.age, even, sizes[:, 3]
        values[:, 4], values[:, 5:7] = np.sqrt(squares[:, 4, 0] + squares[:, 4, 1]), sizes[:, 5]
        values[:, 7], values[:, 8], values[:, 9], values[:, 10] = demand, gain, 1.0 / gain, self._lateness.excess
        self._judge(now, flying, self._sizes, self._values > self._bounds)
        if jumped is not None:  # a reference that begins with a drone's flight has come from nowhere
            self.broken[(self.broken == _REFERENCE) & jumped & (self._grounded >= before)] = _START

    def lately(self) -> FloatArray:
        """Return the mean of the estimated disturbances over the last second, (N, 3), m/s^2."""
        return np.mean(self._remembered, axis=0) if self._remembered else np.zeros((self._count, 3))

    def _jumped(self, reference: FloatArray, elapsed: float) -> np.ndarray | None:
        """Return whose references (N, 9) moved otherwise than by their velocity in that time, s, if some are new."""
        before, self._reference = self._reference, reference
        if self._assigned == self._references.assigned:
            return None
        self._assigned = self._references.assigned
        step = elapsed if math.isfinite(elapsed) else self._period
        off = reference[:, :6] - before[:, :6] - (step / 2.0) * (reference[:, 3:] + before[:, 3:])
        off[:, 3:] *= _JUMP / _JUMP_VELOCITY
        return np.asarray(np.abs(off).max(axis=1) > _JUMP)

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
        if any_of(anew):
            back = np.zeros(self._count)  # time in which the start is forgotten, s
            for part, way in enumerate(self._back):
                start = way.position * sizes[:, 0, part] + way.position_velocity * sizes[:, 1, part]
                back = np.maximum(back, np.log(np.maximum(start / (_FORGOTTEN * self._tube[part]), 1.0)) / way.rate)
            # a disturbance that has changed too fast has done so some time before
            lately = ~flying | (over & ~_OF_RATE).any(axis=1)
            settled = now + self._settling - np.where(lately, 0.0, _RATE_TIME)
            self._settled = np.where(anew, np.maximum(self._settled, settled), self._settled)
            self._due = np.where(anew, np.maximum(now + back, self._settled), self._due)
        within = (sizes <= self._inside).all(axis=(1, 2))
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
            anew = self._now - told > _SILENCE
            size = self._values[index, _OF_DISTURBANCE]
            anew |= which == Assumption.DISTURBANCE and size > _LARGER * self._least[index]
            self._least[index] = size if anew else min(size, self._least[index])
            if anew:
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
        value, bound = self._beyond(index, which)
        return f"tube not claimed: {text}, {factor * value:.3g} {unit}, bound {factor * bound:.3g} {unit}"

    def _beyond(self, index: int, which: int) -> tuple[float, float]:
        """Return value and bound of what does not hold for drone index, `which` assumption."""
        if which == _TUBE:
            part = int((self._sizes[index, 0] / self._tube).argmax())
            return float(self._sizes[index, 0, part]), float(self._tube[part])
        column = int((self._values[index] > self._bounds).argmax())
        return float(self._values[index, column]), float(self._bounds[column])


def _settling(axis: Axis) -> float:
    """Return after what time, s, the estimator has forgotten how it began."""
    loop = FlightLoop(axis.design, axis.design.model)
    n = loop.plant.size
    errors = np.zeros((3, loop.size))  # of position, velocity and disturbance; those of the rest vanish
    errors[0, [0, n]] = errors[1, [1, n + 1]] = 1.0, -1.0
    errors[2, 2 * n] = 1.0
    radius = float(np.abs(np.linalg.eigvals((errors @ loop.matrix(0.0))[:, [0, 1, 2 * n]])).max())
    return axis.design.period * math.log(_FORGOTTEN) / math.log(radius)
