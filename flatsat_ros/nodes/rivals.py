"""Who else publishes where only one may: set-points and poses of a robot."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.node import Node

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import interfaces


class Rivals:
    """Publishers that stand in each other's way, as the ROS graph shows them.

    Two controllers of one drone, or two sources of its poses, make it fly somewhere between what each wants. A
    publisher that was killed stays in the graph for up to 20 s.
    """

    def __init__(self, node: Node, robots: Sequence[str]) -> None:
        """Know of none; the node publishes the set-points of these robots itself."""
        self._node, self._robots = node, list(robots)
        self._found = [""] * len(self._robots)

    def look(self) -> None:
        """Look who publishes now, and tell what has changed."""
        for index, robot in enumerate(self._robots):
            found = "; ".join(filter(None, (self._publishers(topic.of(robot)) for topic in _SINGLE)))
            if found == self._found[index]:
                continue
            self._found[index] = found
            if found:
                self._node.get_logger().error(f"{robot}: no take-off: {found}")
            else:
                self._node.get_logger().info(f"{robot}: one controller and one source of poses again")

    def of(self, index: int) -> str:
        """Return a sentence about those of drone index, empty if there are none."""
        return self._found[index]

    def require_none(self, index: int) -> None:
        """Refuse to let drone index take off while it has rivals.

        Raises:
            FlatsatError: names them.
        """
        if self._found[index]:
            raise FlatsatError(f"{self._found[index]}: stop all but one")

    def _publishers(self, topic: str) -> str:
        """Return who publishes a topic if there is more than one, empty otherwise."""
        if self._node.count_publishers(topic) < 2:
            return ""
        found = self._node.get_publishers_info_by_topic(topic)
        names = sorted(f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found)
        return f"{len(names)} publish {topic}: {', '.join(names)}"


_SINGLE = (interfaces.COMMAND, interfaces.POSE)
