"""One tick of N drones: estimate, reference, law, flight mode, command. Node and simulation run this same code."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import FlatsatError, require_positive
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.battery import Batteries, Charge, Limits
from flatsat_ros.flight.clearance import Cause, Clearance
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guidance import Guidance
from flatsat_ros.flight.loops import DirectLoop, Loop, PredictedLoop
from flatsat_ros.flight.modes import AIRBORNE, Mode, Transition
from flatsat_ros.flight.orientation import Orientations
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.senses import Senses
from flatsat_ros.flight.steering import Steering
from flatsat_ros.flight.supervisor import Supervisor
from flatsat_ros.flight.tick import Command, Report, Tick
from flatsat_ros.flight.traffic import Traffic
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.flight.yaw import YawControl
from flatsat_ros.law.controller import Memory, Output
from flatsat_ros.law.flatness import input_from_acceleration
from flatsat_ros.law.gain import Tuning

# a thrust of this share of T_max is at its limit
_FULL = 0.98
# s: after so long without a tick that is told; the firmware takes set-points for lost after 0.5 s
_PAUSE = 0.2

_FLY, _LEVEL, _DESCEND = (mode.value for mode in AIRBORNE)  # numpy compares with these ten times faster
_GROUNDED = np.array([mode not in AIRBORNE for mode in Mode])  # of each mode


class Pilot:
    """Flies N drones of one certificate.

    Attributes:
        certificate: what is proved of the loop.
        estimator: the drones' estimates.
        batteries: what is known of their batteries.
        clearance: what keeps drones on the ground.
        traffic: who goes where, and who waits for whom.
    """

    def __init__(
        self,
        certificate: Certificate,
        tuning: Tuning,
        policy: Policy,
        count: int,
        names: Sequence[str] | None = None,
        others: Sequence[str] = (),
    ) -> None:
        """Start with all drones idle.

        Args:
            certificate: what is proved of the loop.
            tuning: of the gains, one entry a drone or one for all.
            policy: the figures of the flight layer.
            count: N.
            names: of the drones, for people; None for their numbers.
            others: names of robots that are not flown here, but whose poses are known, see `Traffic.see`.
        """
        self.certificate = certificate
        self.estimator = Estimator(count)
        self.batteries, self.clearance = Batteries(count), Clearance()
        self._policy = policy
        self._orientations = Orientations(self.estimator, policy.yaw_source, count)
        self._supervisor = Supervisor(policy, count)
        flight = certificate.flight
        self._guidance = Guidance(certificate.limits, policy.speed_max, policy.box, count, flight)
        known_as = [f"drone {index}" for index in range(count)] if names is None else names
        self.traffic = Traffic(policy, self._guidance, self._supervisor, known_as, others)
        self._senses = Senses(certificate, policy, count)
        references = self._guidance.references
        self._loop: Loop = (
            DirectLoop(certificate, policy, references, self.estimator)
            if flight is None
            else PredictedLoop(certificate, flight, policy, references, self.estimator)
        )
        self._yaw = YawControl(count)
        self._steering = Steering(certificate, tuning, count)
        self._now = -np.inf  # of the last tick, as are the next ones
        self._state, self._usable = np.zeros((count, 6)), np.zeros(count, dtype=bool)
        self._full = np.zeros(count, dtype=bool)  # thrust at its limit
        self._reports: list[Report] = []  # made between two ticks

    @property
    def memory(self) -> Memory:
        """The controller's gains."""
        return self._steering.memory

    @property
    def mode(self) -> np.ndarray:
        """(N,) values of `Mode`."""
        return self._supervisor.mode

    def retune(self, tuning: Tuning) -> None:
        """Take a new tuning from the next tick on. Gains stay where they are, below the new cap."""
        self._steering.retune(tuning)

    def set_goal(self, index: int, position: ArrayLike, yaw: float = 0.0) -> None:
        """Give drone index a goal (3,), m, to rest at, and a yaw, rad; it takes off if it rests, and no longer lands.

        Where other drones are in its way, it sets out later.

        Raises:
            FlatsatError: goal or yaw is not finite, the goal is outside the box or another drone's place, or the drone
                must not take off.
        """
        if self._policy.goal_mode is GoalMode.STEP:
            self.set_reference(index, Trajectory.hold(position, yaw))
            return
        self._require_clear(index)
        if self.traffic.admit_goal(index, position, float(finite_array("yaw", yaw))):
            self._begin(index, patient=True)

    def set_reference(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index a trajectory; it takes off if it rests, and no longer lands.

        Raises:
            FlatsatError: it leaves the box or no margin inside the input set, comes near another drone, or the drone
                must not take off.
        """
        self._require_clear(index)
        path_mode = self._policy.goal_mode is GoalMode.PATH
        if path_mode and trajectory.times.size == 1:
            self.set_goal(index, trajectory.end, trajectory.yaw)
            return
        if path_mode and self.mode[index] == _FLY:
            self._guidance.require_near(index, trajectory, self._now)
        self.traffic.admit_trajectory(index, trajectory)
        self._begin(index, patient=True)

    def set_planned(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index, which flies, its part of a plan whose pairs `traffic` was told with `Traffic.prove`.

        Raises:
            FlatsatError: it does not fly, or see `set_reference`.
        """
        self._supervisor.require_mode(index, Mode.FLY, purpose="fly a plan")
        self._require_clear(index)
        self._guidance.require_near(index, trajectory, self._now)
        self.traffic.admit_planned(index, trajectory)
        self._begin(index, patient=False)

    def require_ready(self, index: int) -> None:
        """Refuse drone index if it neither flies nor may take off.

        Raises:
            FlatsatError: it is in another mode, disarmed, or something keeps it on the ground.
        """
        self._require_clear(index)
        if self.mode[index] != _FLY and not self._usable[index]:
            raise FlatsatError("the drone's pose is not known: it needs fresh poses")
        modes = (Mode.FLY, Mode.IDLE, Mode.UNLOCK, Mode.CUT, Mode.REST)
        self._supervisor.require_mode(index, *modes, purpose="set out")

    def follows(self, index: int) -> Trajectory | None:
        """Return the reference of drone index while it flies, else None."""
        return self._guidance.references.trajectory(index) if self.mode[index] == _FLY else None

    def is_at_rest(self, index: int) -> bool:
        """Tell whether drone index flies and its reference stays where it is, and it is not landing."""
        resting = self._guidance.references.at_rest[index] and not self._guidance.landing[index]
        return bool(resting and self.mode[index] == _FLY)

    def _require_clear(self, index: int) -> None:
        """Refuse a reference for drone index if it must not take off, or lands because its battery is empty.

        Raises:
            FlatsatError: it is disarmed, has fallen, or something else keeps it on the ground.
        """
        self._supervisor.require_armed(index)
        if self.mode[index] not in AIRBORNE or self.batteries.charges[index] is Charge.EMPTY:
            self.clearance.require(index)

    def _begin(self, index: int, *, patient: bool) -> None:
        """Let a new reference of drone index be flown."""
        self._supervisor.request(index, patient=patient)
        self._steering.note_reference(index)
        if self.mode[index] == _FLY:
            self._guidance.replan(index, self._now)

    def hold(self, index: int) -> None:
        """Let drone index brake and stay where it comes to rest.

        Raises:
            FlatsatError: it does not fly, or lands because its battery is empty.
        """
        self._supervisor.require_mode(index, Mode.FLY, purpose="hold its place")
        self._require_clear(index)
        self.traffic.withdraw(index)
        self._guidance.brake(index, self._now)

    def arm(self, index: int, armed: bool) -> None:
        """Allow drone index to take off, or forbid it; all are armed at first.

        Arming a drone that is known to stand on the ground also opens its thrust lock: somebody else may fly it first,
        by a way that leaves the lock closed.

        Raises:
            FlatsatError: it is in use or in the air and cannot be disarmed.
        """
        height = float(self._state[index, 2]) if self._usable[index] else None
        self._supervisor.arm(index, armed, height)

    def is_opening(self, index: int) -> bool:
        """Tell whether drone index was armed on the ground and its thrust lock is about to be opened."""
        return bool(self._supervisor.unlocking[index])

    def take_off(self, index: int, height: float) -> None:
        """Send drone index straight up by height, m, from where it stands.

        Raises:
            FlatsatError: it does not stand, its pose is not known, it must not take off, the height is not above 0 or
                ends outside the box, or another drone is in the way.
        """
        self._require_clear(index)
        place, mode = self._state[index, :3], Mode(self.mode[index])
        if mode not in (Mode.IDLE, Mode.UNLOCK, Mode.CUT) or self._senses.moves(index, self._state[index]):
            raise FlatsatError(f"the drone is in {mode.name} at z = {place[2]:.2f} m: only one on the ground takes off")
        if not self._usable[index]:
            raise FlatsatError("the drone's pose is not known: it needs fresh poses to take off")
        if reason := self._orientations.unready(index):
            raise FlatsatError(reason)
        climb = np.array([0.0, 0.0, require_positive("height", height, "m")])
        yaw = float(self.estimator.yaw[index])
        if self._policy.goal_mode is GoalMode.STEP:
            self._guidance.follow(index, Trajectory.hold(place + climb, yaw))
        else:
            self.traffic.admit_take_off(index, place + climb, yaw)
        self._begin(index, patient=False)

    def land(self, index: int) -> None:
        """Let drone index brake, sink where it is until something carries it, then rest.

        Raises:
            FlatsatError: it is not in the air, or another drone stays below.
        """
        self._supervisor.require_mode(index, *AIRBORNE, purpose="land")
        self.traffic.admit_landing(index)
        self._guidance.land(index, self._now)

    def retire(self) -> None:
        """Land every drone that is in the air where it is, and let none take off any more."""
        for index, mode in enumerate(self.mode):
            if mode in AIRBORNE:
                self._guidance.land(index, self._now)
            self._supervisor.withdraw(index)

    def unclaimed(self, index: int) -> str:
        """Return why the tube of the certificate's flight section is not claimed of drone index; empty if it is."""
        return self._loop.unclaimed(index)

    @property
    def height(self) -> FloatArray:
        """(N,) estimated z of the last tick, m."""
        return self._state[:, 2]

    @property
    def places(self) -> FloatArray:
        """(N, 3) estimated positions of the last tick, m, world frame."""
        return self._state[:, :3]

    def hand_over(self, index: int) -> None:
        """Fall silent about drone index in flight: from now on somebody else must command it, within 0.5 s.

        Raises:
            FlatsatError: it does not fly.
        """
        self._supervisor.release(index)
        self._guidance.landing[index] = False

    def measure(
        self, index: int, stamp: float, position: Sequence[float], quaternion: Sequence[float], now: float
    ) -> bool:
        """Store a pose of drone index; see `Estimator.measure`."""
        return self.estimator.measure(index, stamp, position, quaternion, now)

    def note_battery(self, index: int, voltage: float, limits: Limits, now: float) -> None:
        """Take in a battery voltage, V, of drone index; an empty one makes it land, see `flight.battery`."""
        finding = self.batteries.measure(index, voltage, limits, now)
        self.clearance.bar(index, Cause.BATTERY, self.batteries.refusal(index))
        if finding is None:
            return
        done = ""
        if finding.charge is Charge.EMPTY:
            done = ": it does not take off"
            self.traffic.withdraw(index)
            if self.mode[index] in AIRBORNE:
                done = ": it brakes and lands"
                self._guidance.land(index, self._now)
        self._reports.append(Report(index, finding.text + done))

    def tick(self, now: float) -> Tick:
        """Compute all commands at time now, s; called once per period of the certificate."""
        begin = perf_counter()
        if now < self._now:
            self.estimator.restart()
            self._supervisor.set_clock_back(now)
            self._senses.set_clock_back(now)
            self.traffic.set_clock_back()
        elif now - self._now > _PAUSE:
            self._reports += self._paused(now - self._now)
        self._now = now
        for index, reason in self.clearance.barred():
            if self._supervisor.call_off(index):
                self._reports.append(Report(index, f"its take-off is called off: {reason}"))
        estimated = self._loop.estimate(now, self._senses.due)
        state, estimate = estimated[:, :6], estimated[:, 6:]
        self._state = state
        usable = self._usable = self.estimator.usable(now, self._policy.pose_timeout)
        grounded = _GROUNDED[self.mode]
        ready = usable & ~(grounded & self._orientations.unready_all()) if np.count_nonzero(grounded) else usable
        sight = self._senses.look(now, estimated, ready, self.mode, self._guidance)
        transitions = self._supervisor.advance(now, sight)
        self.traffic.note(now, state, usable)
        if transitions:
            self._take(transitions, estimated)
        if self.traffic.is_due:
            for index in self.traffic.look():
                self._begin(index, patient=True)
            self._reports += self.traffic.reports()
        flying = self.mode == _FLY
        references = self._guidance.references
        reference = references.sample(now)
        self._guidance.update(now, state, reference, flying, self._full)
        for index, text in self._guidance.outside(state):
            if flying[index]:
                self._guidance.land(index, now)
                self._reports.append(Report(index, f"{text}: it brakes and lands"))
        aim = self._loop.aim(now, estimated, reference, flying)
        output = self._steering.step(aim.state, self.estimator.yaw, aim.base, flying)
        level = (self.mode == _LEVEL) | (self.mode == _DESCEND)
        turned, kept = flying, level
        unseen = self._orientations.unseen(now)
        if np.count_nonzero(unseen):
            turned, kept = flying & ~unseen, level | (flying & unseen)
            for index in self._orientations.patience_ends(now, flying):
                self._guidance.land(index, now)
                self._reports.append(Report(index, "its orientation is not seen and yaw_source is measured: it lands"))
        yaw_rate = self._yaw.turn(self.estimator.yaw, references.yaw, turned, kept)
        command, acceleration = self._command(now, output, flying, level)
        commanded = acceleration  # as far as the yaw is right
        if np.count_nonzero(self._senses.braking.active):
            commanded = self._brake(command, acceleration, level & usable)

        assessment = self._loop.assess(output, acceleration, flying)
        free = self._senses.note(commanded, estimated, self.estimator.yaw, flying, self._guidance.landing)
        if self._policy.goal_mode is GoalMode.PATH:  # steps take a drone to its limit by themselves
            for index in self._senses.at_limit(now, aim.base, estimate, aim.error, self._guidance.landing):
                if flying[index]:
                    self._guidance.land(index, now, state[index, :3])
        for index in self._loop.astray():
            if free[index] and not self._guidance.landing[index]:
                self._guidance.land(index, now)
                self._reports.append(
                    Report(index, "it is where it cannot be if nothing is broken: it brakes and lands")
                )
        self._full = command[:, 0] >= _FULL * self.certificate.limits.thrust_max
        changing = bool(transitions) or self._senses.looked
        aloft = level | (flying & ~self._senses.grounded) if changing else None
        self.estimator.command(now, acceleration, free, aloft)
        told = self._senses.reports() + self.estimator.complaints() + self._loop.reports(free)
        reports, self._reports = self._reports + [Report(*entry) for entry in told], []
        return Tick(
            mode=self.mode.copy(),
            input=command,
            yaw_rate=yaw_rate,
            yaw=self._yaw.heading,
            output=output,
            reference=reference,
            error=aim.error,
            disturbance=aim.disturbance,
            thrust_scale=self._senses.thrust.cautious(flying),
            assessment=assessment,
            transitions=transitions,
            reports=tuple(reports),
            duration=perf_counter() - begin,
        )

    def _paused(self, seconds: float) -> list[Report]:
        """Return what is told of the drones in the air when there was no tick for some time, s."""
        text = f"no tick for {seconds:.2f} s: the controller or its machine stood still, and no commands were sent"
        return [] if seconds == np.inf else [Report(int(i), text) for i in np.flatnonzero(~_GROUNDED[self.mode])]

    def _take(self, transitions: Sequence[Transition], estimated: FloatArray) -> None:
        """Let the parts know of the drones that changed their mode."""
        reset = []
        for index, before, after, _ in transitions:
            ground = self._senses.enter(index, before, after, estimated[index], self._now, self._guidance)
            if ground is not None:
                self._guidance.ground[index] = ground
            if after is Mode.FLY:
                if before not in (Mode.LEVEL, Mode.DESCEND):
                    reset.append(index)
                if self._policy.goal_mode is GoalMode.PATH:
                    self._set_out(index, before, estimated[index, :6])
            elif after in (Mode.CUT, Mode.REST, Mode.FALLEN):
                self._guidance.landing[index] = False
                reset.append(index)
        self._steering.reset(*reset)
        self.traffic.follow(transitions)

    def _set_out(self, index: int, before: Mode, state: FloatArray) -> None:
        """Let drone index, with a state (6,), set out from where it is: its flight begins, or goes on after a mode."""
        end = self._guidance.destination(index)
        away = self._guidance.start(index, state, self._now)
        if not away or end is None:
            return
        if before not in (Mode.LEVEL, Mode.DESCEND):
            self._reports.append(Report(index, f"its trajectory is {away:.2f} m away: it stays where it is"))
        elif self.traffic.lead_on(index, end):
            self._guidance.replan(index, self._now)
        self._reports += self.traffic.reports()

    def _command(
        self, now: float, output: Output, flying: np.ndarray, level: np.ndarray
    ) -> tuple[FloatArray, FloatArray]:
        """Return input and acceleration of each mode: the law's in FLY, level without position, else zero."""
        if np.count_nonzero(flying) == flying.size:
            return output.input, output.acceleration
        flies = flying[:, np.newaxis]
        command = np.where(flies, output.input, 0.0)
        acceleration = np.where(flies, output.acceleration, 0.0)
        if np.count_nonzero(level):
            thrust = self._senses.descent.thrust(now)
            command[level, 0] = thrust[level]
            acceleration[level, 2] = thrust[level] - self.certificate.limits.gravity
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
        yaw = self.estimator.yaw
        who, wanted, asked = self._senses.braking.accelerations(self._state[:, 3:5], yaw, sinking)
        commanded = acceleration.copy()
        acceleration[who, :2], commanded[who, :2] = wanted, asked
        command[who] = input_from_acceleration(commanded[who], yaw[who], self.certificate.limits.gravity)
        return commanded

    def last_command(self, index: int) -> Command | None:
        """Return what to leave behind with drone index on shutdown: level and sinking in the air, else zero thrust.

        None for a drone in IDLE, which somebody else may fly.
        """
        mode = Mode(self.mode[index])
        if mode is Mode.IDLE:
            return None
        thrust = self._policy.level_thrust * self.certificate.limits.gravity if mode in AIRBORNE else 0.0
        scale = float(self._senses.thrust.cautious(np.zeros(len(self.mode), dtype=bool))[index])
        return Command(thrust / scale, 0.0, 0.0, 0.0, float(self._yaw.heading[index]))
