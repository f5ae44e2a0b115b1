"""What happened to the drones of a flight, as far as bounds speak of it; simulated and real time are recorded alike."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.falsification.faults.criteria import RISEN, DroneOutcome


class Record:
    """What happened to N drones so far.

    Attributes:
        met: (N,) whether a drone has met the floor.
        impact: (N,) largest speed at which it did, m/s.
        distance: (N,) farthest it was from its path: sideways, or above the path's highest point, m.
        height: (N,) highest it was above the floor, m.
        separation: (N,) the least distance to another drone while it was in the air, m.
        touched: (N,) whether it has met the floor since the last call of `forget_touches`.
        relaunched: (N,) whether it has risen again since then.
        resting_since: s, since when all stand on the floor; infinite while one does not.
    """

    def __init__(self, position: FloatArray, floor: float) -> None:
        """Begin with drones that stand at positions (N, 3), m, on a floor of a height, m."""
        count = len(position)
        self._floor = floor
        self.paths = [place[np.newaxis].copy() for place in position]
        self.impact, self.distance, self.height = np.zeros((3, count))
        self.separation = np.full(count, np.inf)
        self.met, self.touched, self.relaunched = np.zeros((3, count), dtype=bool)
        self.resting_since = math.inf
        self._grounded = np.ones(count, dtype=bool)
        self._speed = np.zeros(count)

    def extend_path(self, index: int, *places: FloatArray) -> None:
        """Let the path of a drone lead on through places (3,), m."""
        self.paths[index] = np.vstack([self.paths[index], *places])

    def forget_touches(self) -> None:
        """Begin to watch who meets the floor and rises again."""
        self.touched[:] = self.relaunched[:] = False

    def feel(self, velocity: FloatArray, grounded: np.ndarray) -> None:
        """Note who meets the floor, and how fast it was the moment before.

        Args:
            velocity: (N, 3) m/s.
            grounded: (N,) who is on the floor.
        """
        met = grounded & ~self._grounded
        if met.any():
            self.impact[met] = np.maximum(self.impact[met], self._speed[met])
            self.met |= met
            self.touched |= met
        self._grounded = grounded.copy()
        self._speed = np.sqrt((velocity * velocity).sum(axis=1))

    def look(self, time: float, position: FloatArray) -> None:
        """Note where the drones are at a time, s; position (N, 3), m."""
        above = position[:, 2] - self._floor
        self.height = np.maximum(self.height, above)
        self.relaunched |= self.touched & (above > RISEN)
        self.resting_since = min(self.resting_since, time) if self._grounded.all() else math.inf
        for index, path in enumerate(self.paths):
            off = distance_to_path(position[index, :2], path[:, :2])
            # np.maximum keeps what is not a number, which must not be taken for near
            self.distance[index] = np.maximum(
                self.distance[index], np.maximum(off, position[index, 2] - path[:, 2].max())
            )
        apart = np.linalg.norm(position[:, np.newaxis] - position, axis=-1)
        np.fill_diagonal(apart, np.inf)
        nearest = apart.min(axis=1, initial=np.inf)
        self.separation = np.where(above > RISEN, np.minimum(self.separation, nearest), self.separation)

    def outcome(self, drone: int, **end: Any) -> DroneOutcome:
        """Return what came of a drone's flight.

        Args:
            drone: its index.
            end: how it is at the end, see `DroneOutcome`.
        """
        return DroneOutcome(
            met=bool(self.met[drone]),
            impact=float(self.impact[drone]),
            distance=float(self.distance[drone]),
            height=float(self.height[drone]),
            separation=float(self.separation[drone]),
            relaunched=bool(self.relaunched[drone]),
            **end,
        )


def distance_to_path(point: FloatArray, path: FloatArray) -> float:
    """Return the distance of a point (2,) from the polyline through points (M, 2)."""
    if len(path) == 1:
        return float(np.linalg.norm(point - path[0]))
    begin, way = path[:-1], np.diff(path, axis=0)
    square = np.maximum((way * way).sum(axis=1), 1e-12)
    share = np.clip(((point - begin) * way).sum(axis=1) / square, 0.0, 1.0)
    return float(np.linalg.norm(begin + share[:, np.newaxis] * way - point, axis=1).min())
