"""What drones tell of themselves: on `<robot>/battery`, and on crazyswarm2's `<robot>/status` where it can be read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.runtime import ProgramNode


class DroneStatus:
    """Hands on the voltages of drones, and keeps whether they are armed."""

    def __init__(
        self,
        node: ProgramNode,
        robots: Sequence[str],
        vehicles: Sequence[VehicleProfile],
        take_voltage: Callable[[int, float], None],
    ) -> None:
        """Listen to the drones.

        Args:
            node: listens.
            robots: names.
            vehicles: a profile for each robot.
            take_voltage: called with the number of a robot and its voltage, V, for every message that tells one.
        """
        self._robots, self._vehicles, self._take_voltage = list(robots), list(vehicles), take_voltage
        self._armed: list[bool | None] = [None] * len(self._robots)  # None: it has not said
        for topic in filter(None, (interfaces.BATTERY, crazyswarm.installed_status_topic())):
            for index, robot in enumerate(robots):
                node.create_subscription(topic.kind, topic.of(robot), partial(self.take, index), topic.subscribe)

    def take(self, index: int, message: Any) -> None:
        """Take in what drone index tells: sensor_msgs' BatteryState or crazyflie_interfaces' Status."""
        armed = messages.armed_from_message(message)
        self._armed[index] = self._armed[index] if armed is None else armed
        self._take_voltage(index, messages.voltage_from_message(message))

    def disarmed(self, index: int) -> str:
        """Return that drone index says that it is not armed, and what to do; empty if it does not say so."""
        return "" if self._armed[index] is not False else f"its status says that it is not armed: {self._help(index)}"

    def held(self, index: int) -> str:
        """Return why drone index may stay on the ground against the command, and what to do, as far as it is known."""
        required = self._vehicles[index].motors.arming_required
        if self._armed[index] is None and required:
            return f"drones of its kind fly only when they are armed: {self._help(index)}"
        return self.disarmed(index)

    def _help(self, index: int) -> str:
        return f"call {interfaces.service_of(self._robots[index], interfaces.ARM)}"
