"""The parameters of crazyswarm2's server: its robots', and those of simulated drones' firmware.

`<robot>.params.<group>.<name>` are one drone's, `all.params.<group>.<name>` all drones'. The simulated firmware acts on
few of them; what else scripts set is remembered, that is all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.parameter import Parameter

from flatsat_ros.base.errors import FlatsatError, require
from flatsat_ros.crazyflie.crazyflies_yaml import Robot
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare
from flatsat_ros.nodes.ros.runtime import ProgramNode
from flatsat_ros.nodes.server_commands import Drone

_BYTE, _WORD = (0, 255), (0, 65535)
_GROUP_MASK, _YAW_MODE, _CONTROLLER = "hlCommander.groupmask", "flightmode.stabModeYaw", "stabilizer.controller"
# default and bounds, of integers alone; release 2026.08 of the firmware
FIRMWARE: dict[str, tuple[int | float, tuple[int, int] | None]] = {
    _GROUP_MASK: (0, _BYTE),
    _YAW_MODE: (0, (0, 1)),
    _CONTROLLER: (1, (0, 8)),
    "stabilizer.estimator": (2, (0, 5)),
    "commander.enHighLevel": (1, (0, 1)),
    "hlCommander.vtoff": (0.5, None),
    "hlCommander.vland": (0.5, None),
    "kalman.resetEstimation": (0, (0, 1)),
    "kalman.pNAcc_xy": (0.5, None),
    "locSrv.extPosStdDev": (0.01, None),
    "locSrv.extQuatStdDev": (0.0045, None),
    "led.bitmask": (0, _BYTE),
    "ring.effect": (6, _BYTE),
    "ring.solidRed": (20, _BYTE),
    "ring.solidGreen": (20, _BYTE),
    "ring.solidBlue": (20, _BYTE),
    "ring.headlightEnable": (0, _BYTE),
    "ring.fadeColor": (0, (0, 2**32 - 1)),
    "ring.fadeTime": (0.5, None),
    "sound.effect": (0, _BYTE),
    "usd.canLog": (1, (0, 1)),
    "usd.logging": (0, (0, 1)),
}
_PREFIX = ".params."


class ServerParameters:
    """Declares the parameters and hands on what the firmware acts on."""

    def __init__(self, node: ProgramNode, robots: Sequence[Robot], drones: Sequence[Drone]) -> None:
        """Declare them.

        Args:
            node: whose they are.
            robots: what there is to tell of each drone.
            drones: the same, simulated.

        Raises:
            FlatsatError: a value given at the start is not valid.
        """
        self._node = node
        self._drones = {drone.robot: drone for drone in drones}
        self._fixed = {_YAW_MODE: list(YawMode).index(drones[0].fleet.yaw_mode), _CONTROLLER: 1}
        for number, robot in enumerate(robots):
            self._declare_robot(number, robot)
        for name, (default, bounds) in FIRMWARE.items():
            value = self._fixed.get(name, default)
            for who in (interfaces.ALL, *self._drones):
                full = f"{who}{_PREFIX}{name}"
                given = declare(node, full, value, "firmware parameter", bounds=bounds, changeable=True)
                self._apply(full, given)
                if who == interfaces.ALL:
                    value = given  # of each drone, too, unless it has its own
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._hand_on)

    def _declare_robot(self, number: int, robot: Robot) -> None:
        """Declare what scripts ask about a robot; the last byte of the URI is the number that they know it by."""
        uri = robot.uri or f"radio://0/80/2M/E7E7E7E7{number + 1:02X}"
        place = list(self._node.get_parameter("start_positions").value[3 * number : 3 * number + 3])
        known: dict[str, Any] = {
            "enabled": True,
            "initial_position": place,
            "type": robot.kind or "default",
            "uri": uri,
        }
        for name, value in known.items():
            full = f"robots.{robot.name}.{name}"
            told = declare(self._node, full, value, "as crazyflies.yaml has it")
            why = f"{value}, where the drone is simulated: give start_positions"
            require(name != "initial_position" or list(told) == value, full, told, "m", why)

    def _check(self, parameters: Sequence[Parameter]) -> Any:
        """Refuse values that the simulated drones cannot fly with, all with the first of them."""
        try:
            for parameter in parameters:
                self._require(parameter.name, parameter.value)
        except FlatsatError as error:
            return messages.parameters_answer(str(error))
        return messages.parameters_answer()

    def _require(self, name: str, value: object) -> None:
        """Refuse another value of what is fixed.

        Raises:
            FlatsatError: it is one.
        """
        fixed = self._fixed.get(name.partition(_PREFIX)[2])
        why = f"{fixed}: the simulated drone has no other, or got it at the start"
        require(fixed is None or value == fixed, name, value, "", why)

    def _hand_on(self, parameters: Sequence[Parameter]) -> None:
        """Act on new values; what is set for all is each drone's, too."""
        for parameter in parameters:
            self._apply(parameter.name, parameter.value)
            who, found, name = parameter.name.partition(_PREFIX)
            if found and who == interfaces.ALL:
                names = (f"{robot}{_PREFIX}{name}" for robot in self._drones)
                self._node.set_parameters([Parameter(own, value=parameter.value) for own in names])

    def _apply(self, full: str, value: Any) -> None:
        """Give a drone's firmware its group mask.

        Raises:
            FlatsatError: the value is not that of a parameter that is fixed.
        """
        who, _, name = full.partition(_PREFIX)
        self._require(full, value)
        if name == _GROUP_MASK and who in self._drones:
            _, fleet, number = self._drones[who]
            fleet.firmware.high_level.group_mask[number] = value
