"""Who brakes when references, or the drones themselves, come too near to each other.

- If two references come too near within `_FORESIGHT`, the drone whose reference is younger brakes and waits; if that
  one rests, the other does.
- Drones that are measured nearer than the separation both brake; the one whose reference is older then goes on when its
  way is clear.
"""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.guidance import NEAR_GROUND, Guidance
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.neighbours import Conflict, Neighbours
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.separation import DOWNWASH, near_pairs
from flatsat_ros.flight.tick import Report
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.flight.waiting import Waiting

# references that come too near within this time, s, are not flown: at 1 m/s a path needs 2.2 s to brake
_FORESIGHT = 2.5
# so long, s, the trajectories of drones that set out together may take to come, one after the other
SOON = 0.5
# at most so many changed references are looked at each time
_LOOKS = 4
# shortest and longest time between two looks at who is near whom, s; drones change their speed by less until then, m/s
_MEASURE_PERIODS = (0.05, 0.5)
_SPEED_CHANGE = 1.0
# drones that have been too near are told again when they have been farther apart than that by this, m
_APART = 0.05


class Yielding:
    """Who brakes for whom among N drones and M other robots, numbered from N on.

    Attributes:
        changed: whose references or modes have changed; who comes too near to them is to be found out anew.
        reports: what people should know, until somebody empties it.
        measures_at: when to measure again, s.
    """

    def __init__(self, policy: Policy, guidance: Guidance, neighbours: Neighbours, waiting: Waiting) -> None:
        """Begin with nobody on the way.

        Args:
            policy: the figures.
            guidance: gives the drones their references.
            neighbours: where everybody is.
            waiting: takes the goals of drones that brake.
        """
        self._guidance, self._neighbours, self._waiting = guidance, neighbours, waiting
        self._separation, self._steps = policy.separation, policy.goal_mode is GoalMode.STEP
        self.changed: set[int] = set()
        self.reports: list[Report] = []
        # running number of each newest reference, and when it was given, s; robots that others fly have the oldest
        self._given, self._given_at = np.zeros(len(neighbours.names)), np.full(neighbours.count, -math.inf)
        self._suspects: set[tuple[int, int]] = set()  # pairs whose references will come too near
        self._warned: set[tuple[int, int]] = set()  # of those, the ones that nobody can brake
        self._near: set[tuple[int, int]] = set()  # pairs that are too near, and were told
        self._brakes: dict[int, Trajectory | None] = {}  # the references of those that were made to brake
        self.measures_at = -math.inf

    @property
    def is_busy(self) -> bool:
        """Whether references are to be looked at."""
        return bool(self.changed or self._suspects)

    def number(self, index: int) -> None:
        """Note that drone index has a new reference."""
        self._given[index], self._given_at[index] = self._given.max() + 1.0, self._neighbours.now

    def wait(self, index: int, goal: FloatArray, yaw: float, conflict: Conflict) -> None:
        """Let a goal (3,), m, with a yaw, rad, of drone index wait until the conflict is over, and tell that."""
        self._waiting.put(index, goal, yaw, self._given[index])
        self._tell(index, f"its goal waits until the way is clear: {self._neighbours.describe(conflict)}")

    def foresee(self) -> None:
        """Let drones brake whose references would come too near to others soon."""
        for index in sorted(self.changed)[:_LOOKS]:
            self._suspect(index)
        for pair in sorted(self._suspects):
            self._foresee(pair)
        self._warned &= self._suspects
        self.changed |= self._neighbours.take_references()  # of those that brake now

    def _suspect(self, index: int) -> None:
        """Find out anew who will come too near to robot index."""
        self.changed.discard(index)
        self._suspects = {pair for pair in self._suspects if index not in pair}
        here = self._neighbours.presence(index)
        if here is not None:
            for conflict in self._neighbours.conflicts(index, here.track, scale=here.scale):
                self._suspects.add((min(index, conflict.other), max(index, conflict.other)))

    def _foresee(self, pair: tuple[int, int]) -> None:
        """Let one of two robots brake if their references come too near soon; it waits, if it has a goal."""
        there, now = self._neighbours, self._neighbours.now
        movers = [index for index in pair if self._moves(index)]
        if not movers:
            self._suspects.discard(pair)
            return
        brakes = [index for index in movers if not self._keeps_its_way(index)]
        index = max(brakes or movers, key=lambda i: float(self._given[i]))
        here = there.presence(index)
        if here is None or now < self._given_at[index] + SOON:
            return
        conflicts = there.conflicts(index, here.track, now + _FORESIGHT, here.scale)
        for conflict in (conflict for conflict in conflicts if conflict.other in pair):
            if not brakes:
                if pair not in self._warned:
                    self._tell(index, self._neighbours.describe(conflict))
                self._warned.add(pair)
                continue
            yaw, goal = float(self._guidance.references.yaw[index]), self._brake(index)
            if goal is not None:
                self.wait(index, goal, yaw, conflict)

    def _moves(self, index: int) -> bool:
        """Tell whether a robot is a drone with a reference that moves, and is not braking for another drone."""
        if self._neighbours.mode(index) is not Mode.FLY or self._guidance.references.at_rest[index]:
            return False
        brake = self._brakes.get(index)
        return brake is None or self._guidance.references.trajectory(index) is not brake

    def _keeps_its_way(self, index: int) -> bool:
        """Tell whether drone index does not brake for others: it lands, or leaves the ground."""
        return bool(self._guidance.landing[index]) or (self.is_low(index) and bool(self._guidance.waits[index]))

    def is_low(self, index: int) -> bool:
        """Tell whether drone index is near the ground."""
        return bool(self._neighbours.state[index, 2] - self._guidance.ground[index] < NEAR_GROUND)

    def _brake(self, index: int) -> FloatArray | None:
        """Let drone index brake; return where it was on its way to, (3,) m; None if it is led nowhere."""
        goal = self._guidance.destination(index)
        self._guidance.brake(index, self._neighbours.now)
        self._brakes[index] = self._guidance.references.trajectory(index)
        return None if goal is None else goal.copy()

    def measure(self) -> None:
        """Look who is nearer to whom than the separation, and note when anybody can be next."""
        there, limit = self._neighbours, self._separation
        pairs, least = near_pairs(there.places(), there.aloft(), limit + _APART)
        speed = float(np.abs(there.state[:, 3:]).max(initial=0.0)) + _SPEED_CHANGE
        shortest, longest = _MEASURE_PERIODS
        self.measures_at = there.now + min(max((least - limit) / (2.0 * speed), shortest), longest)
        if not (pairs or self._near):
            return
        self._near &= {(i, j) for i, j, _ in pairs}
        for i, j, distance in pairs:
            kept = self._neighbours.kept(i, j)
            must = limit if kept is None else min(kept, limit)
            if distance < must and (i, j) not in self._near and i < there.count:
                self._near.add((i, j))
                self._part(i, j, distance, must)

    def _part(self, i: int, j: int, distance: float, limit: float) -> None:
        """Let two robots that are too near brake, and the drone whose reference is older go on later."""
        there, least = self._neighbours, f"at least {limit:.3g} m, {DOWNWASH:g} times that vertically"
        for index, other in ((i, j), (j, i)):
            if index >= there.count:
                continue
            does = ""
            if not self._steps and self._moves(index) and not self._keeps_its_way(index):
                yaw, goal = float(self._guidance.references.yaw[index]), self._brake(index)
                does = ": it brakes and stays"
                if goal is not None and self._given[index] < self._given[other]:
                    self._waiting.put(index, goal, yaw, self._given[index])
                    does = ": it brakes until its way is clear"
            self._tell(index, f"{distance:.2f} m from {there.names[other]}, must be {least}{does}")

    def _tell(self, index: int, text: str) -> None:
        self.reports.append(Report(index, text))
