"""Flight modes: when a drone is steered, when it sinks without being steered and when its motors rest.

The state machine of one drone is data: `TABLE` lists for each mode which event leads where, the first that is true
first, and `CONDITIONS` when an event happens. `next_mode` reads them; `supervisor` keeps the modes of N drones.

IDLE is silent, so that starting the controller never takes a drone away from whoever flies it. A command is computed
from poses in FLY only. Without poses that can be trusted a drone is held level in LEVEL, for a moment, and then sinks
without position in DESCEND, for as long as its last known height needs; with poses back it flies on, or lands if what
it followed has gone on without it. CUT stops the motors and stays until the user gives a new reference. FALLEN does so
until a person arms the drone again: it did not climb though it was told to, or it fell, and its motors would start at a
bad moment; or it did not move as commanded, and the next goal would have it do that again. REST streams zero thrust
after a landing for longer than the firmware's watchdogs wait: silence right after it would lock the drone until reboot.
One that was taken over and does not move at all, neither as it is told to climb nor as it is pushed aside, stands on
something with its thrust lock closed, and is unlocked.
A drone that somebody else shall fly first is unlocked as it is armed: taken over in the air, still locked, it would
fall.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple

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
# a take-off waits so long, s, for poses that are lost
_TAKE_OFF_PATIENCE = 5.0
# in the air nothing stays in its place that was pushed aside within so long, s
_TRIED = 1.5


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
        held: it was commanded to climb, for the lift-off time or by much, and was not seen to leave the ground.
        fell: it falls, or lies still, against the command.
        astray: it does not move as it is commanded to: its poses or its attitude are not what they seem.
        descended: it has sunk without position for as long as its last known height needs.
        rearmed: a person called `flatsat/arm` for it; the drone itself may have refused.
        grounded: it was unlocked and has not left the ground yet.
        linked: somebody takes its commands, as far as is known.
        taken: s for which somebody has taken the commands of the mode without a break, ten at least.
        resting: it was taken over, wherever that was, and has not moved at all since.
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
    fell: bool = False
    astray: bool = False
    descended: bool = False
    rearmed: bool = False
    grounded: bool = False
    linked: bool = True
    taken: float = 0.0
    resting: bool = False

    @property
    def wanted(self) -> bool:
        """It has a reference to fly, or was armed and can be unlocked."""
        return self.requested or (self.unlocking and self.usable)

    @property
    def unlocked(self) -> bool:
        """Somebody has taken its zero thrust for `unlock_time`, and ten times at least."""
        return self.taken >= self.policy.unlock_time

    @property
    def waited(self) -> bool:
        """The mode has lasted for 5 s more than `unlock_time`."""
        return self.elapsed >= self.policy.unlock_time + _TAKE_OFF_PATIENCE

    @property
    def levelled(self) -> bool:
        """It has been held level for `level_time`, with what was flown level shortly before."""
        return self.elapsed + self.blind >= self.policy.level_time

    @property
    def tried(self) -> bool:
        """The mode has lasted for 1.5 s, in which the drone was pushed aside a little."""
        return self.elapsed >= _TRIED

    @property
    def rested(self) -> bool:
        """The mode has lasted for `rest_time`."""
        return self.elapsed >= self.policy.rest_time


class Event(Enum):
    """Why a drone changes its mode; the value is what a person is told."""

    TAKE_OVER = "a reference is there and the drone is in the air"
    TAKE_OFF = "a reference is there and the drone stands on the ground"
    START_AGAIN = "a new reference is there"
    ARMED = "flatsat/arm was called and the drone stands on the ground"
    NOTHING_TO_DO = "nothing to fly"
    UNHEARD = "given up: nobody takes its commands"
    TAKE_OFF_LOST = "the take-off is given up: no usable pose"
    UNLOCKED_TO_FLY = "the thrust lock is open"
    UNLOCKED = "the thrust lock is open, for others to fly"
    POSE_LOST = "no fresh pose: held level"
    POSE_LOST_GROUNDED = "no fresh pose before it has left the ground: it waits"
    POSE_BACK = "poses are back"
    POSE_BACK_LATE = "poses are back after a descent without them: it goes on"
    TOUCHED_DOWN = "touched down"
    HELD = "told to climb, but it is not seen to leave the ground: in case it has, it sinks without position"
    STANDS = "told to climb, but it stays where it is, on something: unlocked"
    NOT_LIFTED = "not seen to leave the ground (locked, too heavy, another body's poses?): motors stopped until armed"
    FELL = "it falls or lies still against the command: motors stopped until armed"
    ASTRAY = "it does not move as commanded: it brakes by what was seen of that, and sinks"
    LEVEL_TIME_OVER = "still no pose: it sinks without position"
    ASTRAY_DOWN = "it has sunk, as it did not move as commanded: motors stopped until armed"
    DESCENDED = "it has sunk for as long as its last known height needs: motors stopped"
    RESTED = "rested after the landing"
    REARMED = "flatsat/arm was called: it may take off again"


# When an event happens: each of these terms, attributes of `Situation`, is true, or false after a "not".
CONDITIONS: dict[Event, tuple[str, ...]] = {
    Event.TAKE_OVER: ("usable", "requested", "not standing"),
    Event.TAKE_OFF: ("usable", "requested", "standing"),
    Event.START_AGAIN: ("usable", "requested"),
    Event.ARMED: ("usable", "unlocking", "standing"),
    Event.NOTHING_TO_DO: ("not wanted",),
    Event.TAKE_OFF_LOST: ("not usable", "waited"),
    Event.UNHEARD: ("not linked", "waited"),
    Event.UNLOCKED_TO_FLY: ("usable", "requested", "unlocked", "linked"),
    Event.UNLOCKED: ("not requested", "unlocked", "linked"),
    Event.POSE_LOST: ("not usable",),
    Event.POSE_LOST_GROUNDED: ("not usable", "grounded"),
    Event.POSE_BACK: ("usable",),
    Event.POSE_BACK_LATE: ("usable", "steady", "not astray", "not held"),
    Event.TOUCHED_DOWN: ("touched_down",),
    Event.HELD: ("held",),
    Event.STANDS: ("held", "resting", "tried"),
    Event.NOT_LIFTED: ("held", "descended"),
    Event.FELL: ("fell",),
    Event.ASTRAY: ("astray",),
    Event.LEVEL_TIME_OVER: ("levelled",),
    Event.ASTRAY_DOWN: ("astray", "descended"),
    Event.DESCENDED: ("descended",),
    Event.RESTED: ("rested",),
    Event.REARMED: ("rearmed",),
}

TABLE: dict[Mode, tuple[tuple[Event, Mode], ...]] = {
    Mode.IDLE: ((Event.TAKE_OVER, Mode.FLY), (Event.TAKE_OFF, Mode.UNLOCK), (Event.ARMED, Mode.UNLOCK)),
    Mode.UNLOCK: (
        (Event.NOTHING_TO_DO, Mode.IDLE),
        (Event.TAKE_OFF_LOST, Mode.IDLE),
        (Event.UNHEARD, Mode.IDLE),
        (Event.UNLOCKED_TO_FLY, Mode.FLY),
        (Event.UNLOCKED, Mode.IDLE),
    ),
    Mode.FLY: (
        (Event.POSE_LOST_GROUNDED, Mode.UNLOCK),
        (Event.POSE_LOST, Mode.LEVEL),
        (Event.ASTRAY, Mode.DESCEND),
        (Event.FELL, Mode.FALLEN),
        (Event.TOUCHED_DOWN, Mode.REST),
        (Event.HELD, Mode.DESCEND),
    ),
    Mode.LEVEL: ((Event.POSE_BACK, Mode.FLY), (Event.LEVEL_TIME_OVER, Mode.DESCEND)),
    Mode.DESCEND: (
        (Event.STANDS, Mode.UNLOCK),
        (Event.NOT_LIFTED, Mode.FALLEN),
        (Event.POSE_BACK_LATE, Mode.FLY),
        (Event.ASTRAY_DOWN, Mode.FALLEN),
        (Event.DESCENDED, Mode.CUT),
    ),
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
