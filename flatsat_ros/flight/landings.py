"""Landings that cannot be refused: where another robot stands, rests or goes below, a drone lands aside of it."""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.neighbours import Neighbours
from flatsat_ros.flight.tick import Report

# places aside are this much farther than they must be, m, in so many directions, and at so many multiples of that
_MARGIN = 0.1
_DIRECTIONS = 12
_RINGS = 3
# a goal so near, m, is the same
_SAME = 0.05


class Landings:
    """Landings of N drones.

    Attributes:
        aside: by drone that flies aside to land there, the place (3,), m.
        reports: what people should know, until somebody empties it.
    """

    def __init__(self, guidance: Guidance, neighbours: Neighbours, separation: float) -> None:
        """Begin with none; whoever is less than the separation, m, off sideways, and lower, is below."""
        self.aside: dict[int, FloatArray] = {}
        self.reports: list[Report] = []
        self._guidance, self._neighbours, self._separation = guidance, neighbours, separation

    def below(self, index: int, place: FloatArray) -> str:
        """Return who is, or will be, below a place (3,), m, of drone index; empty for nobody."""
        there = self._neighbours
        for other, name in enumerate(there.names):
            if other == index:
                continue
            for end in there.ends(other):
                across = math.hypot(end.place[0] - place[0], end.place[1] - place[1])
                if across < self._separation and end.place[2] < place[2]:
                    return f"{name} {end.does}"
        return ""

    def land(self, index: int) -> None:
        """Let drone index, which flies, land where it is, or aside if somebody is below."""
        now, guidance = self._neighbours.now, self._guidance
        end = guidance.way(index, np.full(3, np.nan), now).end  # where it can brake
        found = self.below(index, end)
        self.aside.pop(index, None)
        if not found:
            guidance.land(index, now)
            return
        for goal in self._around(end):
            if not self.below(index, goal) and not self._neighbours.conflicts(index, self._neighbours.way(index, goal)):
                guidance.go_to(index, goal, float(guidance.references.yaw[index]))
                guidance.replan(index, now)
                self.aside[index] = goal
                away = math.dist(goal[:2], end[:2])
                self.reports.append(Report(index, f"{found} below: it lands {away:.2f} m aside"))
                return
        self.reports.append(Report(index, f"{found} below, and no place aside is free: it lands there"))
        guidance.land(index, now)

    def look(self) -> None:
        """Let those land that have come to rest aside; forget those that are led elsewhere or do not fly any more."""
        for index, place in list(self.aside.items()):
            goal = self._guidance.goal(index)
            elsewhere = goal is not None and math.dist(goal, place) > _SAME
            if self._neighbours.mode(index) is not Mode.FLY or self._guidance.landing[index] or elsewhere:
                del self.aside[index]
            elif self._guidance.references.at_rest[index]:
                self.land(index)

    def _around(self, place: FloatArray) -> list[FloatArray]:
        """Return places (3,), m, around one, the nearest at first, that are inside the box."""
        found = []
        for ring in range(1, _RINGS + 1):
            radius = ring * (self._neighbours.required + _MARGIN)
            for angle in np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False):
                goal = place + radius * np.array([math.cos(angle), math.sin(angle), 0.0])
                try:
                    found.append(self._guidance.require_inside(goal, "the place"))
                except FlatsatError:
                    continue
        return found
