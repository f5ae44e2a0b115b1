"""One step of N drones: estimate, reference, law, flight mode, command. Node and simulation run this same code."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from flatsat_ros.base.arrays import FloatArray, all_of, any_of
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.loops import Steered
from flatsat_ros.flight.modes import Mode, Transition
from flatsat_ros.flight.parts import Parts
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Report, Tick
from flatsat_ros.law.controller import Output
from flatsat_ros.law.flatness import input_from_acceleration

# a thrust of this share of T_max is at its limit
_FULL = 0.98
# A landing drone near its ground that is told so small a share of the thrust of a hover is carried by it, and is not
# told to tilt: as the thrust goes, the noise of an estimate becomes a tilt to the limit, which motors would answer.
_CARRIED = 0.5
# s: after so long without a tick that is told; the firmware takes set-points for lost after 0.5 s
_PAUSE = 0.2


class ControlStep:
    """Takes the parts of a `Pilot` from tick to tick.

    Attributes:
        now: time of the last tick, s.
        state: (N, 6) what was estimated then, m, m/s.
        usable: (N,) whose state could be flown on then.
        reports: what people are told with the next tick.
    """

    def __init__(self, certificate: Certificate, policy: Policy, parts: Parts, count: int) -> None:
        """Begin before the first tick.

        Args:
            certificate: what is proved of the loop.
            policy: the figures of the flight layer.
            parts: of which the flight is put together.
            count: N.
        """
        self._certificate, self._policy, self._parts = certificate, policy, parts
        self.now = -np.inf
        self.state, self.usable = np.zeros((count, 6)), np.zeros(count, dtype=bool)
        self.reports: list[Report] = []
        self._full = np.zeros(count, dtype=bool)  # thrust at its limit

    def begin(self, index: int, *, patient: bool, landed: bool = False) -> None:
        """Let a new reference of drone index be flown.

        Args:
            index: which drone.
            patient: it waits for poses that are lost.
            landed: the drone was landing until now, and the ground may carry it.
        """
        parts = self._parts
        parts.supervisor.request(index, patient=patient)
        parts.steering.note_reference(index)
        if not parts.supervisor.flying[index]:
            return
        if landed and parts.guidance.is_down(index, self.state[index], self.now):
            parts.senses.stand(index, self.state[index, :3])
            parts.steering.reset(index)
            parts.guidance.start(index, self.state[index], self.now)
        else:
            parts.guidance.replan(index, self.now)

    def tick(self, now: float) -> Tick:
        """Compute all commands at time now, s; called once per period of the certificate."""
        begin, parts = perf_counter(), self._parts
        estimator, guidance, senses, supervisor = parts.estimator, parts.guidance, parts.senses, parts.supervisor
        if now < self.now:
            estimator.restart()
            supervisor.set_clock_back(now)
            senses.set_clock_back(now)
            parts.traffic.set_clock_back()
        elif now - self.now > _PAUSE:
            self.reports += self._paused(now - self.now)
        self.now = now
        for index, reason in parts.clearance.barred():
            if supervisor.call_off(index):
                self.reports.append(Report(index, f"its take-off is called off: {reason}"))
        estimated = parts.loop.estimate(now, senses.due, senses.thrust.take_gained())
        state, estimate = estimated[:, :6], estimated[:, 6:]
        self.state = state
        usable = self.usable = estimator.usable(now, self._policy.pose_timeout)
        airborne = supervisor.flying | supervisor.level
        ready = usable if all_of(airborne) else usable & (airborne | ~parts.orientations.unready_all())
        sight = senses.look(now, estimated, ready, supervisor.flying, guidance)
        transitions = supervisor.advance(now, sight)
        parts.traffic.note(now, state, usable)
        if transitions:
            self._take(transitions, estimated)
        if parts.traffic.is_due:
            for index in parts.traffic.look():
                self.begin(index, patient=True)
            self.reports += parts.traffic.reports()
        flying, level, grounded = supervisor.flying, supervisor.level, senses.footing.grounded
        references = guidance.references
        reference = references.sample(now)
        guidance.update(now, state, reference, flying, self._full)
        for index, text in guidance.outside(state):
            if flying[index]:
                guidance.land(index, now)
                self.reports.append(Report(index, f"{text}: it brakes and lands"))
        landing = guidance.landing if any_of(guidance.landing) else None
        touching = None if landing is None else landing & guidance.near_ground(state)
        steered = Steered(flying, level, grounded, landing, touching, senses.footing.resting)
        aim = parts.loop.aim(now, estimated, reference, steered)
        hurried = senses.thrust.hurried
        adapting = flying if hurried is None else flying & ~hurried
        output = parts.steering.step(aim.state, estimator.yaw, aim.base, flying, adapting)
        error = output.error if aim.error is None else aim.error
        turned, kept = flying, level
        unseen = parts.orientations.unseen(now)
        if any_of(unseen):
            turned, kept = flying & ~unseen, level | (flying & unseen)
            for index in parts.orientations.patience_ends(now, flying):
                guidance.land(index, now)
                self.reports.append(Report(index, "its orientation is not seen and yaw_source is measured: it lands"))
        yaw_rate = parts.yaw.turn(estimator.yaw, references.yaw, turned, kept)
        command, acceleration = self._command(now, output, flying, level)
        if touching is not None:
            command, acceleration = self._standing(command, acceleration, touching)
        commanded = acceleration  # as far as the yaw is right
        if any_of(senses.sinking.braking.active):
            commanded = self._brake(command, acceleration, level & usable)

        assessment = parts.loop.assess(output, acceleration, flying)
        guessed = None if parts.orientations.measured else unseen
        free = senses.note(
            commanded,
            estimated,
            error,
            estimator.yaw,
            flying,
            guidance.landing,
            guessed,
            estimator.newest,
            estimator.measured,
            parts.loop.doubted,
        )
        if parts.orientations.from_motion and senses.looks.looked:
            estimator.yaw += senses.take_turns()
        if self._policy.goal_mode is GoalMode.PATH:  # steps take a drone to its limit by themselves
            for index in senses.at_limit(now, aim.base, estimate, error, guidance.landing, parts.loop.ease):
                if flying[index]:
                    guidance.land(index, now, state[index, :3])
        # on the ground nothing is claimed, before a flight and at its end
        lifted = flying & ~grounded
        watched = lifted if touching is None else lifted & ~touching
        for index in parts.loop.astray():
            if watched[index] and not guidance.landing[index]:
                guidance.land(index, now)
                self.reports.append(Report(index, f"{parts.loop.unclaimed(index)}: it brakes and lands"))
        self._full = command[:, 0] >= _FULL * self._certificate.limits.thrust_max
        changing = bool(transitions) or senses.looks.looked
        aloft = level | lifted if changing else None
        estimator.command(now, acceleration, free, aloft)
        told = senses.strays.reports() + estimator.complaints() + parts.loop.reports(watched)
        reports, self.reports = self.reports + [Report(*entry) for entry in told], []
        return Tick(
            mode=supervisor.mode.copy(),
            input=command,
            yaw_rate=yaw_rate,
            yaw=parts.yaw.heading,
            output=output,
            reference=reference,
            error=error,
            disturbance=aim.disturbance,
            thrust_scale=senses.thrust.cautious(flying),
            assessment=assessment,
            transitions=transitions,
            reports=tuple(reports),
            duration=perf_counter() - begin,
        )

    def _paused(self, seconds: float) -> list[Report]:
        """Return what is told of the drones in the air when there was no tick for some time, s."""
        text = f"no tick for {seconds:.2f} s: the controller or its machine stood still, and no commands were sent"
        airborne = self._parts.supervisor.flying | self._parts.supervisor.level
        return [] if seconds == np.inf else [Report(int(index), text) for index in np.flatnonzero(airborne)]

    def _take(self, transitions: Sequence[Transition], estimated: FloatArray) -> None:
        """Let the parts know of the drones that changed their mode."""
        reset = []
        for index, before, after, _ in transitions:
            repeated = self._parts.estimator.is_old(index)
            ground = self._parts.senses.enter(
                index, before, after, estimated[index], self.now, self._parts.guidance, repeated
            )
            if ground is not None:
                self._parts.guidance.ground[index] = ground
            if after is Mode.FLY:
                if before not in (Mode.LEVEL, Mode.DESCEND):
                    reset.append(index)
                if self._policy.goal_mode is GoalMode.PATH:
                    self._set_out(index, before, estimated[index, :6])
            elif after in (Mode.CUT, Mode.REST, Mode.FALLEN):
                self._parts.guidance.landing[index] = False
                reset.append(index)
        self._parts.steering.reset(*reset)
        self._parts.traffic.follow(transitions)

    def _set_out(self, index: int, before: Mode, state: FloatArray) -> None:
        """Let drone index, with a state (6,), set out from where it is: its flight begins, or goes on after a mode."""
        end = self._parts.guidance.destination(index)
        resumed = before in (Mode.LEVEL, Mode.DESCEND)
        away = self._parts.guidance.start(index, state, self.now, resumed=resumed)
        if not away or end is None:
            return
        if not resumed:
            does = "stays where it is"
            if before is Mode.UNLOCK:  # it stands, and nothing else would stop its motors
                does = "does not take off"
                self._parts.guidance.land(index, self.now)
            self.reports.append(Report(index, f"its trajectory is {away:.2f} m away: it {does}"))
        elif self._parts.traffic.lead_on(index, end):
            self._parts.guidance.replan(index, self.now)
        self.reports += self._parts.traffic.reports()

    def _command(
        self, now: float, output: Output, flying: np.ndarray, level: np.ndarray
    ) -> tuple[FloatArray, FloatArray]:
        """Return input and acceleration of each mode: the law's in FLY, level without position, else zero."""
        if all_of(flying):
            return output.input, output.acceleration
        flies = flying[:, np.newaxis]
        command = np.where(flies, output.input, 0.0)
        acceleration = np.where(flies, output.acceleration, 0.0)
        if any_of(level):
            thrust = self._parts.senses.sinking.thrusts(now, self.state[:, 3:], self.usable)
            command[level, 0] = thrust[level]
            acceleration[level, 2] = thrust[level] - self._certificate.limits.gravity
            aside = self._parts.senses.sinking.descent.aside(now)
            if aside is not None:
                acceleration[level, 0] = aside[level]
                yaw, gravity = self._parts.estimator.yaw[level], self._certificate.limits.gravity
                command[level] = input_from_acceleration(acceleration[level], yaw, gravity)
        return command, acceleration

    def _standing(
        self, command: FloatArray, acceleration: FloatArray, touching: np.ndarray
    ) -> tuple[FloatArray, FloatArray]:
        """Return input and acceleration (N, 3), level for those whom the ground carries.

        Args:
            command: (N, 3) input.
            acceleration: (N, 3) that shall come, m/s^2.
            touching: (N,) who lands and is so low that the ground may carry it.
        """
        gravity = self._certificate.limits.gravity
        stands = touching & (command[:, 0] < _CARRIED * gravity)
        if not any_of(stands):
            return command, acceleration
        command, acceleration = command.copy(), acceleration.copy()
        command[stands, 1:] = acceleration[stands, :2] = 0.0
        acceleration[stands, 2] = command[stands, 0] - gravity
        return command, acceleration

    def _brake(self, command: FloatArray, acceleration: FloatArray, sinking: np.ndarray) -> FloatArray:
        """Let drones brake that sink because they do not move as commanded, see `flight.braking`.

        Args:
            command: (N, 3) input, which is changed.
            acceleration: (N, 3) that shall come, m/s^2, which is changed.
            sinking: (N,) who sinks and has a known velocity.

        Returns:
            (N, 3) m/s^2 that is commanded for it.
        """
        yaw = self._parts.estimator.yaw
        who, wanted, asked = self._parts.senses.sinking.braking.accelerations(self.state[:, 3:5], yaw, sinking)
        commanded = acceleration.copy()
        acceleration[who, :2], commanded[who, :2] = wanted, asked
        command[who] = input_from_acceleration(commanded[who], yaw[who], self._certificate.limits.gravity)
        return commanded
