"""Robots that are not flown here but must be kept away from: where they are, from topics as those of drones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from flatsat_ros.base.errors import refusal
from flatsat_ros.nodes.pose_sources import PoseSource, PoseSources
from flatsat_ros.nodes.ros.parameters import declare, require_robot_names
from flatsat_ros.nodes.ros.runtime import ProgramNode

See = Callable[[int, Sequence[float]], None]


def declare_others(node: ProgramNode, robots: Sequence[str]) -> list[str]:
    """Declare of which other robots the poses are known, and return their names.

    ROS cannot tell an empty array from one of another type, so that one empty name stands for no robot.

    Raises:
        FlatsatError: a name is no ROS name, is given twice or is that of a drone that is flown here.
    """
    meaning = "names of robots that are not flown here, kept away from where their poses say they are; [''] for none"
    names = declare(node, "other_poses", [""], meaning)
    if names == [""]:
        return []
    require_robot_names(names)
    for name in names:
        if name in robots:
            raise refusal("parameter other_poses", name, "", "another: this one is flown here")
    return names


class OtherRobots:
    """Where other robots are seen: each from whatever topic has poses of it, as `PoseSource.AUTO`."""

    def __init__(self, node: ProgramNode, names: Sequence[str], world: str, see: See) -> None:
        """Subscribe.

        Args:
            node: that subscribes.
            names: of the robots.
            world: the frame_id that poses must have, or none.
            see: called with the number of a robot and its position (3,), m.
        """
        self._node, self._names, self._see = node, names, see
        self._sources = PoseSources(node, names, world, lambda _: False, PoseSource.AUTO)

    def look(self) -> None:
        """Look for other topics, where one is silent."""
        self._sources.look()

    def take(self) -> None:
        """Take in the poses that have come."""
        for number, name in enumerate(self._names):
            while self._sources.queues[number]:
                with self._node.faults.contain(f"{name}/pose"):
                    self._see(number, self._sources.take(number).position)
