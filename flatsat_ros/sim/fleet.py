"""N simulated Crazyflies: wire-level set-points in, poses out, on a clock that the caller advances."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array, require_each
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import require, require_not_negative, require_number
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.sim.dynamics import STEP, Bodies, Ideal, IdentifiedResponse, Response, Wind
from flatsat_ros.sim.firmware import SUPERVISOR_PERIOD, Firmware
from flatsat_ros.sim.high_level import HIGH_LEVEL_PERIOD
from flatsat_ros.sim.power import Battery, IdealPowerTrain, PowerTrain
from flatsat_ros.sim.proximity import STILL, Proximity
from flatsat_ros.sim.sensor import MotionCapture, PoseSampler, Sample
from flatsat_ros.sim.uplink import ROUNDING, Uplink

_MILLISECONDS = round(STEP * 1000)
_SUPERVISOR_STEPS = SUPERVISOR_PERIOD // _MILLISECONDS
_HIGH_LEVEL_STEPS = HIGH_LEVEL_PERIOD // _MILLISECONDS


class SimulatedFleet(Uplink):
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
        neighbours: places (M, 3), m, and lift (M,), N, of the drones of other fleets in the room; None: none.
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
        proximity: Proximity = STILL,
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
            proximity: ground effect and downwash; none by default: theorems know neither.

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
        response: Response = Ideal() if ideal else IdentifiedResponse(profile.dynamics)
        train = IdealPowerTrain if ideal else PowerTrain
        super().__init__(
            Firmware(profile, count, yaw_mode=yaw_mode), count, command_delay + (0.0 if ideal else profile.delay)
        )
        self.yaw_mode = yaw_mode
        heading = _per_drone("yaw", yaw, count)
        self.bodies = Bodies(response, position, heading, thrust=GRAVITY if flying else 0.0, floor=floor)
        self.power = train(profile, battery or Battery(), count)
        if flying:
            self.firmware.start_flying(float(profile.pwm_from_thrust(GRAVITY)), heading)
        self._acceleration_of_force = scale / profile.mass
        self._mass, self._floor, self._proximity = profile.mass, floor, proximity
        self._lift_gain: FloatArray | float = 1.0
        self._push: FloatArray | None = None
        self.neighbours: tuple[FloatArray, FloatArray] | None = None
        self.wind = wind or Wind()
        self._gust = np.zeros(3)
        require(stream >= 0, "stream", stream, "", "at least 0")
        gusts, *capturing = np.random.SeedSequence(seed).spawn(2 + stream)
        self._gusts = np.random.default_rng(gusts)
        self._recorder = PoseSampler(capture or MotionCapture(), np.random.default_rng(capturing[stream]))
        self._step = 0
        self._record()

    @property
    def time(self) -> float:
        """Time of the state, s: the last grid time at or before the one advanced to."""
        return self._step * STEP

    def reboot(self, index: int) -> None:
        """Set drone index on its feet where it is, and switch it off and on."""
        self._check(index)
        self.bodies.set_upright(index)
        self.firmware.reboot(index, self._step * _MILLISECONDS)

    def advance_to(self, time: float) -> None:
        """Integrate to an absolute time, s.

        Raises:
            FlatsatError: the time has passed already.
        """
        require(self._now <= time < np.inf, "time", time, "s", f"{self._now} s, the present, or later")
        self._now = time
        last = int(np.floor(time / STEP + ROUNDING))
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
            if self._proximity.is_felt:
                self._feel_proximity()
        self._deliver(self._step, now)
        if self._step % _SUPERVISOR_STEPS == 0:
            self.firmware.supervise(now, self.bodies.specific_force, self.power.ratio, self.power.voltage)
        angles, pwm, running = self.firmware.control(STEP, self.bodies.attitude[2, :, 0])
        thrust = self.power.step(pwm, running) * self._acceleration_of_force * self._lift_gain
        self._gust = self.wind.next_gust(self._gust, self._gusts)
        self.bodies.step(thrust, angles, self._gust + self.wind.mean, self._push)
        self._step += 1
        self._record()

    @property
    def lift(self) -> FloatArray:
        """What each drone lifts, (N,), N."""
        return self._mass * self.bodies.thrust

    def _feel_proximity(self) -> None:
        """Look how near floor and other drones are, 100 times a second: a drone moves by a centimetre between."""
        where, others, lift = self.bodies.position, self.bodies.position, self.lift
        self._lift_gain = self._proximity.lift(where[:, 2] - self._floor)
        if self.neighbours is not None:
            others, lift = np.concatenate([others, self.neighbours[0]]), np.concatenate([lift, self.neighbours[1]])
        push = self._proximity.push(where, others, lift)
        self._push = push / self._mass if push.any() else None

    def _record(self) -> None:
        """Let motion capture look, if it is time."""
        if self._recorder.is_due(self.time):
            self._recorder.take(self.time, *self.poses())


def _per_drone(name: str, value: ArrayLike, count: int) -> FloatArray:
    """Return a scalar or (N,) value as (N,)."""
    array = finite_array(name, value)
    require(array.shape in ((), (count,)), f"shape of {name}", array.shape, "", f"() or ({count},)")
    return np.broadcast_to(array, count)
