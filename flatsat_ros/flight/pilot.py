"""One tick of N drones: estimate, reference, law, flight mode, command. Node and simulation run this same code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from time import perf_counter

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, require_positive
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.estimator import Estimator
from flatsat_ros.flight.guarantee import Assessment, Watch
from flatsat_ros.flight.reference import References, Trajectory
from flatsat_ros.flight.supervisor import Mode, Policy, next_mode
from flatsat_ros.law.controller import Controller, Memory, Output
from flatsat_ros.law.gain import Tuning

# yaw is held by turning back in proportion to its error, 1/s, at most this fast, rad/s
_YAW_GAIN = 1.5
_YAW_RATE_MAX = 1.0

# of a reference's margin, this much at most may be spent on a disturbance; the rest is left to steer with
_COMPENSATED_SHARE = 0.5
_TINY = 1e-300

# the thrust scale follows its error with this time constant, s: slowly, beside the estimate of the disturbance
_THRUST_TIME = 3.0

# A landing reference sinks at most this fast, m/s, to this depth, m, below the world's floor (or below itself, should
# it be lower). The drone has touched down when the reference has left it behind by this much, m, while it is this slow,
# m/s, for this long, s.
_LANDING_SPEED = 0.4
_LANDING_DEPTH = 0.6
_TOUCH_DOWN_DISTANCE = 0.25
_TOUCH_DOWN_SPEED = 0.05
_TOUCH_DOWN_TIME = 0.5

# a drone is off the ground when it is so far, m, from the height of its unlocking; this, m/s^2, is a command to climb
_LIFT_OFF = 0.05
_CLIMB = 0.5


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
        thrust_scale: (N,) estimated actual thrust over the thrust that is asked for; ask for T / thrust_scale.
        assessment: where the drones are in the certified sets; it speaks of FLY only.
        duration: computation time of the tick, s.
    """

    mode: FloatArray
    input: FloatArray
    yaw_rate: FloatArray
    yaw: FloatArray
    output: Output
    reference: FloatArray
    disturbance: FloatArray
    thrust_scale: FloatArray
    assessment: Assessment
    duration: float


class Pilot:
    """Flies N drones of one certificate.

    Attributes:
        mode: (N,) flight modes of the last tick.
        memory: the controller's gains.
        estimator: the drones' estimates.
    """

    def __init__(self, certificate: Certificate, tuning: Tuning, policy: Policy, count: int) -> None:
        """Start with all drones idle; tuning has one entry a drone or one for all."""
        self.certificate = certificate
        self.policy = policy
        self.estimator = Estimator(count)
        self.mode = np.full(count, Mode.IDLE)
        self._references = References(count)
        self._margin = np.full(count, certificate.limits.inner_radius)
        self._watch = Watch(certificate, count)
        self._since = np.full(count, -np.inf)
        self._requested = np.zeros(count, dtype=bool)  # a reference was given since the motors were last cut
        self._waits = np.zeros(count, dtype=bool)  # the reference waits for poses that are lost; a take-off does not
        self._landing = np.zeros(count, dtype=bool)
        self._offset = np.zeros(count)  # height above the reference when the landing began, m
        self._resting_since = np.full(count, np.inf)
        self._ground = np.full(count, -np.inf)  # height at which it was unlocked, m
        self._climbing = np.zeros(count, dtype=bool)  # told to climb at the last tick
        self._held_since = np.full(count, np.inf)
        self._again = np.zeros(count, dtype=bool)  # unlocked a second time for the same reference
        self._armed = np.ones(count, dtype=bool)
        self._opening = np.zeros(count, dtype=bool)  # armed on the ground, to be unlocked
        self._state, self._usable = np.zeros((count, 6)), np.zeros(count, dtype=bool)  # of the last tick
        self._referred = np.zeros(count, dtype=bool)  # a reference was given since the last tick in flight
        self._heading = np.zeros(count)  # last commanded psi, rad
        self._thrust_scale = np.ones(count)
        self._last_tick = -np.inf
        self._level = np.array([policy.level_thrust * certificate.limits.gravity, 0.0, 0.0])
        self._controller = Controller(certificate, _spread(tuning, count))
        self.memory = self._controller.start()

    def retune(self, tuning: Tuning) -> None:
        """Take a new tuning from the next tick on. Gains stay where they are, below the new cap."""
        controller = Controller(self.certificate, _spread(tuning, len(self.mode)))
        self._controller = controller
        self.memory = Memory(np.minimum(self.memory.gain, controller.tuning.gain_max))

    def refer(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index a new reference; it takes off if it rests, and no longer lands.

        Raises:
            FlatsatError: the reference leaves no margin inside the input set, or the drone is disarmed.
        """
        self._require_armed(index)
        margin = trajectory.require_margin(self.certificate.limits)
        self._references.assign(index, trajectory)
        self._margin[index] = margin
        self._requested[index] = self._referred[index] = self._waits[index] = True
        self._landing[index] = self._again[index] = False

    def arm(self, index: int, armed: bool) -> None:
        """Allow drone index to take off, or forbid it; all are armed at first.

        Arming a drone that is known to stand on the ground also opens its thrust lock: somebody else may fly it first,
        by a way that leaves the lock closed.

        Raises:
            FlatsatError: it is in use or in the air and cannot be disarmed.
        """
        mode, high = Mode(self.mode[index]), self._is_high(index)
        if not armed and mode not in (Mode.IDLE, Mode.CUT):
            raise FlatsatError(f"the drone is in {mode.name}: it can be disarmed in IDLE or CUT only; land it first")
        if not armed and mode is Mode.IDLE and high:
            raise FlatsatError(
                f"the drone is at z = {self._state[index, 2]:.2f} m, flown by somebody else: land it first"
            )
        self._armed[index] = armed
        self._opening[index] = armed and mode in (Mode.IDLE, Mode.UNLOCK) and self._usable[index] and not high
        if not armed:
            self._requested[index] = False

    def is_opening(self, index: int) -> bool:
        """Tell whether drone index was armed on the ground and its thrust lock is about to be opened."""
        return bool(self._opening[index])

    def _is_high(self, index: int) -> bool:
        """Tell whether drone index is known to be above the ground."""
        return bool(self._usable[index] and self._state[index, 2] >= self.policy.ground_height)

    def _require_armed(self, index: int) -> None:
        if not self._armed[index]:
            raise FlatsatError("the drone is disarmed: arm it first")

    def take_off(self, index: int, height: float) -> None:
        """Send drone index straight up by height, m, from where it stands.

        Raises:
            FlatsatError: it does not stand, its pose is not known, it is disarmed, or the height is not above 0.
        """
        self._require_armed(index)
        mode, place = Mode(self.mode[index]), self._state[index]
        if mode not in (Mode.IDLE, Mode.UNLOCK, Mode.CUT) or self._is_high(index):
            raise FlatsatError(f"the drone is in {mode.name} at z = {place[2]:.2f} m: only one on the ground takes off")
        if not self._usable[index]:
            raise FlatsatError("the drone's pose is not known: it needs fresh poses to take off")
        climb = np.array([0.0, 0.0, require_positive("height", height, "m")])
        self.refer(index, Trajectory.hold(place[:3] + climb, float(self.estimator.yaw[index])))
        self._waits[index] = False

    def land(self, index: int) -> None:
        """Let drone index sink until it stands on something, then rest.

        Raises:
            FlatsatError: it does not fly.
        """
        if self.mode[index] not in (Mode.FLY, Mode.LEVEL):
            raise FlatsatError(f"the drone is in {Mode(self.mode[index]).name}: only one in FLY or LEVEL can land")
        above = self._references.sample(self._last_tick)[index, :3]
        offset = float(self._state[index, 2] - above[2])
        below = above - [0.0, 0.0, max(above[2], 0.0) + max(offset, 0.0) + _LANDING_DEPTH]
        time = 1.875 * (above[2] - below[2]) / _LANDING_SPEED  # the quintic's top speed is 1.875 times its mean
        rest, begin = np.zeros((2, 3)), self._last_tick
        yaw = float(self._references.yaw[index])
        self.refer(index, Trajectory.through([begin, begin + time], [above, below], rest, rest, yaw))
        # a landing keeps its gain: with a smaller one the drone would rise above the reference first
        self._landing[index], self._offset[index], self._referred[index] = True, offset, False

    def hand_over(self, index: int) -> None:
        """Fall silent about drone index in flight: from now on somebody else must command it, within 0.5 s.

        Raises:
            FlatsatError: it does not fly.
        """
        if self.mode[index] != Mode.FLY:
            raise FlatsatError(f"the drone is in {Mode(self.mode[index]).name}: only one in FLY can be handed over")
        self.mode[index], self._requested[index] = Mode.IDLE, False

    def measure(
        self, index: int, stamp: float, position: Sequence[float], quaternion: Sequence[float], now: float
    ) -> bool:
        """Store a pose of drone index; see `Estimator.measure`."""
        return self.estimator.measure(index, stamp, position, quaternion, now)

    def tick(self, now: float) -> Tick:
        """Compute all commands at time now, s; called once per period of the certificate."""
        begin = perf_counter()
        if now < self._last_tick:
            self.estimator.restart()
            self._since = np.minimum(self._since, now)
        self._last_tick = now
        self._state = self.estimator.estimate(now)
        self._usable = self.estimator.usable(now, self.policy.pose_timeout)
        reference = self._references.sample(now)
        self._advance_modes(now, self._touched_down(now, reference), self._stuck(now))

        disturbance = self._compensated()
        base = reference.copy()
        base[:, 6:] -= disturbance
        output = self._steer(base)
        command, acceleration, yaw_rate = self._command(output)

        margin = self._margin - np.sqrt((disturbance * disturbance).sum(axis=1))
        assessment = self._watch.assess(output.error, margin, np.asarray(~base[:, 3:].any(axis=1)))
        self._climbing = (self.mode == Mode.FLY.value) & (acceleration[:, 2] >= _CLIMB)
        if self.policy.thrust_error_max > 0.0:
            self._follow_thrust(acceleration)
        self._watch.follow(acceleration)
        self.estimator.command(now, acceleration)
        duration = perf_counter() - begin
        return Tick(
            self.mode.copy(),
            command,
            yaw_rate,
            self._heading,
            output,
            reference,
            disturbance,
            self._careful_thrust_scale(),
            assessment,
            duration,
        )

    def _steer(self, base: FloatArray) -> Output:
        """Step the law; a new reference that is far restarts the gain first, and only drones in FLY adapt theirs."""
        yaw, tuning, flying = self.estimator.yaw, self._controller.tuning, self.mode == Mode.FLY.value
        memory, output = self._controller.step(self.memory, self._state, yaw, base)
        anew = self._referred & flying & tuning.restart & (output.lyapunov > tuning.threshold)
        if anew.any():
            self.memory = Memory(np.where(anew, tuning.gain_initial, self.memory.gain))
            memory, output = self._controller.step(self.memory, self._state, yaw, base)
        self._referred &= ~flying
        self.memory = Memory(np.where(flying, memory.gain, self.memory.gain))
        return output

    def _command(self, output: Output) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return input, acceleration and yaw rate of each mode: the law's in FLY, level in LEVEL, else zero."""
        yaw = self.estimator.yaw
        error = _wrapped(self._references.yaw - yaw)
        turn = np.clip(_YAW_GAIN * error, -_YAW_RATE_MAX, _YAW_RATE_MAX)
        flying = self.mode == Mode.FLY.value
        heading = _wrapped(yaw + turn / _YAW_GAIN)
        if flying.all():
            self._heading = heading
            return output.input, output.acceleration, turn
        level, flies = self.mode == Mode.LEVEL.value, flying[:, np.newaxis]
        # level without poses, a drone keeps its heading; on the ground it has none to keep
        self._heading = np.where(flying, heading, np.where(level, self._heading, yaw))
        command = np.where(flies, output.input, np.where(level[:, np.newaxis], self._level, 0.0))
        acceleration = np.where(flies, output.acceleration, 0.0)
        acceleration[level, 2] = self._level[0] - self.certificate.limits.gravity
        return command, acceleration, np.where(flying, turn, 0.0)

    def _touched_down(self, now: float, reference: FloatArray) -> np.ndarray:
        """Tell which landing drones stand: their reference has left them behind, and they have rested for a while."""
        below = self._state[:, 2] - reference[:, 2] - self._offset > _TOUCH_DOWN_DISTANCE
        resting = self._landing & below & (np.abs(self._state[:, 5]) < _TOUCH_DOWN_SPEED)
        self._resting_since = np.where(resting, np.minimum(self._resting_since, now), np.inf)
        return np.asarray(now - self._resting_since >= _TOUCH_DOWN_TIME)

    def _stuck(self, now: float) -> np.ndarray:
        """Tell which drones have been told to climb for the lift-off time and have not left the ground."""
        self._ground[np.abs(self._state[:, 2] - self._ground) >= _LIFT_OFF] = -np.inf
        held = self._climbing & np.isfinite(self._ground)
        self._held_since = np.where(held, np.minimum(self._held_since, now), np.inf)
        return np.asarray(now - self._held_since >= self.policy.lift_off_time)

    def last_input(self) -> FloatArray:
        """Return the inputs (N, 3) to leave behind on shutdown: level and sinking for drones in the air, else zero."""
        airborne = (self.mode == Mode.FLY.value) | (self.mode == Mode.LEVEL.value)
        return np.where(airborne[:, np.newaxis], self._level, 0.0)

    def _compensated(self) -> FloatArray:
        """Return the estimated disturbances (N, 3), m/s^2, shortened to what the margins leave over."""
        estimate = self.estimator.disturbance
        size = np.sqrt((estimate * estimate).sum(axis=1))
        most = np.minimum(self.policy.disturbance_max, _COMPENSATED_SHARE * self._margin)
        factor = np.where(self.mode == Mode.FLY.value, np.minimum(1.0, most / np.maximum(size, _TINY)), 0.0)
        return np.asarray(estimate * factor[:, np.newaxis])

    def _follow_thrust(self, acceleration: FloatArray) -> None:
        """Take what disturbs vertically for an error of the thrust, slowly: d_z = (actual / asked for - 1) T_z.

        Not near the ground, which may carry the drone.
        """
        upward = acceleration[:, 2] + self.certificate.limits.gravity
        flying = (self.mode == Mode.FLY.value) & (self._state[:, 2] >= self.policy.ground_height) & (upward > 0.0)
        error = np.where(flying, self.estimator.disturbance[:, 2] / np.maximum(upward, _TINY), 0.0)
        most = self.policy.thrust_error_max
        step = self.certificate.period / _THRUST_TIME
        self._thrust_scale = np.clip(self._thrust_scale * (1.0 + step * error), 1.0 - most, 1.0 + most)

    def _careful_thrust_scale(self) -> FloatArray:
        """Return the thrust scale, no less than 1 for drones that are not steered: they shall not climb by mistake."""
        flying = self.mode == Mode.FLY.value
        return np.where(flying, self._thrust_scale, np.maximum(self._thrust_scale, 1.0))

    def _advance_modes(self, now: float, down: np.ndarray, stuck: np.ndarray) -> None:
        for i in np.flatnonzero((self.mode != Mode.FLY.value) | ~self._usable | down | stuck):
            before = Mode(self.mode[i])
            after = next_mode(
                before,
                now - self._since[i],
                requested=bool(self._requested[i]),
                usable=bool(self._usable[i]),
                height=float(self._state[i, 2]),
                down=bool(down[i]),
                policy=self.policy,
                opening=bool(self._opening[i]),
                stuck=bool(stuck[i]),
                again=bool(self._again[i]),
            )
            self._opening[i] &= after is Mode.UNLOCK
            if after is before:
                continue
            self.mode[i], self._since[i] = after, now
            if after in (Mode.CUT, Mode.REST):
                self._requested[i] = self._landing[i] = False
            elif after is Mode.UNLOCK:
                self._ground[i], self._again[i] = self._state[i, 2], before is Mode.FLY
            elif after is Mode.IDLE:
                self._requested[i] &= self._waits[i]
            elif after is Mode.FLY and before is not Mode.LEVEL:
                self.memory.gain[i] = self._controller.tuning.gain_initial[i]


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return the same angles in [-pi, pi]."""
    return np.asarray(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi)


def _spread(tuning: Tuning, count: int) -> Tuning:
    """Return the tuning with one entry a drone."""
    return Tuning(*(np.broadcast_to(getattr(tuning, entry.name), (count,)) for entry in fields(tuning)))
