"""The controller node: poses in, thrust, roll and pitch out, for any number of drones.

Callbacks convert and store. One fixed-rate tick, the certificate's period, computes all drones in one step. What one
drone's messages or commands break ends with that drone; if the common step breaks, all go down by their last resort.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.clearance import Cause
from flatsat_ros.flight.modes import AIRBORNE, Mode, Transition
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.stamps import StampClock
from flatsat_ros.flight.supervisor import UNLOCKING_ZEROS
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.backends import Backends
from flatsat_ros.nodes.commands import STARTING_TIME, Commands
from flatsat_ros.nodes.controller_setup import declare_setup
from flatsat_ros.nodes.crazyswarm import HAND_OVER_FORCE, SETTLING_TIME, DroneLink
from flatsat_ros.nodes.drone_status import DroneStatus
from flatsat_ros.nodes.flight_report import ThrottledLog, report_flight
from flatsat_ros.nodes.flight_services import FlightServices
from flatsat_ros.nodes.markers import Markers
from flatsat_ros.nodes.other_robots import OtherRobots, declare_others
from flatsat_ros.nodes.plan_control import PlanControl, declare_plan
from flatsat_ros.nodes.pose_sources import PoseSources, declare_pose_source
from flatsat_ros.nodes.reference_topics import ReferenceTopics
from flatsat_ros.nodes.rivals import Rivals
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.diagnostics import Diagnostics, Level, RobotCondition
from flatsat_ros.nodes.ros.parameters import declare, require_known_parameters
from flatsat_ros.nodes.ros.runtime import ProgramNode, run
from flatsat_ros.nodes.setup_report import SetupReport
from flatsat_ros.nodes.tuning import TuningParameters

# how often services of the drones' links and rivals are looked for, s
_LOOK_PERIOD = 1.0
_BROKEN = "the control step failed, see the log; restart the controller"


class ControllerNode(ProgramNode):
    """ROS shell of `Pilot`."""

    shutdown_time_max = 60.0  # s, for landings

    def __init__(self) -> None:
        """Read the parameters, load the certificate and the vehicle, start the tick."""
        super().__init__(interfaces.CONTROLLER_NODE)
        setup = self._setup = declare_setup(self)
        self.robots, self._certificate = setup.robots, setup.certificate
        tuning = TuningParameters(self, self.robots, self._certificate)
        self._backends = Backends(self, self.robots, self._flies)
        self._sources = PoseSources(self, self.robots, setup.world, self._flies, declare_pose_source(self))
        declare(self, HAND_OVER_FORCE, False, "hand over although nobody is there to take over", changeable=True)
        others = declare_others(self, self.robots)
        plan = declare_plan(self)
        require_known_parameters(self)
        self._pilot = Pilot(self._certificate, tuning.tuning(), setup.policy, len(self.robots), self.robots, others)
        tuning.follow(self._pilot.retune)
        SetupReport(self, self._certificate, setup.policy)
        Markers(self, self.robots, setup.world, setup.policy.box, self._newest)

        count = len(self.robots)
        self._stamps = StampClock(count, lambda: self.get_clock().now().nanoseconds, time.monotonic_ns)
        self._commands = Commands(self, self.robots, setup.vehicles, self._backends.of, setup.yaw_mode)
        self._broken = False  # the common step has failed
        self._ticked = self._stamps.now  # s, when the last tick was
        self._log = ThrottledLog(self.get_logger())
        self._durations: list[float] = []
        self._last: Tick | None = None
        self._telemetry = messages.telemetry_message()
        report = interfaces.TELEMETRY
        self._telemetry_publishers = [
            self.create_publisher(report.kind, report.of(robot), report.publish) for robot in self.robots
        ]
        ReferenceTopics(self, self.robots, setup.world.encode(), self._stamps, self._set_reference, self._breathe)
        self._status = DroneStatus(self, self.robots, setup.vehicles, self._take_voltage)
        see = self._pilot.traffic.see
        self._others = OtherRobots(self, others, setup.world, lambda i, place: see(i, place, self._stamps.now))
        actions = {
            "takeoff": self._take_off,
            "land": self._pilot.land,
            "hold": self._pilot.hold,
            "hand_over": self._hand_over,
        }
        steered = {name: partial(self._steer, act) for name, act in actions.items()}
        name = setup.certificate_name
        self._plans = PlanControl(self, plan, self.robots, self._pilot, name, lambda: self._stamps.now, self._log)
        FlightServices(self, self.robots, steered, partial(self._steer, self._arm), self._log, self._breathe)
        self._links = [DroneLink(self, robot) for robot in self.robots]
        self.create_timer(self._certificate.period, self._on_tick)
        bar = self._pilot.clearance.bar
        self._rivals = Rivals(self, self.robots, self._sources.beside, lambda i, why: bar(i, Cause.RIVALS, why))
        self.create_timer(_LOOK_PERIOD, self._look_around)
        Diagnostics(self, self._report)
        self.get_logger().info(
            f"flying {', '.join(self.robots)} with certificate {self._certificate.name!r} at "
            f"{1.0 / self._certificate.period:g} Hz, gain cap {self._certificate.gain_max:.4g}"
        )

    def begin_shutdown(self) -> None:
        """Land the drones that are in the air where they are; let nobody take off any more."""
        with self.faults.contain("landing"):
            self._pilot.retire()

    def is_shut_down(self) -> bool:
        """Tell whether all drones are down and every hand-over that has begun is through."""
        return not self._in_use() and not any(link.is_releasing for link in self._links)

    def shutdown_progress(self) -> str:
        """Return who is still on the way down."""
        return "landing " + ", ".join(self._in_use())

    def _in_use(self) -> list[str]:
        """Return the drones that are in the air or just landed, with their heights."""
        found = []
        for index, robot in enumerate(self.robots):
            if self._commands.last_resort.since[index] is not None:
                if self._commands.last_resort.setpoint(index) is not None:
                    found.append(f"{robot} (last resort)")
            elif self._pilot.mode[index] in (*AIRBORNE, Mode.REST):
                found.append(f"{robot} (z = {self._pilot.height[index]:.2f} m)")
        return found

    def finish(self) -> None:
        """Send the last safe commands: level and sinking in the air, zero thrust otherwise; nothing to idle drones."""
        for index in range(len(self.robots)):
            self._commands.send(index, self._pilot.last_command)
        self._commands.flush()

    def destroy_node(self) -> None:
        """Destroy what belongs to the node, too."""
        self._rivals.close()
        self._plans.close()
        super().destroy_node()  # type: ignore[no-untyped-call]

    def _flies(self, index: int) -> bool:
        """Tell whether a drone is in the air."""
        return self._pilot.mode[index] in AIRBORNE

    def _steer(self, act: Callable[..., str | None], index: int, *wanted: bool) -> str | None:
        """Do something with a drone that is steered; see `FlightServices`."""
        self._require_steered(index)
        return act(index, *wanted)

    def _take_off(self, index: int) -> str:
        """Let a drone take off; return what may keep it on the ground."""
        self._rivals.look(index)
        self._pilot.take_off(index, self._setup.takeoff_height)
        self._rivals.starting.add(index)
        disarmed = self._status.disarmed(index)
        return disarmed and f"{self.robots[index]}: {disarmed}"

    def _arm(self, index: int, wanted: bool) -> str:
        """Allow or forbid take-off, and arm or disarm the drone itself; return what happens now."""
        self._pilot.arm(index, wanted)
        told = self._links[index].arm(wanted)
        if self._pilot.is_opening(index) and self._commands.is_taken(index):
            told += f"; the thrust lock opens: let others fly the drone after {self._unlock_time():.2f} s"
        elif self._pilot.is_opening(index):
            told += f"; the thrust lock opens once somebody takes the commands of {self.robots[index]}"
        elif wanted and self._pilot.mode[index] == Mode.IDLE and not self._pilot.is_seen(index):
            told += "; its place is not known: once it is, arm it again to open its thrust lock"
        return told

    def _unlock_time(self) -> float:
        """Return how long it takes until others may fly a drone that is armed, s."""
        # zeros from the next tick on, taken from the one after it; both times end at ticks; the notice that none follow
        zeros = max(self._setup.policy.unlock_time, UNLOCKING_ZEROS * self._certificate.period)
        return STARTING_TIME + zeros + 4.0 * self._certificate.period + SETTLING_TIME

    def _hand_over(self, index: int) -> None:
        """Fall silent about a drone, and let it stay where it is if its link has a way to.

        Raises:
            FlatsatError: nobody is there to take over.
        """
        if not self.get_parameter(HAND_OVER_FORCE).value:
            self._links[index].require_successor()
        self._pilot.hand_over(index)
        self._links[index].release(in_flight=True)

    def _require_steered(self, index: int) -> None:
        """Refuse what is asked of a drone that goes down by its last resort.

        Raises:
            FlatsatError: it does.
        """
        if self._commands.last_resort.since[index] is not None:
            raise FlatsatError(_BROKEN)

    def _take_poses(self) -> None:
        """Take in the poses since the last tick: one after the other they cost a fifth of what each does by itself."""
        for index, robot in enumerate(self.robots):
            while self._sources.queues[index]:
                with self.faults.contain(f"{robot}/pose"):
                    stamp, position, quaternion = self._sources.take(index)
                    measured = self._stamps.measured(index, stamp)
                    self._pilot.measure(index, measured, position, quaternion, self._stamps.now)
        self._others.take()

    def _take_voltage(self, index: int, voltage: float) -> None:
        self._pilot.note_battery(index, voltage, self._setup.vehicles[index].battery, self._stamps.now)

    def _set_reference(self, index: int, reference: Trajectory) -> None:
        """Let a drone follow a reference from now on, and take off for it if it rests.

        Raises:
            FlatsatError: it cannot, and what it followed before stays.
        """
        self._require_steered(index)
        starts = not self._flies(index)
        if starts:
            self._rivals.look(index)
            self._backends.look(index)
        self._pilot.set_reference(index, reference)
        if starts:
            self._rivals.starting.add(index)

    def _look_at_clock(self) -> None:
        self._log.clock(self._stamps.look())

    def _breathe(self) -> None:
        """Tick if it is time for that: what is asked of a hundred drones at once takes several periods."""
        self._look_at_clock()
        if self._stamps.now - self._ticked >= self._certificate.period:
            with self.faults.contain("tick"):
                self._on_tick()

    def _on_tick(self) -> None:
        with self.faults.contain("clock"):
            self._look_at_clock()
        self._ticked = self._stamps.now
        if self._rivals.starting:
            with self.faults.contain("rivals"):
                self._rivals.look_before_start(self._sources.queues)
        with self.faults.contain("plan"):
            for drone, text in self._plans.look(self._stamps.now):
                self._log.report(self.robots[drone], text)
        with self.faults.contain("links"):
            for index in map(int, np.flatnonzero(self._pilot.mode == Mode.UNLOCK.value)):
                self._pilot.note_link(index, self._commands.arrive(index, self._stamps.now))
        tick = self._step()
        for index in range(len(self.robots)):
            self._commands.send(index, _silent if tick is None else tick.command)
        if tick is not None:
            self._follow(tick)

    def _step(self) -> Tick | None:
        """Compute all drones; None if that fails, now and at all later ticks: all descend by their last resort."""
        if not self._broken:
            with self.faults.contain("control step"):
                self._take_poses()
                return self._pilot.tick(self._stamps.now)
            self._broken = True
            for index in range(len(self.robots)):
                self._commands.last_resort.begin(index)
            self.get_logger().fatal("every drone in the air goes down level, by what was sent before")
        return None

    def _follow(self, tick: Tick) -> None:
        """Tell everybody what a tick brought about."""
        self._last = tick
        self._durations.append(tick.duration * 1e6)
        self._follow_transitions(tick.transitions)
        for index, text in tick.reports:
            self._log.report(self.robots[index], text)
        rows = telemetry.rows(tick)
        for index, robot in enumerate(self.robots):
            with self.faults.contain(f"{robot}/telemetry"):
                messages.fill_telemetry(self._telemetry, rows[index])
                self._telemetry_publishers[index].publish(self._telemetry)

    def _follow_transitions(self, transitions: Sequence[Transition]) -> None:
        """Log them; tell the drones whose set-points begin or end, if their links have a way to."""
        for transition in transitions:
            index, before, after, _ = transition
            robot, link = self.robots[index], self._links[index]
            with self.faults.contain(f"{robot}/transition"):
                self._log.transition(robot, transition, self._status.held(index))
                self._rivals.follow(index, after)
                if after is Mode.UNLOCK:
                    self._commands.begin(index)
                    self._backends.look(index)
                if after is not Mode.IDLE:
                    link.reclaim()
                elif before in (Mode.REST, Mode.UNLOCK):
                    link.release(in_flight=False)

    def _look_around(self) -> None:
        with self.faults.contain("rivals"):
            self._rivals.look_around()
        offered = dict(self.get_service_names_and_types())
        for index, robot in enumerate(self.robots):
            with self.faults.contain(f"{robot}/services"):
                self._links[index].find_services(offered)
                self._backends.look(index)
        with self.faults.contain("pose sources"):
            self._sources.look()
            self._others.look()

    def _newest(self) -> tuple[Tick, np.ndarray] | None:
        return None if self._last is None else (self._last, self._pilot.places)

    def _report(self, _: int) -> list[RobotCondition]:
        """Return how every drone is; nothing of those of which nothing is known before the first tick."""
        durations, self._durations = np.array(self._durations or [0.0]), []
        self._look_at_clock()
        self._take_poses()
        reports = []
        for index, robot in enumerate(self.robots):
            values: dict[str, object] = {
                "refused": self.faults.count(robot),
                "last refusal": self.faults.newest(robot),
                "events": self._log.events[robot],
                "last event": self._log.newest.get(robot, ""),
            }
            if self._commands.last_resort.since[index] is not None:
                reports.append(RobotCondition(robot, robot, Level.ERROR, f"LAST RESORT: {_BROKEN}", values))
            elif self._last is not None:
                values |= {"tick median us": f"{np.median(durations):.0f}", "tick max us": f"{durations.max():.0f}"}
                with self.faults.contain(f"{robot}/report"):
                    rivals, now = self._rivals.of(index), self._stamps.now
                    reports.append(report_flight(robot, index, self._pilot, self._last, now, rivals, values))
        return reports


def _silent(_: int) -> None:
    """Say nothing to a drone."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the controller."""
    return run(ControllerNode, argv)


if __name__ == "__main__":
    sys.exit(main())
