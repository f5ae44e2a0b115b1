"""The controller node: poses in, thrust, roll and pitch out, for any number of drones.

Callbacks convert and store. One fixed-rate tick, the certificate's period, computes all drones in one step.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.certificate.sets import Place
from flatsat_ros.crazyflie.wire import Backend, setpoint_from_command
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.estimator import PREDICTION_MAX
from flatsat_ros.flight.pilot import Command, Pilot, Tick
from flatsat_ros.flight.supervisor import Mode, Policy, Transition
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning
from flatsat_ros.nodes.crazyswarm import SETTLING_TIME, DroneLink
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.diagnostics import Diagnostics, Level, Report
from flatsat_ros.nodes.ros.parameters import (
    declare,
    declare_choice,
    declare_override,
    declare_robots,
    declare_vehicles,
    declare_yaw_mode,
    require_float_or_unset,
    require_known_parameters,
)
from flatsat_ros.nodes.ros.runtime import ProgramNode, run

# how often services of the drones' links are looked for, s
_LOOK_PERIOD = 1.0

Answer = TypeVar("Answer", SetBool.Response, Trigger.Response)

# how long the last commands may take to be acknowledged, s
_ENDING_TIME = 0.5

# parameter, what it means, unit, default and range of the tuning; Tuning's fields in order
_TUNING = (
    ("mu", "adaptation rate mu of the gain; 0 keeps it constant", "1/s", 2.0, (0.0, 100.0)),
    ("v_inf", "threshold V_inf below which the gain rests", "", 0.05, (1e-9, 1e9)),
    ("gamma_0", "gain gamma_0 at take-off", "", 1.0, (1.0, 1e6)),
    ("gamma_max", "cap of the gain, at most the certificate's; 0 takes the certificate's", "", 0.0, (0.0, 1e6)),
    ("nu", "leak of the gain toward 1, at most 1/period; 0 is the paper's law", "1/s", 0.0, (0.0, 1e3)),
)

# the figures of the flight modes that a lab may want otherwise
_POLICY = (
    ("pose_timeout", "age above which a pose is stale", "s", Policy.pose_timeout, (0.01, PREDICTION_MAX)),
    ("level_time", "level descent without poses before the motors are cut", "s", Policy.level_time, (0.1, 60.0)),
    ("unlock_time", "zero thrust before take-off, which opens the lock", "s", Policy.unlock_time, (0.01, 10.0)),
    ("lift_off_time", "commanded climb on the ground that ends in a cut", "s", Policy.lift_off_time, (0.5, 600.0)),
    ("ground_height", "a drone below this height stands on the ground", "m", Policy.ground_height, (-1e3, 1e3)),
    ("disturbance_max", "largest disturbance that is compensated; 0 is the paper's law", "m/s^2", 0.8, (0.0, 100.0)),
    ("thrust_error_max", "largest error of the thrust that is estimated and corrected; 0: none", "", 0.0, (0.0, 0.5)),
)


class ControllerNode(ProgramNode):
    """ROS shell of `Pilot`."""

    shutdown_time_max = 0.5  # s, for hand-overs

    def __init__(self) -> None:
        """Read the parameters, load the certificate and the vehicle, start the tick."""
        super().__init__(interfaces.CONTROLLER_NODE)
        robots = declare_robots(self)
        self.robots = [robot.name for robot in robots]
        certificate = declare(
            self, "certificate", "paper_experiment", "certificate: packaged name or path of a YAML file"
        )
        self._certificate = load_certificate(certificate)
        self._vehicles = declare_vehicles(self, robots)
        self._backend = declare_choice(self, "backend", Backend, "crazyswarm2 back end, gives the sign of the pitch")
        self._yaw_mode = declare_yaw_mode(self)
        for robot, vehicle in zip(self.robots, self._vehicles, strict=True):
            if self._certificate.limits.thrust_max > vehicle.thrust_max:
                raise FlatsatError(
                    f"certificate {self._certificate.name!r} allows a thrust of "
                    f"{self._certificate.limits.thrust_max:.4f} m/s^2, but {robot}, vehicle {vehicle.name!r}, "
                    f"lifts {vehicle.thrust_max:.4f} m/s^2: synthesize one with thrust_max at most that"
                )
        policy = Policy(**{
            name: declare(self, name, default, meaning, unit=unit, bounds=bounds)
            for name, meaning, unit, default, bounds in _POLICY
        })  # fmt: skip
        for name, meaning, unit, default, valid in _TUNING:
            declare(self, name, default, meaning, unit=unit, bounds=valid, changeable=True)
            for robot in self.robots:
                declare_override(self, f"robots.{robot}.{name}", meaning, unit)
        # zero thrust from the next tick on, the tick after it, the notice that no more follows
        self._unlock_time = policy.unlock_time + 2.0 * self._certificate.period + SETTLING_TIME
        self._takeoff_height = declare(
            self, "takeoff_height", 0.5, "how high the takeoff service sends a drone", unit="m", bounds=(0.05, 100.0)
        )
        declare(self, "restart_gain", True, "a far new reference restarts the gain at gamma_0", changeable=True)
        require_known_parameters(self)
        self._pilot = Pilot(self._certificate, self._tuning_with({}), policy, len(self.robots))
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)

        self._origin = self.get_clock().now().nanoseconds
        self._poses: list[tuple[int, bytes]] = []
        self._durations: list[float] = []
        self._last: Tick | None = None
        self._command = Twist()
        self._telemetry = messages.telemetry_message()
        self._command_publishers: list[Publisher] = []
        self._telemetry_publishers: list[Publisher] = []
        for index, robot in enumerate(self.robots):
            self._connect(index, robot)
        for robot in (*self.robots, interfaces.ALL):
            self._serve(robot)
        self._links = [DroneLink(self, robot) for robot in self.robots]
        self.create_timer(self._certificate.period, self._on_tick)
        self.create_timer(_LOOK_PERIOD, self._look_for_services)
        Diagnostics(self, self._report)
        self.get_logger().info(
            f"flying {', '.join(self.robots)} with certificate {self._certificate.name!r} at "
            f"{1.0 / self._certificate.period:g} Hz, gain cap {self._certificate.gain_max:.4g}"
        )

    def is_shut_down(self) -> bool:
        """Tell whether every hand-over that has begun is through."""
        return not any(link.is_releasing for link in self._links)

    def finish(self) -> None:
        """Send the last safe commands: level and sinking in the air, zero thrust otherwise; nothing to idle drones."""
        last = {index: self._pilot.last_command(index) for index in range(len(self.robots))}
        commanded = {index: command for index, command in last.items() if command is not None}
        for index, command in commanded.items():
            self._publish_command(index, command)
        end = time.monotonic() + _ENDING_TIME
        for index in commanded:
            left = max(end - time.monotonic(), 0.0)
            self._command_publishers[index].wait_for_all_acked(Duration(seconds=left))

    def _connect(self, index: int, robot: str) -> None:
        pose, goal, trajectory = interfaces.POSE, interfaces.GOAL, interfaces.TRAJECTORY
        command, report = interfaces.COMMAND, interfaces.TELEMETRY
        self.create_subscription(pose.kind, pose.of(robot), partial(self._on_pose, index), pose.subscribe, raw=True)
        self.create_subscription(goal.kind, goal.of(robot), lambda m: self._on_goal(index, m), goal.subscribe)
        self.create_subscription(
            trajectory.kind, trajectory.of(robot), lambda m: self._on_trajectory(index, m), trajectory.subscribe
        )
        self._command_publishers.append(self.create_publisher(command.kind, command.of(robot), command.publish))
        self._telemetry_publishers.append(self.create_publisher(report.kind, report.of(robot), report.publish))

    def _serve(self, robot: str) -> None:
        """Offer the services of one robot, or of all."""
        indices = range(len(self.robots)) if robot == interfaces.ALL else [self.robots.index(robot)]
        actions: dict[str, Callable[[int], str | None]] = {
            "takeoff": lambda index: self._pilot.take_off(index, self._takeoff_height),
            "land": self._pilot.land,
            "hand_over": self._hand_over,
        }
        for name in interfaces.TRIGGERS:

            def trigger(_: Trigger.Request, answer: Trigger.Response, name: str = name) -> Trigger.Response:
                return self._answer(answer, name, indices, actions[name])

            self.create_service(Trigger, interfaces.service_of(robot, name), trigger)

        def arm(request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
            wanted = messages.arming_from_request(request)
            return self._answer(answer, "arm" if wanted else "disarm", indices, lambda index: self._arm(index, wanted))

        self.create_service(SetBool, interfaces.service_of(robot, interfaces.ARM), arm)

    def _arm(self, index: int, wanted: bool) -> str:
        """Allow or forbid take-off, and arm or disarm the drone itself; return what happens now."""
        self._pilot.arm(index, wanted)
        asked = self._links[index].arm(wanted)
        if not self._pilot.is_opening(index):
            return asked
        return f"{asked}; the thrust lock opens: let others fly the drone after {self._unlock_time:.2f} s"

    def _hand_over(self, index: int) -> None:
        """Fall silent about a drone, and let it stay where it is if its link has a way to."""
        self._pilot.hand_over(index)
        self._links[index].release(in_flight=True)

    def _answer(self, answer: Answer, name: str, indices: Sequence[int], act: Callable[[int], str | None]) -> Answer:
        """Do something with some drones and say how it went for each; a refusal for one does not stop the others."""
        refused, done = [], []
        for index in indices:
            try:
                done.append(act(index))
            except FlatsatError as error:
                refused.append(f"{self.robots[index]}: {name} refused: {error}")
        messages.fill_answer(answer, not refused, "; ".join(refused + [sentence for sentence in done if sentence]))
        for sentence in refused:
            self.get_logger().error(sentence)
        return answer

    def _seconds(self, nanoseconds: int) -> float:
        """Return a clock reading as seconds since the node's start: small enough to keep nanoseconds in a float."""
        return (nanoseconds - self._origin) / messages.NANOSECONDS

    def _take_poses(self, now: float) -> None:
        """Take in the poses since the last tick: one after the other they cost a fifth of what each does by itself."""
        poses, self._poses = self._poses, []
        for index, data in poses:
            stamp, position, quaternion = messages.pose_from_cdr(data)
            self._pilot.measure(index, self._seconds(stamp), position, quaternion, now)

    def _on_pose(self, index: int, data: bytes) -> None:
        self._poses.append((index, data))

    def _on_goal(self, index: int, message: PoseStamped) -> None:
        self._set_reference(index, lambda: messages.setpoint_from_goal(message))

    def _on_trajectory(self, index: int, message: MultiDOFJointTrajectory) -> None:
        now = self.get_clock().now().nanoseconds
        self._set_reference(index, lambda: messages.trajectory_from_message(message, now, self._origin))

    def _set_reference(self, index: int, read: Callable[[], Trajectory]) -> None:
        """Take a reference, or keep the old one and say why."""
        try:
            self._pilot.set_reference(index, read())
        except FlatsatError as error:
            self.get_logger().error(f"{self.robots[index]}: reference refused, the previous one stays: {error}")

    def _on_tick(self) -> None:
        now = self._seconds(self.get_clock().now().nanoseconds)
        self._take_poses(now)
        tick = self._pilot.tick(now)
        self._durations.append(tick.duration * 1e6)
        self._follow_transitions(tick.transitions)
        self._last = tick
        rows = telemetry.rows(tick)
        for index in range(len(self.robots)):
            command = tick.command(index)
            if command is not None:
                self._publish_command(index, command)
            messages.fill_telemetry(self._telemetry, rows[index])
            self._telemetry_publishers[index].publish(self._telemetry)

    def _follow_transitions(self, transitions: Sequence[Transition]) -> None:
        """Say who did not lift off; tell the drones whose set-points begin or end, if their links have a way to."""
        for index, before, after, reason in transitions:
            robot, link = self.robots[index], self._links[index]
            if before is Mode.FLY and after is Mode.CUT:
                self.get_logger().error(
                    f"{robot}: {reason}: motors cut. Not armed, locked until reboot, not linked, or heavier than its "
                    "vehicle profile? A new reference tries again"
                )
            if after is not Mode.IDLE:
                link.reclaim()
            elif before in (Mode.REST, Mode.UNLOCK):
                link.release(in_flight=False)

    def _publish_command(self, index: int, command: Command) -> None:
        setpoint = setpoint_from_command(*command, self._vehicles[index], self._backend, self._yaw_mode)
        messages.fill_command(self._command, setpoint)
        self._command_publishers[index].publish(self._command)

    def _tuning_with(self, changed: dict[str, object]) -> Tuning:
        """Return the tuning with some parameters changed; a robot's own value goes over the common one.

        Raises:
            FlatsatError: a value is not valid.
        """

        def value(name: str) -> float | None:
            found = changed[name] if name in changed else self.get_parameter(name).value
            return require_float_or_unset(name, found)

        columns = []
        for name, *_ in _TUNING:
            common = value(name)
            own = [value(f"robots.{robot}.{name}") for robot in self.robots]
            columns.append(np.array([common if entry is None else entry for entry in own], dtype=float))
        mu, v_inf, initial, cap, nu = columns
        cap = np.where(cap == 0.0, self._certificate.gain_max, cap)
        restart = bool(changed.get("restart_gain", self.get_parameter("restart_gain").value))
        tuning = Tuning(mu, v_inf, initial, cap, nu, restart)
        Controller(self._certificate, tuning)
        return tuning

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.type_ is Parameter.Type.NOT_SET:  # rclpy would forget its declaration
                    raise FlatsatError(f"parameter {parameter.name} cannot be deleted: set it to the common value")
            self._tuning_with({parameter.name: parameter.value for parameter in parameters})
        except FlatsatError as error:
            return messages.parameters_answer(str(error))
        return messages.parameters_answer()

    def _take_parameters(self, _parameters: Sequence[Parameter]) -> None:
        self._pilot.retune(self._tuning_with({}))

    def _look_for_services(self) -> None:
        offered = dict(self.get_service_names_and_types())
        for link in self._links:
            link.find_services(offered)

    def _report(self, nanoseconds: int) -> list[Report]:
        """Return how every drone is; nothing before the first tick."""
        durations, self._durations = np.array(self._durations or [0.0]), []
        if self._last is None:
            return []
        now, reports = self._seconds(nanoseconds), []
        self._take_poses(now)
        median, longest = np.median(durations), durations.max()
        estimator, out, where = self._pilot.estimator, self._last.output, self._last.assessment
        for index, robot in enumerate(self.robots):
            mode, place = Mode(self._pilot.mode[index]), Place(where.place[index])
            outside = mode is Mode.FLY and place is Place.OUTSIDE
            level = Level.ERROR if mode in (Mode.LEVEL, Mode.CUT) else Level.WARN if outside else Level.OK
            values = {
                "V/eps": f"{where.relative_level[index]:.4g}",
                "set": place.name,
                "guaranteed": bool(where.guaranteed[index]) and mode is Mode.FLY,
                "gamma": f"{out.gain[index]:.4g}",
                "applied gain": f"{out.applied_gain[index]:.4g}",
                "pose age s": f"{now - estimator.newest[index]:.3f}",
                "poses refused": int(estimator.rejected[index]),
                "tick median us": f"{median:.0f}",
                "tick max us": f"{longest:.0f}",
            }
            text = mode.name + (": outside the certified sets" if outside else "")
            reports.append(Report(robot, robot, level, text, values))
        return reports


def main(argv: Sequence[str] | None = None) -> int:
    """Run the controller."""
    return run(ControllerNode, argv)


if __name__ == "__main__":
    sys.exit(main())
