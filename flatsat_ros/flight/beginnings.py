"""How long a flight shows how it began: until estimates have settled, and the start outside the tube is forgotten."""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.flight.assumptions import RATE_TIME

# a start outside the tube, or an estimate that began anew, counts as forgotten when so much of it is left
_FORGOTTEN = 0.05


class Beginnings:
    """When all was last otherwise than is assumed, of N drones.

    Attributes:
        ready: when all drones will have been steered for as long as estimates take to settle, s.
        settled: (N,) when the estimates are settled after something did not hold, s.
        due: (N,) when it is forgotten where that left the drone, s.
    """

    def __init__(self, flight: FlightSection, count: int) -> None:
        """Begin with N drones that are not steered yet.

        Args:
            flight: the estimator, the tubes and the ways back into them.
            count: N.
        """
        self._ways = [(axis.tube.position, axis.back) for axis in flight.axes]
        self._settling = max(_settling(axis) for axis in flight.axes)
        self._waited = np.full(count, -np.inf)  # when each was not steered last, s
        self.ready, self.settled, self.due = -math.inf, np.full(count, -np.inf), np.full(count, np.inf)

    def steady(self, now: float, flying: np.ndarray) -> np.ndarray:
        """Return who is steered for as long as estimates take to settle, (N,); flying are those who are by now, s."""
        if not all_of(flying):
            np.copyto(self._waited, now, where=~flying)
            self.ready = now + self._settling
        return np.asarray(flying & (self._waited <= now - self._settling))

    def began(self, time: float) -> np.ndarray:
        """Return who is steered since that time, s, at the earliest, (N,)."""
        return np.asarray(self._waited >= time)

    def begin(self, now: float, anew: np.ndarray, lately: np.ndarray, sizes: FloatArray) -> None:
        """Begin anew with some drones.

        Args:
            now: s.
            anew: (N,) with whom.
            lately: (N,) of whom what does not hold may have come just now: a disturbance that has changed too fast has
                done so some time before.
            sizes: (N, 2, 2) of e and e', horizontal and vertical, m and m/s.
        """
        back = np.zeros(len(anew))  # time in which the start is forgotten, s
        for part, (tube, way) in enumerate(self._ways):
            start = way.position * sizes[:, 0, part] + way.position_velocity * sizes[:, 1, part]
            back = np.maximum(back, np.log(np.maximum(start / (_FORGOTTEN * tube), 1.0)) / way.rate)
        settled = now + self._settling - np.where(lately, 0.0, RATE_TIME)
        self.settled = np.where(anew, np.maximum(self.settled, settled), self.settled)
        self.due = np.where(anew, np.maximum(now + back, self.settled), self.due)


def _settling(axis: Axis) -> float:
    """Return after what time, s, the estimator has forgotten how it began."""
    loop = FlightLoop(axis.design, axis.design.model)
    n = loop.plant.size
    errors = np.zeros((3, loop.size))  # of position, velocity and disturbance; those of the rest vanish
    errors[0, [0, n]] = errors[1, [1, n + 1]] = 1.0, -1.0
    errors[2, 2 * n] = 1.0
    radius = float(np.abs(np.linalg.eigvals((errors @ loop.matrix(0.0))[:, [0, 1, 2 * n]])).max())
    return axis.design.period * math.log(_FORGOTTEN) / math.log(radius)
