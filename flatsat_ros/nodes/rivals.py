"""Who else sends where only one may: set-points, poses and telemetry of a robot, judged by the messages themselves.

On a topic that tells of all drones, as motion capture has it, several may send, but not of the same drone.

Two controllers of one drone, or two sources of its poses, make it fly somewhere between what each wants. The ROS graph
tells who publishes, but not who sends: a joystick node may stay silent, and a process that was killed stays listed for
up to 20 s. So where more than one is listed, a subscription listens. A publisher numbers its messages; two that send at
the same time make the numbers go back and forth. A second controller shows in the telemetry, which it sends while it is
still silent otherwise: it would take off on the same goal.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence, Sized
from enum import Enum
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from flatsat_ros.flight.modes import Mode
from flatsat_ros.nodes.pose_sources import Source
from flatsat_ros.nodes.ros import interfaces

_SINGLE = (interfaces.COMMAND, interfaces.POSE, interfaces.TELEMETRY)
_SHARED = (interfaces.NAMED_POSES, interfaces.TF)
# senders that are heard within this time, s, of each other are there together; so long it takes to know that none is
_HOLD = 2.0
# the last of our own set-points arrives within this time, s
_LAST_COMMAND = 0.5
# to open a subscription takes 3 ms: so many are opened at once
_OPENINGS = 4
# messages between two looks, of two senders at 200 Hz
_DEPTH = 500
# of a topic that tells of all so many are looked into, the newest: each costs some 50 us
_SHARED_DEPTH = 50


class Heard(Enum):
    """How many send on a topic."""

    ONE = "at most one"
    UNKNOWN = "not known yet"
    SEVERAL = "more than one"


class Ear:
    """Listens to one topic, from one look to the next."""

    def __init__(self, subscription: Any, now: float, tells: Callable[[bytes], Iterable[str]]) -> None:
        """Know nothing yet.

        Args:
            subscription: takes raw messages, and is left to this object alone.
            now: s.
            tells: of which robots a message tells.
        """
        self.subscription = subscription
        self._tells = tells
        self._numbers: dict[str, int | None] = {}  # of the newest message about each robot
        self._known_at = now + _HOLD
        self._several_until: dict[str, float] = {}

    def listen(self, now: float, listed: int, robot: str, *, silent: bool) -> Heard:
        """Take what has come since the last look, and return how many tell of a robot.

        Args:
            now: s.
            listed: how many publishers the graph shows.
            robot: its name.
            silent: we do not send, although we are a publisher of the topic: what is heard is of others.
        """
        if self.subscription.get_publisher_count() < listed:
            self._known_at = now + _HOLD
        while (taken := self.subscription.handle.take_message(self.subscription.msg_type, True)) is not None:
            data, number = taken[0], taken[1]["publication_sequence_number"]
            for told in self._tells(data):
                newest = self._numbers.get(told)
                # a middleware that does not number messages leaves it to the graph
                if silent or number is None or (newest is not None and number <= newest):
                    self._several_until[told] = now + _HOLD
                self._numbers[told] = number
        if now < self._several_until.get(robot, -math.inf):
            return Heard.SEVERAL
        return Heard.UNKNOWN if now < self._known_at else Heard.ONE


class Rivals:
    """Those who send in each other's way, for a controller that sends set-points and telemetry itself.

    Attributes:
        starting: drones that have a reference and are not in the air yet: looked at before each tick that may let them.
    """

    def __init__(
        self,
        node: Node,
        robots: Sequence[str],
        beside: Callable[[int], Source | None],
        bar: Callable[[int, str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Know of none.

        Args:
            node: looks, and tells.
            robots: their names.
            beside: where the poses of a robot, by its number, come from if that is not its topic of poses.
            bar: called with the number of a robot and why it must not take off, empty if it may.
            clock: shows s and is never set.
        """
        self.starting: set[int] = set()
        self._node, self._robots, self._beside, self._bar, self._clock = node, list(robots), beside, bar, clock
        self._single = [
            [Source(topic.of(robot), topic.kind, partial(_one, robot)) for topic in _SINGLE] for robot in robots
        ]
        self._found = [""] * len(self._robots)
        self._silent_from = [-math.inf] * len(self._robots)
        self._ears: dict[str, Ear] = {}
        self._ear_node: Node | None = None  # in no executor: rclpy's EventsExecutor cannot hand on the numbers
        self._openings = 0

    def look_around(self) -> None:
        """Look at all drones."""
        self._openings = _OPENINGS
        for index in range(len(self._robots)):
            self.look(index)
        wanted = {self._name(source) for index in range(len(self._robots)) for source in self._sources(index)}
        for name in set(self._ears) - wanted:  # poses come from elsewhere now
            self._close(name)

    def _sources(self, index: int) -> list[Source]:
        """Return the topics of drone index that only one may send."""
        beside = self._beside(index)
        return self._single[index] if beside is None else [*self._single[index], beside]

    def _name(self, source: Source) -> str:
        return str(self._node.resolve_topic_name(source.topic))

    def look(self, index: int) -> bool:
        """Listen who sends now in the place of drone index, tell what has changed, and bar it; return whether it is."""
        robot, now, several, doubtful = self._robots[index], self._clock(), [], []
        for source in self._sources(index):
            name = self._name(source)
            listed = self._node.count_publishers(source.topic)
            if listed < 2:
                self._close(name)
                continue
            ear = self._ear(source, name, now)
            silent = source.topic == interfaces.COMMAND.of(robot) and now >= self._silent_from[index]
            heard = Heard.UNKNOWN if ear is None else ear.listen(now, listed, robot, silent=silent)
            if heard is Heard.SEVERAL:
                about = f" about {robot}" if source.topic in _SHARED else ""
                publishers = self._publishers(source)
                several.append(f"more than one sends {source.topic}{about}, of its publishers {publishers}")
            elif heard is Heard.UNKNOWN:
                doubtful.append(f"{source.topic} has the publishers {self._publishers(source)}")
        found = "; ".join(several)
        advice = "stop all but one" if several else f"if only one of them sends, that is known after {_HOLD:g} s"
        self._bar(index, f"{'; '.join(several or doubtful)}: {advice}" if several or doubtful else "")
        if found and not self._found[index]:
            self._node.get_logger().error(f"{robot}: no take-off: {found}")
        elif self._found[index] and not found:
            self._node.get_logger().info(f"{robot}: one controller and one source of poses again")
        self._found[index] = found
        return bool(several or doubtful)

    def look_before_start(self, poses: Sequence[Sized]) -> None:
        """Look for rivals of the drones that may start at this tick: those whose poses have come."""
        for index in [index for index in self.starting if poses[index]]:
            if self.look(index):
                self.starting.discard(index)  # its take-off is called off

    def follow(self, index: int, mode: Mode) -> None:
        """Take note of the new mode of drone index."""
        if mode is Mode.UNLOCK:
            self.starting.add(index)
        else:
            self.starting.discard(index)
        self._silent_from[index] = self._clock() + _LAST_COMMAND if mode is Mode.IDLE else math.inf

    def of(self, index: int) -> str:
        """Return a sentence about those of drone index, empty if there are none."""
        return self._found[index]

    def close(self) -> None:
        """Listen no more."""
        self._ears.clear()
        if self._ear_node is not None:
            self._ear_node.destroy_node()

    def _ear(self, source: Source, name: str, now: float) -> Ear | None:
        """Return what listens to a topic of a full name, None where it cannot be opened now."""
        if name not in self._ears and self._openings > 0:
            self._openings -= 1
            if self._ear_node is None:
                self._ear_node = Node(
                    "_flatsat_ear",
                    context=self._node.context,
                    use_global_arguments=False,
                    enable_rosout=False,
                    start_parameter_services=False,
                )
            depth = _SHARED_DEPTH if source.topic in _SHARED else _DEPTH
            quality = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
            subscription = self._ear_node.create_subscription(source.kind, name, lambda _: None, quality, raw=True)
            self._ears[name] = Ear(subscription, now, source.tells)
        return self._ears.get(name)

    def _close(self, name: str) -> None:
        ear = self._ears.pop(name, None)
        if ear is not None and self._ear_node is not None:
            self._ear_node.destroy_subscription(ear.subscription)

    def _publishers(self, source: Source) -> str:
        """Return who publishes a topic."""
        found = self._node.get_publishers_info_by_topic(source.topic)
        return ", ".join(sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found))


def _one(robot: str, _: bytes) -> tuple[str]:
    """Return the robot that every message of its topic tells of."""
    return (robot,)
