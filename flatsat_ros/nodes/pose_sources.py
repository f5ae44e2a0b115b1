"""Where the poses of the drones come from: a topic of each, or one that tells of all, as motion capture has it.

Which one is found out (`PoseSource.AUTO`): `<robot>/pose` if that has poses, else the first other one that has; and
another one only when that is silent and the drone does not fly.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import cdr, interfaces, messages
from flatsat_ros.nodes.ros.parameters import declare_choice
from flatsat_ros.nodes.ros.runtime import ProgramNode

_MOTION_CAPTURE = "_mocap"  # what crazyswarm2's motion_capture.yaml has behind the names of its frames
# of the poses of a drone that come between two ticks, so many are taken in, the newest
_POSES_MAX = 100
_SILENCE = 1.0  # s without poses after which another source is looked for


class PoseSource(str, Enum):
    """Topics that poses come from; AUTO is the first of the others that has some."""

    AUTO = "auto"
    POSE = "pose"
    POSES = "poses"
    TF = "tf"
    ODOM = "odom"


# modules and types of messages that not every ROS installation has
_SHARED = {
    PoseSource.POSES: ("motion_capture_tracking_interfaces.msg", "NamedPoseArray"),
    PoseSource.TF: ("tf2_msgs.msg", "TFMessage"),
}


# what tells of the bodies in a message of these types
_READERS: dict[PoseSource, Callable[[Any], Iterable[messages.Body]]] = {
    PoseSource.POSES: messages.named_poses_from_message,
    PoseSource.TF: messages.transforms_from_message,
}


class Source(NamedTuple):
    """A topic that poses of a drone come from.

    Attributes:
        topic: its name.
        kind: type of its messages.
        tells: of which drones a serialised message tells, by name.
    """

    topic: str
    kind: Any
    tells: Callable[[bytes], Iterable[str]]


def declare_pose_source(node: ProgramNode) -> PoseSource:
    """Declare which topic poses come from."""
    return declare_choice(node, "pose_source", PoseSource, "topic that poses come from")


class PoseSources:
    """The poses of all drones, as they come in.

    Attributes:
        queues: of each drone, what has not been taken yet.
    """

    def __init__(
        self, node: ProgramNode, robots: Sequence[str], world: str, flies: Callable[[int], bool], wanted: PoseSource
    ) -> None:
        """Subscribe.

        Args:
            node: that subscribes.
            robots: names of the drones; on /poses bodies are called so, on /tf frames, with _mocap behind it or not.
            world: the frame_id that poses must have, or none.
            flies: whether a drone, by its number, is in the air: then its source stays.
            wanted: the source.

        Raises:
            FlatsatError: the type of the source that was asked for is not installed.
        """
        self.queues: list[deque[bytes | cdr.StampedPose]] = [deque(maxlen=_POSES_MAX) for _ in robots]
        self._node, self._robots, self._flies = node, list(robots), flies
        self._numbers = {robot: index for index, robot in enumerate(robots)}
        self._world = world
        self._wanted = wanted
        self._current: list[PoseSource | None] = [None] * len(robots)
        self._heard = [time.monotonic()] * len(robots)
        self._subscribed: set[PoseSource] = set()
        source = PoseSource.POSE if self._wanted is PoseSource.AUTO else self._wanted
        if self._kind(source) is None:
            module = _SHARED[source][0].partition(".")[0]
            raise FlatsatError(
                f"parameter pose_source = {source.value!r}: {module} must be installed: source its workspace"
            )
        self._subscribe(source)

    def take(self, index: int) -> cdr.StampedPose:
        """Return the oldest pose of a drone that was not taken yet.

        Raises:
            FlatsatError: it is no pose, or of another frame; it is gone then.
        """
        pose = self.queues[index].popleft()
        if isinstance(pose, cdr.StampedPose):
            return pose
        cdr.require_frame(pose, self._world.encode())
        return cdr.pose_from_cdr(pose)

    def beside(self, index: int) -> Source | None:
        """Return where the poses of a drone come from if that is not its topic of poses."""
        source, robot = self._current[index], self._robots[index]
        if source is None or source is PoseSource.POSE:
            return None
        kind = self._kind(source)

        def tells(data: bytes) -> Iterable[str]:
            if source is PoseSource.ODOM:
                return (robot,)
            return [self._robots[of] for of, _ in self._ours(source, deserialize_message(data, kind))]

        return Source(self._topic(source, robot), kind, tells)

    def look(self) -> None:
        """Look for other sources, where the one of a drone is silent or none is known."""
        if self._wanted is not PoseSource.AUTO:
            return
        now = time.monotonic()
        silent = [
            index
            for index in range(len(self._robots))
            if now - self._heard[index] > _SILENCE and not self._flies(index)
        ]
        if not silent:
            return
        for index in silent:
            self._current[index] = None
        for source in set(PoseSource) - self._subscribed - {PoseSource.AUTO}:
            names = [self._topic(source, self._robots[index]) for index in silent]
            if self._kind(source) is not None and any(map(self._node.count_publishers, names)):
                self._subscribe(source)

    def _topic(self, source: PoseSource, robot: str) -> str:
        if source is PoseSource.POSES:
            return interfaces.NAMED_POSES
        if source is PoseSource.TF:
            return interfaces.TF
        return (interfaces.POSE if source is PoseSource.POSE else interfaces.ODOMETRY).of(robot)

    def _kind(self, source: PoseSource) -> Any | None:
        """Return the type of a source's messages, None where it is not installed."""
        if source not in _SHARED:
            return interfaces.POSE.kind if source is PoseSource.POSE else interfaces.ODOMETRY.kind
        module, name = _SHARED[source]
        try:
            return getattr(import_module(module), name)
        except ModuleNotFoundError:
            return None

    def _subscribe(self, source: PoseSource) -> None:
        self._subscribed.add(source)
        node = self._node
        kind: Any = self._kind(source)
        if source is PoseSource.POSE:
            for index, robot in enumerate(self._robots):
                topic, take = interfaces.POSE, partial(self._on_pose, index)
                node.create_subscription(kind, topic.of(robot), take, topic.subscribe, raw=True)
        elif source is PoseSource.ODOM:
            for index, robot in enumerate(self._robots):
                topic, hear = interfaces.ODOMETRY, partial(self._on_odometry, index)
                node.create_subscription(kind, topic.of(robot), hear, topic.subscribe)
        else:
            take = partial(self._on_bodies, source)
            quality = {
                PoseSource.POSES: interfaces.NAMED_POSES_SUBSCRIBE,
                PoseSource.TF: interfaces.TF_SUBSCRIBE,
            }[source]
            node.create_subscription(kind, self._topic(source, ""), take, quality)

    def _on_pose(self, index: int, data: bytes) -> None:
        cdr.require_short(data)
        self._keep(index, PoseSource.POSE, data)

    def _on_odometry(self, index: int, message: Any) -> None:
        frame, stamp, position, quaternion = messages.odometry_from_message(message)
        cdr.require_world(frame, self._world)
        self._keep(index, PoseSource.ODOM, cdr.StampedPose(stamp, position, quaternion))

    def _on_bodies(self, source: PoseSource, message: Any) -> None:
        for index, body in self._ours(source, message):
            cdr.require_world(body.frame, self._world)
            self._keep(index, source, cdr.StampedPose(body.stamp, body.position, body.quaternion))

    def _ours(self, source: PoseSource, message: Any) -> Iterable[tuple[int, messages.Body]]:
        """Return the bodies of a message that are drones, with their numbers."""
        for body in _READERS[source](message):
            index = self._numbers.get(body.name)
            if index is None and source is PoseSource.TF:
                index = self._numbers.get(body.name.removesuffix(_MOTION_CAPTURE))
            # on /tf frames may stand in others than the world's, which are none of poses
            if index is not None and (source is PoseSource.POSES or body.frame in ("", self._world)):
                yield index, body

    def _keep(self, index: int, source: PoseSource, pose: bytes | cdr.StampedPose) -> None:
        """Take in a pose, if it comes from where those of the drone come from."""
        if self._current[index] is None:
            self._current[index] = source
            robot = self._robots[index]
            self._node.get_logger().info(f"{robot}: poses from {self._topic(source, robot)}")
        if self._current[index] is source:
            self._heard[index] = time.monotonic()
            self.queues[index].append(pose)
