"""A plan in flight: all its drones set out together, stand still together and go on together.

Their progress is one number, so what the plan proves about distances holds at any pace (`plans.pacing`). New references
are given a few per tick, ahead of the time from which they differ from the old ones, so that no tick takes longer for
many drones. A drone that no longer follows the plan, whatever the reason, makes the others stand still.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import Enum

import numpy as np

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.flight.battery import Charge
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.tick import Report
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.plans.gathering import Gathering, Planner, Step
from flatsat_ros.plans.pacing import braked, resumed
from flatsat_ros.plans.prepared import PreparedPlan

# number of new references that are given in one tick
_PER_TICK = 1
# s, from when the last of them is given to the time from which they differ from the old ones
_LEAD = 0.3
# s, for which all must have been at their places before they set out, and that they may take to get there
_SETTLED, PATIENCE = 0.5, 60.0
# s, between two checks who is inside its tube; s, after which a drone outside its tube makes all stand still
_LOOK_PERIOD, _OUTSIDE = 0.1, 0.5


class PlanPhase(Enum):
    """What is done with a plan; the value is what people are told."""

    READY = "ready"
    GATHERING = "gathering"
    FLYING = "flying"
    STOPPING = "stopping"
    PAUSED = "paused"
    FLOWN = "flown to its end"
    ABORTED = "aborted"


class Performance:
    """One plan, flown by a pilot.

    Attributes:
        plan: what is flown.
        phase: what is done now.
        held: who was told to hold, as it could not follow.
    """

    def __init__(
        self,
        prepared: PreparedPlan,
        pilot: Pilot,
        names: Sequence[str],
        planner: Planner | None = None,
        called: str = "the plan",
    ) -> None:
        """Bind a verified plan to the drones of a pilot.

        Args:
            prepared: what shall be flown.
            pilot: flies the drones.
            names: of the pilot's drones.
            planner: of the way to their places; without one the rules alone bring them there.
            called: so in what is told.

        Raises:
            FlatsatError: the plan is for drones that are not there, or for another input set.
        """
        plan = prepared.plan
        plan.require_made_for(pilot.certificate)
        for drone in plan.drones:
            if drone.name not in names:
                raise refusal(f"plan {plan.name!r}: drone", drone.name, "", f"one of {', '.join(names)}")
        self.plan, self.phase = plan, PlanPhase.READY
        self._pilot, self._names = pilot, list(names)
        self._indices = [self._names.index(drone.name) for drone in plan.drones]
        self._references = {index: prepared.references[self._names[index]] for index in self._indices}
        self._tubes = {self._names.index(drone.name): drone.tube.radius for drone in plan.drones}
        self._stopping, self._starting = prepared.stop, prepared.start  # s
        for index, reference in self._references.items():
            pilot.require_room(f"the reference of {self._names[index]}", reference)
        self.held: set[int] = set()
        self._given: dict[int, Trajectory] = {}  # the references that are flown
        self._pending: list[int] = []  # who still has to get one
        self._orders = np.zeros(0, dtype=int)  # see `Pilot`, of all drones, when all set out
        self._make: Callable[[int], Trajectory] | None = None  # makes them
        self._progress = 0.0  # s of the plan, where all stand still
        self._origin = 0.0  # s of the clock, when it was 0, in flight
        self._until = -math.inf  # s, when what is done now has ended
        self._settled = math.inf  # s, since when all are at their places
        self._planner, self._called = planner, called
        self._gathering: Gathering | None = None
        self._way: Performance | None = None  # to their places
        self._looked = -math.inf  # s, when drones were looked at last
        self._outside = math.inf  # s, since when a drone is outside its tube
        self._lands = False  # once all stand still
        self._reports: list[Report] = []

    @property
    def origin(self) -> float:
        """When the plan began, or would have begun if it had never been paused, on the pilot's clock, s; in flight."""
        return self._origin

    @property
    def is_busy(self) -> bool:
        """Whether drones follow the plan now."""
        return self.phase in (PlanPhase.GATHERING, PlanPhase.FLYING, PlanPhase.STOPPING, PlanPhase.PAUSED)

    def start(self, now: float) -> str:
        """Let all drones go to their first places and set out together once they are there; return what happens.

        Raises:
            FlatsatError: the plan is being flown, or a drone cannot fly; the text names it.
        """
        if self.is_busy:
            raise FlatsatError(f"the plan is {self.phase.value}: pause, resume or abort it")
        self._progress = 0.0
        return self._gather(now)

    def pause(self, now: float) -> str:
        """Let all drones slow down together, and stand still where they then are; return what happens.

        Raises:
            FlatsatError: the plan is not being flown.
        """
        if self.phase is not PlanPhase.FLYING:
            raise FlatsatError(f"the plan is {self.phase.value}: only one that is flown can be paused")
        self._stop(now)
        return f"all stand still in {self._until - now:.1f} s; their distances stay proved"

    def resume(self, now: float) -> str:
        """Let all drones go on together from where they stand still; return what happens.

        Raises:
            FlatsatError: the plan is not paused, or a drone cannot fly; the text names it.
        """
        if self.phase is not PlanPhase.PAUSED:
            raise FlatsatError(f"the plan is {self.phase.value}: only one that is paused can be resumed")
        return self._gather(now)

    def abort(self, now: float) -> str:
        """Let all drones stand still together, then land where they are; return what happens.

        Raises:
            FlatsatError: the plan is not being flown.
        """
        if not self.is_busy:
            raise FlatsatError(f"the plan is {self.phase.value}: only one that is flown can be aborted")
        if self.phase is PlanPhase.FLYING:
            self._stop(now)
        self._lands = True
        if self.phase is PlanPhase.STOPPING:
            seconds = f"in {max(self._until - now, 0.0):.1f} s"
            return f"all stand still {seconds}, their distances proved until then; they land by the rules of separation"
        self._land()
        return "all land where they are, by the rules of separation: the plan proves nothing any more"

    def look(self, now: float) -> list[Report]:
        """Go on with what is done, once per tick before the pilot's; return what people should know."""
        if self.phase is PlanPhase.GATHERING:
            self._look_who_is_there(now)
        elif self.phase in (PlanPhase.FLYING, PlanPhase.STOPPING):
            self._hand_out(now)
            self._look_who_follows(now)
        if now >= self._until and not self._pending:
            if self.phase is PlanPhase.FLYING:
                self.phase = PlanPhase.FLOWN
                self._tell("the plan has been flown to its end: all hold their last places")
            elif self.phase is PlanPhase.STOPPING:
                self._rest()
        reports, self._reports = self._reports, []
        return reports

    def _gather(self, now: float) -> str:
        """Send all drones to where the plan stands."""
        faults = []
        for index in self._indices:
            try:
                self._pilot.require_ready(index)
                if self._pilot.batteries.charges[index] in (Charge.LOW, Charge.EMPTY):
                    raise FlatsatError("its battery is low: it must be charged")
            except FlatsatError as error:
                faults.append(f"{self._names[index]}: {error}")
        if faults:
            raise FlatsatError("; ".join(faults))
        places = {index: self._references[index].sample(self._progress)[:3] for index in self._indices}
        yaws = {index: self._references[index].yaw for index in self._indices}
        gathering = self._gathering = Gathering(self.plan, places, yaws, self._pilot, self._planner)
        self._way = None
        self.phase, self._until, self._settled = PlanPhase.GATHERING, now + PATIENCE, math.inf
        self._lands = False
        away = gathering.missing()
        gathering.look(now, away)
        if not away:
            return f"all {len(self._indices)} drones are at their places and set out"
        return "first " + ", ".join(self._names[index] for index in away) + " go to their places; then all set out"

    def _look_who_is_there(self, now: float) -> None:
        """Let all set out once all have been at their places for a moment; give up after a minute."""
        assert self._gathering is not None
        if self._gathering.step is Step.FLY:
            self._look_at_way(now, self._gathering)
            return
        if left := self._gathering.left():
            why = ", ".join(f"{self._names[index]} {does}" for index, does in left.items())
            self._give_up(f"{why}: the others hold where they are led to")
            return
        if self._gathering.told:
            self._tell(f"no way for all to their places is planned: {self._gathering.told}; each goes there alone")
            self._gathering.told = ""
        missing = self._gathering.missing()
        self._settled = min(self._settled, now) if not missing else math.inf
        if now - self._settled >= _SETTLED:
            self._set_out(now)
        elif now >= self._until:
            reasons = (f"{self._names[i]} ({self._gathering.refused.get(i, 'not within its tube')})" for i in missing)
            self._give_up(f"after {PATIENCE:g} s not at their places: {', '.join(reasons)}; all hold")
        else:
            self._gathering.look(now, missing)

    def _give_up(self, why: str) -> None:
        self._tell(f"{self._called} does not begin: {why}")
        self.phase = PlanPhase.ABORTED if self._progress == 0.0 else PlanPhase.PAUSED

    def _look_at_way(self, now: float, gathering: Gathering) -> None:
        """Let all go to their places as has been planned."""
        try:
            if self._way is None:
                assert gathering.found is not None
                self._way = Performance(gathering.found, self._pilot, self._names, called="the way to the places")
                self._way.start(now)
                self._tell(f"all go to their places by a plan of {gathering.found.plan.duration:.1f} s")
        except FlatsatError as error:
            gathering.give_up(str(error))
            return
        self._reports += [report for report in self._way.look(now) if self._way.phase is not PlanPhase.FLOWN]
        if not self._way.is_busy or self._way.phase is PlanPhase.PAUSED:
            flown = self._way.phase is PlanPhase.FLOWN
            gathering.give_up("" if flown else "they did not fly it to its end", self._way.held)
            self._until = now + PATIENCE

    def _set_out(self, now: float) -> None:
        """Let all go on from where they stand, at one time."""
        begin = self._begin(now)
        if self._progress == 0.0:  # a plan begins at rest
            origin = begin
            self._make = lambda index: self._references[index].shifted(origin)
        else:
            progress = self._progress
            origin = begin + self._starting / 2.0 - progress
            self._make = lambda index: resumed(self._references[index], progress, begin, self._starting)
        self._pilot.traffic.prove(self._kept())
        self._outside = math.inf
        self._given.clear()
        self._orders = self._pilot.orders.copy()
        self.phase, self._origin, self._until = PlanPhase.FLYING, origin, origin + self.plan.duration
        self._tell(f"{self._called} is flown from {begin - now:.3f} s on: all set out together")

    def _stop(self, now: float) -> None:
        """Let all slow down, from one time on, and stand still."""
        begin, origin, before = self._begin(now), self._origin, dict(self._given)

        def make(index: int) -> Trajectory:
            flown = before.get(index)
            return braked(self._references[index].shifted(origin) if flown is None else flown, begin, self._stopping)

        self._make = make
        self.phase, self._until = PlanPhase.STOPPING, begin + self._stopping
        self._progress = float(np.clip(begin + self._stopping / 2.0 - origin, 0.0, self.plan.duration))

    def _begin(self, now: float) -> float:
        """Let all get new references; return from when on they differ from the old ones, s."""
        self._pending = [index for index in self._indices if self._pilot.follows(index) is not None]
        ticks = math.ceil(len(self._pending) / _PER_TICK)
        return now + _LEAD + ticks * self._pilot.certificate.period

    def _hand_out(self, now: float) -> None:
        """Give some drones the references that are due."""
        for index in self._pending[:_PER_TICK]:
            self._pending.remove(index)
            left = index in self._given and self._pilot.follows(index) is not self._given[index]
            if self._make is None or left or self._pilot.orders[index] != self._orders[index]:
                continue
            trajectory = self._make(index)
            try:
                self._pilot.set_planned(index, trajectory)
                self._given[index] = trajectory
            except FlatsatError as error:
                self._tell(f"{self._names[index]} cannot follow {self._called}: {error}; it holds", index)
                self._pilot.hold(index)
                self.held.add(index)

    def _look_who_follows(self, now: float) -> None:
        """Let the others stand still if a drone does not follow the plan."""
        flown = {index: self._pilot.follows(index) for index in self._indices if index not in self._pending}
        left = [index for index, way in flown.items() if way is None or way is not self._given.get(index)]
        if self.phase is not PlanPhase.FLYING:
            return
        outside = [] if left or now - self._looked < _LOOK_PERIOD else self._who_is_outside(now)
        if left:
            why = ", ".join(self._names[index] for index in left)
            self._stop(now)
            do = f"{'does' if len(left) == 1 else 'do'} not follow {self._called} any more"
            self._tell(f"{why} {do}: the others stand still in {self._until - now:.1f} s")
        elif outside and now - self._outside >= _OUTSIDE:
            why = ", ".join(self._names[index] for index in outside)
            self._stop(now)
            where = "is outside its tube" if len(outside) == 1 else "are outside their tubes"
            self._tell(f"{why} {where}: all stand still in {self._until - now:.1f} s", outside[0])

    def _who_is_outside(self, now: float) -> list[int]:
        """Return who is outside its tube, and note since when somebody is."""
        self._looked, outside = now, []
        for index, given in self._given.items():
            apart = (self._pilot.places[index] - given.sample(now)[:3]) / (1.0, 1.0, self.plan.downwash)
            if not float(np.linalg.norm(apart)) <= self._tubes[index]:
                outside.append(index)
        self._outside = min(self._outside, now) if outside else math.inf
        return outside

    def _rest(self) -> None:
        if self._lands:
            self._land()
            return
        self.phase = PlanPhase.PAUSED
        self._tell(f"{self._called} is paused: all stand still")

    def _land(self) -> None:
        self.phase, self._pending = PlanPhase.ABORTED, []
        for index in self._indices:
            self._pilot.call_off(index)
            if self._pilot.follows(index) is not None:
                try:
                    self._pilot.land(index)
                except FlatsatError as error:
                    self._tell(f"{self._names[index]} does not land: {error}", index)
        self._tell("the plan is aborted: all land where they are")

    def _kept(self) -> dict[tuple[int, int], float]:
        """Return what measured distances the plan proves, m, for drones that are inside their tubes."""
        kept = {}
        for pair in self.plan.pairs:
            first, second = self._names.index(pair.first), self._names.index(pair.second)
            distance = pair.distance * 1e-4 - self._tubes[first] - self._tubes[second]
            kept[min(first, second), max(first, second)] = distance
        return kept

    def _tell(self, text: str, index: int | None = None) -> None:
        self._reports.append(Report(self._indices[0] if index is None else index, text))
