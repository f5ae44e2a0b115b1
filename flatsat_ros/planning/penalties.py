"""The penalties of a search: costs of violated limits of many references at once, with gradients.

Each limit is tightened by some room. Each function returns its cost, and the worst violation of the tightened limit as
a share of that room: below 1 the limit itself holds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.law.input_set import InputSet

_BOX = 100.0  # 1/m^2: a violation of 10 cm weighs like one of 1 m/s^2
_SKIN = 0.25  # of the distance that two drones keep: pairs that are farther apart by less than this are listed


class Penalty(NamedTuple):
    """A cost, and its worst violation as a share of the room."""

    cost: float
    worst: float


class NearPairs:
    """The pairs of drones that may be too near at each sample: a list that is renewed when drones have moved far."""

    def __init__(self, distances: FloatArray) -> None:
        """Begin with nobody.

        Args:
            distances: (N, N) m, that each two drones keep.
        """
        self._distances = distances
        self._skin = _SKIN * float(distances.max(initial=0.0))
        self._upper = np.triu(np.ones(distances.shape, dtype=bool), 1)
        self._places = np.zeros((0, 0, 3))  # at which they were found
        self._first = self._second = np.zeros(0, dtype=np.int64)
        self._asked = np.zeros(0)

    def push_apart(self, positions: FloatArray, room: float, slopes: FloatArray) -> Penalty:
        """Charge for pairs nearer than their distance and the room at samples (S, 3, N): the mean of (d0 - |D|)^2."""
        places = np.ascontiguousarray(positions.transpose(0, 2, 1))
        self._renew(places, room)
        flat = places.reshape(-1, 3)
        difference = flat[self._first] - flat[self._second]
        square = (difference * difference).sum(axis=1)
        near = np.flatnonzero(square < (self._asked + room) ** 2)
        first, second, difference = self._first[near], self._second[near], difference[near]
        distance = np.sqrt(square[near]) + 1e-9
        depth = np.maximum(self._asked[near] + room - distance, 0.0)
        push = (-2.0 * depth / distance)[:, np.newaxis] * difference
        gradient = np.zeros_like(flat)
        for axis in range(3):
            gradient[:, axis] = np.bincount(first, push[:, axis], len(flat))
            gradient[:, axis] -= np.bincount(second, push[:, axis], len(flat))
        slopes[:] = gradient.reshape(places.shape).transpose(0, 2, 1)
        return Penalty(float(depth @ depth), float(depth.max(initial=0.0)) / room)

    def _renew(self, places: FloatArray, room: float) -> None:
        """Renew the list of near pairs if a drone has moved by more than half of the skin."""
        if places.shape == self._places.shape:
            moved = places - self._places
            if 4.0 * float((moved * moved).sum(axis=2).max(initial=0.0)) <= self._skin**2:
                return
        count = places.shape[1]
        squares = (places * places).sum(axis=2)
        between = squares[:, :, np.newaxis] + squares[:, np.newaxis] - 2.0 * (places @ places.transpose(0, 2, 1))
        reach = self._distances + room + self._skin
        sample, pair = np.divmod(np.flatnonzero(((between < reach * reach) & self._upper).ravel()), count * count)
        one, other = np.divmod(pair, count)
        self._places = places
        self._first, self._second = sample * count + one, sample * count + other
        self._asked = self._distances[one, other]


def push_away(
    positions: FloatArray, boxes: FloatArray, distances: FloatArray, room: float, slopes: FloatArray
) -> Penalty:
    """Charge for drones nearer to boxes than their distance and the room, at samples; add the gradient to the slopes.

    Args:
        positions: (S, 3, N) m.
        boxes: (K, 2, 3) m, lower and upper corners. Who is inside is pushed toward the nearest face.
        distances: (N,) m, that each drone keeps.
        room: m.
        slopes: (S, 3, N), added to.
    """
    cost = worst = 0.0
    for lower, upper in boxes[..., np.newaxis]:
        above, below = positions - upper, lower - positions
        outside = np.maximum(above, 0.0) - np.maximum(below, 0.0)
        depths = np.maximum(
            above, below
        )  # to each pair of faces; the largest is the nearest face where all are negative
        face = depths.argmax(axis=1)[:, np.newaxis]
        inside = np.take_along_axis(depths, face, axis=1)
        away = np.sqrt((outside * outside).sum(axis=1, keepdims=True))
        is_inside = inside <= 0.0
        depth = np.maximum(distances + room - np.where(is_inside, inside, away), 0.0)
        direction = outside / np.maximum(away, 1e-9)
        normal = np.zeros_like(positions)
        sides = np.where(np.take_along_axis(above, face, axis=1) >= np.take_along_axis(below, face, axis=1), 1.0, -1.0)
        np.put_along_axis(normal, face, sides, axis=1)
        slopes -= 2.0 * depth * np.where(is_inside, normal, direction)
        cost += float((depth * depth).sum())
        worst = max(worst, float(depth.max(initial=0.0)) / room)
    return Penalty(cost, worst)


def keep_box(positions: FloatArray, lower: FloatArray, upper: FloatArray, room: float, slopes: FloatArray) -> Penalty:
    """Charge for points (K, 3, N) beyond a box with corners (3,) less the room, m."""
    low, high = (lower + room)[:, np.newaxis], (upper - room)[:, np.newaxis]
    beyond = np.maximum(positions - high, 0.0) - np.maximum(low - positions, 0.0)
    slopes[:] = 2.0 * _BOX * beyond
    return Penalty(_BOX * float((beyond * beyond).sum()), float(np.abs(beyond).max()) / room)


def keep_input_set(
    accelerations: FloatArray, limits: InputSet, margin: float, room: float, slopes: FloatArray
) -> Penalty:
    """Charge for what is missing to the margin and the room (K, 3, N): tilt, thrust_max, thrust_min, m/s^2."""
    margin += room
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
    worst = max(float(each.max()) for each in (tilt, most, least)) / room
    return Penalty(float((tilt * tilt).sum() + (most * most).sum() + (least * least).sum()), worst)


def shorten(vectors: FloatArray, room: float, slopes: FloatArray) -> Penalty:
    """Charge for norms of vectors (K, 3, N) above 1 less the room."""
    most = 1.0 - room
    lengths = np.sqrt((vectors * vectors).sum(axis=1)) + 1e-12
    beyond = np.maximum(lengths - most, 0.0)
    slopes[:] = (2.0 * beyond / lengths)[:, np.newaxis] * vectors
    return Penalty(float((beyond * beyond).sum()), float(beyond.max()) / room)
