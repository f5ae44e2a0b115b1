"""Simulated Crazyflies behind crazyswarm2's topics: set-points in, motion capture poses out, in real time.

Simulated time follows the node's clock. When it cannot, because the process was stopped or the machine is too slow, it
pauses for what exceeds `_CATCH_UP`: the simulation never falls further and further behind, stamps never lie in the
future, and no drone takes a stall of its own simulator for a lost link. The same holds when the clock steps.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Twist
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import refusal, require_number
from flatsat_ros.crazyflie.crazyflies_yaml import Robot
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.wire import Backend
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces, messages, server_messages
from flatsat_ros.nodes.ros.diagnostics import Diagnostics, Level, RobotCondition
from flatsat_ros.nodes.ros.parameters import (
    declare,
    declare_robots,
    declare_vehicles,
    declare_yaw_mode,
    require_known_parameters,
)
from flatsat_ros.nodes.ros.runtime import ProgramNode, run
from flatsat_ros.nodes.server_commands import Drone, ServerCommands
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.firmware import Firmware
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import BATTERY_PERIOD, Battery
from flatsat_ros.sim.proximity import STILL, Proximity
from flatsat_ros.sim.sensor import MotionCapture
from flatsat_ros.sim.state_machine import State

# how often the simulation is brought up to date, s; poses leave at most this much later than they are due
_TICK = 0.005
# the most that is caught up at once, s: less than the silence after which the firmware levels out
_CATCH_UP = 0.25


class Measured(NamedTuple):
    """One measured pose.

    Attributes:
        stamp: on the node's clock, ns.
        robot: its number.
        position: (3,) m, world.
        quaternion: (4,) x, y, z, w; body -> world.
    """

    stamp: int
    robot: int
    position: FloatArray
    quaternion: FloatArray


class SimDrone(ProgramNode):
    """ROS shell of one `SimulatedFleet` for each vehicle profile.

    Attributes:
        program: name of the node.
        robots: names of the drones.
        drones: where each is simulated.
        proximity: ground effect and downwash by default.
        backend: whose set-points are taken.
    """

    program = interfaces.SIM_DRONE_NODE
    proximity = STILL
    backend = Backend.CPP

    def __init__(self) -> None:
        """Read the parameters, switch the drones on, start simulated time."""
        super().__init__(self.program)
        robots = declare_robots(self)
        self.robots = [robot.name for robot in robots]
        self._fleets = self._build_fleets(robots)
        drones = {
            robot: Drone(self.robots[robot], fleet, number)
            for fleet, members in self._fleets
            for number, robot in enumerate(members)
        }
        self.drones = [drones[robot] for robot in range(len(self.robots))]
        self.declare_more(robots, self.get_parameter("pose_rate").value)
        require_known_parameters(self)
        self._pose = messages.pose_message()
        self._pose_publishers: list[Publisher] = []
        self._battery_publishers: list[Publisher] = []
        self._status = crazyswarm.installed_status_topic()
        self._status_publishers: list[Publisher] = []
        for index, robot in enumerate(self.robots):
            self._connect(index, robot)
        # ns: what the clock showed last; what it shows when simulated time is 0, now and without any pause
        self._seen = self._epoch = self._started = self.get_clock().now().nanoseconds
        ServerCommands(self, self.drones, self._advance)
        self.create_timer(_TICK, self._advance)
        self.create_timer(BATTERY_PERIOD, self._publish_batteries)
        Diagnostics(self, self._report)
        self.get_logger().info(f"simulating {', '.join(self.robots)}")

    def declare_more(self, robots: Sequence[Robot], pose_rate: float) -> None:
        """Declare what another program has besides, before unknown parameters are refused; nothing by default.

        Args:
            robots: what there is to tell of each drone.
            pose_rate: Hz.
        """

    def _build_fleets(self, robots: Sequence[Robot]) -> list[tuple[SimulatedFleet, list[int]]]:
        """Read what is simulated and how; return a fleet and the indices of its robots for each vehicle profile.

        Raises:
            FlatsatError: a value is not valid.
        """
        vehicles = declare_vehicles(self, robots)
        count, places = len(robots), [entry for robot in robots for entry in robot.position]
        start = declare(self, "start_positions", places, "initial x, y, z of every drone in turn", unit="m")
        if len(start) != 3 * count:
            valid = f"{3 * count}: x, y, z of {count} drones"
            raise refusal("entries of parameter start_positions", len(start), "", valid)
        for entry in start:
            require_number("entry of parameter start_positions", entry, "m", -1e3, 1e3)
        common: dict[str, Any] = {
            "dynamics": declare(
                self, "dynamics", "identified", "ideal: double integrator; identified: with attitude, lag, drag"
            ),
            "yaw": declare(self, "start_yaw", 0.0, "initial yaw of every drone", unit="rad", bounds=(-np.pi, np.pi)),
            "yaw_mode": declare_yaw_mode(self),
            "floor": declare(self, "floor", 0.0, "height of the floor", unit="m", bounds=(-1e3, 1e3)),
            "seed": declare(self, "seed", 0, "seed of noise, drop-out and gusts", bounds=(0, 2**31 - 1)),
            "thrust_scale": declare(
                self, "thrust_scale", 1.0, "force over what the vehicle profile promises", bounds=(0.1, 10.0)
            ),
            "command_delay": declare(
                self,
                "command_delay",
                LINK_DELAY,
                "from a command's arrival here to the drone",
                unit="s",
                bounds=(0.0, 10.0),
            ),
            "wind": self._wind(),
            "capture": self._capture(),
            "battery": self._battery(),
            "proximity": self._proximity(),
        }
        fleets = []
        for stream, kind in enumerate(dict.fromkeys(vehicles)):
            members = [index for index, vehicle in enumerate(vehicles) if vehicle == kind]
            where = np.reshape(start, (count, 3))[members]
            fleets.append((SimulatedFleet(kind, len(members), start=where, stream=stream, **common), members))
        return fleets

    def _wind(self) -> Wind:
        mean = declare(self, "wind", [0.0, 0.0, 0.0], "mean air velocity in the world frame, x, y, z", unit="m/s")
        if len(mean) != 3:
            raise refusal("entries of parameter wind", len(mean), "", "3: x, y, z")
        for entry in mean:
            require_number("entry of parameter wind", entry, "m/s", -100.0, 100.0)
        return Wind(
            mean=(mean[0], mean[1], mean[2]),
            gust=declare(self, "gust", 0.0, "standard deviation of gusts, per axis", unit="m/s", bounds=(0.0, 100.0)),
            gust_time=declare(self, "gust_time", 1.0, "correlation time of gusts", unit="s", bounds=(1e-3, 1e3)),
        )

    def _capture(self) -> MotionCapture:
        noise = "standard deviation of a measured position, per axis; no sample is further than 5 of them off"
        return MotionCapture(
            rate=declare(self, "pose_rate", 100.0, "poses per second", unit="Hz", bounds=(0.1, 500.0)),
            noise=declare(self, "position_noise", 0.0, noise, unit="m", bounds=(0.0, 10.0)),
            dropout=declare(self, "drop_out", 0.0, "probability that a pose is lost", bounds=(0.0, 1.0)),
            latency=declare(
                self, "pose_delay", 0.0, "from a pose's stamp to its publication", unit="s", bounds=(0.0, 10.0)
            ),
        )

    def _proximity(self) -> Proximity:
        strength, usual = (0.0, 100.0), self.proximity
        push = "push on a drone right below another, over the other's lift, at no distance; 0: no downwash"
        return Proximity(
            ground_effect=declare(
                self, "ground_effect", usual.ground_effect, "strength of the ground effect; 0: none", bounds=strength
            ),
            downwash=declare(self, "downwash", usual.downwash, push, bounds=strength),
            reach=declare(self, "downwash_reach", usual.reach, "how far down it goes", unit="m", bounds=(0.21, 10.0)),
            width=declare(
                self, "downwash_width", usual.width, "how far aside it is half as strong", unit="m", bounds=(0.01, 10.0)
            ),
        )

    def _battery(self) -> Battery:
        drain = "fall of the open-circuit voltage at full force"
        return Battery(
            voltage=declare(
                self, "battery_voltage", 4.0, "open-circuit voltage at the start", unit="V", bounds=(0.1, 100.0)
            ),
            sag=declare(self, "battery_sag", 0.0, "voltage drop at full force", unit="V", bounds=(0.0, 100.0)),
            drain=declare(self, "battery_drain", 0.0, drain, unit="V/s", bounds=(0.0, 100.0)),
        )

    def _connect(self, index: int, robot: str) -> None:
        pose, command = interfaces.POSE, interfaces.COMMAND
        self._pose_publishers.append(self.create_publisher(pose.kind, pose.of(robot), pose.publish))
        battery = interfaces.BATTERY
        self._battery_publishers.append(self.create_publisher(battery.kind, battery.of(robot), battery.publish))
        if status := self._status:
            self._status_publishers.append(self.create_publisher(status.kind, status.of(robot), status.publish))
        self.create_subscription(command.kind, command.of(robot), partial(self._on_command, index), command.subscribe)
        reboot = interfaces.drone_service_of(robot, interfaces.REBOOT)
        self.create_service(Trigger, reboot, lambda _, answer: self._reboot(index, answer))

    def _reboot(self, index: int, answer: Trigger.Response) -> Trigger.Response:
        _, fleet, number = self.drones[index]
        fleet.reboot(number)
        messages.fill_answer(answer, True, "")
        return answer

    def _on_command(self, index: int, message: Twist) -> None:
        """Hand a set-point over as it is: NaN angles as well, which the firmware does not check either."""
        self._advance()
        _, fleet, number = self.drones[index]
        roll, pitch, yaw, thrust = messages.command_from_message(message)
        fleet.command(number, roll, self.backend.pitch_sign * pitch, yaw, thrust)

    def _advance(self) -> None:
        """Bring the simulation up to the clock, as far as one step may, and publish the poses that are due."""
        now = self.get_clock().now().nanoseconds
        elapsed, self._seen = now - self._seen, now
        self._epoch += elapsed - min(max(elapsed, 0), round(_CATCH_UP * messages.NANOSECONDS))
        time = (now - self._epoch) / messages.NANOSECONDS
        measured = []
        if len(self._fleets) > 1:
            self._introduce()
        for fleet, members in self._fleets:
            fleet.advance_to(time)
            for sample in fleet.measurements(time):
                stamp = self._epoch + round(sample.stamp * messages.NANOSECONDS)
                measured.append(Measured(stamp, members[sample.drone], sample.position, sample.quaternion))
        if len(self._fleets) > 1:
            measured.sort(key=lambda one: one.stamp)
        self.publish_measured(measured)

    def _introduce(self) -> None:
        """Tell each fleet where the drones of the others are, for the air that they push down."""
        for fleet, _ in self._fleets:
            others = [other for other, _ in self._fleets if other is not fleet]
            where = np.concatenate([other.bodies.position for other in others])
            fleet.neighbours = where, np.concatenate([other.lift for other in others])

    def publish_measured(self, measured: Sequence[Measured]) -> None:
        """Publish poses, in the order of their stamps."""
        for stamp, robot, position, quaternion in measured:
            messages.fill_pose(self._pose, stamp, position, quaternion)
            self._pose_publishers[robot].publish(self._pose)

    def _publish_batteries(self) -> None:
        """Publish the batteries of the drones that are switched on, and their status where its type is installed."""
        now = self.get_clock().now().nanoseconds
        for index, (robot, fleet, number) in enumerate(self.drones):
            if not fleet.firmware.powered[number]:
                continue
            voltage = float(fleet.power.voltage[number])
            self._battery_publishers[index].publish(messages.battery_message(now, voltage))
            if self._status is not None:
                info, low = int(fleet.firmware.info()[number]), bool(fleet.firmware.battery_low[number])
                status = server_messages.status_message(self._status.kind, now, robot, voltage, info, low)
                self._status_publishers[index].publish(status)

    def _report(self, _now: int) -> list[RobotCondition]:
        """Return how every drone is."""
        paused = (self._epoch - self._started) / messages.NANOSECONDS
        infos = {fleet: fleet.firmware.info() for fleet, _ in self._fleets}
        reports = []
        for robot, fleet, number in self.drones:
            level, text = _condition(fleet.firmware, number)
            values = {
                "state": State(fleet.firmware.state[number]).name,
                "supervisor.info": int(infos[fleet][number]),
                "thrust locked": bool(fleet.firmware.thrust_locked[number]),
                "tumbled": bool(fleet.firmware.tumbled[number]),
                "battery V": f"{fleet.power.voltage[number]:.2f}",
                "on the floor": bool(fleet.bodies.grounded[number]),
                "commands ignored": self.faults.count(robot),
                "paused s": f"{paused:.2f}",
            }
            reports.append(RobotCondition(robot, robot, level, text, values))
        return reports


def _condition(firmware: Firmware, index: int) -> tuple[Level, str]:
    """Return how well a drone is, and its condition in a few words."""
    state = State(firmware.state[index])
    if not firmware.powered[index]:
        return Level.ERROR, "battery empty"
    if firmware.tumbled[index] or state is State.CRASHED:
        return Level.ERROR, "tumbled"
    if state in (State.FREE_FALL, State.LOCKED):
        return Level.ERROR, "motors off until reboot"
    if state is State.LEVEL_OUT:
        return Level.WARN, "level-out"
    if firmware.thrust_locked[index]:
        return Level.WARN, "thrust locked"
    if firmware.battery_low[index]:
        return Level.WARN, "battery low"
    return Level.OK, state.name.lower().replace("_", " ")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulated drones."""
    return run(SimDrone, argv)


if __name__ == "__main__":
    sys.exit(main())
