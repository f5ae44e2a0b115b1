"""The supervisor: the modes of N drones and what their users have asked for; it reports every transition.

What leads from one mode to the next stands in `flight.modes`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import AIRBORNE, STANDING_HEIGHT, Event, Mode, Situation, Transition, next_mode
from flatsat_ros.flight.policy import Policy

_FLY, _LEVEL, _DESCEND = (mode.value for mode in AIRBORNE)  # numpy compares with these ten times faster
# modes whose motors are not told to turn: drones in them can be disarmed
_ON_THE_GROUND = (Mode.IDLE, Mode.UNLOCK, Mode.CUT, Mode.REST, Mode.FALLEN)
# what a drone flew level without poses counts with its next loss, less this share of the time between them
_FORGOTTEN = 0.2
# so many flights begin at one tick: each needs a path, whose computing takes a tenth of a period
_STARTS = 4
# So many zeros, at least, open a lock: where one of five is lost on the way, one lock in ten million stays closed.
UNLOCKING_ZEROS = 10
# poses are steady when all have been usable for this long, s
_STEADY_TIME = 0.5


class Sight(NamedTuple):
    """What is known of N drones at a tick, (N,) each; see `Situation`.

    Attributes:
        height: estimated z, m.
        usable: the estimate can be flown on.
        touched_down: asked to land, and carried by something.
        held: told to climb, and not seen to leave the ground.
        fell: falls or lies still against the command.
        astray: does not move as commanded.
        descended: has sunk without position for long enough.
        grounded: has not left the ground since its unlocking.
        resting: was taken over and has not moved since.
    """

    height: FloatArray
    usable: np.ndarray
    touched_down: np.ndarray
    held: np.ndarray
    fell: np.ndarray
    astray: np.ndarray
    descended: np.ndarray
    grounded: np.ndarray
    resting: np.ndarray


class Supervisor:
    """The flight modes of N drones, and what their users have asked for.

    Attributes:
        mode: (N,) values of `Mode`.
        flying: (N,) who is steered.
        level: (N,) who is in the air without being steered.
        armed: (N,) who may take off; all at first.
        unlocking: (N,) who was armed on the ground and is about to be unlocked.
        requested: (N,) who got a reference since the motors were last stopped.
        linked: (N,) whose commands somebody takes, as far as is known; all at first.
    """

    def __init__(self, policy: Policy, count: int) -> None:
        self.mode = np.full(count, Mode.IDLE.value)
        self._sort()
        self.armed = np.ones(count, dtype=bool)
        self.unlocking = np.zeros(count, dtype=bool)
        self.linked = np.ones(count, dtype=bool)
        self._policy = policy
        self._since = np.full(count, -np.inf)
        self.requested = np.zeros(count, dtype=bool)
        # s, and how many by now: zeros that somebody took in a row, of drones in UNLOCK
        self._taken_since, self._taken = np.full(count, np.inf), np.zeros(count, dtype=int)
        self._blind = np.zeros(count)  # see Situation, at the beginning of the mode, s
        self._usable_since = np.full(count, np.inf)  # of drones without poses
        self._patient = np.zeros(count, dtype=bool)  # it waits for poses that are lost; a take-off by service does not
        self._rearmed = np.zeros(count, dtype=bool)  # a person armed it since it fell
        self._retired = False  # see `retire`
        self._pending: list[Transition] = []  # made between two ticks

    def require_armed(self, index: int) -> None:
        """Refuse a drone that must not take off.

        Raises:
            FlatsatError: it is disarmed, or the controller ends.
        """
        if self._retired:
            raise FlatsatError("the controller ends: drones in the air land, and none takes off any more")
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
        self.requested[index], self._patient[index] = True, patient

    def arm(self, index: int, armed: bool, height: float | None) -> None:
        """Allow drone index to take off, or forbid it.

        Args:
            index: which drone.
            armed: allow.
            height: its estimated z, m; None if that is not known.

        Raises:
            FlatsatError: it is in the air and cannot be disarmed, or the controller ends and it cannot be armed.
        """
        mode = Mode(self.mode[index])
        if armed and self._retired:
            raise FlatsatError("the controller ends: no drone is armed any more")
        high = height is not None and height >= self._policy.floor + STANDING_HEIGHT
        if not armed:
            self.require_mode(index, *_ON_THE_GROUND, purpose="be disarmed; land it first")
            if mode is Mode.IDLE and high:
                raise FlatsatError(f"the drone is at z = {height:.2f} m, flown by somebody else: land it first")
            self.requested[index] = False
        self.armed[index] = armed
        self._rearmed[index] = armed and mode is Mode.FALLEN
        self.unlocking[index] = armed and mode in (Mode.IDLE, Mode.UNLOCK) and height is not None and not high

    def retire(self) -> None:
        """Let no drone take off any more, whoever arms it; those in the air go on."""
        self.armed[:] = self.unlocking[:] = self.requested[:] = False
        self._retired = True

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
        self._sort()

    def set_clock_back(self, now: float) -> None:
        """Let no mode last longer because the clock was set back to now, s."""
        self._since = np.minimum(self._since, now)
        for since in (self._usable_since, self._taken_since):
            since[:] = np.where(np.isfinite(since), np.minimum(since, now), np.inf)

    def advance(self, now: float, sight: Sight) -> tuple[Transition, ...]:
        """Take the modes to time now, s; return the transitions since the last call.

        Args:
            now: s.
            sight: what is known of the drones.
        """
        made, self._pending = self._pending, []
        events = sight.touched_down, sight.held, sight.fell, sight.astray
        flies = self.flying & sight.usable
        if all_of(flies) and not any(map(any_of, events)):
            return tuple(made)
        starts = 0
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
                fell=bool(sight.fell[index]),
                astray=bool(sight.astray[index]),
                descended=bool(sight.descended[index]),
                rearmed=bool(self._rearmed[index]),
                grounded=bool(sight.grounded[index]),
                linked=bool(self.linked[index]),
                taken=self._take(index, now) if before is Mode.UNLOCK else 0.0,
                resting=bool(sight.resting[index]),
            )
            after, event = next_mode(before, situation)
            if event is Event.UNLOCKED_TO_FLY and starts == _STARTS:
                continue  # at the next tick
            starts += event is Event.UNLOCKED_TO_FLY
            self.unlocking[index] &= after is Mode.UNLOCK
            if event is not None:
                self._enter(index, event, after, now)
                made.append(Transition(index, before, after, event.value))
        return tuple(made)

    def _take(self, index: int, now: float) -> float:
        """Return `Situation.taken` of drone index, which is in UNLOCK, and count the zero of this tick."""
        if not self.linked[index]:
            self._taken_since[index], self._taken[index] = np.inf, 0
            return 0.0
        since = self._taken_since[index] = min(now, self._taken_since[index])
        self._taken[index] += 1
        return now - float(since) if self._taken[index] > UNLOCKING_ZEROS else 0.0

    def _sort(self) -> None:
        self.flying = self.mode == _FLY
        self.level = (self.mode == _LEVEL) | (self.mode == _DESCEND)

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
        self._taken_since[index], self._taken[index] = now, 1  # unless nobody takes it, as is noted next
        self._sort()
        if after in (Mode.CUT, Mode.REST, Mode.FALLEN):
            self.requested[index] = self._rearmed[index] = False
        elif after is Mode.IDLE:
            # a goal waits for poses; motors start as soon as a link is there only if somebody asks for it then
            self.requested[index] &= self._patient[index] and event is not Event.UNHEARD
