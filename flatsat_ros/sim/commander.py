"""The Crazyflie firmware's set-points: what packets say, and whose set-points have the priority, for N drones at once.

A restatement of bitcraze/crazyflie-firmware, release 2026.08, commander.c, crtp_commander_rpyt.c and
crtp_commander_generic.c: the high-level commander flies until a set-point comes over the link, and again when the link
gives the priority back. The times are in integer milliseconds, as in `sim.firmware`.
"""

from __future__ import annotations

import math

import numpy as np

from flatsat_ros.base.arrays import BoolArray, FloatArray
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.sim.high_level import HighLevelCommander
from flatsat_ros.sim.position_controller import (
    PositionController,
    PositionSetpoint,
    SetpointMode,
    Velocities,
    along_heading,
)

THRUST_MIN = 1000  # PWM; crtp_commander_rpyt.c MIN_THRUST
NEVER = -(10**9)  # ms; an event that has not happened


class Commander:
    """The set-points in force of N drones, and where the next ones come from.

    Attributes:
        setpoint: (4, N) roll, pitch, rad; yaw, rad, or yaw rate, rad/s counter-clockwise; thrust, PWM.
        yaw_is_angle: (N,) which of both the third is.
        thrust_locked: (N,) whether thrust is ignored until a packet with thrust 0 comes.
        received: (N,) ms, when the newest set-point came.
        high_level: the drones' high-level commanders, which take commands such as take-off.
    """

    def __init__(self, profile: VehicleProfile, count: int, yaw_mode: YawMode) -> None:
        """Boot; `reset` makes each drone ready.

        Args:
            profile: the drones' kind.
            count: N.
            yaw_mode: what the yaw of a packet means, flightmode.stabModeYaw.
        """
        self._pwm_max, self._yaw_mode = profile.pwm_max, yaw_mode
        self.high_level = HighLevelCommander(count)
        self._position_controller = PositionController(count, profile.motors.hover_pwm)
        self.setpoint = np.zeros((4, count))
        self.yaw_is_angle, self.thrust_locked = np.zeros((2, count), dtype=bool)
        self.received = np.zeros(count, dtype=np.int64)
        # commander.c: the priority is the high-level commander's, which then owns the set-point
        self._relaxed = np.zeros(count, dtype=bool)
        # what the position controller follows where it makes the set-point, else ATTITUDE
        self._mode = np.zeros(count, dtype=np.int64)
        # the last set-point of the link, if it speaks of position or velocity, else ATTITUDE
        self._streamed = np.zeros(count, dtype=np.int64)
        self._place, self._velocity = np.zeros((2, 3, count))  # m, m/s

    def reset(self, index: int) -> None:
        """Forget all set-points of drone index: its firmware boots."""
        self.thrust_locked[index] = True  # crtp_commander_rpyt.c, initial value
        self._relaxed[index] = True  # commander.c commanderInit: no priority yet
        self.setpoint[:, index] = 0.0
        self.yaw_is_angle[index] = self._yaw_mode is YawMode.ANGLE
        self._mode[index] = self._streamed[index] = SetpointMode.ATTITUDE
        self.high_level.group_mask[index] = 0
        self.received[index] = NEVER

    def start_flying(self, thrust: float, yaw: FloatArray) -> None:
        """Begin unlocked and level since time 0, by set-points with a thrust, PWM, and (N,) yaw, rad."""
        self.thrust_locked[:] = self._relaxed[:] = False
        if self._yaw_mode is YawMode.ANGLE:
            self.setpoint[2] = yaw
        self.setpoint[3] = thrust
        self.received[:] = 0

    def receive(self, index: int, roll: float, pitch: float, yaw: float, thrust: float, now: int) -> None:
        """Decode a set-point packet; the arguments are those of `Firmware.receive`."""
        if thrust < 1.0:  # 0 in the packet
            self.thrust_locked[index] = False
        ignored = self.thrust_locked[index] or thrust < THRUST_MIN
        accepted = 0.0 if ignored else min(thrust, self._pwm_max)
        angles = (roll, pitch, self._yaw_mode.sign * yaw)
        finite = (math.radians(angle) if math.isfinite(angle) else math.nan for angle in angles)
        self.setpoint[:, index] = *finite, accepted
        self.yaw_is_angle[index] = self._yaw_mode is YawMode.ANGLE
        self._mode[index] = SetpointMode.ATTITUDE
        self._take_over(index, SetpointMode.ATTITUDE, now)

    def receive_position(self, index: int, setpoint: PositionSetpoint, now: int) -> None:
        """Take a set-point that speaks of position or velocity; see `Firmware.receive_position`."""
        self.setpoint[2, index] = setpoint.yaw
        self.yaw_is_angle[index] = setpoint.mode in (SetpointMode.POSITION, SetpointMode.FULL_STATE)
        self._place[:, index], self._velocity[:, index] = setpoint.place, setpoint.velocity
        self._take_over(index, setpoint.mode, now)

    def _take_over(self, index: int, mode: SetpointMode, now: int) -> None:
        """Give a set-point of the link the priority: commander.c commanderSetSetpoint."""
        self._streamed[index] = mode
        self.received[index] = now
        self._relaxed[index] = False
        self.high_level.stop(index)

    def notify_setpoints_stop(self, index: int) -> None:
        """Give the priority back to the high-level commander: commander.c commanderRelaxPriority.

        The last set-point stays in force until that commander next runs; then its own takes over, a null one if its
        planner is stopped.
        """
        self._relaxed[index] = True

    def refresh(self, now: int, can_fly: BoolArray) -> None:
        """Take the set-points of high-level commanders, null ones too, for fresh: stabilizer.c stabilizerTask.

        Args:
            now: ms.
            can_fly: (N,) who may fly.
        """
        self.received[self._relaxed & can_fly] = now

    def plan(
        self,
        now: int,
        can_fly: BoolArray,
        levelling: BoolArray,
        position: FloatArray,
        velocity: FloatArray,
        yaw: FloatArray,
    ) -> BoolArray:
        """Run the high-level commander and the position controller once, see `Firmware.plan`.

        Args:
            now: ms.
            can_fly: (N,) who may fly.
            levelling: (N,) who levels out.
            position: (N, 3) m, world, of the on-board estimate.
            velocity: (N, 3) m/s, world, likewise.
            yaw: (N,) rad, likewise.

        Returns:
            (N,) whose set-point is of another mode than the one before.
        """
        self.high_level.update(now, ~can_fly, position, velocity, yaw)
        heard = self._relaxed & can_fly
        streamed = can_fly & ~self._relaxed & (self._streamed != SetpointMode.ATTITUDE)
        none = np.zeros_like(heard)
        if not (heard | streamed).any():
            return none
        flown = heard & self.high_level.following
        self.setpoint[:, heard & ~flown] = 0.0  # crtp_commander_high_level.c nullSetpoint
        guided = flown | streamed
        # supervisor.c supervisorOverrideSetpoint changes the mode of what levels out
        mode = np.where(levelling, SetpointMode.LEVEL, np.where(flown, SetpointMode.POSITION, self._streamed))
        mode[~guided] = SetpointMode.ATTITUDE
        fresh: BoolArray = np.asarray(guided & (mode != self._mode))
        self._mode = mode
        if not guided.any():
            return none
        goal = self.high_level.goal
        heading, velocities = goal[3], None
        place = goal[:3]
        if streamed.any():
            place = np.where(flown, place, self._place)
            heading, velocities = np.where(flown, heading, self.setpoint[2]), self._velocities(streamed, yaw)
        roll, pitch, thrust = self._position_controller.control(place, position.T, velocity.T, yaw, fresh, velocities)
        self.setpoint = np.where(guided, (roll, pitch, heading, thrust), self.setpoint)
        self.yaw_is_angle |= flown
        return fresh

    def _velocities(self, streamed: BoolArray, yaw: FloatArray) -> Velocities:
        """Return the velocities that set-points of the link tell, those of the world turned to the (N,) yaw, rad."""
        world, hover = (streamed & (self._streamed == mode) for mode in (SetpointMode.VELOCITY, SetpointMode.HOVER))
        told = np.where(world, along_heading(self._velocity, yaw), self._velocity)
        return Velocities(told, world | hover, world)
