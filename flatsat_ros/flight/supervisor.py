"""Flight modes: when a drone is steered, when it sinks without being steered and when its motors rest.

The state machine of one drone is data: `TABLE` lists for each mode which event leads where, the first that is true
first. `next_mode` reads it; `Supervisor` keeps the modes and flags of N drones and reports every transition.

IDLE is silent, so that starting the controller never takes a drone away from whoever flies it. A command is computed
from poses in FLY only. Without poses that can be trusted a drone is held level in LEVEL, for a moment, and then sinks
without position in DESCEND, for as long as its last known height needs; with poses back it flies on, or lands if what
it followed has gone on without it. CUT stops the motors and stays until the user gives a new reference. FALLEN does so
until a person arms the drone again: it did not climb though it was told to, or it fell; its motors would start at a bad
moment. REST streams zero thrust after a landing for longer than the firmware's watchdogs wait: silence right after it
would lock the drone until reboot. A drone that somebody else shall fly first is unlocked as it is armed: taken over in
the air, still locked, it would fall.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.policy import Policy


class Mode(IntEnum):
    """What is done with one drone. Arrays are compared with a `.value`, which numpy takes ten times faster."""

    IDLE = 0
    UNLOCK = 1
    FLY = 2
    LEVEL = 3
    CUT = 4
    REST = 5
    DESCEND = 6
    FALLEN = 7


# modes of drones that are in the air, or may be
AIRBORNE = (Mode.FLY, Mode.LEVEL, Mode.DESCEND)

# a drone lower than this above the floor, m, stands on it until it has flown
STANDING_HEIGHT = 0.15
# what a drone flew level without poses counts with its next loss, less this share of the time between them
_FORGOTTEN = 0.2
# poses are steady when all have been usable for this long, s
_STEADY_TIME = 0.5
# a take-off waits so long, s, for poses that are lost
_TAKE_OFF_PATIENCE = 5.0


@dataclass(frozen=True)
class Situation:
    """What the next mode of one drone depends on.

    Attributes:
        elapsed: s since the present mode began.
        policy: the figures.
        blind: s for which it was held level before, so lately that it counts with the present time.
        usable: the estimate can be flown on.
        steady: it could for half a second.
        standing: the estimated height is that of something that stands on the floor.
        requested: a reference was given since the motors were last stopped.
        unlocking: it was armed on the ground and shall be unlocked without flying.
        touched_down: it was asked to land and something carries it.
        held: it was commanded to climb for the lift-off time and has not left the ground.
        retried: it has been unlocked a second time already; the first time its link may not have been there yet.
        fell: it falls, or lies still, against the command.
        astray: it does not move as it is commanded to: its poses or its attitude are not what they seem.
        descended: it has sunk without position for as long as its last known height needs.
        rearmed: a person armed it.
        grounded: it was unlocked and has not left the ground yet.
    """

    elapsed: float
    policy: Policy
    usable: bool
    standing: bool
    requested: bool
    blind: float = 0.0
    steady: bool = False
    unlocking: bool = False
    touched_down: bool = False
    held: bool = False
    retried: bool = False
    fell: bool = False
    astray: bool = False
    descended: bool = False
    rearmed: bool = False
    grounded: bool = False

    @property
    def wanted(self) -> bool:
        """It has a reference to fly, or was armed and can be unlocked."""
        return self.requested or (self.unlocking and self.usable)

    @property
    def unlocked(self) -> bool:
        """The mode has lasted for `unlock_time`."""
        return self.elapsed >= self.policy.unlock_time

    @property
    def waited(self) -> bool:
        """The mode has lasted for 5 s more than `unlock_time`."""
        return self.elapsed >= self.policy.unlock_time + _TAKE_OFF_PATIENCE

    @property
    def levelled(self) -> bool:
        """It has been held level for `level_time`, with what was flown level shortly before."""
        return self.elapsed + self.blind >= self.policy.level_time

    @property
    def rested(self) -> bool:
        """The mode has lasted for `rest_time`."""
        return self.elapsed >= self.policy.rest_time


class Event(Enum):
    """Why a drone changes its mode; the value is what a person is told."""

    TAKE_OVER = "a reference is there and the drone is in the air"
    TAKE_OFF = "a reference is there and the drone stands on the ground"
    START_AGAIN = "a new reference is there"
    ARMED = "armed on the ground"
    NOTHING_TO_DO = "nothing to fly"
    TAKE_OFF_LOST = "the take-off is given up: no usable pose"
    UNLOCKED_TO_FLY = "the thrust lock is open"
    UNLOCKED = "the thrust lock is open, for others to fly"
    POSE_LOST = "no fresh pose: held level"
    POSE_LOST_GROUNDED = "no fresh pose before it has left the ground: it waits"
    POSE_BACK = "poses are back"
    POSE_BACK_LATE = "poses are back after a descent without them: it goes on"
    TOUCHED_DOWN = "touched down"
    HELD = "told to climb, but it did not leave the ground: unlocked once more"
    HELD_AGAIN = (
        "told to climb, but it did not leave the ground after a second unlocking: motors stopped until armed again"
    )
    FELL = "it falls or lies still against the command: motors stopped until armed"
    ASTRAY = "it does not move as commanded: it brakes by what was seen of that, and sinks"
    LEVEL_TIME_OVER = "still no pose: it sinks without position"
    DESCENDED = "it has sunk for as long as its last known height needs: motors stopped"
    RESTED = "rested after the landing"
    REARMED = "armed again"


# When an event happens: each of these terms, attributes of `Situation`, is true, or false after a "not".
CONDITIONS: dict[Event, tuple[str, ...]] = {
    Event.TAKE_OVER: ("usable", "requested", "not standing"),
    Event.TAKE_OFF: ("usable", "requested", "standing"),
    Event.START_AGAIN: ("usable", "requested"),
    Event.ARMED: ("usable", "unlocking", "standing"),
    Event.NOTHING_TO_DO: ("not wanted",),
    Event.TAKE_OFF_LOST: ("not usable", "waited"),
    Event.UNLOCKED_TO_FLY: ("usable", "requested", "unlocked"),
    Event.UNLOCKED: ("not requested", "unlocked"),
    Event.POSE_LOST: ("not usable",),
    Event.POSE_LOST_GROUNDED: ("not usable", "grounded"),
    Event.POSE_BACK: ("usable",),
    Event.POSE_BACK_LATE: ("usable", "steady", "not astray"),
    Event.TOUCHED_DOWN: ("touched_down",),
    Event.HELD: ("held", "not retried"),
    Event.HELD_AGAIN: ("held", "retried"),
    Event.FELL: ("fell",),
    Event.ASTRAY: ("astray",),
    Event.LEVEL_TIME_OVER: ("levelled",),
    Event.DESCENDED: ("descended",),
    Event.RESTED: ("rested",),
    Event.REARMED: ("rearmed",),
}

TABLE: dict[Mode, tuple[tuple[Event, Mode], ...]] = {
    Mode.IDLE: ((Event.TAKE_OVER, Mode.FLY), (Event.TAKE_OFF, Mode.UNLOCK), (Event.ARMED, Mode.UNLOCK)),
    Mode.UNLOCK: (
        (Event.NOTHING_TO_DO, Mode.IDLE),
        (Event.TAKE_OFF_LOST, Mode.IDLE),
        (Event.UNLOCKED_TO_FLY, Mode.FLY),
        (Event.UNLOCKED, Mode.IDLE),
    ),
    Mode.FLY: (
        (Event.POSE_LOST_GROUNDED, Mode.UNLOCK),
        (Event.POSE_LOST, Mode.LEVEL),
        (Event.ASTRAY, Mode.DESCEND),
        (Event.FELL, Mode.FALLEN),
        (Event.TOUCHED_DOWN, Mode.REST),
        (Event.HELD, Mode.UNLOCK),
        (Event.HELD_AGAIN, Mode.FALLEN),
    ),
    Mode.LEVEL: ((Event.POSE_BACK, Mode.FLY), (Event.LEVEL_TIME_OVER, Mode.DESCEND)),
    Mode.DESCEND: ((Event.POSE_BACK_LATE, Mode.FLY), (Event.DESCENDED, Mode.CUT)),
    Mode.CUT: ((Event.START_AGAIN, Mode.UNLOCK),),
    Mode.REST: ((Event.RESTED, Mode.IDLE),),
    Mode.FALLEN: ((Event.REARMED, Mode.IDLE),),
}


def next_mode(mode: Mode, situation: Situation) -> tuple[Mode, Event | None]:
    """Return the mode that follows and the event that leads there, None where the mode stays."""
    for event, after in TABLE[mode]:
        if all(_is_true(term, situation) for term in CONDITIONS[event]):
            return after, event
    return mode, None


def _is_true(term: str, situation: Situation) -> bool:
    name = term.removeprefix("not ")
    return bool(getattr(situation, name)) is (name == term)


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


class Sight(NamedTuple):
    """What is known of N drones at a tick, (N,) each; see `Situation`.

    Attributes:
        height: estimated z, m.
        usable: the estimate can be flown on.
        touched_down: asked to land, and carried by something.
        held: told to climb, and still on the ground.
        fell: falls or lies still against the command.
        astray: does not move as commanded.
        descended: has sunk without position for long enough.
        grounded: has not left the ground since its unlocking.
    """

    height: FloatArray
    usable: np.ndarray
    touched_down: np.ndarray
    held: np.ndarray
    fell: np.ndarray
    astray: np.ndarray
    descended: np.ndarray
    grounded: np.ndarray


class Supervisor:
    """The flight modes of N drones, and what their users have asked for.

    Attributes:
        mode: (N,) values of `Mode`.
        armed: (N,) who may take off; all at first.
        unlocking: (N,) who was armed on the ground and is about to be unlocked.
        requested: (N,) who got a reference since the motors were last stopped.
    """

    def __init__(self, policy: Policy, count: int) -> None:
        self.mode = np.full(count, Mode.IDLE.value)
        self.armed = np.ones(count, dtype=bool)
        self.unlocking = np.zeros(count, dtype=bool)
        self._policy = policy
        self._since = np.full(count, -np.inf)
        self.requested = np.zeros(count, dtype=bool)
        self._blind = np.zeros(count)  # see Situation, at the beginning of the mode, s
        self._usable_since = np.full(count, np.inf)  # of drones without poses
        self._patient = np.zeros(count, dtype=bool)  # it waits for poses that are lost; a take-off by service does not
        self._retried = np.zeros(count, dtype=bool)  # unlocked a second time for the same reference
        self._rearmed = np.zeros(count, dtype=bool)  # a person armed it since it fell
        self._pending: list[Transition] = []  # made between two ticks

    def require_armed(self, index: int) -> None:
        """Refuse a drone that must not take off.

        Raises:
            FlatsatError: it is disarmed.
        """
        if not self.armed[index]:
            raise FlatsatError("the drone is disarmed: arm it first")
        if self.mode[index] == Mode.FALLEN:
            raise FlatsatError("the drone has fallen, its motors are stopped: look after it, then arm it again")

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
        self.requested[index], self._patient[index], self._retried[index] = True, patient, False

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
        high = height is not None and height >= self._policy.floor + STANDING_HEIGHT
        if not armed:
            self.require_mode(index, Mode.IDLE, Mode.CUT, Mode.FALLEN, purpose="be disarmed; land it first")
            if mode is Mode.IDLE and high:
                raise FlatsatError(f"the drone is at z = {height:.2f} m, flown by somebody else: land it first")
            self.requested[index] = False
        self.armed[index] = armed
        self._rearmed[index] = armed and mode is Mode.FALLEN
        self.unlocking[index] = armed and mode in (Mode.IDLE, Mode.UNLOCK) and height is not None and not high

    def withdraw(self, index: int) -> None:
        """Let drone index not take off any more; one in the air goes on."""
        self.armed[index] = self.unlocking[index] = self.requested[index] = False

    def call_off(self, index: int) -> bool:
        """Forget the reference of drone index unless it is in the air; return whether there was one to forget."""
        forgets = bool(self.requested[index]) and self.mode[index] not in AIRBORNE
        if forgets:
            self.requested[index] = False
        return forgets

    def release(self, index: int) -> None:
        """Fall silent about drone index in flight: somebody else flies it from now on.

        Raises:
            FlatsatError: it does not fly.
        """
        self.require_mode(index, Mode.FLY, purpose="be handed over")
        self._pending.append(Transition(index, Mode.FLY, Mode.IDLE, "handed over"))
        self.mode[index], self.requested[index] = Mode.IDLE.value, False

    def set_clock_back(self, now: float) -> None:
        """Let no mode last longer because the clock was set back to now, s."""
        self._since = np.minimum(self._since, now)
        self._usable_since = np.where(np.isfinite(self._usable_since), np.minimum(self._usable_since, now), np.inf)

    def advance(self, now: float, sight: Sight) -> tuple[Transition, ...]:
        """Take the modes to time now, s; return the transitions since the last call.

        Args:
            now: s.
            sight: what is known of the drones.
        """
        made, self._pending = self._pending, []
        events = sight.touched_down, sight.held, sight.fell, sight.astray
        flies = (self.mode == Mode.FLY.value) & sight.usable
        if np.count_nonzero(flies) == flies.size and not any(map(np.count_nonzero, events)):
            return tuple(made)
        for index in map(int, np.flatnonzero(~flies | np.any(events, axis=0))):
            before = Mode(self.mode[index])
            seen = self._usable_since[index] = min(now, self._usable_since[index]) if sight.usable[index] else np.inf
            situation = Situation(
                elapsed=now - float(self._since[index]),
                policy=self._policy,
                usable=bool(sight.usable[index]),
                standing=bool(sight.height[index] < self._policy.floor + STANDING_HEIGHT),
                requested=bool(self.requested[index]),
                blind=float(self._blind[index]),
                steady=bool(now - seen >= _STEADY_TIME),
                unlocking=bool(self.unlocking[index]),
                touched_down=bool(sight.touched_down[index]),
                held=bool(sight.held[index]),
                retried=bool(self._retried[index]),
                fell=bool(sight.fell[index]),
                astray=bool(sight.astray[index]),
                descended=bool(sight.descended[index]),
                rearmed=bool(self._rearmed[index]),
                grounded=bool(sight.grounded[index]),
            )
            after, event = next_mode(before, situation)
            self.unlocking[index] &= after is Mode.UNLOCK
            if event is not None:
                self._enter(index, event, after, now)
                made.append(Transition(index, before, after, event.value))
        return tuple(made)

    def elapsed(self, now: float) -> FloatArray:
        """Return how long each mode has lasted, (N,) s."""
        return now - self._since

    def _enter(self, index: int, event: Event, after: Mode, now: float) -> None:
        elapsed, before = now - float(self._since[index]), self.mode[index]
        if before == Mode.LEVEL:
            self._blind[index] += elapsed
        elif after is Mode.LEVEL:
            self._blind[index] = max(0.0, float(self._blind[index]) - _FORGOTTEN * elapsed)
        self.mode[index], self._since[index] = after.value, now
        if after in (Mode.CUT, Mode.REST, Mode.FALLEN):
            self.requested[index] = self._rearmed[index] = False
        elif after is Mode.UNLOCK:
            self._retried[index] |= event is Event.HELD
        elif after is Mode.IDLE:
            self.requested[index] &= self._patient[index]
