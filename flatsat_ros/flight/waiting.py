"""Goals that wait until the way there is clear of other drones.

Each is tried again and again, first the one that was tried longest ago. None waits longer than `_PATIENCE` for drones
that rest. Drones that rest in each other's way set out together, if their ways are clear when they all do.
"""

from __future__ import annotations

import math

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.neighbours import Neighbours
from flatsat_ros.flight.supervisor import Supervisor
from flatsat_ros.flight.tick import Report

# a goal waits so long, s, for drones that rest in its way
_PATIENCE = 10.0
# so many are tried at each look
_TRIES = 4
# between two looks whether drones can set out together, s, and how many of them at most
_TOGETHER_PERIOD = 0.5
_TOGETHER = 6


class Waiting:
    """The goals that wait, by drone.

    Attributes:
        goals: (3,) m.
        reports: what people should know, until somebody empties it.
    """

    def __init__(self, guidance: Guidance, supervisor: Supervisor, neighbours: Neighbours) -> None:
        """Begin with none."""
        self.goals: dict[int, FloatArray] = {}
        self.reports: list[Report] = []
        self._guidance, self._supervisor, self._neighbours = guidance, supervisor, neighbours
        self._yaws: dict[int, float] = {}
        self._ages: dict[int, float] = {}  # running numbers: the least is the oldest
        self._stuck: dict[int, float] = {}  # s, since when all that are in the way rest; infinite if one does not
        self._tried: dict[int, float] = {}  # s, when the way was looked at last
        self._joined = -math.inf  # s, when to look again who can set out together

    def set_clock_back(self) -> None:
        """Let nothing wait longer because the clock was set back."""
        self._joined = -math.inf
        self._stuck = dict.fromkeys(self._stuck, math.inf)
        self._tried = dict.fromkeys(self._tried, -math.inf)

    def put(self, index: int, goal: FloatArray, yaw: float, age: float) -> None:
        """Let a goal (3,), m, with a yaw, rad, of drone index wait; the running number is that of its reference."""
        self.goals[index], self._yaws[index], self._ages[index] = goal, yaw, age
        self._stuck[index], self._tried[index] = math.inf, -math.inf

    def withdraw(self, index: int) -> None:
        """Let no goal of drone index wait any longer."""
        self.goals.pop(index, None)

    def look(self) -> list[int]:
        """Give drones their goals whose way is clear, as is due; return which."""
        waiting = sorted(self.goals, key=lambda i: (self._tried[i], self._ages[i]))
        # one at a time: only at the next look the others know of its way
        first = next((index for index in waiting[:_TRIES] if self._try(index)), None)
        begun = [] if first is None else [first]
        now = self._neighbours.now
        if not begun and now >= self._joined:
            self._joined = now + _TOGETHER_PERIOD
            begun = self._set_out_together()
        return begun

    def _try(self, index: int) -> bool:
        """Let drone index set out if its way is clear; tell whether it is."""
        now, mode, goal = self._neighbours.now, self._neighbours.mode(index), self.goals[index]
        self._tried[index] = now
        if not self._supervisor.armed[index] or self._guidance.landing[index]:
            self.withdraw(index)
            return False
        if mode in (Mode.LEVEL, Mode.DESCEND):
            return False
        conflicts = self._neighbours.conflicts(index, self._neighbours.way(index, goal), lost=True)
        if not conflicts:
            self._set_out(index, "its way is clear: it sets out")
            return True
        resting = all(conflict.rests for conflict in conflicts)
        self._stuck[index] = min(self._stuck[index], now) if resting else math.inf
        if now - self._stuck[index] >= _PATIENCE:
            self.withdraw(index)
            text = f"its goal is given up, it waited for {_PATIENCE:g} s: {self._neighbours.describe(conflicts[0])}"
            self.reports.append(Report(index, text))
        return False

    def _set_out_together(self) -> list[int]:
        """Let drones that rest in each other's way set out at once if their ways are clear then; return which."""
        stuck = [index for index in self.goals if math.isfinite(self._stuck[index])]
        oldest = sorted(stuck, key=lambda i: self._ages[i])[:_TOGETHER]
        ways = {index: self._neighbours.way(index, self.goals[index]) for index in oldest}
        while len(ways) > 1:
            blocked = [i for i, track in ways.items() if self._neighbours.conflicts(i, track, instead=ways)]
            if not blocked:
                for index in ways:
                    self._set_out(index, "its way is clear as those in it set out, too: it does")
                return list(ways)
            del ways[blocked[-1]]
        return []

    def _set_out(self, index: int, text: str) -> None:
        """Give drone index the goal that waits for it."""
        self._guidance.go_to(index, self.goals.pop(index), self._yaws[index])
        self.reports.append(Report(index, text))
