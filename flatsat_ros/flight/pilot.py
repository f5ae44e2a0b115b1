"""One tick of N drones: estimate, reference, law, flight mode, command. Node and simulation run this same code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from time import perf_counter
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, require_positive
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.detectors import LiftOffDetector, TouchDownDetector
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guarantee import Assessment, GuaranteeMonitor
from flatsat_ros.flight.references import References
from flatsat_ros.flight.supervisor import Mode, Policy, Supervisor, Transition
from flatsat_ros.flight.thrust import ThrustScale
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.flight.yaw import YawControl
from flatsat_ros.law.controller import Controller, Memory, Output
from flatsat_ros.law.gain import Tuning

# of a reference's margin, this much at most may be spent on a disturbance; the rest is left to steer with
_COMPENSATED_SHARE = 0.5
_TINY = 1e-300

# A landing reference sinks at most this fast, m/s, to this depth, m, below z = 0 (or below itself, should it be lower).
_LANDING_SPEED = 0.4
_LANDING_DEPTH = 0.6

_FLY, _LEVEL = Mode.FLY.value, Mode.LEVEL.value  # numpy compares with these ten times faster

# an upward acceleration of this much, m/s^2, is a command to climb
_CLIMB = 0.5


class Command(NamedTuple):
    """What one drone is told.

    Attributes:
        thrust: T, m/s^2, over the thrust scale: what the motors are asked for.
        roll: phi, rad.
        pitch: theta, rad.
        yaw_rate: psi rate, rad/s, counter-clockwise.
        yaw: psi, rad, for drones that take an angle.
    """

    thrust: float
    roll: float
    pitch: float
    yaw_rate: float
    yaw: float


@dataclass(frozen=True, eq=False)
class Tick:
    """The outcome of one tick for N drones.

    Attributes:
        mode: (N,) values of `Mode`.
        input: (N, 3) commanded (T, phi, theta): m/s^2, rad, rad; zero thrust in UNLOCK and CUT, level in LEVEL.
        yaw_rate: (N,) commanded psi rate, rad/s, counter-clockwise.
        yaw: (N,) commanded psi in [-pi, pi], rad, for drones that take an angle; it leads them by a limited angle.
        output: the law's output; it is the command in FLY only.
        reference: (N, 9) position, velocity, acceleration.
        disturbance: (N, 3) compensated disturbance, m/s^2, world frame.
        thrust_scale: (N,) estimated actual thrust over the thrust that is asked for.
        assessment: where the drones are in the certified sets; of meaning for drones in FLY only.
        transitions: the changes of modes since the tick before, and why.
        duration: computation time of the tick, s.
    """

    mode: np.ndarray
    input: FloatArray
    yaw_rate: FloatArray
    yaw: FloatArray
    output: Output
    reference: FloatArray
    disturbance: FloatArray
    thrust_scale: FloatArray
    assessment: Assessment
    transitions: tuple[Transition, ...]
    duration: float

    def command(self, index: int) -> Command | None:
        """Return what drone index is told, None in IDLE: then it is left to whoever flies it."""
        if self.mode[index] == Mode.IDLE:
            return None
        thrust, roll, pitch = self.input[index].tolist()
        scale = float(self.thrust_scale[index])
        return Command(thrust / scale, roll, pitch, float(self.yaw_rate[index]), float(self.yaw[index]))


class Pilot:
    """Flies N drones of one certificate.

    Attributes:
        certificate: what is proved of the loop.
        estimator: the drones' estimates.
        memory: the controller's gains.
    """

    def __init__(self, certificate: Certificate, tuning: Tuning, policy: Policy, count: int) -> None:
        """Start with all drones idle; tuning has one entry a drone or one for all."""
        self.certificate = certificate
        self.estimator = Estimator(count)
        self._policy = policy
        self._supervisor = Supervisor(policy, count)
        self._references = References(count)
        self._touch_down = TouchDownDetector(count)
        self._lift_off = LiftOffDetector(count, policy.lift_off_time)
        self._thrust = ThrustScale(count, policy.thrust_error_max)
        self._yaw = YawControl(count)
        self._monitor = GuaranteeMonitor(certificate, count)
        self._controller = Controller(certificate, _spread(tuning, count))
        self.memory = self._controller.start()
        self._restarts = np.zeros(count, dtype=bool)  # a new reference may restart the gain
        self._climbing = np.zeros(count, dtype=bool)  # told to climb at the last tick
        # of the last tick
        self._now = -np.inf
        self._state, self._usable = np.zeros((count, 6)), np.zeros(count, dtype=bool)

    @property
    def mode(self) -> np.ndarray:
        """(N,) values of `Mode`."""
        return self._supervisor.mode

    def retune(self, tuning: Tuning) -> None:
        """Take a new tuning from the next tick on. Gains stay where they are, below the new cap."""
        controller = Controller(self.certificate, _spread(tuning, len(self.mode)))
        self._controller = controller
        self.memory = Memory(np.minimum(self.memory.gain, controller.tuning.gain_max))

    def set_reference(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index a new reference; it takes off if it rests, and no longer lands.

        Raises:
            FlatsatError: the reference leaves no margin inside the input set, or the drone is disarmed.
        """
        self._follow(index, trajectory, patient=True)

    def _follow(self, index: int, trajectory: Trajectory, *, patient: bool) -> None:
        self._supervisor.require_armed(index)
        margin = trajectory.require_margin(self.certificate.limits)
        self._references.assign(index, trajectory, margin)
        self._supervisor.request(index, patient=patient)
        self._touch_down.end(index)
        self._restarts[index] = True

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

    def _is_high(self, index: int) -> bool:
        """Tell whether drone index is known to be above the ground."""
        return bool(self._usable[index] and self._state[index, 2] >= self._policy.ground_height)

    def take_off(self, index: int, height: float) -> None:
        """Send drone index straight up by height, m, from where it stands.

        Raises:
            FlatsatError: it does not stand, its pose is not known, it is disarmed, or the height is not above 0.
        """
        self._supervisor.require_armed(index)
        place, mode = self._state[index, :3], Mode(self.mode[index])
        if mode not in (Mode.IDLE, Mode.UNLOCK, Mode.CUT) or self._is_high(index):
            raise FlatsatError(f"the drone is in {mode.name} at z = {place[2]:.2f} m: only one on the ground takes off")
        if not self._usable[index]:
            raise FlatsatError("the drone's pose is not known: it needs fresh poses to take off")
        climb = np.array([0.0, 0.0, require_positive("height", height, "m")])
        self._follow(index, Trajectory.hold(place + climb, float(self.estimator.yaw[index])), patient=False)

    def land(self, index: int) -> None:
        """Let drone index sink until it stands on something, then rest.

        Raises:
            FlatsatError: it does not fly.
        """
        self._supervisor.require_mode(index, Mode.FLY, Mode.LEVEL, purpose="land")
        above = self._references.sample(self._now)[index, :3]
        offset = float(self._state[index, 2] - above[2])
        below = above - [0.0, 0.0, max(above[2], 0.0) + max(offset, 0.0) + _LANDING_DEPTH]
        time = 1.875 * (above[2] - below[2]) / _LANDING_SPEED  # the quintic's top speed is 1.875 times its mean
        rest, begin = np.zeros((2, 3)), self._now
        yaw = float(self._references.yaw[index])
        self._follow(index, Trajectory.through([begin, begin + time], [above, below], rest, rest, yaw), patient=True)
        # a landing keeps its gain: with a smaller one the drone would rise above the reference first
        self._restarts[index] = False
        self._touch_down.begin(index, offset)

    def hand_over(self, index: int) -> None:
        """Fall silent about drone index in flight: from now on somebody else must command it, within 0.5 s.

        Raises:
            FlatsatError: it does not fly.
        """
        self._supervisor.release(index)
        self._touch_down.end(index)

    def measure(
        self, index: int, stamp: float, position: Sequence[float], quaternion: Sequence[float], now: float
    ) -> bool:
        """Store a pose of drone index; see `Estimator.measure`."""
        return self.estimator.measure(index, stamp, position, quaternion, now)

    def tick(self, now: float) -> Tick:
        """Compute all commands at time now, s; called once per period of the certificate."""
        begin = perf_counter()
        if now < self._now:
            self.estimator.restart()
            self._supervisor.set_clock_back(now)
        self._now = now
        estimated = self.estimator.estimate(now)
        state, estimate = estimated[:, :6], estimated[:, 6:]
        self._state = state
        usable = self._usable = self.estimator.usable(now, self._policy.pose_timeout)
        reference = self._references.sample(now)
        transitions = self._supervisor.advance(
            now,
            state[:, 2],
            usable,
            self._touch_down.standing(now, state, reference),
            self._lift_off.held(now, state[:, 2], self._climbing),
        )
        if transitions:
            self._take(transitions)
        flying = self.mode == _FLY

        disturbance, spent = self._compensate(estimate, flying)
        base = reference.copy()
        base[:, 6:] -= disturbance
        output = self._steer(base, flying)
        level = self.mode == _LEVEL
        yaw_rate = self._yaw.turn(self.estimator.yaw, self._references.yaw, flying, level)
        command, acceleration = self._command(output, flying, level)

        margin = self._references.margin - spent
        fixed = self._references.at_rest & (spent == 0.0)
        assessment = self._monitor.assess(output.error, margin, fixed)
        self._monitor.follow(acceleration - np.where(flying[:, np.newaxis], base[:, 6:], 0.0))
        upward = acceleration[:, 2] + self.certificate.limits.gravity
        high = state[:, 2] >= self._policy.ground_height
        self._thrust.learn(upward, estimate[:, 2], flying & high, self.certificate.period)
        self._climbing = flying & (acceleration[:, 2] >= _CLIMB)
        self.estimator.command(now, acceleration)
        return Tick(
            mode=self.mode.copy(),
            input=command,
            yaw_rate=yaw_rate,
            yaw=self._yaw.heading,
            output=output,
            reference=reference,
            disturbance=disturbance,
            thrust_scale=self._thrust.cautious(flying),
            assessment=assessment,
            transitions=transitions,
            duration=perf_counter() - begin,
        )

    def _take(self, transitions: Sequence[Transition]) -> None:
        """Let the parts know of the drones that changed their mode."""
        gain, initial = self.memory.gain.copy(), self._controller.tuning.gain_initial
        for index, before, after, _ in transitions:
            if after in (Mode.CUT, Mode.REST):
                self._touch_down.end(index)
            elif after is Mode.UNLOCK:
                self._lift_off.begin(index, float(self._state[index, 2]))
            elif after is Mode.FLY and before is not Mode.LEVEL:
                gain[index] = initial[index]
        self.memory = Memory(gain)

    def _steer(self, base: FloatArray, flying: np.ndarray) -> Output:
        """Step the law; a new reference that is far restarts the gain first, and only drones in FLY adapt theirs."""
        yaw, tuning = self.estimator.yaw, self._controller.tuning
        memory, output = self._controller.step(self.memory, self._state, yaw, base)
        if np.count_nonzero(self._restarts):
            anew = self._restarts & flying & tuning.restart & (output.lyapunov > tuning.threshold)
            if anew.any():
                self.memory = Memory(np.where(anew, tuning.gain_initial, self.memory.gain))
                memory, output = self._controller.step(self.memory, self._state, yaw, base)
            self._restarts &= ~flying
        self.memory = Memory(np.where(flying, memory.gain, self.memory.gain))
        return output

    def _command(self, output: Output, flying: np.ndarray, level: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return input and acceleration of each mode: the law's in FLY, level in LEVEL, else zero."""
        if np.count_nonzero(flying) == flying.size:
            return output.input, output.acceleration
        flies, gravity = flying[:, np.newaxis], self.certificate.limits.gravity
        command = np.where(flies, output.input, 0.0)
        acceleration = np.where(flies, output.acceleration, 0.0)
        command[level, 0] = self._policy.level_thrust * gravity
        acceleration[level, 2] = (self._policy.level_thrust - 1.0) * gravity
        return command, acceleration

    def last_command(self, index: int) -> Command | None:
        """Return what to leave behind with drone index on shutdown: level and sinking in the air, else zero thrust.

        None for a drone in IDLE, which somebody else may fly.
        """
        mode = Mode(self.mode[index])
        if mode is Mode.IDLE:
            return None
        airborne = mode in (Mode.FLY, Mode.LEVEL)
        thrust = self._policy.level_thrust * self.certificate.limits.gravity if airborne else 0.0
        scale = float(self._thrust.cautious(np.zeros(len(self.mode), dtype=bool))[index])
        return Command(thrust / scale, 0.0, 0.0, 0.0, float(self._yaw.heading[index]))

    def _compensate(self, estimate: FloatArray, flying: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the disturbances (N, 3), m/s^2, shortened to what the margins leave over, and their sizes."""
        size = np.sqrt((estimate * estimate).sum(axis=1))
        most = np.minimum(self._policy.disturbance_max, _COMPENSATED_SHARE * self._references.margin)
        spent = np.where(flying, np.minimum(size, most), 0.0)
        return estimate * (spent / np.maximum(size, _TINY))[:, np.newaxis], spent


def _spread(tuning: Tuning, count: int) -> Tuning:
    """Return the tuning with one entry a drone."""
    return Tuning(*(np.broadcast_to(getattr(tuning, entry.name), (count,)) for entry in fields(tuning)))
