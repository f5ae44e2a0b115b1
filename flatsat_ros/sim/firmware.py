"""The Crazyflie firmware's rules on when thrust is given and taken away, for N drones at once.

A restatement of bitcraze/crazyflie-firmware, release 2026.08; the file and function behind each rule stand beside it.
The caller gives the time, in integer milliseconds as the firmware's own ticks; no clock is read.

Not modelled: deck faults, motor speed checks (bidirectional DSHOT only), the emergency stop watchdog, crash detection
by acceleration (off by default), recovery from a crash without a reboot, flightmode parameters other than stabModeYaw,
bits 8 to 11 of supervisor.info.
"""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import BoolArray, FloatArray, IntArray
from flatsat_ros.base.errors import require
from flatsat_ros.crazyflie.link import SupervisorInfo
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.sim.commander import NEVER, Commander
from flatsat_ros.sim.position_controller import PositionSetpoint
from flatsat_ros.sim.state_machine import CAN_FLY, MOTORS_ALLOWED, Conditions, State, next_state

SUPERVISOR_PERIOD = 40  # ms; stabilizer_types.h RATE_SUPERVISOR, 25 Hz
LEVEL_OUT_AGE = 500  # ms; supervisor.c COMMANDER_WDT_TIMEOUT_STABILIZE
SHUTDOWN_AGE = 2000  # ms; supervisor.c COMMANDER_WDT_TIMEOUT_SHUTDOWN
FLYING_HYSTERESIS = 2000  # ms; supervisor.c IS_FLYING_HYSTERESIS_THRESHOLD
PREFLIGHT_TIMEOUT = 30000  # ms; platform_defaults.h PREFLIGHT_TIMEOUT_MS
LANDING_TIMEOUT = 3000  # ms; platform_defaults.h LANDING_TIMEOUT_MS
FREE_FALL = 0.1  # g; supervisor.c isTumbledCheck
TILTED, TILTED_TIME = 0.5, 1000  # g, ms; platform_defaults.h SUPERVISOR_TUMBLE_CHECK_ACCEPTED_TILT_*
UPSIDE_DOWN, UPSIDE_DOWN_TIME = -0.2, 100  # g, ms; platform_defaults.h SUPERVISOR_TUMBLE_CHECK_ACCEPTED_UPSIDEDOWN_*
BATTERY_TIME = 5000  # ms; platform_defaults_cf2.h DEFAULT_BAT_LOW_DURATION_TO_TRIGGER_SEC


class Firmware:
    """The memory of N drones' firmware and the events that change it.

    Attributes:
        state: (N,) values of State.
        thrust_locked: (N,) whether thrust is ignored until a packet with thrust 0 comes.
        armed, emergency, crashed, tumbled: (N,) flags of the supervisor, see Conditions.
        battery_low: (N,) whether the battery has been low for five seconds.
        powered: (N,) whether the drone is switched on.
        high_level: the drones' high-level commanders, which take commands such as take-off.
    """

    def __init__(self, profile: VehicleProfile, count: int, *, yaw_mode: YawMode = YawMode.RATE) -> None:
        """Boot.

        Args:
            profile: the drones' kind.
            count: N.
            yaw_mode: what the yaw of a packet means, flightmode.stabModeYaw.
        """
        self._profile = profile
        self._auto_arming = not profile.motors.arming_required
        self._commander = Commander(profile, count, yaw_mode)
        self.high_level, self.thrust_locked = self._commander.high_level, self._commander.thrust_locked
        self.state = np.zeros(count, dtype=np.int64)
        self.armed, self.emergency, self.crashed, self.tumbled, self.battery_low, self.powered = np.zeros(
            (6, count), dtype=bool
        )
        self._yaw_goal = np.zeros(count)  # rad; controller_pid.c attitudeDesired.yaw
        self._lost = np.zeros((3, count), dtype=bool)  # axes whose PID integral is NaN
        # times, ms
        self._thrusting, self._tilted, self._ready, self._landed, self._not_low, self._not_critical = np.zeros(
            (6, count), dtype=np.int64
        )
        for index in range(count):
            self.reboot(index, 0)

    def reboot(self, index: int, now: int) -> None:
        """Switch drone index off and, at time now, ms, on."""
        for flags in (self.armed, self.emergency, self.crashed, self.tumbled, self.battery_low):
            flags[index] = False
        self.powered[index] = True
        self.state[index] = State.NOT_INITIALIZED
        self._commander.reset(index)
        self._lost[:, index] = False
        for times in (self._thrusting, self._tilted, self._ready, self._landed):
            times[index] = NEVER
        self._not_low[index] = self._not_critical[index] = now

    def start_flying(self, thrust: float, yaw: FloatArray) -> None:
        """Begin in the air: armed, unlocked and level since time 0 with this thrust, PWM, and (N,) yaw, rad."""
        self.armed[:] = True
        self.state[:] = State.FLYING
        self._yaw_goal = yaw
        self._thrusting[:] = 0
        self._commander.start_flying(thrust, yaw)

    def receive(self, index: int, roll: float, pitch: float, yaw: float, thrust: float, now: int) -> None:
        """Decode a set-point packet: crtp_commander_rpyt.c crtpCommanderRpytDecodeSetpoint.

        It takes the priority from the high-level commander, whose planner stops: commander.c commanderSetSetpoint. The
        firmware does not check angles for NaN; `control` has what comes of one.

        Args:
            index: the receiver.
            roll: deg, positive toward -y.
            pitch: deg, positive toward +x (the packet itself carries its negative).
            yaw: deg/s or deg, as yaw_mode says.
            thrust: 0..65535. Fractions, which the packet drops, are kept: the motors round more coarsely.
            now: ms.

        Raises:
            FlatsatError: the thrust does not fit the packet.
        """
        require(0.0 <= thrust <= PWM_FULL, "thrust", thrust, "", f"from 0 to {PWM_FULL}")
        if self.powered[index]:
            self._commander.receive(index, roll, pitch, yaw, thrust, now)

    def receive_position(self, index: int, setpoint: PositionSetpoint, now: int) -> None:
        """Take a set-point that speaks of position or velocity: crtp_commander_generic.c; see receive.

        The thrust lock is not for it: it flies a drone whose thrust is locked, and leaves the lock as it is.
        """
        if self.powered[index]:
            self._commander.receive_position(index, setpoint, now)

    def notify_setpoints_stop(self, index: int) -> None:
        """Give the priority back to the high-level commander: commander.c commanderRelaxPriority.

        The last set-point stays in force until that commander next runs; then its own takes over, a null one if its
        planner is stopped.
        """
        self._commander.notify_setpoints_stop(index)

    def plan(self, now: int, position: FloatArray, velocity: FloatArray, yaw: FloatArray) -> None:
        """Run the high-level commander and the position controller once, every HIGH_LEVEL_PERIOD.

        stabilizer.c stabilizerTask, controller_pid.c controllerPid. Without the priority the commander plans on, but
        its set-points are not used (commander.c commanderSetSetpoint). While the drone levels out, only thrust is.

        Args:
            now: ms.
            position: (N, 3) m, world, of the on-board estimate.
            velocity: (N, 3) m/s, world, likewise.
            yaw: (N,) rad, likewise.
        """
        can_fly, levelling = CAN_FLY[self.state], self.state == State.LEVEL_OUT
        fresh = self._commander.plan(now, can_fly, levelling, position, velocity, yaw)
        self._lost[:, fresh] = False  # controller_pid.c setpointModeChanged: all PIDs are reset

    def request_arming(self, index: int, arm: bool) -> bool:
        """Arm or disarm; False if refused: supervisor.c supervisorRequestArming."""
        if arm and not self.armed[index] and self.state[index] != State.PREFLIGHT_PASSED:
            return False
        self.armed[index] = arm
        return True

    def request_emergency(self, index: int) -> None:
        """Stop until reboot: crtp_supervisor.c handleSupervisorCommand, CMD_EMERGENCY_STOP."""
        self.emergency[index] = True

    def supervise(self, now: int, specific_force: FloatArray, ratio: FloatArray, voltage: FloatArray) -> None:
        """Run the supervisor once, every SUPERVISOR_PERIOD: supervisor.c supervisorUpdate.

        Args:
            now: ms.
            specific_force: (N, 3) accelerometer, body frame, g.
            ratio: (N,) motor command, 0..1.
            voltage: (N,) battery, V.
        """
        self._manage_power(now, voltage)
        self._commander.refresh(now, CAN_FLY[self.state])
        self._check_tumbled(now, specific_force)
        # isFlyingCheck: a motor above idle, or that not longer ago than the hysteresis
        self._thrusting[ratio * PWM_FULL > self._profile.motors.idle_pwm] = now
        age = now - self._commander.received
        conditions = Conditions(
            armed=self.armed,
            flying=now - self._thrusting < FLYING_HYSTERESIS,
            tumbled=self.tumbled,
            silent=age > LEVEL_OUT_AGE,
            link_lost=age > SHUTDOWN_AGE,
            emergency=self.emergency,
            crashed=self.crashed,
            preflight_over=now - self._ready > PREFLIGHT_TIMEOUT,
            landing_over=now - self._landed > LANDING_TIMEOUT,
        )
        state = next_state(self.state, conditions)
        entered = state != self.state
        self.state = state
        # postTransitionActions
        self._ready[entered & (state == State.READY_TO_FLY)] = now
        self._landed[entered & (state == State.LANDED)] = now
        self.crashed[entered & (state == State.CRASHED)] = True
        self.armed &= ~entered | MOTORS_ALLOWED[state]
        if self._auto_arming:
            self.armed |= entered & (state == State.PREFLIGHT_PASSED)

    def _check_tumbled(self, now: int, force: FloatArray) -> None:
        """Tilted for long or upside down for a moment; free fall is fine: supervisor.c isTumbledCheck."""
        tilted = force[:, 2] < TILTED
        restart = ~tilted | (np.abs(force) < FREE_FALL).all(axis=1) | (self._tilted == NEVER)
        self._tilted[restart] = now
        tilted_for = now - self._tilted
        self._tilted[~tilted] = NEVER
        upside_down = force[:, 2] < UPSIDE_DOWN
        self.tumbled = tilted & ((upside_down & (tilted_for > UPSIDE_DOWN_TIME)) | (tilted_for > TILTED_TIME))

    def _manage_power(self, now: int, voltage: FloatArray) -> None:
        """Warn at low voltage, switch off at critical voltage, each after 5 s: pm_stm32f4.c pmTask."""
        limits = self._profile.battery
        self._not_low[voltage > limits.low_voltage] = now
        self._not_critical[voltage > limits.critical_voltage] = now
        self.battery_low = now - self._not_low > BATTERY_TIME
        self.powered &= ~(self.battery_low & (now - self._not_critical > BATTERY_TIME))

    def control(self, dt: float, yaw: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Run the controller once: supervisor.c supervisorOverrideSetpoint, controller_pid.c controllerPid.

        A NaN angle makes the integral of that axis' PID NaN, whose output then becomes a torque of 0: nobody controls
        the axis until a thrust of 0 resets the PIDs (pid.c pidUpdate, attitude_pid_controller.c saturateSignedInt16).
        Without thrust the firmware leaves the attitude alone; here it goes level, which only a falling drone shows.

        Args:
            dt: since the last call, s.
            yaw: (N,) attitude, rad.

        Returns:
            (3, N) desired roll, pitch, yaw, rad, NaN for an axis that nobody controls; (N,) PWM; (N,) motors allowed.
        """
        setpoint = self._commander.setpoint
        active = self.powered & CAN_FLY[self.state] & (setpoint[3] > 0.0)
        roll, pitch, turn, thrust = np.where(active, setpoint, 0.0)
        level = self.state == State.LEVEL_OUT
        followed = np.where(self._commander.yaw_is_angle, turn, self._yaw_goal + turn * dt)
        self._yaw_goal = np.where(active, np.where(level, self._yaw_goal, followed), yaw)
        # the shorter way round
        goal = yaw + np.remainder(self._yaw_goal - yaw + np.pi, 2.0 * np.pi) - np.pi
        angles = np.array([np.where(level, 0.0, roll), np.where(level, 0.0, pitch), goal])
        self._lost = active & (self._lost | np.isnan(angles))
        return np.where(self._lost, np.nan, angles), thrust, self.powered & MOTORS_ALLOWED[self.state]

    def info(self) -> IntArray:
        """Return the (N,) supervisor.info, of `SupervisorInfo`: supervisor.c updateLogData."""
        flags = {
            SupervisorInfo.CAN_BE_ARMED: self.state == State.PREFLIGHT_PASSED,
            SupervisorInfo.ARMED: self.armed,
            SupervisorInfo.AUTO_ARMING: np.full_like(self.armed, self._auto_arming),
            SupervisorInfo.CAN_FLY: CAN_FLY[self.state],
            SupervisorInfo.FLYING: (self.state == State.FLYING) | (self.state == State.LEVEL_OUT),
            SupervisorInfo.TUMBLED: self.tumbled,
            SupervisorInfo.LOCKED: self.state == State.LOCKED,
            SupervisorInfo.CRASHED: self.crashed,
        }
        return np.asarray(
            np.sum([flag.astype(np.int64) * bit.value for bit, flag in flags.items()], axis=0, dtype=np.int64)
        )
