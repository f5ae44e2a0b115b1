"""The link to simulated drones: what is sent arrives after the link's delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import finite_array
from flatsat_ros.base.errors import require, require_not_negative, require_number, require_positive
from flatsat_ros.crazyflie.vehicle import PWM_FULL
from flatsat_ros.sim.dynamics import STEP
from flatsat_ros.sim.firmware import Firmware
from flatsat_ros.sim.position_controller import PositionSetpoint
from flatsat_ros.sim.trajectories import Piece

ROUNDING = 1e-6  # steps: times closer than this to a step are on it


class _Packet(NamedTuple):
    """A command under way.

    Attributes:
        step: of its arrival.
        take: what the drone does with it, given the time, ms.
    """

    step: int
    take: Callable[[int], object]


class Uplink:
    """Commands on their way to N drones.

    Attributes:
        count: N.
        firmware: of the receivers.
    """

    def __init__(self, firmware: Firmware, count: int, delay: float) -> None:
        """Begin with nothing on its way.

        Args:
            firmware: of the receivers.
            count: N.
            delay: from a command to its arrival, s.
        """
        self.firmware, self.count = firmware, count
        self._delay = delay
        self._packets: deque[_Packet] = deque()
        self._now = 0.0

    def command(self, index: int, roll: float, pitch: float, yaw: float, thrust_pwm: float) -> None:
        """Send a set-point, as cmd_vel_legacy carries it, at the time advanced to.

        Args:
            index: the receiver.
            roll: deg, positive toward -y.
            pitch: deg, positive toward +x (crazyswarm2's cpp back-end).
            yaw: deg/s or deg, as yaw_mode says.
            thrust_pwm: 0..65535; clipped by the firmware, not here.

        Raises:
            FlatsatError: no such drone, or a thrust that no packet can carry. Angles may be NaN: see firmware.
        """
        self._check(index)
        require(0.0 <= thrust_pwm <= PWM_FULL, "thrust_pwm", thrust_pwm, "", f"from 0 to {PWM_FULL}")
        self._send(partial(self.firmware.receive, index, roll, pitch, yaw, thrust_pwm))

    def command_position(self, index: int, setpoint: PositionSetpoint) -> None:
        """Send a set-point of position or velocity, at the time advanced to; see command.

        Raises:
            FlatsatError: no such drone.
        """
        self._check(index)
        self._send(partial(self.firmware.receive_position, index, setpoint))

    def take_off(self, index: int, height: float, duration: float, yaw: float | None = None, *, group: int = 0) -> None:
        """Send the high-level command to rise straight to a height and hover there, at the time advanced to.

        Nothing tells the sender what the firmware refuses, as on the radio: see firmware and high_level. The command
        does not move the drone while set-points have the priority, that is if one was sent since the last
        notify_setpoints_stop. It works whether or not the thrust is locked, and leaves the lock as it is: if it is
        closed, the next set-point cuts the motors, whatever its thrust.

        Args:
            index: the receiver.
            height: m, world.
            duration: s.
            yaw: rad, world; None keeps the present one. crazyswarm2's cpp back-end sends what amounts to 0.
            group: bits of the groups that it is for; 0 is for all.

        Raises:
            FlatsatError: no such drone, a value that is not finite, or a negative duration.
        """
        self._send(partial(self.firmware.high_level.take_off, *self._rise(index, height, duration, yaw)), index, group)

    def land(self, index: int, height: float, duration: float, yaw: float | None = None, *, group: int = 0) -> None:
        """Send the high-level command to sink straight to a height and stop the motors there; see take_off."""
        self._send(partial(self.firmware.high_level.land, *self._rise(index, height, duration, yaw)), index, group)

    def go_to(
        self,
        index: int,
        position: ArrayLike,
        yaw: float,
        duration: float,
        *,
        relative: bool = False,
        group: int = 0,
    ) -> None:
        """Send the high-level command to fly to a place and hover there, at the time advanced to; see take_off.

        Args:
            index: the receiver.
            position: (3,) m, world.
            yaw: rad, world.
            duration: s.
            relative: position and yaw are added to the drone's present goal or, if it has none, to its state.
            group: bits of the groups that it is for; 0 is for all.

        Raises:
            FlatsatError: no such drone, a value that is not finite, not three coordinates, or a negative duration.
        """
        self._check(index)
        place = finite_array("position", position, 3)
        require(place.shape == (3,), "shape of position", place.shape, "", "(3,)")
        require_number("yaw", yaw, "rad")
        require_not_negative("duration", duration, "s")
        go = partial(self.firmware.high_level.go_to, index, place.copy(), yaw, duration, relative)
        self._send(go, index, group)

    def upload_trajectory(self, index: int, trajectory: int, offset: int, pieces: Sequence[Piece]) -> None:
        """Write a trajectory into a drone's memory, at once; all trajectories share its places for pieces.

        Args:
            index: the receiver.
            trajectory: its number.
            offset: place of its first piece.
            pieces: what it is made of.

        Raises:
            FlatsatError: no such drone, number or place.
        """
        self._check(index)
        self.firmware.high_level.memories[index].upload(trajectory, offset, pieces)

    def start_trajectory(
        self,
        index: int,
        trajectory: int,
        *,
        time_scale: float = 1.0,
        reverse: bool = False,
        relative: bool = True,
        group: int = 0,
    ) -> None:
        """Send the high-level command to fly an uploaded trajectory and hover at its end, at the time advanced to.

        See take_off. A drone without a trajectory of that number stays as it is.

        Args:
            index: the receiver.
            trajectory: its number.
            time_scale: how many times as long it takes.
            reverse: whether it is flown backward in time.
            relative: whether it is shifted to begin at the present goal or, if there is none, where the drone is.
            group: bits of the groups that it is for; 0 is for all.

        Raises:
            FlatsatError: no such drone, or a time scale that is not above 0.
        """
        self._check(index)
        require_positive("time_scale", time_scale, "")
        start = partial(
            self.firmware.high_level.start_trajectory, index, trajectory, float(time_scale), reverse, relative
        )
        self._send(start, index, group)

    def notify_setpoints_stop(self, index: int) -> None:
        """Tell a drone that no more set-points will come, at the time advanced to: its high-level commander takes over.

        In the air a high-level command must follow at once, such as a relative go_to by 0: without one the motors stop.

        Raises:
            FlatsatError: no such drone.
        """
        self._check(index)
        self._send(lambda _now: self.firmware.notify_setpoints_stop(index))

    def _deliver(self, step: int, now: int) -> None:
        """Let the drones take what has arrived by a step, at its time, ms."""
        while self._packets and self._packets[0].step <= step:
            self._packets.popleft().take(now)

    def _send(self, take: Callable[[int], object], index: int = 0, group: int = 0) -> None:
        """Put a command on its way; drone index takes it if it belongs to the group, 0 meaning all, on its arrival."""
        if group:
            everybodys = take

            def take(now: int) -> object:
                return self.firmware.high_level.is_addressed(index, group) and everybodys(now)

        self._packets.append(_Packet(math.ceil((self._now + self._delay) / STEP - ROUNDING), take))

    def _rise(
        self, index: int, height: float, duration: float, yaw: float | None
    ) -> tuple[int, float, float, float | None]:
        """Return the arguments of a take-off or a landing, checked."""
        self._check(index)
        require_number("height", height, "m")
        if yaw is not None:
            require_number("yaw", yaw, "rad")
        require_not_negative("duration", duration, "s")
        return index, height, duration, yaw

    def _check(self, index: int) -> None:
        """Refuse an index outside the fleet."""
        require(0 <= index < self.count, "index", index, "", f"from 0 to {self.count - 1}")
