"""Flight without a set-point stream: the Crazyflie's high-level commander, for N drones.

A restatement of bitcraze/crazyflie-firmware, release 2026.08; the file and function behind each rule stand beside it.
Commands become polynomials in time, and polynomials become goals of position and yaw every HIGH_LEVEL_PERIOD, which
the position controller follows. The on-board estimate of position, velocity and yaw is the truth.

Not modelled: compressed trajectories, spirals, straight (linear) go-to, take-off and landing at a given velocity, and
the estimate's errors.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import BoolArray, FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.sim.trajectories import Piece, TrajectoryMemory

HIGH_LEVEL_PERIOD = 10  # ms; stabilizer_types.h RATE_HL_COMMANDER and POSITION_RATE, 100 Hz
SHORTEST = 1e-3  # s: on board a duration of 0 is a jump to the goal at once, here one within a period

# of a polynomial in s the coefficients of s^4..s^7 from its value and three derivatives at s = 1
_HIGHER = np.linalg.inv(
    [[1.0, 1.0, 1.0, 1.0], [4.0, 5.0, 6.0, 7.0], [12.0, 20.0, 30.0, 42.0], [24.0, 60.0, 120.0, 210.0]]
)


def polynomial(
    start: FloatArray, rate: FloatArray, acceleration: FloatArray, end: FloatArray, duration: float
) -> FloatArray:
    """Return the coefficients of the 7th-order polynomial between a motion and rest: pptraj.c poly7_nojerk.

    Args:
        start: (...) value at the beginning.
        rate: (...) first derivative there, 1/s.
        acceleration: (...) second derivative there, 1/s^2; the third is 0.
        end: (...) value at the end, where all three derivatives are 0.
        duration: s, above 0.

    Returns:
        (8, ...) coefficients of ascending powers of time / duration.
    """
    first, second = rate * duration, 0.5 * acceleration * duration**2
    zero = np.zeros_like(start)
    missing = np.array([end - start - first - second, -first - 2.0 * second, -2.0 * second, zero])
    return np.concatenate([[start, first, second, zero], np.tensordot(_HIGHER, missing, 1)])


class HighLevelCommander:
    """The planners of N drones.

    Attributes:
        following: (N,) whether the drone is on a trajectory or hovers at its end; else the planner stops the motors.
        blocked: (N,) whether the supervisor forbids the drone to fly: commands are refused.
        goal: (4, N) x, y, z, m, and yaw, rad, of the drones that are following, as of the last update.
        memories: N memories of uploaded trajectories.
        group_mask: (N,) bits of the groups that each drone belongs to, hlCommander.groupmask; 0 is none.
    """

    def __init__(self, count: int) -> None:
        """Boot, stopped: planner.c plan_init."""
        self.following = np.zeros(count, dtype=bool)
        self.blocked = np.ones(count, dtype=bool)
        self.goal = np.zeros((4, count))
        self._landing = np.zeros(count, dtype=bool)
        self.memories = [TrajectoryMemory() for _ in range(count)]
        self.group_mask = np.zeros(count, dtype=np.int64)
        self._coefficients = np.zeros((8, 4, count))
        self._begin = np.zeros(count)  # ms
        self._pieces: list[deque[Piece]] = [deque() for _ in range(count)]  # of a trajectory, to be flown next
        self._duration = np.ones(count)  # s
        self._position, self._velocity, self._yaw = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)

    def update(self, now: int, blocked: BoolArray, position: FloatArray, velocity: FloatArray, yaw: FloatArray) -> None:
        """Move the goals on: crtp_commander_high_level.c crtpCommanderHighLevelGetSetpoint, crtpCommanderBlock.

        A drone that is not following starts its next trajectory from the state given here. On board
        notify_setpoints_stop gives the state once more (commander.c commanderRelaxPriority), at most one period later.

        Args:
            now: ms.
            blocked: (N,) the negation of supervisor.c supervisorCanFly: the planner stops.
            position: (N, 3) m, world, of the on-board estimate.
            velocity: (N, 3) m/s, world, likewise.
            yaw: (N,) rad, likewise.
        """
        self._position, self._velocity, self._yaw = position, velocity, yaw
        self.blocked = blocked
        if not self.following.any():
            return
        if any(self._pieces):
            for index in range(len(self._pieces)):
                self._next_piece(index, now)
        progress = np.minimum((now - self._begin) * 1e-3 / self._duration, 1.0)
        # planner.c plan_current_goal: a landing ends with the motors off
        self.following &= ~(blocked | (self._landing & (progress >= 1.0)))
        self.goal = np.where(self.following, polyval(progress, self._coefficients, tensor=False), self.goal)

    def is_addressed(self, index: int, group: int) -> bool:
        """Whether a command to a group is for a drone too, 0 meaning all: crtp_commander_high_level.c isInGroup."""
        return group == 0 or bool(group & self.group_mask[index])

    def take_off(self, index: int, height: float, duration: float, yaw: float | None, now: int) -> bool:
        """Rise straight to a height and hover; False if refused, being blocked or not stopped: planner.c plan_takeoff.

        Args:
            index: the receiver.
            height: m, world.
            duration: s.
            yaw: rad, world; None keeps the present one.
            now: ms.
        """
        if self.blocked[index] or self.following[index]:
            return False
        self._rise(index, height, duration, yaw, now)
        return True

    def land(self, index: int, height: float, duration: float, yaw: float | None, now: int) -> bool:
        """Sink straight to a height and stop the motors; False if blocked or landing: planner.c plan_land.

        The arguments are those of take_off. A stopped planner takes it too: then the motors start for it.
        """
        if self.blocked[index] or (self.following[index] and self._landing[index]):
            return False
        self._rise(index, height, duration, yaw, now)
        self._landing[index] = True
        return True

    def go_to(self, index: int, position: ArrayLike, yaw: float, duration: float, relative: bool, now: int) -> bool:
        """Fly to a place and hover there; False if blocked: planner.c plan_go_to, plan_go_to_from.

        Args:
            index: the receiver.
            position: (3,) m, world.
            yaw: rad, world; reached the shorter way round.
            duration: s.
            relative: position and yaw are added to the present goal or, if there is none, to the present state.
            now: ms.
        """
        if self.blocked[index]:
            return False
        if self.following[index]:
            start, rate, acceleration = self._planned(index, now)
            # pptraj.c poly4d_eval: the yaw rate is seen from the tilted body
            thrust = acceleration[:3] + (0.0, 0.0, GRAVITY)
            rate[3] *= thrust[2] / np.linalg.norm(thrust)
            acceleration[3] = 0.0
        else:
            start, acceleration = self._told(index), np.zeros(4)
            rate = np.array([*self._velocity[index], 0.0])
        end = np.array([*np.asarray(position, dtype=np.float64), yaw])
        self._plan(index, start, rate, acceleration, start + end if relative else end, duration, now)
        return True

    def start_trajectory(
        self, index: int, trajectory: int, time_scale: float, reverse: bool, relative: bool, now: int
    ) -> bool:
        """Fly a trajectory of the memory; False if blocked or not defined: planner.c plan_start_trajectory.

        Changes of the memory do not reach a flight under way; on board they do. The yaw is never shifted.

        Args:
            index: the receiver.
            trajectory: its number.
            time_scale: how many times as long it takes, above 0.
            reverse: whether it is flown backward in time.
            relative: whether it is shifted to begin at the present goal or, if there is none, at the present place.
            now: ms.
        """
        pieces = self.memories[index].pieces_of(trajectory, time_scale, reverse)
        if self.blocked[index] or not pieces:
            return False
        shift = np.zeros(4)
        if relative:
            shift[:3] = self._told(index)[:3] - pieces[0].coefficients[0, :3]
        self._pieces[index] = deque(piece.shifted(shift) for piece in pieces)
        self._begin[index], self._duration[index] = now, 0.0
        self.following[index], self._landing[index] = True, False
        self._next_piece(index, now)
        self.goal[:, index] = self._coefficients[0, :, index]
        return True

    def _next_piece(self, index: int, now: int) -> None:
        """Go on to the piece of a trajectory that a time, ms, falls into: pptraj.c piecewise_eval."""
        pieces = self._pieces[index]
        while pieces and (now - self._begin[index] > self._duration[index] * 1e3 or self._duration[index] == 0.0):
            piece = pieces.popleft()
            self._begin[index] += self._duration[index] * 1e3
            self._coefficients[:, :, index], self._duration[index] = piece.coefficients, piece.duration

    def stop(self, index: int) -> None:
        """Forget the trajectory and stop the motors: planner.c plan_stop."""
        self.following[index] = False
        self._pieces[index].clear()

    def _rise(self, index: int, height: float, duration: float, yaw: float | None, now: int) -> None:
        """Plan from rest, straight up or down: planner.c plan_takeoff_or_landing."""
        start = self._told(index)
        end = np.array([start[0], start[1], height, start[3] if yaw is None else yaw])
        self._plan(index, start, np.zeros(4), np.zeros(4), end, duration, now)

    def _told(self, index: int) -> FloatArray:
        """Return the (4,) last goal or, without one, the last state."""
        if self.following[index]:
            return self.goal[:, index].copy()
        return np.array([*self._position[index], self._yaw[index]])

    def _planned(self, index: int, now: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the (4,) value, rate and acceleration of x, y, z, yaw on the trajectory; at its end it rests."""
        self._next_piece(index, now)
        duration = self._duration[index]
        progress = min((now - self._begin[index]) * 1e-3 / duration, 1.0)
        coefficients = self._coefficients[:, :, index]
        value, rate, acceleration = (polyval(progress, polyder(coefficients, k)) / duration**k for k in range(3))
        moving = float(progress < 1.0)
        return value, moving * rate, moving * acceleration

    def _plan(
        self,
        index: int,
        start: FloatArray,
        rate: FloatArray,
        acceleration: FloatArray,
        end: FloatArray,
        duration: float,
        now: int,
    ) -> None:
        """Follow the polynomial from a motion to rest from now on."""
        end[3] = start[3] + math.remainder(end[3] - start[3], 2.0 * math.pi)
        duration = max(duration, SHORTEST)
        self._coefficients[:, :, index] = polynomial(start, rate, acceleration, end, duration)
        self._begin[index], self._duration[index] = now, duration
        self._pieces[index].clear()
        self.goal[:, index] = start
        self.following[index], self._landing[index] = True, False
