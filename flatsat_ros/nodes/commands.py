"""Set-points of N drones on their way to the wire, and what is sent when no command can be computed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from geometry_msgs.msg import Twist
from rclpy.duration import Duration

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import Backend, WireSetpoint, YawMode, setpoint_from_command
from flatsat_ros.flight.tick import Command
from flatsat_ros.nodes.last_resort import LastResort
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.runtime import ENDING_TIME, ProgramNode

# Who takes commands may know of their sender later than the sender of it, and a receiver that keeps the newest command
# alone may be so late that it overtakes all zeros of 0.3 s: two cores, ten drones, a load of 3. For so long, s, what
# arrives of a stream that begins is not counted.
STARTING_TIME = 0.7


class Commands:
    """Publishes commands drone by drone: a drone for which that fails descends by its last resort.

    Attributes:
        last_resort: of each drone.
    """

    def __init__(
        self,
        node: ProgramNode,
        robots: Sequence[str],
        vehicles: Sequence[VehicleProfile],
        backend_of: Callable[[int], Backend],
        yaw_mode: YawMode,
    ) -> None:
        """Begin with nothing sent.

        Args:
            node: publishes.
            robots: names of the drones.
            vehicles: their profiles.
            backend_of: of crazyswarm2, of a drone by its number.
            yaw_mode: what the yaw on the wire means.
        """
        hover = [float(vehicle.pwm_from_thrust(GRAVITY)) for vehicle in vehicles]
        self.last_resort = LastResort(hover, keeps_yaw=yaw_mode is YawMode.ANGLE)
        self._node, self._robots, self._vehicles = node, robots, vehicles
        self._backend_of, self._yaw_mode = backend_of, yaw_mode
        self._message, topic = Twist(), interfaces.COMMAND
        self._taken_since = [math.inf] * len(robots)  # s, since the stream began and all who take it were there
        self._takers = [0] * len(robots)
        self._publishers = [node.create_publisher(topic.kind, topic.of(robot), topic.publish) for robot in robots]

    def send(self, index: int, command_of: Callable[[int], Command | None]) -> None:
        """Send a drone its command, or its last resort where there is none to be had."""
        robot = self._robots[index]
        if self.last_resort.since[index] is None:
            with self._node.faults.contain(f"{robot}/command"):
                command = command_of(index)
                if command is not None:
                    vehicle = self._vehicles[index]
                    setpoint = setpoint_from_command(*command, vehicle, self._backend_of(index), self._yaw_mode)
                    self._publish(index, setpoint)
                    self.last_resort.note(index, setpoint)
                return
            self.last_resort.begin(index)
        with self._node.faults.contain(f"{robot}/last resort"):
            last = self.last_resort.setpoint(index)
            if last is not None:
                self._publish(index, last)

    def is_taken(self, index: int) -> bool:
        """Tell whether somebody takes the commands of a drone."""
        return bool(self._publishers[index].get_subscription_count() > 0)

    def begin(self, index: int) -> None:
        """Take note that a stream of commands to a drone begins."""
        self._taken_since[index] = math.inf

    def arrive(self, index: int, now: float) -> bool:
        """Tell, at time now, s, whether a drone's commands have been taken for long enough to count on them.

        Who was there first may be a recorder, or a simulator that was killed: with whoever joins it begins anew.
        """
        takers = self._publishers[index].get_subscription_count()
        if takers == 0:
            self._taken_since[index] = math.inf
        elif takers > self._takers[index] or math.isinf(self._taken_since[index]):
            self._taken_since[index] = now
        self._takers[index] = takers
        return now - self._taken_since[index] >= STARTING_TIME

    def flush(self) -> None:
        """Wait until what was sent is acknowledged, for a limited time."""
        end = time.monotonic() + ENDING_TIME
        for publisher in self._publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))

    def _publish(self, index: int, setpoint: WireSetpoint) -> None:
        messages.fill_command(self._message, setpoint)
        self._publishers[index].publish(self._message)
