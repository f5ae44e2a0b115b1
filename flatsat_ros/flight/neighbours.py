"""Where N drones and M other robots are from now on, and who would come too near to whom.

A drone in FLY follows its reference; everybody else is taken to stay where it was measured last.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.modes import AIRBORNE, STANDING_HEIGHT, Mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.separation import (
    DOWNWASH,
    IN_THE_AIR,
    STANDING,
    TOLERANCE,
    PreparedTrajectory,
    closest_approaches,
)
from flatsat_ros.flight.supervisor import Supervisor
from flatsat_ros.flight.trajectory import Trajectory

# references are this much farther apart than drones must be, m: drones are not exactly on theirs
_ALLOWANCE = 0.05
_AIRBORNE = np.array([mode in AIRBORNE for mode in Mode])  # of each mode


class Conflict(NamedTuple):
    """Someone who comes too near: who, how near, m, when, s, and whether that one stays where it is."""

    other: int
    distance: float
    time: float
    rests: bool


class Presence(NamedTuple):
    """Where a robot is from now on, how distances from it count, (3,), and whether it stays there."""

    track: PreparedTrajectory
    scale: FloatArray
    rests: bool


class EndPlace(NamedTuple):
    """A place (3,), m, where a robot will stay or may, how distances from it count, (3,), and what it does there."""

    place: FloatArray
    scale: FloatArray
    does: str


class Neighbours:
    """N drones of this controller, and M other robots, numbered from N on, of which nothing but poses is known.

    Attributes:
        names: of all, for people.
        count: N.
        required: least distance of references, m.
        now: s, of the last tick, as are the next two.
        state: (N, 6) m, m/s.
        usable: (N,) whose state is known.
        seen: (M, 3) where the others were seen last, m; NaN if they never were.
        seen_at: (M,) when, s.
        planned: the references of drones that fly a plan, by number.
        proved: by pair of numbers, in order, what the drones of that plan keep, m, if both follow it.
    """

    def __init__(
        self, policy: Policy, guidance: Guidance, supervisor: Supervisor, names: Sequence[str], others: Sequence[str]
    ) -> None:
        """Begin with nobody known; see `Traffic`."""
        self.names, self.count = [*names, *others], len(names)
        self.required = policy.separation + _ALLOWANCE
        self.now = -math.inf
        self.state, self.usable = np.zeros((self.count, 6)), np.zeros(self.count, dtype=bool)
        self.seen, self.seen_at = np.full((len(others), 3), np.nan), np.full(len(others), math.inf)
        self.planned: dict[int, Trajectory] = {}
        self.proved: dict[tuple[int, int], float] = {}
        self._unseen = np.zeros(len(others), dtype=bool)  # who has not been seen for too long, and was told
        self._standing = policy.floor + STANDING_HEIGHT
        self._guidance, self._supervisor = guidance, supervisor
        self._tracks: list[PreparedTrajectory | None] = [None] * self.count
        self._low, self._high = np.full((2, self.count, 3), np.nan)  # boxes around the tracks

    @property
    def valid(self) -> str:
        """Which distances are, for people."""
        return f"at least {self.required:g} m, {DOWNWASH:g} times that vertically"

    def kept(self, one: int, other: int) -> float | None:
        """Return the distance, m, that the plan which two drones follow proves them to keep; None without one."""
        distance = self.proved.get((min(one, other), max(one, other)))
        if distance is None or not (self._follows_plan(one) and self._follows_plan(other)):
            return None
        return distance

    def _follows_plan(self, index: int) -> bool:
        planned = self.planned.get(index)
        follows = planned is not None and self._guidance.references.trajectory(index) is planned
        return follows and self.mode(index) is Mode.FLY

    def take_references(self) -> set[int]:
        """Take the references that have changed; return whose."""
        if not self._guidance.changed:
            return set()
        changed = set(self._guidance.changed)
        self._guidance.changed.clear()
        for index in changed:
            trajectory = self._guidance.references.trajectory(index)
            if trajectory is not None:
                self._tracks[index] = track = PreparedTrajectory(trajectory)
                self._low[index], self._high[index] = track.low.min(axis=0), track.high.max(axis=0)
        return changed

    def changes_of_sight(self, timeout: float) -> list[str]:
        """Return for people which others have not been seen for longer than a timeout, s, or are seen again."""
        if not self.seen.size:
            return []
        unseen = self.now - self.seen_at > timeout
        changed, self._unseen = np.flatnonzero(unseen != self._unseen), unseen
        lost = f"for {timeout:g} s: it is taken to be where it was last"
        names = [self.names[self.count + other] for other in changed]
        return [
            f"no pose of {name} {lost}" if unseen[other] else f"poses of {name} are back"
            for other, name in zip(changed, names, strict=True)
        ]

    def mode(self, index: int) -> Mode:
        """Return the mode of a robot, IDLE for others: somebody else flies it, or nobody."""
        return Mode(self._supervisor.mode[index]) if index < self.count else Mode.IDLE

    def places(self) -> FloatArray:
        """Return where everybody was measured last, (N + M, 3) m, NaN for unknown."""
        own = self.state[:, :3].copy()
        if np.count_nonzero(self.usable) < self.count:
            own = np.where(self.usable[:, np.newaxis], own, np.nan)
        return np.concatenate([own, self.seen]) if self.seen.size else own

    def place(self, index: int) -> FloatArray:
        """Return where a robot was measured last, (3,) m, NaN for unknown."""
        if index >= self.count:
            return np.asarray(self.seen[index - self.count])
        return self.state[index, :3] if self.usable[index] else np.full(3, np.nan)

    def aloft(self) -> np.ndarray:
        """Tell who is in the air, (N + M,): by the mode and well above its ground, others by their height."""
        high = self.state[:, 2] - self._guidance.ground >= STANDING_HEIGHT
        own = np.asarray(_AIRBORNE[self._supervisor.mode] & self.usable & high)
        return np.concatenate([own, self.seen[:, 2] >= self._standing]) if self.seen.size else own

    def is_high(self, index: int) -> bool:
        """Tell whether a robot is measured so high that it does not stand."""
        return bool(self.place(index)[2] >= self._standing)

    def _lost(self) -> np.ndarray:
        """Tell which drones are in the air without being seen, (N,): they are taken to be where they were last."""
        return np.asarray(self._supervisor.level & ~self.usable)

    def presence(self, index: int, *, lost: bool = False) -> Presence | None:
        """Return where a robot is from now on; None if nothing is known of it.

        Args:
            index: which.
            lost: a drone in the air that is not seen is taken to be where it was last.
        """
        mode = self.mode(index)
        track = self._tracks[index] if mode is Mode.FLY else None
        if track is not None:
            return Presence(track, IN_THE_AIR, bool(self._guidance.references.at_rest[index]))
        place = self.state[index, :3] if lost and index < self.count and self._lost()[index] else self.place(index)
        if np.isnan(place).any():
            return None
        in_the_air = mode in AIRBORNE or bool(place[2] >= self._standing)
        return Presence(PreparedTrajectory(Trajectory.hold(place)), IN_THE_AIR if in_the_air else STANDING, True)

    def way(self, index: int, goal: FloatArray | None) -> PreparedTrajectory:
        """Return the way of drone index from now on to a goal (3,), m; None to land where it is."""
        state = None if self.mode(index) is Mode.FLY else self.state[index]
        return PreparedTrajectory(self._guidance.way(index, goal, self.now, state))

    def describe(self, conflict: Conflict) -> str:
        """Return a conflict in words."""
        seconds = max(conflict.time - self.now, 0.0)
        name = self.names[conflict.other]
        return f"it would be {conflict.distance:.2f} m from {name} in {seconds:.1f} s, must be {self.valid}"

    def conflicts(
        self,
        index: int,
        track: PreparedTrajectory,
        until: float = math.inf,
        scale: FloatArray = IN_THE_AIR,
        instead: Mapping[int, PreparedTrajectory] | None = None,
        without: Collection[int] = (),
        *,
        lost: bool = False,
    ) -> list[Conflict]:
        """Return who would come too near to robot index on a track, the first at first.

        Those that are too near already count only where they come nearer still.

        Args:
            index: which robot.
            track: where it would be.
            until: s, until when.
            scale: how distances from it count.
            instead: where some of the others would be instead.
            without: who does not count.
            lost: drones in the air that are not seen count, too.
        """
        found = [
            (other, there)
            for other, there in self._candidates(index, track, instead or {}, lost)
            if other not in without and (scale * there.scale < 1.0).any()
        ]
        if not found or not math.isfinite(self.now):  # before the first tick nobody flies
            return []
        tracks = [there.track for _, there in found]
        scales = np.array([np.maximum(scale, there.scale) for _, there in found])
        apart = (track.at(self.now) - np.array([theirs.at(self.now) for theirs in tracks])) * scales
        least = np.minimum(self.required, np.sqrt((apart * apart).sum(axis=1)) - 2.0 * TOLERANCE)
        distance, time = closest_approaches(track, tracks, scales, least + TOLERANCE, self.now, until)
        conflicts = [
            # who has come to the end of its track by then rests, too
            Conflict(other, float(distance[i]), float(time[i]), there.rests or bool(time[i] >= there.track.times[-1]))
            for i, (other, there) in enumerate(found)
            if distance[i] < least[i]
        ]
        return sorted(conflicts, key=lambda conflict: conflict.time)

    def _candidates(
        self, index: int, track: PreparedTrajectory, instead: Mapping[int, PreparedTrajectory], lost: bool
    ) -> Iterator[tuple[int, Presence]]:
        """Yield those whose surroundings touch those of a track, and all that would be elsewhere."""
        places = self.places()
        if lost:
            places[: self.count][self._lost()] = self.state[self._lost(), :3]
        low, high = places, places.copy()
        flying = np.flatnonzero((self._supervisor.mode == Mode.FLY.value) & ~np.isnan(self._low[:, 0]))
        low[flying], high[flying] = self._low[flying], self._high[flying]
        gap = np.maximum(track.low.min(axis=0) - high, low - track.high.max(axis=0))
        near = ((np.maximum(gap, 0.0) * IN_THE_AIR) ** 2).sum(axis=1) < self.required**2  # unknown places are not
        for other in map(int, np.flatnonzero(near)):
            elsewhere = other == index or other in instead or self.kept(index, other) is not None
            there = None if elsewhere else self.presence(other, lost=lost)
            if there is not None:
                yield other, there
        yield from ((other, Presence(theirs, IN_THE_AIR, False)) for other, theirs in instead.items() if other != index)

    def ends(self, index: int) -> list[EndPlace]:
        """Return where a robot will stay, or may."""
        mode, own = self.mode(index), index < self.count
        track = self._tracks[index] if mode is Mode.FLY else None
        if track is not None and self._guidance.landing[index]:
            return [EndPlace(np.array([*track.end[:2], self._guidance.ground[index]]), STANDING, "lands")]
        if track is not None:
            return [EndPlace(track.end, IN_THE_AIR, "rests" if self._guidance.references.at_rest[index] else "goes")]
        ends = []
        goal = self._guidance.goal(index) if own and self._supervisor.requested[index] else None
        if goal is not None and mode not in AIRBORNE:
            ends.append(EndPlace(goal, IN_THE_AIR, "goes"))
        if own and self._lost()[index]:
            return [*ends, EndPlace(self.state[index, :3], IN_THE_AIR, "was seen last")]
        place = self.place(index)
        in_the_air = mode in AIRBORNE or bool(place[2] >= self._standing)
        if np.isnan(place).any() or (in_the_air and own and mode is Mode.IDLE):
            return ends  # somebody else flies it, who knows where
        return [*ends, EndPlace(place, IN_THE_AIR if in_the_air else STANDING, "rests" if in_the_air else "stands")]
