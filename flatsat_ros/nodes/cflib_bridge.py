"""The link to real Crazyflies without crazyswarm2: its topics on one side, cflib on the other.

cmd_vel_legacy goes out as set-points, the on-board estimate comes in as pose, motion capture goes out as external
pose; battery, link and console appear on /diagnostics. cflib is GPL and optional: no other executable needs it.
"""

from __future__ import annotations

import os
import socket
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import Twist
from std_srvs.srv import Empty

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, refusal, require_number
from flatsat_ros.base.files import located
from flatsat_ros.crazyflie.crazyflies_yaml import Robot
from flatsat_ros.crazyflie.link import (
    Address,
    PacketQueue,
    ShutdownSequence,
    require_packable,
    require_pose,
    sendable,
)
from flatsat_ros.crazyflie.outbox import Outbox, Packet, Stream
from flatsat_ros.flight.policy import Policy
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.link_watch import LinkWatch
from flatsat_ros.nodes.ros import cdr, interfaces, messages
from flatsat_ros.nodes.ros.parameters import (
    declare,
    declare_choice,
    declare_robots,
    declare_vehicles,
    declare_yaw_mode,
    require_known_parameters,
)
from flatsat_ros.nodes.ros.runtime import ProgramNode, run

if TYPE_CHECKING:
    from flatsat_ros.nodes.cflib_link import Link

_VOLTS_MAX = 60.0  # V: no battery that flies has more


class ExternalPose(str, Enum):
    """What of an external pose is sent to the drones."""

    NONE = "none"
    POSITION = "position"
    POSE = "pose"


class OnShutdown(str, Enum):
    """How drones that were flown are left when the bridge ends."""

    STOP = "stop"
    LAND = "land"


class CflibBridge(ProgramNode):
    """ROS shell of the links."""

    def __init__(self) -> None:
        """Read the parameters, take the drones, connect."""
        super().__init__(interfaces.BRIDGE_NODE)
        cflib_link = _import_links()
        robots = declare_robots(self)
        self.robots = [robot.name for robot in robots]
        addresses = self._addresses(robots)
        self._vehicles = dict(zip(self.robots, declare_vehicles(self, robots), strict=True))
        pose_rate = declare(
            self,
            "pose_rate",
            0.0,
            "poses per second from the on-board estimate, rounded to whole 10 ms; 0: none",
            unit="Hz",
            bounds=(0.0, 100.0),
        )
        external = declare_choice(self, "external_pose", ExternalPose, "what of external poses is sent to the drones")
        self._publishes_pose = pose_rate > 0.0
        settings = cflib_link.Settings(
            pose_period=10 * max(round(100.0 / pose_rate), 1) if pose_rate else 0,
            timeout=declare(
                self, "link_timeout", 2.0, "silence of a drone after which its connection is lost", unit="s",
                bounds=(0.1, 60.0),
            ),
            cache=self._cache(),
        )  # fmt: skip
        cflib_link.initialise()
        self.links = self._links(addresses, 1 if external is ExternalPose.NONE else 2, settings, cflib_link)
        for link in self.links:
            self._connect(link)
        suffix = declare(self, "external_pose_topic", "mocap_pose", "name of the external pose, below the robot's")
        if external is not ExternalPose.NONE:
            self._locate(suffix, with_attitude=external is ExternalPose.POSE)
        everybody = interfaces.drone_service_of(interfaces.ALL, interfaces.EMERGENCY)
        self.create_service(Empty, everybody, partial(self._on_emergency, self.links))
        self._watch = LinkWatch(self, self.links, [vehicle.battery.low_voltage for vehicle in self._vehicles.values()])
        require_known_parameters(self)
        self._claims = _claimed(addresses)  # last: nothing is refused any more
        for link in self.links:
            link.start()
        pairs = zip(self.robots, addresses, strict=True)
        self.get_logger().info("linking " + ", ".join(f"{robot} at {address.uri}" for robot, address in pairs))

    def finish(self) -> None:
        """Leave every drone as configured; the emergency stop works until the last one is through."""
        for link in self.links:
            link.leave()
        self.spin_while(lambda: any(link.alive for link in self.links))

    def destroy_node(self) -> None:
        """Leave the drones to other bridges, and destroy what belongs to the node."""
        for claim in self._claims:
            claim.close()
        super().destroy_node()  # type: ignore[no-untyped-call]

    def _addresses(self, robots: Sequence[Robot]) -> list[Address]:
        # where simulators of the firmware listen, unless the user's file says better; to a file nothing is added
        file = str(self.get_parameter("crazyflies_yaml").value)
        if file and not all(robot.uri for robot in robots) and "uris" not in self._parameter_overrides:
            missing = next(robot.name for robot in robots if not robot.uri)
            raise located(file, f"robots.{missing} has no uri: must have one, or parameter uris gives those of all")
        default = [robot.uri or f"udp://127.0.0.1:{19850 + index}" for index, robot in enumerate(robots)]
        uris = declare(self, "uris", default, "URI of every drone in turn: radio://0/80/2M/E7E7E7E701, udp://host:port")
        if len(uris) != len(self.robots):
            raise refusal("entries of parameter uris", len(uris), "", f"{len(self.robots)}: one per robot")
        addresses = [Address.parse(uri) for uri in uris]
        for index, address in enumerate(addresses):
            if address.drone in [other.drone for other in addresses[:index]]:
                raise refusal("URI", address.uri, "", "given once: each drone has its own")
            if address.ignored:
                self.get_logger().warning(f"{address.uri}: cflib does not know {', '.join(address.ignored)}: ignored")
        return addresses

    def _shutdown_sequences(self) -> dict[str, ShutdownSequence]:
        """Return how each drone is left."""
        end = declare_choice(self, "on_shutdown", OnShutdown, "how drones that were flown are left")
        time = declare(self, "land_time", 3.0, "level descent before the motors stop", unit="s", bounds=(0.1, 60.0))
        descent, yaw_mode = time if end is OnShutdown.LAND else 0.0, declare_yaw_mode(self)
        sinking = Policy.level_thrust * GRAVITY
        return {
            robot: ShutdownSequence(descent, float(vehicle.pwm_from_thrust(sinking)), yaw_mode)
            for robot, vehicle in self._vehicles.items()
        }

    def _cache(self) -> str | None:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "flatsat_ros", "cflib")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self.get_logger().warning(f"connecting will take seconds each time, no cache: {error}")
            return None
        return str(folder)

    def _links(self, addresses: Sequence[Address], streams: int, settings: Any, cflib_link: Any) -> list[Link]:
        """Make the links; the drones of one dongle share its time."""
        rate = declare(self, "rate", 100.0, "most set-points per second and drone", unit="Hz", bounds=(5.0, 500.0))
        spacing = declare(self, "spacing", 0.001, "between any two packets of one dongle", unit="s", bounds=(0.0, 0.1))
        users, queues = Counter(address.transport for address in addresses), {}
        try:
            for name, count in users.items():
                queue = PacketQueue[tuple[str, Stream], Packet](streams * count, period=1.0 / rate, gap=spacing)
                queues[name] = queue
        except FlatsatError as error:
            raise FlatsatError(f"parameters rate = {rate} Hz, spacing = {spacing} s: {error}") from error
        sequences = self._shutdown_sequences()
        return [
            cflib_link.Link(
                robot,
                address,
                Outbox(robot, queues[address.transport], sequences[robot]),
                settings,
                self._pose_publisher(robot),
                self._battery_publisher(robot),
                self._line_logger(robot),
            )
            for robot, address in zip(self.robots, addresses, strict=True)
        ]

    def _pose_publisher(self, robot: str) -> Callable[[tuple[float, ...], tuple[float, ...]], None]:
        """Return what publishes a pose, in a thread of cflib's; stamped on arrival, for the drone's clock is its own.

        The topic exists only where poses are asked for: it may be motion capture's.
        """
        if not self._publishes_pose:
            return lambda _position, _quaternion: None
        pose, message = interfaces.POSE, messages.pose_message()
        publisher = self.create_publisher(pose.kind, pose.of(robot), pose.publish)

        def publish(position: tuple[float, ...], quaternion: tuple[float, ...]) -> None:
            with self.faults.contain(f"{robot}/on-board estimate"):
                require_pose(position, quaternion)
                messages.fill_pose(message, self.get_clock().now().nanoseconds, position, quaternion)
                publisher.publish(message)

        return publish

    def _battery_publisher(self, robot: str) -> Callable[[float], None]:
        battery = interfaces.BATTERY
        publisher = self.create_publisher(battery.kind, battery.of(robot), battery.publish)

        def publish(volts: float) -> None:
            with self.faults.contain(f"{robot}/battery"):
                require_number("battery", volts, "V", 0.0, _VOLTS_MAX)
                publisher.publish(messages.battery_message(self.get_clock().now().nanoseconds, volts))

        return publish

    def _line_logger(self, robot: str) -> Callable[[str], None]:
        return lambda line: self.get_logger().info(f"{robot}: {line}")

    def _connect(self, link: Link) -> None:
        """Connect the topics and services of one drone."""
        command, robot = interfaces.COMMAND, link.robot
        self.create_subscription(command.kind, command.of(robot), partial(self._on_command, link), command.subscribe)
        emergency, arm = (interfaces.drone_service_of(robot, name) for name in (interfaces.EMERGENCY, interfaces.ARM))
        self.create_service(Empty, emergency, partial(self._on_emergency, [link]))
        crazyswarm.serve_arming(self, arm, partial(self._on_arm, link))

    def _locate(self, suffix: str, with_attitude: bool) -> None:
        """Send external poses on to the drones.

        Raises:
            FlatsatError: they would be our own.
        """
        for link in self.links:
            own, topic = (self.resolve_topic_name(f"{link.robot}/{name}") for name in (interfaces.POSE.suffix, suffix))
            if self._publishes_pose and own == topic:
                raise FlatsatError(
                    f"external poses from {topic} would be the bridge's own estimate: choose another "
                    "external_pose_topic, or pose_rate 0.0"
                )
            self.create_subscription(
                interfaces.POSE.kind,
                topic,
                partial(self._on_external_pose, link, with_attitude),
                interfaces.POSE.subscribe,
                raw=True,
            )

    def _on_command(self, link: Link, message: Twist) -> None:
        link.command(sendable(messages.command_from_message(message), self._vehicles[link.robot].pwm_max))

    def _on_external_pose(self, link: Link, with_attitude: bool, data: bytes) -> None:
        with self.faults.contain(f"{link.robot}/external pose"):
            cdr.require_short(data)
            _, position, quaternion = cdr.pose_from_cdr(data)
            values = position + quaternion if with_attitude else position
            require_packable("external pose", values)
            link.locate(position, quaternion if with_attitude else None)

    def _on_emergency(self, links: Sequence[Link], _: Empty.Request, answer: Empty.Response) -> Empty.Response:
        for link in links:
            link.stop_motors()
        self.get_logger().error(f"emergency stop of {', '.join(link.robot for link in links)}")
        return answer

    def _on_arm(self, link: Link, wanted: bool) -> tuple[bool, str]:
        sent = link.arm(wanted)
        return sent, "sent" if sent else f"{link.robot}: not connected: {link.condition}"


def _import_links() -> Any:
    """Load what needs cflib.

    Raises:
        FlatsatError: cflib is not installed.
    """
    try:
        from flatsat_ros.nodes import cflib_link
    except ModuleNotFoundError as error:
        raise FlatsatError(f'{error}: cflib_bridge needs cflib: pip install "flatsat_ros[crazyflie]"') from error
    return cflib_link


def _claimed(addresses: Sequence[Address]) -> list[socket.socket]:
    """Take drones for this process, all or none.

    Raises:
        FlatsatError: another bridge has one.
    """
    with ExitStack() as claims:
        taken = [claims.enter_context(_claim(address)) for address in addresses]
        claims.pop_all()
    return taken


def _claim(address: Address) -> socket.socket:
    """Take a drone for this process, by a name that the kernel gives only once on a machine and frees by itself.

    Two bridges would fight over the set-points of one drone, each believing to fly it.

    Raises:
        FlatsatError: another bridge has it.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0flatsat_ros cflib_bridge {address.drone}")
    except OSError as error:
        claim.close()
        raise FlatsatError(
            f"{address.uri} is taken by another cflib_bridge on this machine: stop that first"
        ) from error
    return claim


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bridge."""
    return run(CflibBridge, argv)


if __name__ == "__main__":
    sys.exit(main())
