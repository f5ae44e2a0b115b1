"""Log blocks of simulated drones as crazyswarm2's server offers them: added and removed while it runs, and odometry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from rclpy.publisher import Publisher
from rclpy.timer import Timer

from flatsat_ros.base.errors import FlatsatError, require
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces, server_messages
from flatsat_ros.nodes.ros.runtime import ProgramNode
from flatsat_ros.nodes.server_commands import Drone
from flatsat_ros.sim.log_variables import VARIABLES, require_variables

_FREQUENCIES = 1, 100  # Hz: of log blocks, whose period is a multiple of 10 ms (log.c)
_MILLISECONDS = 1000


class _Block(NamedTuple):
    """What is published over and over."""

    publisher: Publisher
    timer: Timer


class ServerLogging:
    """The log blocks that are published now, by drone and topic."""

    def __init__(self, node: ProgramNode, drones: Sequence[Drone]) -> None:
        """Offer to add and remove them, where crazyflie_interfaces is installed.

        Args:
            node: that publishes them.
            drones: whose they are.
        """
        self._node = node
        self._blocks: dict[tuple[str, str], _Block] = {}
        self._log_kind: Any = getattr(crazyswarm.message_types(), "LogDataGeneric", None)
        kinds = crazyswarm.services()
        if kinds is None:
            return
        services = (
            (interfaces.ADD_LOGGING, kinds.AddLogging, self._add),
            (interfaces.REMOVE_LOGGING, kinds.RemoveLogging, self._remove),
        )
        for drone in drones:
            for name, kind, act in services:
                service = interfaces.drone_service_of(drone.robot, name)
                node.create_service(kind, service, partial(self._serve, name, act, drone))

    def add_odometry(self, drone: Drone, frequency: float) -> None:
        """Publish a drone's odometry at a frequency, Hz."""
        topic = interfaces.ODOMETRY
        publisher = self._node.create_publisher(topic.kind, topic.of(drone.robot), topic.publish)
        self._repeat(drone, topic.suffix, frequency, publisher, lambda: self._odometry(drone))

    def _serve(self, name: str, act: Callable[[Drone, Any], None], drone: Drone, request: Any, answer: Any) -> Any:
        """Answer whether it was done; the reason why not goes to the log."""
        done = False
        with self._node.faults.contain(f"{drone.robot}/{name}"):
            act(drone, request)
            done = True
        server_messages.fill_success(answer, done)
        return answer

    def _add(self, drone: Drone, request: Any) -> None:
        """Begin to publish a block.

        Raises:
            FlatsatError: it is published already, or cannot be.
        """
        topic, frequency, variables = server_messages.logging_from_request(request)
        if (drone.robot, topic) in self._blocks or topic in (interfaces.POSE.suffix, "status"):
            raise FlatsatError(f"log topic {topic}: is published already")
        least, most = _FREQUENCIES
        require(
            least <= frequency <= most, f"frequency of log topic {topic}", frequency, "Hz", f"from {least} to {most}"
        )
        if topic == interfaces.ODOMETRY.suffix:
            self.add_odometry(drone, float(frequency))
            return
        require(topic != "scan", "log topic", topic, "", "another: the simulated drone has no Multi-ranger deck")
        require(len(variables) > 0, f"variables of log topic {topic}", len(variables), "", "at least 1")
        require_variables(variables)
        kinds = crazyswarm.message_types()
        assert kinds is not None, "it came with the services"
        name = f"{drone.robot}/{topic}"
        publisher = self._node.create_publisher(kinds.LogDataGeneric, name, interfaces.LOG_BLOCK)
        self._repeat(
            drone, topic, float(frequency), publisher, lambda: self._log(drone, kinds.LogDataGeneric, variables)
        )

    def _remove(self, drone: Drone, request: Any) -> None:
        """Cease to publish a block.

        Raises:
            FlatsatError: it is not published.
        """
        topic = server_messages.topic_from_request(request)
        block = self._blocks.pop((drone.robot, topic), None)
        if block is None:
            raise FlatsatError(f"log topic {topic}: is not published, or always")
        self._node.destroy_timer(block.timer)
        self._node.destroy_publisher(block.publisher)

    def _repeat(
        self, drone: Drone, topic: str, frequency: float, publisher: Publisher, make: Callable[[], Any]
    ) -> None:
        timer = self._node.create_timer(1.0 / frequency, lambda: publisher.publish(make()))
        self._blocks[drone.robot, topic] = _Block(publisher, timer)

    def _log(self, drone: Drone, kind: type[Any], variables: Sequence[str]) -> Any:
        """Return what the drone logs now."""
        logged = [VARIABLES[name](drone.fleet, drone.number) for name in variables]
        return server_messages.log_message(kind, self._now(), round(drone.fleet.time * _MILLISECONDS), logged)

    def _odometry(self, drone: Drone) -> Any:
        bodies, number = drone.fleet.bodies, drone.number
        where, turn = bodies.position[number], bodies.quaternion[number]
        velocity, rates = bodies.body_velocity[number], bodies.body_rates[number]
        return server_messages.odometry_message(self._now(), drone.robot, where, turn, velocity, rates)

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
