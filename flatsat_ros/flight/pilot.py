"""What people may ask of N drones, and what is known of them; the tick itself stands in `flight.step`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import FlatsatError, require_positive
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.battery import Charge, VoltageLimits
from flatsat_ros.flight.clearance import Cause
from flatsat_ros.flight.modes import AIRBORNE, Mode
from flatsat_ros.flight.parts import put_together
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.step import ControlStep
from flatsat_ros.flight.tick import Command, Report, Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.controller import Memory
from flatsat_ros.law.gain import Tuning


class Pilot:
    """Flies N drones of one certificate.

    Attributes:
        certificate: what is proved of the loop.
        estimator: the drones' estimates.
        batteries: what is known of their batteries.
        clearance: what keeps drones on the ground.
        traffic: who goes where, and who waits for whom.
        orders: (N,) how often each was told where to go, to take off, hold, land or be left alone, but for plans.
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
        known_as = [f"drone {index}" for index in range(count)] if names is None else names
        parts = self._parts = put_together(certificate, tuning, policy, count, known_as, others)
        self._step = ControlStep(certificate, policy, parts, count)
        self._policy, self.orders = policy, np.zeros(count, dtype=int)
        self.certificate, self.estimator = certificate, parts.estimator
        self.batteries, self.clearance, self.traffic = parts.batteries, parts.clearance, parts.traffic

    @property
    def memory(self) -> Memory:
        """The controller's gains."""
        return self._parts.steering.memory

    @property
    def mode(self) -> np.ndarray:
        """(N,) values of `Mode`."""
        return self._parts.supervisor.mode

    def retune(self, tuning: Tuning) -> None:
        """Take a new tuning from the next tick on. Gains stay where they are, below the new cap."""
        self._parts.steering.retune(tuning)

    def set_goal(self, index: int, position: ArrayLike, yaw: float = 0.0) -> None:
        """Give drone index a goal to rest at; it takes off if it rests, and no longer lands.

        Where other drones are in its way, it sets out later.

        Args:
            index: of the drone.
            position: (3,) m, world frame.
            yaw: psi, rad, counter-clockwise.

        Raises:
            FlatsatError: goal or yaw is not finite, the goal is outside the box or another drone's place, or the drone
                must not take off.
        """
        if self._policy.goal_mode is GoalMode.STEP:
            self.set_reference(index, Trajectory.hold(position, yaw))
            return
        self._require_clear(index)
        landed = bool(self._parts.guidance.landing[index])
        begins = self.traffic.admit_goal(index, position, float(finite_array("yaw", yaw)))
        self.orders[index] += 1
        if begins:
            self._step.begin(index, patient=True, landed=landed)

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
        if path_mode and self.mode[index] == Mode.FLY:
            self._parts.guidance.require_near(index, trajectory, self._step.now)
        landed = bool(self._parts.guidance.landing[index])
        self.traffic.admit_trajectory(index, trajectory)
        self.orders[index] += 1
        self._step.begin(index, patient=True, landed=landed)

    def set_planned(self, index: int, trajectory: Trajectory) -> None:
        """Give drone index, which flies, its part of a plan: a trajectory.

        The distances that the plan proves between its drones must have been given to `traffic` by `Traffic.prove`.

        Raises:
            FlatsatError: it does not fly, or see `set_reference`.
        """
        self._parts.supervisor.require_mode(index, Mode.FLY, purpose="fly a plan")
        self._require_clear(index)
        self._parts.guidance.require_near(index, trajectory, self._step.now)
        self.traffic.admit_planned(index, trajectory)
        self._step.begin(index, patient=False)

    def require_ready(self, index: int) -> None:
        """Refuse drone index if it neither flies nor may take off.

        Raises:
            FlatsatError: it is in another mode, disarmed, or something keeps it on the ground.
        """
        self._require_clear(index)
        if self.mode[index] != Mode.FLY and not self._step.usable[index]:
            raise FlatsatError("the drone's pose is not known: it needs fresh poses")
        modes = (Mode.FLY, Mode.IDLE, Mode.UNLOCK, Mode.CUT, Mode.REST)
        self._parts.supervisor.require_mode(index, *modes, purpose="set out")

    def follows(self, index: int) -> Trajectory | None:
        """Return the reference of drone index while it flies, else None."""
        return self._parts.guidance.references.trajectory(index) if self.mode[index] == Mode.FLY else None

    def destination(self, index: int) -> FloatArray | None:
        """Return where drone index is led in the end, (3,) m; None if it is led nowhere."""
        return self._parts.guidance.destination(index)

    def call_off(self, index: int) -> None:
        """Let drone index neither wait for its goal any longer nor take off for it."""
        self.traffic.withdraw(index)
        self._parts.supervisor.call_off(index)

    def require_room(self, what: str, trajectory: Trajectory) -> None:
        """Refuse a trajectory, called `what`, that leaves the box.

        Raises:
            FlatsatError: it does; the text names the side.
        """
        for corner in trajectory.bounds():
            self._parts.guidance.require_inside(corner, what)

    def is_landing(self, index: int) -> bool:
        """Tell whether drone index is in the air and lands."""
        return bool(self._parts.guidance.landing[index]) and self.mode[index] in AIRBORNE

    def is_at_rest(self, index: int) -> bool:
        """Tell whether drone index flies and its reference stays where it is, and it is not landing."""
        resting = self._parts.guidance.references.at_rest[index] and not self._parts.guidance.landing[index]
        return bool(resting and self.mode[index] == Mode.FLY)

    def _require_clear(self, index: int) -> None:
        """Refuse a reference for drone index if it must not take off, or lands because its battery is empty.

        Raises:
            FlatsatError: it is disarmed, has fallen, or something else keeps it on the ground.
        """
        self._parts.supervisor.require_armed(index)
        if self.mode[index] not in AIRBORNE or self.batteries.charges[index] is Charge.EMPTY:
            self.clearance.require(index)

    def hold(self, index: int) -> None:
        """Let drone index brake and stay where it comes to rest; where the ground would carry it then, it lands.

        Raises:
            FlatsatError: it does not fly, or lands because its battery is empty.
        """
        self._parts.supervisor.require_mode(index, Mode.FLY, purpose="hold its place")
        self._require_clear(index)
        self.traffic.withdraw(index)
        self.orders[index] += 1
        if not self._parts.guidance.brake(index, self._step.now):
            self._step.reports.append(Report(index, "it is told to hold where the ground would carry it: it lands"))

    def arm(self, index: int, armed: bool) -> None:
        """Allow drone index to take off, or forbid it; all are armed at first.

        Arming a drone that is known to stand on the ground also opens its thrust lock: somebody else may fly it first,
        by a way that leaves the lock closed.

        Raises:
            FlatsatError: it is in the air and cannot be disarmed, or the controller ends and it cannot be armed.
        """
        height = float(self._step.state[index, 2]) if self._step.usable[index] else None
        self._parts.supervisor.arm(index, armed, height)
        self.orders[index] += not armed

    def note_link(self, index: int, linked: bool) -> None:
        """Note whether drone index is linked: until somebody takes its commands, its thrust lock cannot be opened."""
        self._parts.supervisor.linked[index] = linked

    def is_seen(self, index: int) -> bool:
        """Tell whether the place of drone index is known."""
        return bool(self._step.usable[index])

    def is_opening(self, index: int) -> bool:
        """Tell whether drone index was armed on the ground and its thrust lock is about to be opened for others."""
        supervisor = self._parts.supervisor
        return bool(supervisor.unlocking[index] and not supervisor.requested[index])

    def take_off(self, index: int, height: float) -> None:
        """Send drone index straight up by height, m, from where it stands.

        Raises:
            FlatsatError: it does not stand, its pose is not known, it must not take off, the height is not above 0 or
                ends outside the box, or another drone is in the way.
        """
        self._require_clear(index)
        place, mode = self._step.state[index, :3], Mode(self.mode[index])
        if mode not in (Mode.IDLE, Mode.UNLOCK, Mode.CUT) or self._parts.senses.footing.moves(self._step.state[index]):
            raise FlatsatError(f"the drone is in {mode.name} at z = {place[2]:.2f} m: only one on the ground takes off")
        if not self._step.usable[index]:
            raise FlatsatError("the drone's pose is not known: it needs fresh poses to take off")
        if reason := self._parts.orientations.unready(index):
            raise FlatsatError(reason)
        climb = np.array([0.0, 0.0, require_positive("height", height, "m")])
        yaw = float(self.estimator.yaw[index])
        if self._policy.goal_mode is GoalMode.STEP:
            self._parts.guidance.follow(index, Trajectory.hold(place + climb, yaw))
        else:
            self.traffic.admit_take_off(index, place + climb, yaw)
        self.orders[index] += 1
        self._step.begin(index, patient=False)

    def land(self, index: int) -> None:
        """Let drone index brake, sink where it is until something carries it, then rest.

        The take-off of one that is not in the air yet is called off, be it that its goal waits for something.

        Raises:
            FlatsatError: it is neither in the air nor about to take off, or another drone stays below.
        """
        waits = self.traffic.is_waiting(index) or bool(self._parts.supervisor.requested[index])
        if waits and self.mode[index] not in AIRBORNE:
            self.call_off(index)
            self.orders[index] += 1
            self._step.reports.append(Report(index, "its take-off is called off: it is told to land"))
            return
        self._parts.supervisor.require_mode(index, *AIRBORNE, purpose="land")
        self.traffic.admit_landing(index)
        self.orders[index] += 1
        self._parts.guidance.land(index, self._step.now)

    def retire(self) -> None:
        """Land every drone that is in the air where it is, and let none take off any more, whoever arms it."""
        self._parts.supervisor.retire()
        for index, mode in enumerate(self.mode):
            if mode in AIRBORNE:
                self.traffic.land(index)

    def unclaimed(self, index: int) -> str:
        """Return why the tube of the certificate's flight section is not claimed of drone index; empty if it is."""
        return self._parts.loop.unclaimed(index)

    @property
    def height(self) -> FloatArray:
        """(N,) estimated z of the last tick, m."""
        return self._step.state[:, 2]

    @property
    def places(self) -> FloatArray:
        """(N, 3) estimated positions of the last tick, m, world frame."""
        return self._step.state[:, :3]

    def hand_over(self, index: int) -> None:
        """Fall silent about drone index in flight: from now on somebody else must command it, within 0.5 s.

        Raises:
            FlatsatError: it does not fly.
        """
        self._parts.supervisor.release(index)
        self.orders[index] += 1
        self._parts.guidance.landing[index] = False

    def measure(
        self, index: int, stamp: float, position: Sequence[float], quaternion: Sequence[float], now: float
    ) -> bool:
        """Store a pose of drone index; the arguments are those of `Estimator.measure`."""
        return self.estimator.measure(index, stamp, position, quaternion, now)

    def note_battery(self, index: int, voltage: float, limits: VoltageLimits, now: float) -> None:
        """Take in a voltage, V, of the battery of drone index at time now, s; if it is empty by the limits, land it."""
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
                self.traffic.land(index)
        self._step.reports.append(Report(index, finding.text + done))

    def tick(self, now: float) -> Tick:
        """Compute all commands at time now, s; called once per period of the certificate."""
        return self._step.tick(now)

    def last_command(self, index: int) -> Command | None:
        """Return what to leave behind with drone index on shutdown: level and sinking in the air, else zero thrust.

        None for a drone in IDLE, which somebody else may fly.
        """
        mode = Mode(self.mode[index])
        if mode is Mode.IDLE:
            return None
        thrust = self._policy.level_thrust * self.certificate.limits.gravity if mode in AIRBORNE else 0.0
        scale = float(self._parts.senses.thrust.cautious(np.zeros(len(self.mode), dtype=bool))[index])
        return Command(thrust / scale, 0.0, 0.0, 0.0, float(self._parts.yaw.heading[index]))
