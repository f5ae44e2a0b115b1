"""N simulated Crazyflies: wire-level set-points in, poses out, on a clock that the caller advances."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array, require_each
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import require, require_not_negative, require_number, require_positive
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.sim.dynamics import STEP, Bodies, Ideal, Identified, Response, Wind
from flatsat_ros.sim.firmware import SUPERVISOR_PERIOD, Firmware
from flatsat_ros.sim.high_level import HIGH_LEVEL_PERIOD
from flatsat_ros.sim.position_controller import PositionSetpoint
from flatsat_ros.sim.power import Battery, IdealPowerTrain, PowerTrain
from flatsat_ros.sim.sensor import MotionCapture, Recorder, Sample
from flatsat_ros.sim.trajectories import Piece

_MILLISECONDS = round(STEP * 1000)
_SUPERVISOR_STEPS = SUPERVISOR_PERIOD // _MILLISECONDS
_HIGH_LEVEL_STEPS = HIGH_LEVEL_PERIOD // _MILLISECONDS
_ROUNDING = 1e-6  # steps: times closer than this to a step are on it


class _Packet(NamedTuple):
    """A command under way.

    Attributes:
        step: of its arrival.
        take: what the drone does with it, given the time, ms.
    """

    step: int
    take: Callable[[int], object]


class SimulatedFleet:
    """N drones of one kind in one room.

    Everything is a function of the arguments, the commands and their times: the same seed gives the same flight,
    whether advance_to is called once or for many small steps. Integration is on a fixed grid of STEP; the state is that
    of the last grid time, `time`, at or before the one advanced to.

    Attributes:
        count: N.
        yaw_mode: what the yaw of a set-point means.
        firmware: supervisor states, flags, `info()`; arming and emergency requests.
        bodies: the true state.
        power: battery voltages.
        wind: may be changed between two steps.
    """

    def __init__(
        self,
        profile: VehicleProfile,
        count: int,
        *,
        dynamics: str = "identified",
        start: ArrayLike | None = None,
        yaw: ArrayLike = 0.0,
        flying: bool = False,
        seed: int = 0,
        stream: int = 0,
        floor: float = 0.0,
        wind: Wind | None = None,
        capture: MotionCapture | None = None,
        battery: Battery | None = None,
        thrust_scale: ArrayLike = 1.0,
        command_delay: float = 0.0,
        yaw_mode: YawMode = YawMode.RATE,
    ) -> None:
        """Switch the drones on at time 0.

        Args:
            profile: the drones' kind.
            count: N.
            dynamics: "identified", or "ideal": the double integrator, with exact motors, no drag, no dead time.
            start: (N, 3) initial positions, m; by default on the floor, half a metre apart along x.
            yaw: (N,) or scalar, initial yaw, rad.
            flying: start in the air, hovering, thrust unlocked, instead of booting on the floor.
            seed: of gusts, noise and drop-out.
            stream: number of this fleet among those that share a room, 0 or more: fleets with the same seed have the
                same gusts, and each stream has noise of its own.
            floor: height of the floor, m.
            wind: still air by default. Without drag, so with ideal dynamics, wind does nothing.
            capture: motion capture without faults at 100 Hz by default.
            battery: one that never changes by default.
            thrust_scale: (N,) or scalar, actual force over the force the profile promises.
            command_delay: from command() to the drone, s, besides the profile's dead time.
            yaw_mode: what the yaw of a set-point means, flightmode.stabModeYaw.

        Raises:
            FlatsatError: an argument is out of its bounds.
        """
        require(dynamics in ("identified", "ideal"), "dynamics", dynamics, "", "identified or ideal")
        require(count >= 1, "count", count, "", "at least 1")
        require_number("floor", floor, "m")
        require_not_negative("command_delay", command_delay, "s")
        if start is None:
            start = np.linspace((0.0, 0.0, floor), (0.5 * (count - 1), 0.0, floor), count)
        position = finite_array("start", start, 3)
        require(position.shape == (count, 3), "shape of start", position.shape, "", str((count, 3)))
        scale = _per_drone("thrust_scale", thrust_scale, count)
        require_each(scale > 0.0, "thrust_scale", scale, "", "above 0")

        ideal = dynamics == "ideal"
        response: Response = Ideal() if ideal else Identified(profile.dynamics)
        train = IdealPowerTrain if ideal else PowerTrain
        self.count = count
        self.yaw_mode = yaw_mode
        heading = _per_drone("yaw", yaw, count)
        self.bodies = Bodies(response, position, heading, thrust=GRAVITY if flying else 0.0, floor=floor)
        self.firmware = Firmware(profile, count, yaw_mode=yaw_mode)
        self.power = train(profile, battery or Battery(), count)
        if flying:
            self.firmware.start_flying(float(profile.pwm_from_thrust(GRAVITY)), heading)
        self._acceleration_of_force = scale / profile.mass
        self._delay = command_delay + (0.0 if ideal else profile.delay)
        self.wind = wind or Wind()
        self._gust = np.zeros(3)
        require(stream >= 0, "stream", stream, "", "at least 0")
        gusts, *capturing = np.random.SeedSequence(seed).spawn(2 + stream)
        self._gusts = np.random.default_rng(gusts)
        self._recorder = Recorder(capture or MotionCapture(), np.random.default_rng(capturing[stream]))
        self._packets: deque[_Packet] = deque()
        self._now = 0.0
        self._step = 0
        self._record()

    @property
    def time(self) -> float:
        """Time of the state, s: the last grid time at or before the one advanced to."""
        return self._step * STEP

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

    def reboot(self, index: int) -> None:
        """Set a drone on its feet where it is, and switch it off and on."""
        self._check(index)
        self.bodies.set_upright(index)
        self.firmware.reboot(index, self._step * _MILLISECONDS)

    def advance_to(self, time: float) -> None:
        """Integrate to an absolute time, s; times already passed are an error."""
        require(self._now <= time < np.inf, "time", time, "s", f"{self._now} s, the present, or later")
        self._now = time
        last = int(np.floor(time / STEP + _ROUNDING))
        while self._step < last:
            self._advance()

    def poses(self) -> tuple[FloatArray, FloatArray]:
        """Return the true (N, 3) positions, m, and (N, 4) quaternions, x, y, z, w, at `time`."""
        return self.bodies.position.copy(), self.bodies.quaternion

    def measurements(self, time: float) -> list[Sample]:
        """Return the motion capture samples that were released until a time, s; each is returned once."""
        return self._recorder.release(time)

    def _advance(self) -> None:
        """One STEP: high-level commander, packets, supervisor, controller, motors, body, motion capture."""
        now = self._step * _MILLISECONDS
        if self._step % _HIGH_LEVEL_STEPS == 0:
            self.firmware.plan(now, self.bodies.position, self.bodies.velocity, self.bodies.attitude[2, :, 0])
        while self._packets and self._packets[0].step <= self._step:
            self._packets.popleft().take(now)
        if self._step % _SUPERVISOR_STEPS == 0:
            self.firmware.supervise(now, self.bodies.specific_force, self.power.ratio, self.power.voltage)
        angles, pwm, running = self.firmware.control(STEP, self.bodies.attitude[2, :, 0])
        thrust = self.power.step(pwm, running) * self._acceleration_of_force
        self._gust = self.wind.next_gust(self._gust, self._gusts)
        self.bodies.step(thrust, angles, self._gust + self.wind.mean)
        self._step += 1
        self._record()

    def _record(self) -> None:
        """Let motion capture look, if it is time."""
        if self._recorder.is_due(self.time):
            self._recorder.take(self.time, *self.poses())

    def _send(self, take: Callable[[int], object], index: int = 0, group: int = 0) -> None:
        """Put a command on its way; drone index takes it if it belongs to the group, 0 meaning all, on its arrival."""
        if group:
            everybodys = take

            def take(now: int) -> object:
                return self.firmware.high_level.is_addressed(index, group) and everybodys(now)

        self._packets.append(_Packet(int(np.ceil((self._now + self._delay) / STEP - _ROUNDING)), take))

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


def _per_drone(name: str, value: ArrayLike, count: int) -> FloatArray:
    """Return a scalar or (N,) value as (N,)."""
    array = finite_array(name, value)
    require(array.shape in ((), (count,)), f"shape of {name}", array.shape, "", f"() or ({count},)")
    return np.broadcast_to(array, count)
