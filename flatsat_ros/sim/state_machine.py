"""The states of the Crazyflie's supervisor, and what leads from one to the next, for N drones at once.

A restatement of bitcraze/crazyflie-firmware, release 2026.08, supervisor.c and supervisor_state_machine.c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from flatsat_ros.base.arrays import BoolArray, IntArray


class State(IntEnum):
    """supervisor_state_machine.h supervisorState_t."""

    NOT_INITIALIZED = 0
    PREFLIGHT_NOT_PASSED = 1
    PREFLIGHT_PASSED = 2
    ARMING = 3
    READY_TO_FLY = 4
    FLYING = 5
    LANDED = 6
    RESET = 7
    LEVEL_OUT = 8
    FREE_FALL = 9
    LOCKED = 10
    CRASHED = 11


# stabilizer.c stabilizerTask: in any other state the set-point is nulled (supervisor.c supervisorCanFly)
CAN_FLY = np.isin(list(State), (State.READY_TO_FLY, State.FLYING, State.LEVEL_OUT, State.LANDED))
# supervisor.c supervisorAreMotorsAllowedToRun, and postTransitionActions: any other state disarms
MOTORS_ALLOWED = CAN_FLY | np.isin(list(State), State.ARMING)


@dataclass(frozen=True)
class Conditions:
    """What the supervisor decides on, (N,) each.

    Attributes:
        armed: the drone is armed.
        flying: a motor has turned faster than idle within the last two seconds.
        tumbled: tilted for too long, or upside down.
        silent: the last set-point is so old that the drone levels out.
        link_lost: the last set-point is so old that the motors stop.
        emergency: an emergency stop was requested.
        crashed: it tumbled in flight and has not been rebooted since.
        preflight_over: ready to fly for too long without flying.
        landing_over: landed for too long without flying.
    """

    armed: BoolArray
    flying: BoolArray
    tumbled: BoolArray
    silent: BoolArray
    link_lost: BoolArray
    emergency: BoolArray
    crashed: BoolArray
    preflight_over: BoolArray
    landing_over: BoolArray


# supervisor_state_machine.c transitionLists: of the rows of a state the first that holds is taken
TRANSITIONS: tuple[tuple[State, State, Callable[[Conditions], BoolArray]], ...] = (
    (State.NOT_INITIALIZED, State.PREFLIGHT_NOT_PASSED, lambda c: np.ones_like(c.armed)),
    (State.PREFLIGHT_NOT_PASSED, State.FREE_FALL, lambda c: c.emergency),
    (State.PREFLIGHT_NOT_PASSED, State.PREFLIGHT_PASSED, lambda c: ~c.tumbled),
    (State.PREFLIGHT_PASSED, State.FREE_FALL, lambda c: c.emergency),
    (State.PREFLIGHT_PASSED, State.PREFLIGHT_NOT_PASSED, lambda c: c.tumbled),
    (State.PREFLIGHT_PASSED, State.ARMING, lambda c: c.armed),
    (State.ARMING, State.FREE_FALL, lambda c: c.emergency),
    (State.ARMING, State.PREFLIGHT_NOT_PASSED, lambda c: c.tumbled | ~c.armed),
    (State.ARMING, State.READY_TO_FLY, lambda c: np.ones_like(c.armed)),
    (State.READY_TO_FLY, State.FREE_FALL, lambda c: c.emergency),
    (State.READY_TO_FLY, State.PREFLIGHT_NOT_PASSED, lambda c: c.tumbled | c.preflight_over | ~c.armed),
    (State.READY_TO_FLY, State.FLYING, lambda c: c.flying),
    (State.FLYING, State.FREE_FALL, lambda c: c.link_lost | c.emergency),
    (State.FLYING, State.CRASHED, lambda c: c.tumbled),
    (State.FLYING, State.RESET, lambda c: ~c.armed),
    (State.FLYING, State.LEVEL_OUT, lambda c: c.silent),
    (State.FLYING, State.LANDED, lambda c: ~c.flying),
    (State.LANDED, State.RESET, lambda c: c.landing_over | ~c.armed),
    (State.LANDED, State.FLYING, lambda c: c.flying),
    (State.RESET, State.PREFLIGHT_NOT_PASSED, lambda c: np.ones_like(c.armed)),
    (State.LEVEL_OUT, State.FREE_FALL, lambda c: c.link_lost | c.tumbled | c.emergency),
    (State.LEVEL_OUT, State.FLYING, lambda c: ~c.silent & ~c.link_lost),
    (State.FREE_FALL, State.LOCKED, lambda c: np.ones_like(c.armed)),
    (State.CRASHED, State.PREFLIGHT_NOT_PASSED, lambda c: ~c.crashed & ~c.tumbled),
    (State.CRASHED, State.LOCKED, lambda c: c.emergency),
)


def next_state(state: IntArray, conditions: Conditions) -> IntArray:
    """Return the (N,) supervisor states that follow; each drone makes at most one transition."""
    following = state.copy()
    waiting = np.ones(len(state), dtype=bool)
    for origin, target, holds in TRANSITIONS:
        taken = waiting & (state == origin)
        if taken.any():
            taken &= holds(conditions)
            following[taken] = target
            waiting &= ~taken
    return following
