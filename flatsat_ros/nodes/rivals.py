"""Who else publishes where only one may: set-points and poses of a robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized

from rclpy.node import Node

from flatsat_ros.flight.supervisor import Mode
from flatsat_ros.nodes.ros import interfaces

_SINGLE = (interfaces.COMMAND, interfaces.POSE)
_ADVICE = "stop all but one; a process that was killed stays listed for up to 20 s: wait so long"


class Rivals:
    """Publishers that stand in each other's way, as the ROS graph shows them.

    Two controllers of one drone, or two sources of its poses, make it fly somewhere between what each wants. One that
    is silent counts as well: a second controller would take off on the same goal. A publisher that was killed stays in
    the graph until DDS gives up its process, for up to 20 s.

    Attributes:
        starting: drones that have a reference and are not in the air yet: looked at before each tick that may let them.
    """

    def __init__(self, node: Node, robots: Sequence[str], bar: Callable[[int, str], None]) -> None:
        """Know of none; the node publishes the set-points of these robots itself.

        Args:
            node: looks, and tells.
            robots: their names.
            bar: called with the number of a robot and why it must not take off, empty if it may.
        """
        self.starting: set[int] = set()
        self._node, self._robots, self._bar = node, list(robots), bar
        self._found = [""] * len(self._robots)

    def look(self, index: int) -> None:
        """Look who publishes now in the place of drone index, bar it accordingly, and tell what has changed."""
        robot = self._robots[index]
        found = "; ".join(filter(None, (self._publishers(topic.of(robot)) for topic in _SINGLE)))
        self._bar(index, f"{found}: {_ADVICE}" if found else "")
        if found == self._found[index]:
            return
        self._found[index] = found
        if found:
            self._node.get_logger().error(f"{robot}: no take-off: {found}")
        else:
            self._node.get_logger().info(f"{robot}: one controller and one source of poses again")

    def look_before_start(self, poses: Sequence[Sized]) -> None:
        """Look for rivals of the drones that may start at this tick: those whose poses have come."""
        for index in [index for index in self.starting if poses[index]]:
            self.look(index)
            if self._found[index]:
                self.starting.discard(index)  # its take-off is called off

    def follow(self, index: int, mode: Mode) -> None:
        """Take note of the new mode of drone index."""
        if mode is Mode.UNLOCK:
            self.starting.add(index)
        else:
            self.starting.discard(index)

    def of(self, index: int) -> str:
        """Return a sentence about those of drone index, empty if there are none."""
        return self._found[index]

    def _publishers(self, topic: str) -> str:
        """Return who publishes a topic if there is more than one, empty otherwise."""
        if self._node.count_publishers(topic) < 2:
            return ""
        found = self._node.get_publishers_info_by_topic(topic)
        names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found)
        return f"{len(names)} publish {topic}: {', '.join(names)}"
