"""References of many drones that keep apart and keep their limits: found, not proved, for one duration.

All references are shapes of one kind, so that one matrix takes the unknowns of all drones to everything that matters.
What is minimised is the jerk plus penalties on what is violated, whose weights grow from stage to stage. A pair pushes
itself apart by the depth of the violation, (d0 - |D|)^2, at samples so dense that no drone passes through another
between two of them.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.planning.descent import descend
from flatsat_ros.planning.detours import along, around
from flatsat_ros.planning.penalties import NearPairs, Penalty, keep_box, keep_input_set, push_away, shorten
from flatsat_ros.planning.program import raising
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.curve import DEGREE, ORDER

_SMOOTH, _PENALTY = 1e-3, 30.0  # weights of the jerk and of the penalty in the first stage
_GROWTH = 4.0  # factor of the weight of the penalty from stage to stage
_TOLERANCE = 1e-7  # of a stage's descent
_APART = 10.0  # 1/m^2, weight of distances

# The room by which limits are tightened in the first stage, because a penalty never becomes quite 0
_ROOM = 4e-3  # m, of distances
_MARGIN = 2e-3  # m/s^2, of the input set
_SHARE = 3e-3  # relative, of speed, jerk and snap
_INSET = 2e-4  # m, of the box
_WIDER = 1.5  # factor of the room from stage to stage
_ENOUGH = 0.8  # a search ends where violations take at most this share of the room

_SMOOTH_WAY = 1e-5  # m^2, weight of jerk where a way around boxes is followed
_HOP = 0.5  # two drones move by at most about this share of the distance that they keep, between two samples
_PEAK = 1.3 * 15.0 / 8.0  # largest speed over the mean speed of a reference, with a detour


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
        boxes: (K, 2, 3) m, lower and upper corners of obstacles.
        reaches: (N,) m, that each drone keeps away from them, in the downwash metric.
    """

    shapes: Shapes
    waypoints: FloatArray
    distances: FloatArray
    downwash: float
    limits: InputSet
    bounds: Bounds
    boxes: FloatArray
    reaches: FloatArray


class Search:
    """The penalty function of a swarm, over the modes (F, 3, N) of its references."""

    def __init__(self, swarm: Swarm) -> None:
        self.swarm = swarm
        shapes = swarm.shapes
        self._samples = _samples(swarm)
        parts = [_sampled(shapes, self._samples), *(shapes.bezier[order] for order in (0, 1, 2, 3, 4))]
        self._parts = [slice(a, b) for a, b in zip(*_edges([len(part) for part in parts]), strict=True)]
        asked = swarm.bounds.asked
        self._asked = [  # which parts make f, of what degree and how much of each along x, y and z
            (
                self._parts[1 + order], raising(order, min(asked)),
                np.array([[float(factor)] for factor in factors]), order,
            )
            for order, factors in asked.items()
        ]  # fmt: skip
        stacked = np.concatenate(parts)
        self._modes = stacked @ shapes.modes
        self._waypoints = swarm.waypoints.transpose(1, 2, 0)  # (W, 3, N)
        self._fixed = np.tensordot(stacked @ shapes.fixed, self._waypoints, axes=1)
        self._stretch = np.array([1.0, 1.0, 1.0 / swarm.downwash])[:, np.newaxis]
        self._neighbours = NearPairs(swarm.distances)
        self._boxes = swarm.boxes * self._stretch[:, 0]

    def begin(self, swirl: float, seed: int, spread: float = 0.0) -> FloatArray:
        """Return modes (F, 3, N) to begin with: a little noise, a detour of each drone to its right, ways around boxes.

        Args:
            swirl: the detour, as a share of the way; drones that swap places turn around each other then.
            seed: of the noise, which decides what symmetry leaves open.
            spread: share of the duration by which those that have to go around boxes set out one after the other.
        """
        count = self._modes.shape[1]
        noise = np.random.default_rng(seed).normal(size=(count, *self._waypoints.shape[1:]))
        modes = 1e-2 * noise / (1.0 + np.arange(count))[:, np.newaxis, np.newaxis]
        way = self._waypoints[-1] - self._waypoints[0]
        modes[0] += swirl * np.stack([way[1], -way[0], np.zeros_like(way[0])])
        if len(self._boxes):
            modes += self._around(spread)
        return np.asarray(modes)

    def _around(self, spread: float) -> FloatArray:
        """Return modes (F, 3, N) near ways around the boxes; who comes to a box first sets out first."""
        shapes = self.swarm.shapes
        times, passed = _times(shapes, self._samples), shapes.knots[shapes.passed]
        leg = np.searchsorted(passed, times, side="right") - 1
        share = (times - passed[leg]) / np.diff(passed)[leg]
        corners = [float(np.linalg.norm(ways[0][1] - ways[0][0])) for ways in self._detours]
        rank = np.argsort(np.argsort(corners, kind="stable"), kind="stable") / max(1, len(corners) - 1)
        samples = self._parts[0]
        wanted = np.zeros_like(self._fixed[samples])
        for number, ways in enumerate(self._detours):
            pace = share
            if len(ways) == 1:
                u = np.clip((share - spread * rank[number]) / (1.0 - spread), 0.0, 1.0)
                pace = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
            for index, way in enumerate(ways):
                wanted[leg == index, :, number] = along(way, pace[leg == index])
        matrix = self._modes[samples]
        missing = (wanted / self._stretch - self._fixed[samples]).reshape(len(matrix), -1)
        square = matrix.T @ matrix + _SMOOTH_WAY * len(matrix) * np.eye(matrix.shape[1])
        found = np.linalg.solve(square, matrix.T @ missing)
        return np.asarray(found.reshape(-1, *wanted.shape[1:]))

    @cached_property
    def _detours(self) -> list[list[FloatArray]]:
        """A way around the boxes (P, 3) for each leg of each drone, heights divided by the downwash."""
        stretch = self._stretch[:, 0]
        bounds = self.swarm.bounds
        found = []
        for places, reach in zip(self.swarm.waypoints * stretch, self.swarm.reaches.tolist(), strict=True):
            ways = []
            for start, goal in itertools.pairwise(places):
                way = around(start, goal, self._boxes, reach, bounds.lower * stretch, bounds.upper * stretch)
                ways.append(np.array([start, goal]) if way is None else way)
            found.append(ways)
        return found

    def points(self, modes: FloatArray) -> FloatArray:
        """Return the control points (N, n, 3) of all references."""
        shapes = self.swarm.shapes
        fixed = np.tensordot(shapes.fixed, self._waypoints, axes=1)
        return np.asarray((fixed + np.tensordot(shapes.modes, modes, axes=1)).transpose(2, 0, 1))

    def settle(self, modes: FloatArray, duration: float, stage: int, steps: int) -> tuple[FloatArray, bool]:
        """Return modes with less of what is violated, and whether nothing is any more, as far as is seen.

        Args:
            modes: to begin with.
            duration: s.
            stage: from 0 on; penalties and what is asked for beyond the limits grow with it.
            steps: of the descent, at most.
        """
        weight, wider = _PENALTY * _GROWTH**stage, _WIDER**stage
        worst = math.inf

        def cost(flat: FloatArray) -> tuple[float, FloatArray]:
            nonlocal worst
            value, gradient, worst = self._cost(flat.reshape(modes.shape), duration, weight, wider)
            return value, gradient

        found = descend(cost, modes.ravel(), steps, _TOLERANCE, lambda: worst < _ENOUGH)
        return found.reshape(modes.shape), worst < _ENOUGH

    def _cost(self, modes: FloatArray, duration: float, weight: float, wider: float) -> tuple[float, FloatArray, float]:
        """Return the penalty function, its gradient, flat, and the worst violation as a share of the room."""
        flat = modes.reshape(len(modes), -1)
        values = self._fixed + (self._modes @ flat).reshape(self._fixed.shape)
        slopes = np.zeros_like(values)
        samples, positions, velocities, accelerations, jerks, snaps = self._parts
        swarm = self.swarm
        bounds = swarm.bounds
        places, pushes = values[samples] * self._stretch, slopes[samples]
        apart = [
            self._neighbours.push_apart(places, _ROOM * wider, pushes),
            push_away(places, self._boxes, swarm.reaches, _ROOM * wider, pushes),
        ]
        pushes *= self._stretch * (_APART / self._samples)
        charges = [Penalty(each.cost * _APART / self._samples, each.worst) for each in apart]
        charges.append(keep_box(values[positions], bounds.lower, bounds.upper, _INSET * wider, slopes[positions]))
        charges.append(self._keep_margin(values, duration, _MARGIN * wider, slopes))
        for part, order, most in (
            (velocities, 1, bounds.speed_max), (accelerations, 2, bounds.acceleration_max),
            (jerks, 3, bounds.jerk_max), (snaps, 4, bounds.snap_max),
        ):  # fmt: skip
            if most is not None:
                scale = duration**order * most
                slope = np.empty_like(slopes[part])
                charges.append(shorten(values[part] / scale, _SHARE * wider, slope))
                slopes[part] += slope / scale
        gradient = _SMOOTH * modes.ravel() + weight * (self._modes.T @ slopes.reshape(len(slopes), -1)).ravel()
        cost = 0.5 * _SMOOTH * float((modes * modes).sum()) + weight * sum(charge.cost for charge in charges)
        return cost, gradient, max(charge.worst for charge in charges)

    def _keep_margin(self, values: FloatArray, duration: float, room: float, slopes: FloatArray) -> Penalty:
        """Charge for what f lacks of its margin; slopes, of all values, get what that adds to them."""
        bounds, spans = self.swarm.bounds, len(self.swarm.shapes.lengths)
        parts = [(part, raised, factors / duration**order) for part, raised, factors, order in self._asked]
        f: FloatArray = np.sum([
            (raised @ values[part].reshape(spans, raised.shape[1], -1)).reshape(-1, *values.shape[1:]) * factors
            for part, raised, factors in parts
        ], axis=0)  # fmt: skip
        slope = np.empty_like(f)
        charge = keep_input_set(f, bounds.room(self.swarm.limits), bounds.margin, room, slope)
        for part, raised, factors in parts:
            own = (slope * factors).reshape(spans, len(raised), -1)
            slopes[part] += (raised.T @ own).reshape(-1, *values.shape[1:])
        return charge


def _samples(swarm: Swarm) -> int:
    """Return how many samples of each span are enough."""
    ways = np.diff(swarm.waypoints, axis=1)
    legs = np.diff(swarm.shapes.knots[swarm.shapes.passed])
    fastest = _PEAK * float((np.sqrt((ways**2).sum(axis=2)) / legs).max())  # m per duration
    closest = float(swarm.distances[~np.eye(len(swarm.distances), dtype=bool)].min(initial=math.inf))
    if len(swarm.boxes):
        closest = min(closest, float(swarm.reaches.min()))
    hop = 2.0 * fastest * float(np.diff(swarm.shapes.knots).max())
    return min(40, max(3, math.ceil(hop / (_HOP * closest))))


def _times(shapes: Shapes, samples: int) -> FloatArray:
    """Return the times of the samples, as shares of the duration."""
    within = (np.arange(samples) + 0.5) / samples
    return np.asarray((shapes.knots[:-1, np.newaxis] + np.diff(shapes.knots)[:, np.newaxis] * within).ravel())


def _sampled(shapes: Shapes, samples: int) -> FloatArray:
    """Return the matrix (M samples, n) from control points to positions in the middle of equal parts of each span."""
    t = (np.arange(samples) + 0.5) / samples
    bernstein = np.array([math.comb(DEGREE, k) * t**k * (1.0 - t) ** (DEGREE - k) for k in range(ORDER)]).T
    spans = shapes.bezier[0].reshape(-1, ORDER, shapes.count)
    return np.asarray((bernstein @ spans).reshape(-1, shapes.count))


def _edges(sizes: list[int]) -> tuple[list[int], list[int]]:
    ends = np.cumsum(sizes).tolist()
    return [0, *ends[:-1]], ends
