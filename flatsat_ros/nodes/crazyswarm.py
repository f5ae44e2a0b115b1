"""A drone's own link: crazyswarm2's services and status where crazyflie_interfaces is installed, std_srvs' without it.

crazyflie_interfaces is no package that every ROS installation has: it is loaded when it is first needed.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from rclpy.client import Client
from rclpy.task import Future
from std_srvs.srv import SetBool

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.runtime import ProgramNode

_PACKAGE = "crazyflie_interfaces"
# The last set-point may still be under way when the drone is told that none follows; were it the last to arrive, the
# drone would wait for the next one. The firmware keeps a set-point for 0.5 s.
SETTLING_TIME = 0.15  # s
# the parameter with which a drone is handed over although nobody holds it
HAND_OVER_FORCE = "hand_over_force"
_HOLD_TIME = 1  # s, in which the high-level commander comes to rest


def services() -> Any | None:
    """Return the module crazyflie_interfaces.srv, None where it is not installed."""
    try:
        return import_module(f"{_PACKAGE}.srv")
    except ModuleNotFoundError:
        return None


def message_types() -> Any | None:
    """Return the module crazyflie_interfaces.msg, None where it is not installed."""
    try:
        return import_module(f"{_PACKAGE}.msg")
    except ModuleNotFoundError:
        return None


def installed_status_topic() -> interfaces.Topic | None:
    """Return the topic of crazyswarm2's status messages, None where crazyflie_interfaces is not installed."""
    kinds = message_types()
    return None if kinds is None else interfaces.status_topic(kinds.Status)


class DroneLink:
    """What one robot's link can be asked for beside set-points: arming, and to give the drone to its own commander."""

    def __init__(self, node: ProgramNode, robot: str) -> None:
        """Know no service yet: `find_services` looks for them."""
        self._node, self._robot = node, robot
        self._clients: dict[str, Client] = {}
        self._unusable: dict[str, list[str]] = {}  # types that are offered and not known or not installed here
        self._released, self._pending = False, 0

    def find_services(self, offered: dict[str, list[str]]) -> None:
        """Connect to the services that are offered by now, by full name with their types."""
        for suffix in (interfaces.ARM, interfaces.NOTIFY, interfaces.GO_TO):
            name, client = interfaces.drone_service_of(self._robot, suffix), self._clients.get(suffix)
            if client is not None and client.service_is_ready():
                continue
            types = offered.get(self._node.resolve_service_name(name), [])
            found = next((kind for kind in map(self._kind, types) if kind is not None), None)
            self._unusable[suffix] = types if found is None else []
            if found is not None and (client is None or found is not client.srv_type):
                self._clients[suffix] = self._node.create_client(found, name)

    def _kind(self, name: str) -> Any | None:
        """Return the service type of a name, None if it is none that we know or have."""
        package, _, kind = name.partition("/srv/")
        if name == "std_srvs/srv/SetBool":
            return SetBool
        return getattr(services(), kind, None) if package == _PACKAGE else None

    def arm(self, wanted: bool) -> str:
        """Ask the drone to arm or disarm; return a sentence about it: its link may have no such service."""
        client = self._ready(interfaces.ARM)
        if client is None:
            unusable = ", ".join(self._unusable.get(interfaces.ARM, []))
            why = f" of a type that is installed here, only {unusable}" if unusable else ""
            return f"{self._robot}: the drone itself was not asked: no service {self._robot}/{interfaces.ARM}{why}"
        self._ask(client, messages.arming_request(_kind_of(client), wanted), self._report)
        return f"{client.service_name} asked to {'arm' if wanted else 'disarm'}"

    def _report(self, future: Future) -> None:
        if refusal := messages.refusal_from_answer(future.result()):
            # servers that arm several drones at once say of which one they speak
            self._node.get_logger().error(f"{self._robot}: {refusal.removeprefix(f'{self._robot}: ')}")

    def require_successor(self) -> None:
        """Refuse to give a drone away in the air if its own commander cannot be told to hold it.

        Raises:
            FlatsatError: names the services that are missing.
        """
        missing = [suffix for suffix in (interfaces.NOTIFY, interfaces.GO_TO) if self._ready(suffix) is None]
        if missing:
            names = " and ".join(interfaces.drone_service_of(self._robot, suffix) for suffix in missing)
            raise FlatsatError(
                f"nobody is there to take over: there is no service {names}; if you command the drone within 0.5 s "
                f"yourself, set parameter {HAND_OVER_FORCE} to true"
            )

    def release(self, *, in_flight: bool) -> None:
        """Tell the drone, whose set-points have just ended, that none follows, and in flight to stay where it is.

        Does nothing if its link has no such services, and nothing any more once the drone is taken back: the notice
        would cut the motors until the next set-point.

        The order is the firmware's: the notice tells its commander where the drone is, and a go-to before it would
        start from an old place; after it the motors rest until the go-to comes.
        """
        notify, go_to = self._ready(interfaces.NOTIFY), self._ready(interfaces.GO_TO)
        self._released = True
        if notify is None or (in_flight and go_to is None):
            return

        def tell() -> None:
            timer.cancel()
            self._node.destroy_timer(timer)
            if not self._released:
                self._pending -= 1
                return
            self._ask(notify, _kind_of(notify).Request(), stay)
            self._node.get_logger().info(f"{notify.service_name}: no more set-points")

        def stay(_: Future) -> None:
            if in_flight and go_to is not None and self._released:
                go_to.call_async(messages.hold_request(_kind_of(go_to), _HOLD_TIME))
                self._node.get_logger().info(f"{go_to.service_name}: hold the place")
            self._pending -= 1

        self._pending += 1
        timer = self._node.create_timer(SETTLING_TIME, tell)

    def _ask(self, client: Client, request: Any, then: Callable[[Future], object]) -> None:
        client.call_async(request).add_done_callback(self._node.faults.contained(client.service_name, then))

    @property
    def is_releasing(self) -> bool:
        """Whether something is still to be said to the drone."""
        return self._pending > 0

    def reclaim(self) -> None:
        """Note that set-points are sent again."""
        self._released = False

    def _ready(self, suffix: str) -> Client | None:
        client = self._clients.get(suffix)
        return client if client is not None and client.service_is_ready() else None


def _kind_of(client: Client) -> Any:
    """Return the service type of a client, which rclpy annotates as what it cannot be."""
    return client.srv_type


def serve_arming(node: ProgramNode, name: str, act: Callable[[bool], tuple[bool, str]]) -> None:
    """Offer arming as crazyswarm2 does, or, without its interfaces, with an answer."""
    kinds = services()

    def take(request: Any, answer: Any) -> Any:
        done, text = act(messages.arming_from_request(request))
        if kinds is None:
            messages.fill_answer(answer, done, text)
        elif not done:
            node.get_logger().error(text)
        return answer

    node.create_service(SetBool if kinds is None else kinds.Arm, name, take)
