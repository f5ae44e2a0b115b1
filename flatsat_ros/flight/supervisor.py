"""Flight modes: when a drone is steered, when it is levelled and when its motors rest.

The state machine of one drone is data: `TABLE` lists for each mode which event leads where, the first that is true
first. `next_mode` reads it; `Supervisor` keeps the modes and flags of N drones and reports every transition.

IDLE is silent, so that starting the controller never takes a drone away from whoever flies it. A command is computed
from poses in FLY only. In LEVEL, when the estimate is not usable, the drone is kept level and sinks slowly; with poses
back in time it flies on. CUT stops the motors and stays until the user gives a new reference. A drone that does not
lift off is cut, too: its gain grown by then, it would leap when somebody arms it. REST streams zero thrust after a
landing for longer than the firmware's watchdogs wait: silence right after it would lock the drone until reboot. A drone
that somebody else shall fly first is unlocked as it is armed: taken over in the air, still locked, it would fall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import (
    FlatsatError,
    require,
    require_fields,
    require_not_negative,
    require_number,
    require_positive,
)
from flatsat_ros.flight.estimator import PREDICTION_MAX


class Mode(IntEnum):
    """What is done with one drone. Arrays are compared with a `.value`, which numpy takes ten times faster."""

    IDLE = 0
    UNLOCK = 1
    FLY = 2
    LEVEL = 3
    CUT = 4
    REST = 5


@dataclass(frozen=True)
class Policy:
    """The figures of the state machine.

    Attributes:
        pose_timeout: age, s, above which a pose is stale and the drone is levelled; at most estimator.PREDICTION_MAX.
        level_time: s of level descent without poses before the motors are cut.
        unlock_time: s of zero thrust that open the firmware's thrust lock before take-off.
        lift_off_time: s of a commanded climb that leave the drone on the ground after which the motors are cut.
        rest_time: s of zero thrust after touch-down; the firmware needs more than 1.8 s.
        ground_height: m, world frame: a drone below it is taken to stand on the ground when its reference arrives.
        level_thrust: thrust while levelled, as a fraction of gravity, at most 1, so that it sinks slowly.
        disturbance_max: largest disturbance, m/s^2, that is compensated in flight; 0 is the paper's law.
        thrust_error_max: largest error of the thrust, as a fraction, that is estimated and corrected; 0 estimates none.

    Raises:
        FlatsatError: a time or the fraction is not above 0, a fraction is above its bound, or the height is not finite.
    """

    pose_timeout: float = 0.3
    level_time: float = 3.0
    unlock_time: float = 0.3
    lift_off_time: float = 3.0
    rest_time: float = 2.5
    ground_height: float = 0.15
    level_thrust: float = 0.95
    disturbance_max: float = 0.0
    thrust_error_max: float = 0.0

    def __post_init__(self) -> None:
        seconds = ("pose_timeout", "level_time", "unlock_time", "lift_off_time", "rest_time")
        require_fields(self, require_positive, level_thrust="g", **dict.fromkeys(seconds, "s"))
        age = f"at most {PREDICTION_MAX} s: the estimate predicts no further"
        require(self.pose_timeout <= PREDICTION_MAX, "pose_timeout", self.pose_timeout, "s", age)
        require(self.level_thrust <= 1.0, "level_thrust", self.level_thrust, "g", "at most 1 g, or it would climb")
        require_fields(self, require_not_negative, disturbance_max="m/s^2")
        require_fields(self, require_number, ground_height="m")
        require_number("thrust_error_max", self.thrust_error_max, "", 0.0, 0.5)


@dataclass(frozen=True)
class Situation:
    """What the next mode of one drone depends on.

    Attributes:
        elapsed: s since the present mode began.
        policy: the figures.
        usable: the estimate can be flown on.
        standing: the estimated height is below the ground's.
        requested: a reference was given since the motors were last stopped.
        unlocking: it was armed on the ground and shall be unlocked without flying.
        touched_down: it was asked to land and stands.
        held: it was commanded to climb for the lift-off time and has not left the ground.
        retried: it has been unlocked a second time already; the first time its link may not have been there yet.
    """

    elapsed: float
    policy: Policy
    usable: bool
    standing: bool
    requested: bool
    unlocking: bool = False
    touched_down: bool = False
    held: bool = False
    retried: bool = False


class Event(Enum):
    """Why a drone changes its mode; the value is what a person is told."""

    TAKE_OVER = "a reference is there and the drone is in the air"
    TAKE_OFF = "a reference is there and the drone stands on the ground"
    START_AGAIN = "a new reference is there"
    ARMED = "armed on the ground"
    NOTHING_TO_DO = "no reference or no usable pose"
    UNLOCKED_TO_FLY = "the thrust lock is open"
    UNLOCKED = "the thrust lock is open, for others to fly"
    POSE_LOST = "no fresh pose"
    POSE_BACK = "poses are back"
    TOUCHED_DOWN = "touched down"
    HELD = "told to climb, but it did not leave the ground: unlocked once more"
    HELD_AGAIN = "told to climb, but it did not leave the ground after a second unlocking"
    LEVEL_TIME_OVER = "no pose for the whole level descent"
    RESTED = "rested after the landing"


_CONDITIONS: dict[Event, Callable[[Situation], bool]] = {
    Event.TAKE_OVER: lambda s: s.usable and s.requested and not s.standing,
    Event.TAKE_OFF: lambda s: s.usable and s.requested and s.standing,
    Event.START_AGAIN: lambda s: s.usable and s.requested,
    Event.ARMED: lambda s: s.usable and s.unlocking and s.standing,
    Event.NOTHING_TO_DO: lambda s: not s.usable or not (s.requested or s.unlocking),
    Event.UNLOCKED_TO_FLY: lambda s: s.requested and s.elapsed >= s.policy.unlock_time,
    Event.UNLOCKED: lambda s: not s.requested and s.elapsed >= s.policy.unlock_time,
    Event.POSE_LOST: lambda s: not s.usable,
    Event.POSE_BACK: lambda s: s.usable,
    Event.TOUCHED_DOWN: lambda s: s.touched_down,
    Event.HELD: lambda s: s.held and not s.retried,
    Event.HELD_AGAIN: lambda s: s.held and s.retried,
    Event.LEVEL_TIME_OVER: lambda s: s.elapsed >= s.policy.level_time,
    Event.RESTED: lambda s: s.elapsed >= s.policy.rest_time,
}

TABLE: dict[Mode, tuple[tuple[Event, Mode], ...]] = {
    Mode.IDLE: ((Event.TAKE_OVER, Mode.FLY), (Event.TAKE_OFF, Mode.UNLOCK), (Event.ARMED, Mode.UNLOCK)),
    Mode.UNLOCK: (
        (Event.NOTHING_TO_DO, Mode.IDLE),
        (Event.UNLOCKED_TO_FLY, Mode.FLY),
        (Event.UNLOCKED, Mode.IDLE),
    ),
    Mode.FLY: (
        (Event.POSE_LOST, Mode.LEVEL),
        (Event.TOUCHED_DOWN, Mode.REST),
        (Event.HELD, Mode.UNLOCK),
        (Event.HELD_AGAIN, Mode.CUT),
    ),
    Mode.LEVEL: ((Event.POSE_BACK, Mode.FLY), (Event.LEVEL_TIME_OVER, Mode.CUT)),
    Mode.CUT: ((Event.START_AGAIN, Mode.UNLOCK),),
    Mode.REST: ((Event.RESTED, Mode.IDLE),),
}


def next_mode(mode: Mode, situation: Situation) -> tuple[Mode, Event | None]:
    """Return the mode that follows and the event that leads there, None where the mode stays."""
    for event, after in TABLE[mode]:
        if _CONDITIONS[event](situation):
            return after, event
    return mode, None


class Transition(NamedTuple):
    """A change of one drone's mode.

    Attributes:
        drone: its index.
        before: the mode until now.
        after: the mode from now on.
        reason: why, for people.
    """

    drone: int
    before: Mode
    after: Mode
    reason: str


class Supervisor:
    """The flight modes of N drones, and what their users have asked for.

    Attributes:
        mode: (N,) values of `Mode`.
        armed: (N,) who may take off; all at first.
        unlocking: (N,) who was armed on the ground and is about to be unlocked.
    """

    def __init__(self, policy: Policy, count: int) -> None:
        self.mode = np.full(count, Mode.IDLE.value)
        self.armed = np.ones(count, dtype=bool)
        self.unlocking = np.zeros(count, dtype=bool)
        self._policy = policy
        self._since = np.full(count, -np.inf)
        self._requested = np.zeros(count, dtype=bool)  # a reference was given since the motors were last stopped
        self._patient = np.zeros(count, dtype=bool)  # it waits for poses that are lost; a take-off by service does not
        self._retried = np.zeros(count, dtype=bool)  # unlocked a second time for the same reference
        self._pending: list[Transition] = []  # made between two ticks

    def require_armed(self, index: int) -> None:
        """Refuse a drone that must not take off.

        Raises:
            FlatsatError: it is disarmed.
        """
        if not self.armed[index]:
            raise FlatsatError("the drone is disarmed: arm it first")

    def require_mode(self, index: int, *allowed: Mode, purpose: str) -> None:
        """Refuse a drone in another mode than those allowed for a purpose.

        Raises:
            FlatsatError: names the mode and what is possible.
        """
        mode = Mode(self.mode[index])
        if mode not in allowed:
            names = " or ".join(entry.name for entry in allowed)
            raise FlatsatError(f"the drone is in {mode.name}: only one in {names} can {purpose}")

    def request(self, index: int, *, patient: bool) -> None:
        """Note that drone index has a new reference to fly.

        Args:
            index: which drone.
            patient: it waits for poses that are lost before take-off, be it much later.
        """
        self._requested[index], self._patient[index], self._retried[index] = True, patient, False

    def arm(self, index: int, armed: bool, height: float | None) -> None:
        """Allow drone index to take off, or forbid it.

        Args:
            index: which drone.
            armed: allow.
            height: its estimated z, m; None if that is not known.

        Raises:
            FlatsatError: it is in use or in the air and cannot be disarmed.
        """
        mode = Mode(self.mode[index])
        high = height is not None and height >= self._policy.ground_height
        if not armed:
            self.require_mode(index, Mode.IDLE, Mode.CUT, purpose="be disarmed; land it first")
            if mode is Mode.IDLE and high:
                raise FlatsatError(f"the drone is at z = {height:.2f} m, flown by somebody else: land it first")
            self._requested[index] = False
        self.armed[index] = armed
        self.unlocking[index] = armed and mode in (Mode.IDLE, Mode.UNLOCK) and height is not None and not high

    def release(self, index: int) -> None:
        """Fall silent about drone index in flight: somebody else flies it from now on.

        Raises:
            FlatsatError: it does not fly.
        """
        self.require_mode(index, Mode.FLY, purpose="be handed over")
        self._pending.append(Transition(index, Mode.FLY, Mode.IDLE, "handed over"))
        self.mode[index], self._requested[index] = Mode.IDLE.value, False

    def set_clock_back(self, now: float) -> None:
        """Let no mode last longer because the clock was set back to now, s."""
        self._since = np.minimum(self._since, now)

    def advance(
        self, now: float, height: FloatArray, usable: np.ndarray, touched_down: np.ndarray, held: np.ndarray
    ) -> tuple[Transition, ...]:
        """Take the modes to time now, s; return the transitions since the last call.

        Args:
            now: s.
            height: (N,) estimated z, m.
            usable: (N,) as in `Situation`, like the next two.
            touched_down: (N,).
            held: (N,).
        """
        undisturbed = (self.mode == Mode.FLY.value) & usable & ~(touched_down | held)
        made, self._pending = self._pending, []
        if np.count_nonzero(undisturbed) == undisturbed.size:
            return tuple(made)
        for index in map(int, np.flatnonzero(~undisturbed)):
            before = Mode(self.mode[index])
            situation = Situation(
                elapsed=now - float(self._since[index]),
                policy=self._policy,
                usable=bool(usable[index]),
                standing=bool(height[index] < self._policy.ground_height),
                requested=bool(self._requested[index]),
                unlocking=bool(self.unlocking[index]),
                touched_down=bool(touched_down[index]),
                held=bool(held[index]),
                retried=bool(self._retried[index]),
            )
            after, event = next_mode(before, situation)
            self.unlocking[index] &= after is Mode.UNLOCK
            if event is not None:
                self._enter(index, before, after, now)
                made.append(Transition(index, before, after, event.value))
        return tuple(made)

    def _enter(self, index: int, before: Mode, after: Mode, now: float) -> None:
        self.mode[index], self._since[index] = after.value, now
        if after in (Mode.CUT, Mode.REST):
            self._requested[index] = False
        elif after is Mode.UNLOCK:
            self._retried[index] = before is Mode.FLY
        elif after is Mode.IDLE:
            self._requested[index] &= self._patient[index]
