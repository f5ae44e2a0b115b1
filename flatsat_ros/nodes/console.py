"""The console: a page on this machine that shows the drones live and commands them, http://127.0.0.1:8410.

It shows what the controller and the drones tell, twenty times a second while a browser is there, and listens to nothing
otherwise. What it commands goes through the services, topics and parameters that everybody uses.
"""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any, TypeGuard

from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import Empty, SetBool, Trigger

from flatsat_ros.base.errors import FlatsatError, one_line, quoted, refusal, require
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import cdr, interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare, require_known_parameters, require_robot_names
from flatsat_ros.nodes.ros.runtime import ProgramNode, run
from flatsat_ros.viewing.page import json_value, page_of_console
from flatsat_ros.viewing.server import Broadcast, ConsoleServer

_PERIOD = 0.05  # s, between two pictures
_LINES = 200  # of the log, kept for pages that come later
_LINE_LENGTH = 4000  # characters
_BETWEEN = ": "  # node and drone in the name of a status
_ROBOTS = 200  # at most: for each there are topics
_READY = 2.0  # s, that a service has to be there
_REFUSED = 0.4  # s, within which the controller refuses a goal, if it does
_LOOK = 0.02  # s
TUNED = ("mu", "v_inf", "gamma_max", "nu")
_ARMING = {"arm": True, "disarm": False}


class Console(ProgramNode):
    """What browsers see and ask for, handed to and from ROS."""

    def __init__(self) -> None:
        """Begin to serve the page."""
        super().__init__(interfaces.CONSOLE_NODE)
        port = declare(self, "port", 8410, "of the page, on 127.0.0.1; 0 takes a free one", bounds=(0, 65535))
        require_known_parameters(self)
        self._robots: list[str] = []
        self._setup: dict[str, Any] = {}
        self._lines: deque[dict[str, Any]] = deque(maxlen=_LINES)
        self._line_number = 0
        self._began = time.time()  # pages tell by it whose numbers of lines they see
        self._newest: dict[tuple[str, str], tuple[float, bytes]] = {}  # by robot and topic: arrival, s, and message
        self._links: dict[str, tuple[float, dict[str, Any]]] = {}  # by robot: arrival, s, and how its drone says it is
        self._refusals: deque[tuple[float, str]] = deque(maxlen=100)
        self._open_subscriptions: list[Subscription] = []
        self._goals: dict[str, Publisher] = {}
        self._picture_timer: Timer | None = None
        self._callers: dict[str, Client] = {}
        self._waiting: list[Callable[[], bool]] = []  # each tells whether it has been done
        self._waiting_timer: Timer | None = None
        self._hear(interfaces.SETUP, interfaces.SETUP.suffix, self._on_setup)
        self._stream = Broadcast(self._on_followed)
        self._server = ConsoleServer(port, page_of_console(), self._stream, self._command)
        # pages that wait for a console connect at once: they are answered when this node's callbacks run
        self._serving = self.create_timer(_LOOK, self._serve)
        self.get_logger().info(f"open {self._server.address} in a browser on this machine")

    def _serve(self) -> None:
        self._serving.cancel()
        self._server.serve()

    def finish(self) -> None:
        """Close the page."""
        self._server.close()

    def _hear(self, topic: interfaces.Topic, name: str, take: Callable[[bytes], None]) -> Subscription:
        return self.create_subscription(topic.kind, name, take, topic.subscribe, raw=True)

    # what is shown

    def _on_followed(self, followed: bool) -> None:
        """Listen while somebody looks; called from the threads of the server."""
        self._soon(self._open if followed else self._close)

    def _soon(self, call: Callable[[], None]) -> None:
        """Let something be done by the thread that runs the callbacks."""
        executor = self.executor
        if executor is not None:

            def contained() -> None:
                with self.faults.contain("console"):
                    call()

            executor.create_task(contained)

    def _open(self) -> None:
        if self._picture_timer is not None:
            return
        self._picture_timer = self.create_timer(_PERIOD, self._show)
        hear = self._open_subscriptions.append
        hear(self._hear(interfaces.LOG, interfaces.LOG.suffix, self._on_line))
        hear(self._hear(interfaces.REFUSALS, interfaces.REFUSALS.suffix, self._on_refusal))
        kind, quality = interfaces.DIAGNOSTICS_KIND, interfaces.DIAGNOSTICS_QOS
        hear(self.create_subscription(kind, interfaces.DIAGNOSTICS, self._on_statuses, quality, raw=True))
        for robot in self._robots:
            goal = interfaces.GOAL
            self._goals[robot] = self.create_publisher(goal.kind, goal.of(robot), goal.publish)
            for topic in (interfaces.POSE, interfaces.TELEMETRY, interfaces.BATTERY):
                hear(self._hear(topic, topic.of(robot), partial(self._on_news, robot, topic.suffix)))

    def _close(self) -> None:
        if self._picture_timer is not None:
            self._picture_timer.cancel()
            self.destroy_timer(self._picture_timer)
            self._picture_timer = None
        for subscription in self._open_subscriptions:
            self.destroy_subscription(subscription)
        self._open_subscriptions.clear()
        for publisher in self._goals.values():
            self.destroy_publisher(publisher)
        self._goals.clear()
        self._newest.clear()
        self._links.clear()

    def _on_setup(self, data: bytes) -> None:
        found = _setup(messages.text_from_message(cdr.message_from_cdr(data, interfaces.SETUP.kind)))
        robots = found.get("robot_names", [])
        self._setup = found
        if robots != self._robots:
            self._robots = robots
            if self._picture_timer is not None:
                self._close()
                self._open()

    def _on_news(self, robot: str, suffix: str, data: bytes) -> None:
        self._newest[robot, suffix] = time.monotonic(), data

    def _on_line(self, data: bytes) -> None:
        level, name, text = messages.line_from_message(cdr.message_from_cdr(data, interfaces.LOG.kind))
        self._line_number += 1
        line = f"{name}: {text}"[:_LINE_LENGTH]
        self._lines.append({"number": self._line_number, "level": level, "text": line})

    def _on_statuses(self, data: bytes) -> None:
        """Keep what the nodes that speak with drones say of their links; the controller's telemetry says the rest."""
        message = cdr.message_from_cdr(data, interfaces.DIAGNOSTICS_KIND)
        for name, hardware, severity, text in messages.statuses_from_message(message):
            node, _, robot = name.rpartition(_BETWEEN)
            if robot in self._robots and node != interfaces.CONTROLLER_NODE:
                where = node if hardware == robot else hardware
                self._links[robot] = time.monotonic(), {"severity": severity, "text": f"{where}: {text}"[:_LINE_LENGTH]}

    def _on_refusal(self, data: bytes) -> None:
        text = messages.text_from_message(cdr.message_from_cdr(data, interfaces.REFUSALS.kind))
        self._refusals.append((time.monotonic(), one_line(text)))

    def _show(self) -> None:
        now = time.monotonic()
        drones = []
        for robot in self._robots:
            drone: dict[str, Any] = {"name": robot}
            for suffix, (arrival, data) in ((s, m) for (r, s), m in self._newest.items() if r == robot):
                with self.faults.contain(f"{robot}/{suffix}"):
                    drone[suffix.rpartition("/")[2]] = {"age": now - arrival, **_told(suffix, data)}
            if robot in self._links:
                arrival, link = self._links[robot]
                drone["link"] = {"age": now - arrival, **link}
            drones.append(drone)
        lines = {"began": self._began, "lines": list(self._lines)}
        picture = {"time": time.time(), "setup": self._setup, "drones": drones, **lines}
        self._stream.publish(json.dumps(json_value(picture), allow_nan=False).encode())

    # what is asked for

    def _command(self, wanted: dict[str, Any]) -> Future[str]:
        """Do what a page asks for; called from the threads of the server."""
        answer: Future[str] = Future()

        def begin() -> None:
            try:
                self._begin(wanted, answer)
            except FlatsatError as error:
                answer.set_exception(error)
            except Exception as error:
                answer.set_exception(FlatsatError("failed by an error of the program: see the log"))
                self.faults.note("console/command", error)

        self._soon(begin)
        return answer

    def _begin(self, wanted: Mapping[str, Any], answer: Future[str]) -> None:
        what, who = wanted.get("do"), wanted.get("who")
        if who not in (*self._robots, interfaces.ALL):
            raise refusal("who", who, "", f"one of {', '.join([*self._robots, interfaces.ALL])}")
        if what in interfaces.TRIGGERS:
            self._ask(Trigger, interfaces.service_of(who, what), Trigger.Request(), answer)
        elif isinstance(what, str) and what in _ARMING:
            request = messages.arming_request(SetBool, _ARMING[what])
            self._ask(SetBool, interfaces.service_of(who, interfaces.ARM), request, answer)
        elif what == interfaces.EMERGENCY:
            self._ask(Empty, interfaces.drone_service_of(who, what), Empty.Request(), answer)
        elif what == "goal":
            self._send_goal(str(who), wanted, answer)
        elif what == "set":
            self._set(str(who), wanted, answer)
        else:
            known = [*interfaces.TRIGGERS, *_ARMING, interfaces.EMERGENCY, "goal", "set"]
            raise refusal("do", what, "", f"one of {', '.join(known)}")

    def _ask(self, kind: type[Any], name: str, request: Any, answer: Future[str]) -> None:
        """Call a service as soon as it is there."""
        client = self._callers.get(name)
        if client is None:
            client = self._callers[name] = self.create_client(kind, name)
        end = time.monotonic() + _READY

        def try_to() -> bool:
            if client.service_is_ready():
                client.call_async(request).add_done_callback(self.faults.contained(name, done))
                return True
            if time.monotonic() > end:
                answer.set_exception(FlatsatError(f"there is no service {client.service_name}: is its node running?"))
                return True
            return False

        def done(future: Any) -> None:
            refused, text = messages.outcome_from_answer(future.result())
            if refused:
                answer.set_exception(FlatsatError(refused))
            else:
                answer.set_result(text)

        self._wait_for(try_to)

    def _wait_for(self, attempt: Callable[[], bool]) -> None:
        """Try something now, and again and again until it says that it is done."""
        if attempt():
            return
        self._waiting.append(attempt)
        if self._waiting_timer is None:
            self._waiting_timer = self.create_timer(_LOOK, self._try_again)

    def _try_again(self) -> None:
        self._waiting = [attempt for attempt in self._waiting if not attempt()]
        if not self._waiting and self._waiting_timer is not None:
            self._waiting_timer.cancel()
            self.destroy_timer(self._waiting_timer)
            self._waiting_timer = None

    def _send_goal(self, who: str, wanted: Mapping[str, Any], answer: Future[str]) -> None:
        if who == interfaces.ALL:
            raise FlatsatError("a goal is for one drone: choose it")
        place = wanted.get("position")
        if not (isinstance(place, list) and len(place) == 3 and all(_is_number(value) for value in place)):
            raise refusal("position", place, "m", "three numbers, each below 1e9")
        if self.count_subscribers(interfaces.GOAL.of(who)) == 0:
            raise FlatsatError(f"nobody takes goals for {who}: is the controller running?")
        if who not in self._goals:
            raise FlatsatError("goals are taken while a page is open")
        message = messages.pose_message()
        messages.fill_pose(message, self.get_clock().now().nanoseconds, place, (0.0, 0.0, 0.0, 1.0))
        self._goals[who].publish(message)
        sent = time.monotonic()

        def try_to() -> bool:
            refused = [text for when, text in self._refusals if when >= sent and text.startswith(f"{who}/")]
            if not refused and time.monotonic() - sent < _REFUSED:
                return False
            if refused:
                answer.set_exception(FlatsatError(refused[0]))
            else:
                answer.set_result(f"{who} flies to {', '.join(f'{value:.2f}' for value in place)} m")
            return True

        self._wait_for(try_to)

    def _set(self, who: str, wanted: Mapping[str, Any], answer: Future[str]) -> None:
        name, value = wanted.get("name"), wanted.get("value")
        if name not in TUNED:
            raise refusal("name", name, "", f"one of {', '.join(TUNED)}")
        if not _is_number(value):
            raise refusal(name, value, "", "a number below 1e9")
        full = name if who == interfaces.ALL else f"robots.{who}.{name}"
        request = messages.parameters_request({full: float(value)})
        self._ask(SetParameters, f"{interfaces.CONTROLLER_NODE}/set_parameters", request, answer)


def _setup(text: str) -> dict[str, Any]:
    """Return what a controller says of itself, by name: words, numbers and lists of them.

    Raises:
        FlatsatError: it is something else, or its robots are none.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refusal("setup", text, "", "JSON") from error
    require(isinstance(found, dict), "setup", found, "", "an object")
    for name, value in found.items():
        flat = not any(isinstance(entry, (dict, list)) for entry in (value if isinstance(value, list) else [value]))
        require(flat, f"{quoted(name)} of the setup", value, "", "a word, a number or a list of them")
    names = found.get("robot_names", [])
    named = isinstance(names, list) and all(isinstance(name, str) for name in names) and len(names) <= _ROBOTS
    require(named, "robot_names", names, "", f"a list of at most {_ROBOTS} names")
    require_robot_names(names)
    return dict(found)


def _told(suffix: str, data: bytes) -> dict[str, Any]:
    """Return what a message of a robot's topic says: `values`, and `stamp`, s, of a pose."""
    if suffix == interfaces.POSE.suffix:
        stamp, position, turn = cdr.pose_from_cdr(data)
        return {"values": [*position, *turn], "stamp": stamp / messages.NANOSECONDS}
    if suffix == interfaces.TELEMETRY.suffix:
        row = messages.telemetry_from_message(cdr.message_from_cdr(data, interfaces.TELEMETRY.kind)).tolist()
        return {"values": row if len(row) == len(FIELDS) else []}
    return {"values": [messages.voltage_from_message(cdr.message_from_cdr(data, interfaces.BATTERY.kind))]}


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e9


def main(argv: Sequence[str] | None = None) -> int:
    """Run the console."""
    return run(Console, argv)


if __name__ == "__main__":
    sys.exit(main())
