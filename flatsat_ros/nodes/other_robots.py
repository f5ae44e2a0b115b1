"""Robots that are not flown here but must be kept away from: where they are, from their pose topics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from flatsat_ros.base.errors import refusal
from flatsat_ros.nodes.ros import cdr, interfaces
from flatsat_ros.nodes.ros.parameters import declare, require_robot_names
from flatsat_ros.nodes.ros.runtime import ProgramNode

See = Callable[[int, Sequence[float]], None]


def declare_others(node: ProgramNode, robots: Sequence[str]) -> list[str]:
    """Declare of which other robots the poses are known, and return their names.

    ROS cannot tell an empty array from one of another type, so that one empty name stands for no robot.

    Raises:
        FlatsatError: a name is no ROS name, is given twice or is that of a drone that is flown here.
    """
    meaning = "names of robots that are not flown here, kept away from where <name>/pose says they are; [''] for none"
    names = declare(node, "other_poses", [""], meaning)
    if names == [""]:
        return []
    require_robot_names(names)
    for name in names:
        if name in robots:
            raise refusal("parameter other_poses", name, "", "another: this one is flown here")
    return names


def follow_others(node: ProgramNode, names: Sequence[str], world: bytes, see: See) -> None:
    """Call see with the number of another robot and its position (3,), m, for every pose of it.

    Args:
        node: that subscribes.
        names: of the robots.
        world: the frame_id that poses must have, or none.
        see: what is called.
    """

    def take(number: int, data: bytes) -> None:
        cdr.require_short(data)
        cdr.require_frame(data, world)
        _, position, _ = cdr.pose_from_cdr(data)
        see(number, position)

    pose = interfaces.POSE
    for number, name in enumerate(names):
        node.create_subscription(pose.kind, pose.of(name), partial(take, number), pose.subscribe, raw=True)
