"""Drones of one controller keep out of each other's way: what is refused, what waits, and who yields.

- A goal too near to where another drone rests, stands, lands or goes is refused. If only the way there is not clear,
  the goal waits until it is (`flight.waiting`); until then the drone does as before, stays on the ground, or ends its
  landing.
- A take-off or a landing whose way is not clear is refused; drones on the move make room for one that lands. A
  trajectory that comes near another reference on the move is refused. Drones that rest in the way of one, and are not
  near yet, may still be given trajectories of their own: those of a swap come one after the other.
- A drone whose battery is empty, or whose controller ends, lands aside if another robot is below (`flight.landings`);
  without poses that is only told.
- References change by themselves, too, as when they wait for a drone to climb. So where two come too near soon, or
  drones are, somebody brakes (`flight.yielding`).

With `goal_mode: step` references jump, as in the paper: nothing is refused and nobody brakes, but it is told.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.landings import Landings
from flatsat_ros.flight.modes import AIRBORNE, Mode, Transition
from flatsat_ros.flight.neighbours import Conflict, Neighbours
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.separation import IN_THE_AIR, PreparedTrajectory
from flatsat_ros.flight.supervisor import Supervisor
from flatsat_ros.flight.tick import Report
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.flight.waiting import Waiting
from flatsat_ros.flight.yielding import SOON, Yielding

# between two looks at what waits, or may come near, s
_LOOK_PERIOD = 0.1


class Traffic:
    """Who goes where among N drones and M other robots, numbered from N on."""

    def __init__(
        self, policy: Policy, guidance: Guidance, supervisor: Supervisor, names: Sequence[str], others: Sequence[str]
    ) -> None:
        """Begin with nobody on the way.

        Args:
            policy: the figures.
            guidance: gives the drones their references.
            supervisor: knows the drones' modes.
            names: of the N drones, for people.
            others: of the M robots of which nothing but poses is known.
        """
        self._policy, self._guidance, self._supervisor = policy, guidance, supervisor
        self._neighbours = Neighbours(policy, guidance, supervisor, names, others)
        self._steps = policy.goal_mode is GoalMode.STEP
        self._alone = len(names) + len(others) < 2
        self._waiting = Waiting(guidance, supervisor, self._neighbours)
        self._landings = Landings(guidance, self._neighbours, policy.separation)
        self._yielding = Yielding(policy, guidance, self._neighbours, self._waiting)
        self._reports: list[Report] = []
        self._looked = self._due = -math.inf  # when to look again, s

    def note(self, now: float, state: FloatArray, usable: np.ndarray) -> None:
        """Take note of a tick.

        Args:
            now: s.
            state: (N, 6) m, m/s.
            usable: (N,) whose state is known.
        """
        there = self._neighbours
        there.now, there.state, there.usable = now, state, usable

    @property
    def is_due(self) -> bool:
        """Whether there is something to look at."""
        return not self._alone and (self._neighbours.now >= self._due or bool(self._guidance.changed))

    def set_clock_back(self) -> None:
        """Look again at once: the clock was set back."""
        self._looked = self._due = self._yielding.measures_at = -math.inf
        self._waiting.set_clock_back()

    def see(self, other: int, position: ArrayLike, now: float) -> None:
        """Take note of where the other robot `other`, from 0 on, is seen: (3,) m, at a time, s."""
        if np.isfinite(position).all():
            self._neighbours.seen[other], self._neighbours.seen_at[other] = position, now

    def reports(self) -> list[Report]:
        """Return what people should know since the last call."""
        reports, self._reports = self._reports, []
        for part in (self._yielding, self._waiting, self._landings):
            reports, part.reports = reports + part.reports, []
        return reports

    def admit_goal(self, index: int, position: ArrayLike, yaw: float) -> bool:
        """Give drone index a goal (3,), m, with a yaw, rad; tell whether it may set out now.

        Raises:
            FlatsatError: the goal is outside the box, or too near to where another drone will be.
        """
        goal = self._guidance.require_inside(position, "the goal")
        self._require_free(index, goal)
        conflicts = self._on_way(index, goal)
        self._number(index)
        if not conflicts:
            self._tell_who_leaves(index, goal)
            self._guidance.go_to(index, goal, yaw)
            return True
        self._yielding.wait(index, goal.copy(), yaw, conflicts[0])
        mode = self._neighbours.mode(index)
        if mode is Mode.FLY and self._guidance.landing[index]:
            self._guidance.brake(index, self._neighbours.now)
        if mode is not Mode.IDLE or not self._neighbours.is_high(index):
            return False
        self._guidance.stop(index)  # somebody let go of it in the air: it is held until its way is clear
        return True

    def lead_on(self, index: int, end: FloatArray) -> bool:
        """Lead drone index to the end (3,), m, of a trajectory that has gone on without it; tell whether it goes.

        Otherwise it waits for that where it is, or stays because somebody else goes there; near the ground it lands.
        """
        try:
            goes = self.admit_goal(index, end, float(self._guidance.references.yaw[index]))
            does = "it goes to the end of that" if goes else "it will go to the end of that"
        except FlatsatError as error:
            goes, does = False, f"it stays where it is: {error}"
        if not goes and self._yielding.is_low(index):
            self.withdraw(index)
            self._guidance.land(index, self._neighbours.now)
            does = "it is near the ground and its way is not clear: it lands"
        self._tell(index, f"its trajectory has gone on without it: {does}")
        return goes

    def admit_take_off(self, index: int, place: ArrayLike, yaw: float) -> None:
        """Give drone index a goal (3,), m, straight above it.

        Raises:
            FlatsatError: the goal is outside the box, or another drone is too near to it or to the way there.
        """
        goal = self._guidance.require_inside(place, "the goal")
        self._require_free(index, goal)
        self._require_clear(self._on_way(index, goal))
        self._number(index)
        self._guidance.go_to(index, goal, yaw)

    def admit_landing(self, index: int) -> None:
        """Let drone index land where it is; others on the move make room.

        Raises:
            FlatsatError: another drone rests, stands or lands there.
        """
        if self._neighbours.mode(index) is Mode.FLY and self._must_check():
            track = PreparedTrajectory(self._guidance.way(index, None, self._neighbours.now))
            self._require_clear([conflict for conflict in self._neighbours.conflicts(index, track) if conflict.rests])
        self.withdraw(index)

    def land(self, index: int) -> None:
        """Let drone index land, come what may: aside if another robot is below and it can."""
        self.withdraw(index)
        if self._neighbours.mode(index) is Mode.FLY and self._must_check():
            self._landings.land(index)
            self._due = -math.inf
        else:
            self._guidance.land(index, self._neighbours.now)

    def admit_trajectory(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index a trajectory.

        Raises:
            FlatsatError: it leaves the box or no margin inside the input set, or comes too near to another drone.
        """
        self._admit(index, trajectory, ())

    def _admit(self, index: int, trajectory: Trajectory, without: Collection[int]) -> None:
        if self._must_check():
            track, now = PreparedTrajectory(trajectory), self._neighbours.now
            conflicts = self._neighbours.conflicts(index, track, without=without)
            self._require_clear([conflict for conflict in conflicts if not conflict.rests])
            if conflicts:
                self._require_clear(self._neighbours.conflicts(index, track, now + SOON, without=without))
        self._guidance.follow(index, trajectory)
        self._number(index)

    def prove(self, pairs: Mapping[tuple[int, int], float]) -> None:
        """Take note of what the drones of a plan keep, m, by pair of numbers in order, instead of the last plan's."""
        self._neighbours.planned, self._neighbours.proved = {}, dict(pairs)

    def admit_planned(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index its part of a plan; it keeps apart from the plan's other drones by what is proved of them.

        Raises:
            FlatsatError: see `admit_trajectory`.
        """
        there = self._neighbours
        self._admit(index, trajectory, {i for pair in there.proved if index in pair for i in pair})
        there.planned[index] = trajectory

    def is_waiting(self, index: int) -> bool:
        """Tell whether a goal of drone index waits until the way is clear."""
        return index in self._waiting.goals

    def withdraw(self, index: int) -> None:
        """Let no goal of drone index wait any longer; landings and disarming do that by themselves."""
        self._waiting.withdraw(index)

    def follow(self, transitions: Sequence[Transition]) -> None:
        """Take note of changed modes: what waits for a drone that has come down is forgotten."""
        for index, before, after, _ in transitions:
            self._yielding.changed.add(index)
            if before in AIRBORNE and after not in AIRBORNE:
                self.withdraw(index)
            if after is Mode.DESCEND and not self._alone:
                found = self._landings.below(index, self._neighbours.state[index, :3])
                if found:
                    self._tell(index, f"{found} below, onto which it may sink: without its place it cannot go aside")

    def look(self) -> list[int]:
        """Look who may come near whom, and let drones brake; return whose goals need not wait any longer."""
        now, begun = self._neighbours.now, []
        self._yielding.changed |= self._neighbours.take_references()
        for text in self._neighbours.changes_of_sight(self._policy.pose_timeout):
            self._tell(0, text)
        if now >= self._yielding.measures_at:
            self._yielding.measure()
        if now >= self._looked and not self._steps:
            self._looked = now + _LOOK_PERIOD
            self._yielding.foresee()
            begun = self._waiting.look()
            self._landings.look()
        busy = not self._steps and (self._yielding.is_busy or self._waiting.goals or self._landings.aside)
        self._due = min(self._yielding.measures_at, self._looked) if busy else self._yielding.measures_at
        return begun

    def _must_check(self) -> bool:
        """Tell whether references are checked; take the newest if they are."""
        if self._alone or self._steps:
            return False
        self._yielding.changed |= self._neighbours.take_references()
        return True

    def _number(self, index: int) -> None:
        """Note that drone index has a new reference."""
        self.withdraw(index)
        self._yielding.number(index)
        self._due = -math.inf

    def _on_way(self, index: int, goal: FloatArray) -> list[Conflict]:
        """Return who is in the way of drone index to a goal (3,), m; nobody if its own place is not known."""
        there = self._neighbours
        known = there.mode(index) is Mode.FLY or there.usable[index]
        return there.conflicts(index, there.way(index, goal), lost=True) if self._must_check() and known else []

    def _require_free(self, index: int, goal: FloatArray) -> None:
        """Refuse a goal (3,), m, of drone index too near to where another one will be in the end.

        Raises:
            FlatsatError: names the other one and the distance.
        """
        if not self._must_check():
            return
        there = self._neighbours
        for other, name in enumerate(there.names):
            ends = [(end.place, end.scale, end.does) for end in there.ends(other)] if other != index else []
            if other != index and other in self._waiting.goals:
                ends.append((self._waiting.goals[other], IN_THE_AIR, "waits to go"))
            for place, scale, does in ends:
                if max(abs(goal[0] - place[0]), abs(goal[1] - place[1])) >= there.required:
                    continue
                apart = math.dist(goal * scale, place * scale)
                if apart < there.required:
                    raise refusal(f"distance of the goal from where {name} {does}", round(apart, 2), "m", there.valid)

    def _tell_who_leaves(self, index: int, goal: FloatArray) -> None:
        """Tell who is at the goal (3,), m, of drone index and leaves in time: what looks like an error may be one."""
        if not self._must_check():
            return
        there = self._neighbours
        apart = np.sqrt((((there.places() - goal) * IN_THE_AIR) ** 2).sum(axis=1))
        apart[index] = np.inf
        for other in map(int, np.flatnonzero(there.aloft() & (apart < there.required))):
            self._tell(index, f"its goal is near {there.names[other]}, {apart[other]:.2f} m, which leaves in time")

    def _require_clear(self, conflicts: Sequence[Conflict]) -> None:
        """Refuse a way with conflicts.

        Raises:
            FlatsatError: there is one; the text names the other one, the distance and the time.
        """
        if conflicts:
            other, distance, time, _ = conflicts[0]
            seconds = max(time - self._neighbours.now, 0.0)
            what = f"distance from {self._neighbours.names[other]} in {seconds:.1f} s"
            raise refusal(what, round(distance, 2), "m", self._neighbours.valid)

    def _tell(self, index: int, text: str) -> None:
        self._reports.append(Report(index, text))
        self._due = -math.inf
