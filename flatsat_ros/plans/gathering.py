"""Drones go to where a plan stands: by another plan where somebody makes one, otherwise by the rules that goals follow.

Ways to goals are straight, so drones that have arrived can be in the way of others for good. Where many have to move,
those on the ground first climb, then all stand still in the air until a way for all at once has been planned, and fly
it. Who plans is no part of this room: a process of its own, or a simulation, for which time stands still.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.separation import IN_THE_AIR
from flatsat_ros.plans.plan import Plan
from flatsat_ros.plans.prepared import PreparedPlan

# s, after which goals that were given up or refused are sent again; m, up to which two goals are the same
_AGAIN, _SAME = 1.0, 1e-6
# m, from its place, within which the reference of a drone that is there must end
_THERE = 1e-3
# m, that drones on the ground climb first, and s, that they may take for it
_CLIMB, _CLIMBING = 0.5, 10.0

_DOWN = (Mode.IDLE, Mode.CUT, Mode.REST, Mode.FALLEN)  # modes in which a drone does not fly any more

# the process that reads a pickled `Move` and writes what `prepared.received` reads
COMMAND = (sys.executable, "-m", "flatsat_ros.planning.gathering")


@dataclass(frozen=True, eq=False)
class Move:
    """What is to be planned.

    Attributes:
        plan: to whose drones' places it leads; its bounds, tubes and metric hold on the way, too.
        starts: (3,) m, where each drone rests, by name.
        goals: likewise, where it shall rest.
    """

    plan: Plan
    starts: Mapping[str, FloatArray]
    goals: Mapping[str, FloatArray]


# begins to plan a move; what it returns tells the plan once it is there, None before, and raises what it is refused for
Planner = Callable[[Move], Callable[[], PreparedPlan | None]]


class Step(Enum):
    """What is done now."""

    CLIMB = "climb"
    PLAN = "plan"
    FLY = "fly"
    RULES = "rules"


class Gathering:
    """Brings the drones of a plan to their places.

    Attributes:
        step: what is done now.
        found: the way that has been planned, for whoever flies it and calls `give_up` at its end.
        refused: who could not be sent by the rules when that was tried last, and why.
        told: why nothing was planned; empty if something was, or nothing had to be.
    """

    def __init__(
        self,
        plan: Plan,
        places: Mapping[int, FloatArray],
        yaws: Mapping[int, float],
        pilot: Pilot,
        planner: Planner | None,
    ) -> None:
        """Begin with nobody sent.

        Args:
            plan: whose drones they are.
            places: (3,) m, of each of them, by its number, in the order of the plan.
            yaws: rad, there.
            pilot: flies them.
            planner: plans how many move at once; None where nobody does.
        """
        self.refused: dict[int, str] = {}
        self.told = ""
        self.found: PreparedPlan | None = None
        self._plan, self._places, self._yaws, self._pilot, self._planner = plan, dict(places), yaws, pilot, planner
        self._tubes = {index: drone.tube.radius for index, drone in zip(places, plan.drones, strict=True)}
        self._sent = -math.inf  # s, when drones were sent last
        self._began = math.nan  # s, when they began to climb
        self._above: dict[int, FloatArray] = {}  # where those on the ground climb to, m
        self._poll: Callable[[], PreparedPlan | None] | None = None
        # how often each was told something, here or by others; and who was seen in flight
        self._orders, self._flown = {index: int(pilot.orders[index]) for index in places}, set[int]()
        self.step = Step.RULES if planner is None or len(self.missing()) < 2 else Step.CLIMB

    def missing(self) -> list[int]:
        """Return who does not rest inside its tube at its place."""
        return [index for index in self._places if not self._is_there(index)]

    def left(self) -> dict[int, str]:
        """Return who must not be sent to its place any more, and why."""
        found = {}
        for index in self._places:
            mode = Mode(self._pilot.mode[index])
            if mode is Mode.FLY:
                self._flown.add(index)
            if self._pilot.orders[index] != self._orders[index]:
                found[index] = "was told something else"
            elif self._pilot.is_landing(index):
                found[index] = "lands"
            elif mode in _DOWN and index in self._flown:
                found[index] = "has come down"
        return found

    def look(self, now: float, missing: list[int]) -> None:
        """Go on, once per tick.

        Args:
            now: s.
            missing: see there.
        """
        if self.step is Step.CLIMB:
            self._climb(now)
        elif self.step is Step.PLAN:
            self._look_at_plan()
        elif self.step is Step.RULES:
            self._send(now, {index: self._places[index] for index in missing})

    def give_up(self, why: str, held: Iterable[int] = ()) -> None:
        """Let the rules do the rest.

        Args:
            why: empty where the planned way has been flown to its end.
            held: who was told to hold meanwhile, as it could not follow that way.
        """
        self.step, self.told = Step.RULES, why
        self._orders |= {index: int(self._pilot.orders[index]) for index in held}

    def _climb(self, now: float) -> None:
        """Let those on the ground climb; once all stand still in the air let their way be planned."""
        if math.isnan(self._began):
            self._began = now
            low = [i for i in self._places if self._pilot.follows(i) is None or self._pilot.is_landing(i)]
            self._above = {index: self._pilot.places[index] + [0.0, 0.0, _CLIMB] for index in low}
        if all(self._pilot.is_at_rest(index) for index in self._places):
            starts = {index: np.asarray(self._pilot.destination(index)) for index in self._places}
            names = dict(zip(self._places, (drone.name for drone in self._plan.drones), strict=True))
            move = Move(
                self._plan, {names[index]: place for index, place in starts.items()},
                {names[index]: place for index, place in self._places.items()},
            )  # fmt: skip
            assert self._planner is not None
            try:
                self.step, self._poll = Step.PLAN, self._planner(move)
            except FlatsatError as error:
                self.give_up(str(error))
        elif now - self._began > _CLIMBING:
            self.give_up("not all could climb to where it begins")
        else:
            self._send(now, {index: place for index, place in self._above.items() if not self._pilot.is_at_rest(index)})

    def _look_at_plan(self) -> None:
        assert self._poll is not None
        try:
            self.found = self._poll()
        except FlatsatError as error:
            self.give_up(str(error))
        else:
            self.step = Step.PLAN if self.found is None else Step.FLY

    def _send(self, now: float, places: Mapping[int, FloatArray]) -> None:
        """Send drones to places, now and then: where one is refused, others may make room."""
        if now - self._sent < _AGAIN:
            return
        self._sent, self.refused = now, {}
        for index, place in places.items():
            goal, flies = self._pilot.destination(index), self._pilot.follows(index) is not None
            if self._pilot.traffic.is_waiting(index):
                continue
            if flies and goal is not None and float(np.abs(goal - place).max()) < _SAME:
                continue
            try:
                self._pilot.set_goal(index, place, self._yaws[index])
                self._orders[index] = int(self._pilot.orders[index])
            except FlatsatError as error:
                self.refused[index] = str(error)

    def _is_there(self, index: int) -> bool:
        place, follows = self._places[index], self._pilot.follows(index)
        if follows is None or not self._pilot.is_at_rest(index) or float(np.abs(follows.end - place).max()) > _THERE:
            return False
        return float(np.linalg.norm((self._pilot.places[index] - place) * IN_THE_AIR)) <= self._tubes[index]
