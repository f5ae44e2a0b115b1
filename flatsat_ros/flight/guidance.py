"""What each drone shall follow: given trajectories, or paths to goals that begin where the reference is.

A goal becomes a path to rest (`flight.path`) from the present motion of the reference, so that the error stays small
for any distance. Braking, landing and taking off are paths as well. While a drone hangs below its reference with its
thrust at the limit, or is still near the ground, the horizontal part of its path stands still: the thrust is then
wanted for the lift alone. Only the reference changes, never the saturation of the law.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, any_of, finite_array
from flatsat_ros.base.errors import refusal
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.flight.path import path_to
from flatsat_ros.flight.path_limits import PathLimits, ReferenceBox
from flatsat_ros.flight.preview import needed_margin
from flatsat_ros.flight.references import References
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet

# a landing reference sinks at most this fast, m/s, to this depth, m, below the ground
_LANDING_SPEED = 0.4
_LANDING_DEPTH = 2.0
# below this height over its ground, m, a drone whose goal is above it only climbs
NEAR_GROUND = 0.2
# there, one that is no faster than this, m/s, stands
_STANDING_SPEED = 0.1
# a goal is above it by more than the first, m, and then until by less than the second; below the third height, m,
# a drone may touch the ground, and goes nowhere
_ABOVE = 0.05
_ABOVE_NO_MORE = 0.02
_TOUCHES = 0.05
# a drone that is seen so far, m, below the ground on which it stood has left that
_LEFT = 0.05
# one whose reference sinks below this, m above the ground, brakes as hard as may be: to the limits of a flight
# certificate it would come to rest below the ground
_BRAKES_FROM = 0.4
# a drone hangs below its reference from this error on, m, until it is below the second
_HANGS = 0.10
_HANGS_NO_MORE = 0.05
# a drone this far, m, from where its trajectory is cannot follow it
_FAR = 0.5
# One that was not steered for a moment, and is this near, m, to where its path within what its certificate assumes is
# by now, goes on with it: set out anew again and again, where poses come rarely, it would not come to rest for long.
_BESIDE = 0.2
# a drone this far outside the box, m, has left it
_TOLERATED = 0.3
# the reference of a drone that lands and cannot follow is this near to it, m: enough to hold against the wind
_GIVES_WAY = 0.5
# a drone that sets out in motion, faster than this, m/s, or after it was not steered, is led by what the input set
# allows: nothing is proved of such a beginning, and it shall soon be where it was
_SETS_OUT = 0.1
_BRAKE = np.full(3, np.nan)


class Guidance:
    """The references of N drones.

    Attributes:
        references: what is followed.
        landing: (N,) who sinks until something carries it.
        ground: (N,) height on which each drone stood last, m.
        changed: who got a new reference since somebody emptied this.
        waits: (N,) the horizontal part of whose path stands still.
    """

    def __init__(
        self, limits: InputSet, speed: float, box: ReferenceBox, count: int, flight: FlightSection | None = None
    ) -> None:
        """Begin without references.

        Args:
            limits: V_c.
            speed: largest speed of paths, m/s.
            box: room for goals, trajectories and paths.
            count: N.
            flight: what is assumed of references, if anything; paths keep it.
        """
        self.references = References(count, float(limits.margin(np.zeros(3))))
        self.landing = np.zeros(count, dtype=bool)
        self.ground = np.full(count, float(box.low[2]))
        self.changed: set[int] = set()
        self._limits = limits
        self._flight = flight
        self._widest = PathLimits.within(limits, speed)
        self._path_limits = self._widest if flight is None else PathLimits.assumed(limits, speed, flight)
        self._box = box
        # what is below the floor stands on something
        self._lowest = np.tile([*box.low[:2] - _TOLERATED, -math.inf], (count, 1))
        self._highest = np.tile(box.high + _TOLERATED, (count, 1))
        self._goals: list[FloatArray | None] = [None] * count  # of those that follow paths; NaN where they brake
        self.waits = np.zeros(count, dtype=bool)

    def require_inside(self, place: ArrayLike, what: str) -> FloatArray:
        """Return a place (3,), m, refusing one outside the box.

        Raises:
            FlatsatError: it is not finite or outside; the text names the side.
        """
        point = finite_array(what, place, 3)
        for axis, name in enumerate("xyz"):
            low, high = float(self._box.low[axis]), float(self._box.high[axis])
            if not low <= point[axis] <= high:
                raise refusal(f"{name} of {what}", float(point[axis]), "m", f"in the box, from {low:g} to {high:g} m")
        return point

    def follow(self, index: int, trajectory: Trajectory) -> None:
        """Let drone index follow a trajectory.

        Raises:
            FlatsatError: it leaves the box or no margin inside the input set.
        """
        low, high = trajectory.bounds()
        self.require_inside(low, "the trajectory")
        self.require_inside(high, "the trajectory")
        self._assign(index, trajectory)
        self._goals[index] = None

    def require_near(self, index: int, trajectory: Trajectory, now: float) -> None:
        """Refuse a trajectory that drone index, in flight, would have to jump to.

        Raises:
            FlatsatError: it is too far from the present reference; the text says how far.
        """
        away = float(np.linalg.norm(trajectory.sample(now)[:3] - self.references.motion(index, now)[0]))
        if away > _FAR:
            raise refusal(
                "distance of the trajectory from where the drone is led now",
                round(away, 3),
                "m",
                f"at most {_FAR} m: send its first point as a goal before",
            )

    def go_to(self, index: int, goal: ArrayLike, yaw: float) -> None:
        """Give drone index a goal (3,), m; its path is made by `start`, or at once by `replan`.

        Raises:
            FlatsatError: the goal is not finite or outside the box.
        """
        self._goals[index] = self.require_inside(goal, "the goal").copy()
        self.references.yaw[index] = yaw
        self.landing[index] = False

    def goal(self, index: int) -> FloatArray | None:
        """Return the goal (3,), m, of drone index; None if it has none: it brakes, lands or follows a trajectory."""
        goal = self._goals[index]
        return None if goal is None or np.isnan(goal).any() or self.landing[index] else goal

    def destination(self, index: int) -> FloatArray | None:
        """Return where drone index is led in the end, (3,) m: its goal, or the end of its trajectory; else None."""
        trajectory = self.references.trajectory(index)
        return trajectory.end if self._goals[index] is None and trajectory is not None else self.goal(index)

    def way(self, index: int, goal: FloatArray | None, now: float, state: FloatArray | None = None) -> Trajectory:
        """Return the path on which drone index would go to a goal.

        Args:
            index: which drone.
            goal: (3,) m; None to land where it is.
            now: s.
            state: (6,) m, m/s, of a drone that sets out from there and not from where its reference is.
        """
        motion = self.references.motion(index, now)
        if state is not None:
            motion = self._motion(index, state)
        landing = goal is None
        return self._path(index, motion, self._below(index, motion) if goal is None else goal, now, landing=landing)

    def brake(self, index: int, now: float) -> bool:
        """Let the reference of drone index come to rest as soon as it can, and stay there.

        Returns:
            Whether that is in the air; it lands where the ground would carry it.
        """
        self.stop(index)
        self.replan(index, now)
        goal = self.goal(index)
        if goal is None or goal[2] - self.ground[index] >= _TOUCHES:
            return True
        self.land(index, now)
        return False

    def stop(self, index: int) -> None:
        """Let drone index stay where its flight begins."""
        self._goals[index] = _BRAKE.copy()
        self.landing[index] = False

    def land(self, index: int, now: float, place: FloatArray | None = None) -> None:
        """Let the reference of drone index brake and sink below the ground, until something carries the drone.

        Args:
            index: which drone.
            now: s.
            place: (3,) where the drone is, m, if it cannot follow: its reference gives way to within half a metre, and
                stands over it near the ground.
        """
        motion = self.references.motion(index, now)
        if place is not None:
            away = motion[0, :2] - place[:2]
            kept = 0.0 if place[2] - self.ground[index] < NEAR_GROUND else _GIVES_WAY
            motion[0, :2] = place[:2] + away * min(1.0, kept / max(float(np.hypot(*away)), _GIVES_WAY))
        self._goals[index] = self._below(index, motion)
        self.landing[index] = True
        self._plan(index, motion, now)

    def _below(self, index: int, motion: FloatArray) -> FloatArray:
        """Return the goal (3,), m, of a landing from a motion (4, 3): somewhere below the ground."""
        return np.array([math.nan, math.nan, min(float(self.ground[index]), float(motion[0, 2])) - _LANDING_DEPTH])

    def start(self, index: int, state: FloatArray, now: float, *, resumed: bool = False) -> float:
        """Let drone index, whose flight begins or goes on, set out from where it is.

        Args:
            index: which drone.
            state: (6,) its position, m, and velocity, m/s.
            now: s.
            resumed: its flight goes on after it was not steered.

        Returns:
            How far away its trajectory is, m, if it is too far to be followed: then it brakes; else 0.
        """
        motion = self._motion(index, state)
        motion[1] /= max(float(np.linalg.norm(motion[1])) / self._path_limits.speed, 1.0)
        urgent = resumed or float(np.abs(motion[1]).max()) > _SETS_OUT
        away = float(np.linalg.norm(self.references.motion(index, now)[0] - state[:3]))
        if resumed and self._flight is not None and away <= _BESIDE:
            return 0.0
        if self._goals[index] is None:
            if away <= _FAR:
                return 0.0
            self._goals[index] = _BRAKE.copy()
            self._plan(index, motion, now, urgent=urgent)
            return away
        # a drone near the ground only climbs; a goal that is where it comes to rest is found on the whole way
        if self.goal(index) is not None:
            self.waits[index] = state[2] - self.ground[index] < NEAR_GROUND
        self._plan(index, motion, now, urgent=urgent)
        return 0.0

    def _motion(self, index: int, state: FloatArray) -> FloatArray:
        """Return the motion (4, 3) of drone index with a state (6,); the speed of one that stands is noise."""
        motion = np.zeros((4, 3))
        motion[0] = state[:3]
        if state[2] - self.ground[index] >= NEAR_GROUND or np.abs(state[3:]).max() > _STANDING_SPEED:
            motion[1] = state[3:]
        return motion

    def replan(self, index: int, now: float) -> None:
        """Lead the reference of drone index from its present motion to its goal."""
        if self._goals[index] is not None:
            motion = self.references.motion(index, now)
            low = motion[0, 2] - self.ground[index] < _BRAKES_FROM
            self._plan(index, motion, now, urgent=bool(low and motion[1, 2] < 0.0))

    def is_down(self, index: int, state: FloatArray, now: float) -> bool:
        """Tell whether drone index, with a state (6,), m, m/s, and its reference are where the ground may carry it."""
        height = max(float(state[2]), float(self.references.motion(index, now)[0, 2]))
        return height - float(self.ground[index]) < _TOUCHES

    def outside(self, state: FloatArray) -> list[tuple[int, str]]:
        """Return which drones that do not land have left the box, and by which side.

        Args:
            state: (N, 6) m, m/s.
        """
        place = state[:, :3].copy()  # faster than a view
        low, high = place < self._lowest, place > self._highest
        if not (any_of(low) or any_of(high)):
            return []
        found = []
        for index, axis in np.argwhere((low | high) & ~self.landing[:, np.newaxis]):
            side = float((self._box.low if low[index, axis] else self._box.high)[axis])
            name, sign = "xyz"[axis], "<" if low[index, axis] else ">"
            found.append((int(index), f"it has left the box, {name} = {state[index, axis]:.2f} {sign} {side:g} m"))
        return found

    def near_ground(self, state: FloatArray) -> np.ndarray:
        """Tell who is near the ground on which it stood last, (N,); state is (N, 6), m, m/s."""
        return np.asarray(state[:, 2] - self.ground < NEAR_GROUND)

    def update(
        self, now: float, state: FloatArray, reference: FloatArray, flying: np.ndarray, full: np.ndarray
    ) -> None:
        """Let horizontal references stand still, or go on, as the drones hang below theirs or are near the ground.

        Args:
            now: s.
            state: (N, 6) m, m/s.
            reference: (N, 9).
            flying: (N,) who is steered.
            full: (N,) whose thrust was at its limit at the last tick.
        """
        low = self.near_ground(state)
        if not (any_of(low) or any_of(full) or any_of(self.waits)):
            return
        for index in map(int, np.flatnonzero(low & flying & ~self.landing)):
            if state[index, 2] < self.ground[index] - _LEFT:
                self.ground[index] = min(float(self.ground[index]), float(self._box.low[2]))
            low[index] = self._only_climbs(index, float(state[index, 2]))
        error = reference[:, 2] - state[:, 2]
        hangs = np.where(self.waits, error > _HANGS_NO_MORE, (error > _HANGS) & full)
        wait = flying & ~self.landing & (low | hangs)
        changed = (wait != self.waits) & flying
        if not any_of(changed):
            return
        for index in map(int, np.flatnonzero(changed)):
            self.waits[index] = wait[index]
            self.replan(index, now)

    def _only_climbs(self, index: int, height: float) -> bool:
        """Tell whether drone index, near the ground at a height, m, is to climb before it goes anywhere."""
        above, goal = height - float(self.ground[index]), self._goals[index]
        if goal is None or np.isnan(goal[2]) or above < _TOUCHES:
            return above < NEAR_GROUND
        needed = _ABOVE_NO_MORE if self.waits[index] else _ABOVE
        return above < NEAR_GROUND and float(goal[2]) - height > needed

    def _plan(self, index: int, motion: FloatArray, now: float, *, urgent: bool = False) -> None:
        """Lead drone index from a motion (4, 3) to its goal; urgent for a motion that no path has led to."""
        goal = self._goals[index]
        assert goal is not None
        landing = bool(self.landing[index])
        wait = bool(self.waits[index]) and not landing
        path = self._path(index, motion, goal, now, landing=landing, wait=wait, urgent=urgent)
        if not wait:
            self._goals[index] = np.where(np.isnan(goal), path.end, goal)
        self._assign(index, path)

    def _path(
        self,
        index: int,
        motion: FloatArray,
        goal: FloatArray,
        now: float,
        *,
        landing: bool,
        wait: bool = False,
        urgent: bool = False,
    ) -> Trajectory:
        box, limits = self._box, self._path_limits
        if urgent or not limits.led_to(motion):  # within narrower ones it would take long to come back to them
            limits = self._widest
        if landing:
            box = ReferenceBox(np.array([*box.low[:2], -math.inf]), box.high)
            limits = limits.slower(_LANDING_SPEED)
        return path_to(motion, goal, now, limits, box, float(self.references.yaw[index]), wait=wait)

    def _assign(self, index: int, trajectory: Trajectory) -> None:
        margin = trajectory.require_margin(self._limits)
        demand, flight = 0.0, self._flight
        if flight is not None:
            demand = flight.demanded(trajectory.demand(), needed_margin(trajectory, self._limits, flight))
        self.references.assign(index, trajectory, margin, demand)
        self.changed.add(index)
