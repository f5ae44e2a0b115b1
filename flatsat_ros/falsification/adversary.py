"""Everything that a certificate leaves open, drawn against it: limits, starts, gains, disturbances, references."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.certificate.lowered import lowered
from flatsat_ros.falsification.loops import disturbance_matrix, unit, worst_disturbance
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet

# How far inside the boundary of a set the runs start, relatively: beyond rounding, within anything physical.
_INSIDE = 1e-9

_LONGEST_RUN = 20  # periods at one gain when two gains alternate


def limits(random: np.random.Generator) -> InputSet:
    """Draw limits: tilt from 2 to 75 degrees, thrust from 1.03 g to 3 g, half of them with a least thrust."""
    thrust = GRAVITY * (1.0 + 10.0 ** random.uniform(-1.5, 0.3))
    least = GRAVITY * random.uniform(0.0, 0.8) * random.integers(2)
    return InputSet(thrust, math.radians(2.0 * 37.5 ** random.random()), GRAVITY, float(least))


def certificate(random: np.random.Generator) -> Certificate:
    """Draw limits, alpha from 0.3 to 4 1/s and alpha h from 0.01 to 1, and certify them in closed form."""
    bounds, rate = limits(random), 0.3 * 13.0 ** random.random()
    period = 10.0 ** random.uniform(-2.0, 0.0) / rate
    return closed_form_certificate(bounds, rate, period, "drawn")


def with_limits(proven: Certificate, bounds: InputSet) -> Certificate:
    """Return a certificate for other limits: P, W and the gains do not depend on them, eps does."""
    ball = bounds.inner_radius**2
    return lowered(replace(proven, limits=bounds, ball=ball, level=proven.level * ball / proven.ball))[0]


def starts(random: np.random.Generator, proven: Certificate, count: int) -> FloatArray:
    """Draw states z (count, 3 n): on the boundaries of E, of D, of its largest kappa-set or of E_w, and inside E.

    Half of the directions are random; the others are those in which the certificate is tight: eta as large as V allows,
    toward the nearest face of the input set, and V or W growing most at either end of the gain interval. With a lag or
    a delay, some drones hover at the start and others have any commands on their way.
    """
    sets, timing = proven.sets, proven.timing
    shapes = np.empty((4, count, timing.size, 3))
    for columns, matrix, block in zip((slice(0, 2), slice(2, 3)), proven.loops, proven.blocks, strict=True):
        root = np.linalg.inv(np.linalg.cholesky(matrix)).T
        gaussian = random.standard_normal((count, timing.size, 3))
        shapes[0, ..., columns] = np.einsum("ij,njk->nik", root, gaussian)[..., columns]
        shapes[1, ..., columns] = np.linalg.solve(matrix, timing.feedback(block)[0])[:, np.newaxis]
        for shape, gain in ((shapes[2], proven.gain_min), (shapes[3], proven.gain_max)):
            step = timing.closed_loop(block, gain)
            growing = root @ np.linalg.eigh(root.T @ step.T @ matrix @ step @ root)[1][:, -1]
            shape[..., columns] = growing[:, np.newaxis]
    toward = (random.random(count) < 0.3)[:, np.newaxis]
    directions = np.where(toward, _toward_a_face(random, sets.limits, count), random.standard_normal((count, 3)))
    shapes[1:] *= directions[:, np.newaxis]
    z = shapes[random.choice(4, count, p=[0.5, 0.25, 0.125, 0.125]), np.arange(count)]
    z[random.random(count) < 0.5, 2:] = 0.0

    flat = z.reshape(count, -1)
    ellipsoid, larger = 1.0 / sets.scale_ellipsoid(flat), 1.0 / sets.scale_larger(flat)
    other = larger / proven.gain_min if proven.robust is None else ellipsoid * math.sqrt(sets.floor / sets.level)
    sizes = np.stack([ellipsoid, larger, other, ellipsoid * random.random(count)])
    flat *= (1.0 - _INSIDE) * sizes[random.integers(4, size=count), np.arange(count)][:, np.newaxis]
    # under a disturbance the edge of D is not covered everywhere
    uncovered = ~sets.classify(flat).guaranteed
    flat[uncovered] *= ((1.0 - _INSIDE) / sets.scale_ellipsoid(flat[uncovered]))[:, np.newaxis]
    return np.asarray(flat)


def _toward_a_face(random: np.random.Generator, bounds: InputSet, count: int) -> FloatArray:
    """Draw eta, (count, 3), for which -eta points at the cone, the sphere or the floor where it is nearest to 0."""
    azimuth, tilt = random.uniform(0.0, 2.0 * math.pi, count), np.full(count, bounds.tilt_max)
    faces = [np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), -np.sin(tilt)]
    upward = np.stack([0.0 * azimuth, 0.0 * azimuth, np.ones(count)], axis=-1)
    candidates = np.stack([np.stack(faces, axis=-1), upward, -upward])
    nearest = bounds.gauge(candidates).argmax(axis=0)
    return np.asarray(-candidates[nearest, np.arange(count)])


class Course(IntEnum):
    """How a run chooses its gain."""

    CONSTANT = 0
    RANDOM = 1
    EXTREMES = 2  # one end of the interval or the other, at random
    ALTERNATING = 3  # between two gains, each for some periods
    GREEDY = 4  # the end at which the certified function is largest one period on
    LAW = 5  # the adaptation law of the controller


class Gains:
    """The gain gamma of every run: anything in [low, high], chosen against the certificate."""

    def __init__(self, random: np.random.Generator, low: FloatArray, high: float) -> None:
        """Draw a course for each of the (N,) runs; those that adapt have gains of at least 1."""
        count = len(low)
        self.course = random.integers(len(Course), size=count)
        self._low, self._high, self._random = np.where(self.course == Course.LAW, 1.0, low), high, random
        self._one, self._other = self._draw(), self._draw()
        extreme = random.random(count) < 0.5
        self._one, self._other = np.where(extreme, self._low, self._one), np.where(extreme, high, self._other)
        self._runs = random.integers(1, _LONGEST_RUN + 1, size=(2, count))
        # which part of the certified function is driven up: V_h, V_v or both
        self._weights = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])[random.integers(3, size=count)]

    def _draw(self) -> FloatArray:
        uniform = self._random.random(len(self._low))
        logarithmic = self._random.random(len(self._low)) < 0.5
        return np.where(
            logarithmic,
            self._low * (self._high / self._low) ** uniform,
            self._low + uniform * (self._high - self._low),
        )

    def choose(
        self, step: int, adapted: FloatArray, parts: Callable[[np.ndarray, FloatArray], tuple[FloatArray, FloatArray]]
    ) -> FloatArray:
        """Return gamma (N,).

        Args:
            step: number of the period.
            adapted: (N,) what the adaptation law says.
            parts: of some runs (their indices) at some gains, the certified function one period on: V_h and V_v.
        """
        gain = self._draw()
        coin = self._random.random(len(gain)) < 0.5
        gain = np.where(self.course == Course.CONSTANT, self._one, gain)
        gain = np.where(self.course == Course.EXTREMES, np.where(coin, self._low, self._high), gain)
        first = step % self._runs.sum(axis=0) < self._runs[0]
        gain = np.where(self.course == Course.ALTERNATING, np.where(first, self._one, self._other), gain)
        rows = np.flatnonzero(self.course == Course.GREEDY)
        low, high = self._low[rows], np.full(len(rows), self._high)
        # the function is convex in the gain: the worst is at an end
        ends = [(np.stack(parts(rows, end), axis=-1) * self._weights[rows]).sum(axis=-1) for end in (low, high)]
        gain[rows] = np.where(ends[0] > ends[1], low, high)
        return np.where(self.course == Course.LAW, adapted, gain)


def tuning(random: np.random.Generator, proven: Certificate) -> Tuning:
    """Draw an adaptation law from slow to far too fast; the leak is none for half of them."""
    rate = 10.0 ** random.uniform(-1.0, 1.5) * proven.rate / proven.level
    threshold = proven.level * 10.0 ** random.uniform(-3.0, -0.3)
    initial = proven.gain_max ** (random.random() * random.integers(2))
    leak = random.random() * random.integers(2) / proven.period
    return Tuning(*(np.full(1, value) for value in (rate, threshold, initial, proven.gain_max, leak)))


class Disturbance:
    """w of every run, w'w <= 1, constant over a period: for ever the same, random, or driving V, V_h or V_v up."""

    def __init__(self, random: np.random.Generator, proven: Certificate, count: int, period: float) -> None:
        """Draw a course for each run; what w does to the state in a period follows from E and the period, s."""
        self.matrix = np.zeros((6, 6)) if proven.robust is None else disturbance_matrix(proven.robust)  # E
        e, m = self.matrix[:3, :3], self.matrix[3:, 3:]
        self.gathered = np.block([[period * e, period**2 / 2.0 * m], [0.0 * e, period * m]])
        self._random = random
        self._course = random.integers(5, size=count)
        self._constant = unit(random.standard_normal((count, 6)))
        parts = np.array([(1.0, 1.0, 1.0), (1.0, 1.0, 0.0), (0.0, 0.0, 1.0)])[random.integers(3, size=count)]
        self._metric = proven.matrix * np.tile(parts, 2)[:, np.newaxis]

    def choose(self, undisturbed: FloatArray) -> FloatArray:
        """Return w (N, 6), given where the errors xi (N, 6) would be one period on without it."""
        w = unit(self._random.standard_normal(undisturbed.shape))
        worst = w
        for _ in range(3):  # V grows most for w along G'P xi, which depends on w
            xi = undisturbed + worst @ self.gathered.T
            worst = worst_disturbance(np.einsum("ni,nij->nj", xi, self._metric), self.gathered)
        course = self._course[:, np.newaxis]
        return np.where(course == 0, self._constant, np.where(course == 1, w, worst))


@dataclass(frozen=True, eq=False)
class SwingingReferences:
    """N references whose acceleration swings between two points of the input set.

    Attributes:
        centre, swing: (N, 3) m/s^2.
        frequency, phase: (N,) rad/s, rad.
    """

    centre: FloatArray
    swing: FloatArray
    frequency: FloatArray
    phase: FloatArray

    @classmethod
    def draw(cls, random: np.random.Generator, proven: Certificate, margin: FloatArray) -> SwingingReferences:
        """Draw references that keep their accelerations as far from the boundary as `margin` (N,), m/s^2, says."""
        count, bounds = len(margin), proven.limits
        ends = []
        for _ in range(2):
            direction = random.standard_normal((count, 3))
            # margin is concave: between 0 and a point of the boundary it falls at least linearly
            edge = direction / bounds.gauge(direction)[:, np.newaxis]
            ends.append(edge * (random.random(count) ** 0.2 * (1.0 - margin / bounds.inner_radius))[:, np.newaxis])
        frequency = proven.rate * 10.0 ** random.uniform(-1.0, 1.0, count)
        return cls((ends[0] + ends[1]) / 2.0, (ends[0] - ends[1]) / 2.0, frequency, random.uniform(0.0, 6.3, count))

    def at(self, time: float) -> FloatArray:
        """Return (N, 9) with the acceleration; position and velocity are 0, for only errors matter."""
        angle = (self.frequency * time + self.phase)[:, np.newaxis]
        swinging = self.centre + self.swing * np.sin(angle)
        return np.concatenate([np.zeros((len(swinging), 6)), swinging], axis=1)
