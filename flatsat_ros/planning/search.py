"""References of many drones that keep apart and keep their limits: found, not proved, for one duration.

All references are shapes of one kind, so that one matrix takes the unknowns of all drones to everything that matters.
What is minimised is the jerk plus penalties on what is violated, whose weights grow from stage to stage. A pair pushes
itself apart by the depth of the violation, (d0 - |D|)^2, at samples so dense that no drone passes through another
between two of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.planning.descent import descend
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.curve import DEGREE, ORDER

_SMOOTH, _PENALTY = 1e-3, 30.0  # weights at first
_GROWTH = 4.0  # of the penalty from stage to stage
_STEPS, _TOLERANCE = 120, 1e-7  # of a stage's descent
_BOX = 100.0  # 1/m^2: a violation of 10 cm weighs like one of 1 m/s^2

# what is asked for beyond the limits, for a penalty is never quite 0
_ROOM = 4e-3  # m, of distances
_MARGIN = 2e-3  # m/s^2
_SHARE = 0.997  # of speed, jerk and snap
_INSET = 1e-4  # m, of the box

_HOP = 0.5  # of the distance that two drones keep, what they move between two samples at most, about
_PEAK = 1.3 * 15.0 / 8.0  # largest over mean speed of a reference, with a detour


@dataclass(frozen=True, eq=False)
class Swarm:
    """What is asked of many drones at once.

    Attributes:
        shapes: of all references.
        waypoints: (N, W, 3) m.
        distances: (N, N) m, that each two of them keep in the downwash metric.
        downwash: how many times as far drones keep apart along the vertical.
        limits: the input set.
        bounds: of each reference.
    """

    shapes: Shapes
    waypoints: FloatArray
    distances: FloatArray
    downwash: float
    limits: InputSet
    bounds: Bounds


class Search:
    """The penalty function of a swarm, over the modes (F, 3, N) of its references."""

    def __init__(self, swarm: Swarm) -> None:
        self.swarm = swarm
        shapes = swarm.shapes
        self._asked = swarm.distances + _ROOM
        self._samples = _samples(swarm)
        parts = [_sampled(shapes, self._samples), *(shapes.bezier[order] for order in (0, 1, 2, 3, 4))]
        self._parts = [slice(a, b) for a, b in zip(*_edges([len(part) for part in parts]), strict=True)]
        stacked = np.concatenate(parts)
        self._modes = stacked @ shapes.modes
        self._waypoints = swarm.waypoints.transpose(1, 2, 0)  # (W, 3, N)
        self._fixed = np.tensordot(stacked @ shapes.fixed, self._waypoints, axes=1)
        self._stretch = np.array([1.0, 1.0, 1.0 / swarm.downwash])[:, np.newaxis]

    def begin(self, swirl: float, seed: int) -> FloatArray:
        """Return modes (F, 3, N) to begin with: a little noise, and a detour of each drone to its right.

        Args:
            swirl: the detour, as a share of the way; drones that swap places turn around each other then.
            seed: of the noise, which decides what symmetry leaves open.
        """
        count = self._modes.shape[1]
        noise = np.random.default_rng(seed).normal(size=(count, *self._waypoints.shape[1:]))
        modes = 1e-2 * noise / (1.0 + np.arange(count))[:, np.newaxis, np.newaxis]
        way = self._waypoints[-1] - self._waypoints[0]
        modes[0] += swirl * np.stack([way[1], -way[0], np.zeros_like(way[0])])
        return np.asarray(modes)

    def points(self, modes: FloatArray) -> FloatArray:
        """Return the control points (N, n, 3) of all references."""
        shapes = self.swarm.shapes
        fixed = np.tensordot(shapes.fixed, self._waypoints, axes=1)
        return np.asarray((fixed + np.tensordot(shapes.modes, modes, axes=1)).transpose(2, 0, 1))

    def settle(self, modes: FloatArray, duration: float, stage: int) -> FloatArray:
        """Return modes with less of what is violated, for a duration, s; penalties grow with the stage, from 0 on."""
        weight = _PENALTY * _GROWTH**stage

        def cost(flat: FloatArray) -> tuple[float, FloatArray]:
            return self._cost(flat.reshape(modes.shape), duration, weight)

        found = descend(cost, modes.ravel(), _STEPS, _TOLERANCE)
        return found.reshape(modes.shape)

    def _cost(self, modes: FloatArray, duration: float, weight: float) -> tuple[float, FloatArray]:
        """Return the penalty function and its gradient, flat."""
        flat = modes.reshape(len(modes), -1)
        values = self._fixed + (self._modes @ flat).reshape(self._fixed.shape)
        slopes = np.zeros_like(values)
        samples, positions, velocities, *derivatives = self._parts
        cost = _push_apart(
            values[samples] * self._stretch, self._asked, slopes[samples]
        ) / self._samples  # fmt: skip
        slopes[samples] *= self._stretch / self._samples
        cost += _keep_box(values[positions], self.swarm.bounds, slopes[positions])
        accelerations, jerks, snaps = derivatives
        cost += _keep_input_set(
            values[accelerations] / duration**2, self.swarm.limits, self.swarm.bounds.margin, slopes[accelerations]
        )
        slopes[accelerations] /= duration**2
        bounds = self.swarm.bounds
        for part, order, most in (
            (velocities, 1, bounds.speed_max), (jerks, 3, bounds.jerk_max), (snaps, 4, bounds.snap_max),
        ):  # fmt: skip
            if most is not None:
                scale = duration**order * most * _SHARE
                cost += _shorten(values[part] / scale, slopes[part])
                slopes[part] /= scale
        gradient = _SMOOTH * modes.ravel() + weight * (self._modes.T @ slopes.reshape(len(slopes), -1)).ravel()
        return 0.5 * _SMOOTH * float((modes * modes).sum()) + weight * cost, gradient


def _samples(swarm: Swarm) -> int:
    """Return how many samples of each span are enough."""
    ways = np.diff(swarm.waypoints, axis=1)
    legs = np.diff(swarm.shapes.knots[swarm.shapes.passed])
    fastest = _PEAK * float((np.sqrt((ways**2).sum(axis=2)) / legs).max())  # m per duration
    closest = float(swarm.distances[~np.eye(len(swarm.distances), dtype=bool)].min(initial=math.inf))
    hop = 2.0 * fastest * float(np.diff(swarm.shapes.knots).max())
    return min(40, max(3, math.ceil(hop / (_HOP * closest))))


def _sampled(shapes: Shapes, samples: int) -> FloatArray:
    """Return the matrix (M samples, n) from control points to positions in the middle of equal parts of each span."""
    t = (np.arange(samples) + 0.5) / samples
    bernstein = np.array([math.comb(DEGREE, k) * t**k * (1.0 - t) ** (DEGREE - k) for k in range(ORDER)]).T
    spans = shapes.bezier[0].reshape(-1, ORDER, shapes.count)
    return np.asarray((bernstein @ spans).reshape(-1, shapes.count))


def _edges(sizes: list[int]) -> tuple[list[int], list[int]]:
    ends = np.cumsum(sizes).tolist()
    return [0, *ends[:-1]], ends


def _push_apart(positions: FloatArray, asked: FloatArray, slopes: FloatArray) -> float:
    """Return the sum of (d0 - |D|)^2 over pairs that are too near at samples (S, 3, N); the slopes get its gradient."""
    places = np.ascontiguousarray(positions.transpose(0, 2, 1))
    count = places.shape[1]
    squares = (places * places).sum(axis=2)
    products = places @ places.transpose(0, 2, 1)
    between = squares[:, :, np.newaxis] + squares[:, np.newaxis] - 2.0 * products
    near = np.flatnonzero((between < asked * asked).ravel())
    sample, pair = np.divmod(near, count * count)
    first, second = np.divmod(pair, count)
    one = first < second
    sample, first, second = sample[one], first[one], second[one]
    difference = places[sample, first] - places[sample, second]
    distance = np.sqrt((difference * difference).sum(axis=1)) + 1e-9
    depth = np.maximum(asked[first, second] - distance, 0.0)
    push = (-2.0 * depth / distance)[:, np.newaxis] * difference
    gradient = np.zeros_like(places)
    np.add.at(gradient, (sample, first), push)
    np.subtract.at(gradient, (sample, second), push)
    slopes[:] = gradient.transpose(0, 2, 1)
    return float(depth @ depth)


def _keep_box(positions: FloatArray, bounds: Bounds, slopes: FloatArray) -> float:
    lower, upper = (bounds.lower + _INSET)[:, np.newaxis], (bounds.upper - _INSET)[:, np.newaxis]
    beyond = np.maximum(positions - upper, 0.0) - np.maximum(lower - positions, 0.0)
    slopes[:] = 2.0 * _BOX * beyond
    return _BOX * float((beyond * beyond).sum())


def _keep_input_set(accelerations: FloatArray, limits: InputSet, margin: float, slopes: FloatArray) -> float:
    """Return the squares of what is missing to the margin (K, 3, N): tilt, thrust_max, thrust_min, m/s^2."""
    margin += _MARGIN
    sine, cosine = math.sin(limits.tilt_max), math.cos(limits.tilt_max)
    across, up = accelerations[:, :2], accelerations[:, 2] + limits.gravity
    level = np.sqrt((across * across).sum(axis=1)) + 1e-12
    tilt = np.maximum(level * cosine - up * sine + margin, 0.0)
    slopes[:, :2] = (2.0 * cosine * tilt / level)[:, np.newaxis] * across
    slopes[:, 2] = -2.0 * sine * tilt
    thrust = np.sqrt(level * level + up * up)
    most = np.maximum(thrust - limits.thrust_max + margin, 0.0)
    share = 2.0 * most / thrust
    slopes[:, :2] += share[:, np.newaxis] * across
    least = np.maximum(limits.thrust_min + margin - up, 0.0)
    slopes[:, 2] += share * up - 2.0 * least
    return float((tilt * tilt).sum() + (most * most).sum() + (least * least).sum())


def _shorten(vectors: FloatArray, slopes: FloatArray) -> float:
    """Return the squares of what the norms of vectors (K, 3, N) exceed 1 by."""
    lengths = np.sqrt((vectors * vectors).sum(axis=1)) + 1e-12
    beyond = np.maximum(lengths - 1.0, 0.0)
    slopes[:] = (2.0 * beyond / lengths)[:, np.newaxis] * vectors
    return float((beyond * beyond).sum())
