"""What crazyswarm2's server takes for its drones, taken for simulated ones.

Services of the high-level commander and of arming, for one drone and for all, and topics of set-points. Where
crazyflie_interfaces is not installed there are emergency and arming alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

from std_srvs.srv import Empty

from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces, server_messages
from flatsat_ros.nodes.ros.runtime import ProgramNode
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.position_controller import PositionSetpoint
from flatsat_ros.sim.state_machine import State
from flatsat_ros.sim.trajectories import ON_BOARD

Answer = TypeVar("Answer")


class Drone(NamedTuple):
    """Where a robot is simulated.

    Attributes:
        robot: its name.
        fleet: that it belongs to.
        number: in that fleet.
    """

    robot: str
    fleet: SimulatedFleet
    number: int


class ServerCommands:
    """The services and set-points of crazyswarm2's server, but for cmd_vel_legacy."""

    def __init__(self, node: ProgramNode, drones: Sequence[Drone], advance: Callable[[], object]) -> None:
        """Offer them, the emergency stop of all last: scripts take the server for ready when they see it.

        Args:
            node: that offers them.
            drones: whom they are for.
            advance: brings the simulation up to the clock.
        """
        self._node, self._advance = node, advance
        for drone in drones:
            self._offer(drone.robot, [drone])
        self._offer(interfaces.ALL, drones)

    def _offer(self, who: str, drones: Sequence[Drone]) -> None:
        """Offer for one drone, or for all, what is there for it."""
        crazyswarm.serve_arming(self._node, interfaces.drone_service_of(who, interfaces.ARM), partial(_arm, drones))
        kinds = crazyswarm.services()
        for name, (kind, command) in COMMANDS.items() if kinds else ():
            service = interfaces.drone_service_of(who, name)
            self._node.create_service(getattr(kinds, kind), service, partial(self._serve, name, command, drones))
        messages = crazyswarm.message_types()
        for suffix, (kind, read) in _SETPOINTS.items() if messages else ():
            if who != interfaces.ALL or suffix == interfaces.FULL_STATE:
                topic = interfaces.setpoint_topic(suffix, getattr(messages, kind))
                take = partial(self._take, suffix, read, drones)
                self._node.create_subscription(topic.kind, topic.of(who), take, topic.subscribe)
        emergency = interfaces.drone_service_of(who, interfaces.EMERGENCY)
        self._node.create_service(Empty, emergency, partial(self._stop, drones))

    def _serve(
        self,
        name: str,
        command: Callable[[Drone, Any], str | None],
        drones: Sequence[Drone],
        request: Any,
        answer: Answer,
    ) -> Answer:
        """Give drones a command; what one of them refuses the others get none the less."""
        self._advance()
        for drone in drones:
            with self._node.faults.contain(f"{drone.robot}/{name}"):
                if warning := command(drone, request):
                    self._node.get_logger().warning(f"{drone.robot}/{name}: {warning}")
        return answer

    def _take(self, name: str, read: Callable[[Any], PositionSetpoint], drones: Sequence[Drone], message: Any) -> None:
        """Hand a set-point to drones."""
        self._advance()
        for drone in drones:
            with self._node.faults.contain(f"{drone.robot}/{name}"):
                drone.fleet.command_position(drone.number, read(message))

    def _stop(self, drones: Sequence[Drone], _: Empty.Request, answer: Empty.Response) -> Empty.Response:
        for drone in drones:
            drone.fleet.firmware.request_emergency(drone.number)
        return answer


def _arm(drones: Sequence[Drone], armed: bool) -> tuple[bool, str]:
    """Arm or disarm drones; return whether all did, and the reasons of those that did not."""
    refused = [
        f"{drone.robot}: arming refused in state {State(firmware.state[drone.number]).name}: must be PREFLIGHT_PASSED"
        for drone in drones
        if not (firmware := drone.fleet.firmware).request_arming(drone.number, armed)
    ]
    return not refused, "; ".join(refused)


def _take_off(drone: Drone, request: Any) -> None:
    drone.fleet.take_off(drone.number, **server_messages.rise_from_request(request))


def _land(drone: Drone, request: Any) -> None:
    drone.fleet.land(drone.number, **server_messages.rise_from_request(request))


def _go_to(drone: Drone, request: Any) -> None:
    drone.fleet.go_to(drone.number, **server_messages.way_from_request(request))


def _upload(drone: Drone, request: Any) -> str:
    trajectory, offset, pieces = server_messages.trajectory_from_request(request)
    drone.fleet.upload_trajectory(drone.number, trajectory, offset, pieces)
    last = offset + len(pieces)
    return f"trajectory up to piece {last}: a real drone holds {ON_BOARD}" if last > ON_BOARD else ""


def _start(drone: Drone, request: Any) -> None:
    drone.fleet.start_trajectory(drone.number, **server_messages.start_from_request(request))


def _notify(drone: Drone, _request: Any) -> None:
    """The notice has no group and no time of validity on its way to the drone: crtp_commander.c."""
    drone.fleet.notify_setpoints_stop(drone.number)


# by the name of the service: its type in crazyflie_interfaces, and what a drone does, which may end with a warning
COMMANDS: dict[str, tuple[str, Callable[[Drone, Any], str | None]]] = {
    interfaces.TAKEOFF: ("Takeoff", _take_off),
    interfaces.LAND: ("Land", _land),
    interfaces.GO_TO: ("GoTo", _go_to),
    interfaces.UPLOAD: ("UploadTrajectory", _upload),
    interfaces.START: ("StartTrajectory", _start),
    interfaces.NOTIFY: ("NotifySetpointsStop", _notify),
}
# by the name of the topic: its type in crazyflie_interfaces, and what reads its messages
_SETPOINTS: dict[str, tuple[str, Callable[[Any], PositionSetpoint]]] = {
    interfaces.FULL_STATE: ("FullState", server_messages.full_state_from_message),
    interfaces.POSITION: ("Position", server_messages.position_from_message),
    interfaces.VELOCITY: ("VelocityWorld", server_messages.velocity_from_message),
    interfaces.HOVER: ("Hover", server_messages.hover_from_message),
}
