"""Goals and trajectories for the drones as they come on topics, taken in or refused with a sentence on another one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.stamps import StampClock
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.ros import cdr, interfaces, messages
from flatsat_ros.nodes.ros.runtime import ProgramNode


class ReferenceTopics:
    """Takes references for robots and tells why one is refused: nobody answers its sender."""

    def __init__(
        self,
        node: ProgramNode,
        robots: Sequence[str],
        world: bytes,
        stamps: StampClock,
        follow: Callable[[int, Trajectory], None],
        breathe: Callable[[], None],
    ) -> None:
        """Subscribe to the topics.

        Args:
            node: subscribes.
            robots: names.
            world: frame of all references.
            stamps: tell when a trajectory begins.
            follow: lets a drone, given its number, follow a reference from now on; raises FlatsatError to refuse.
            breathe: looks at the clocks, and does what cannot wait until many references have been taken.
        """
        self._node, self._robots, self._world, self._stamps = node, list(robots), world, stamps
        self._follow, self._breathe = follow, breathe
        refusals = interfaces.REFUSALS
        self._refusals = node.create_publisher(refusals.kind, refusals.suffix, refusals.publish)
        for index, robot in enumerate(robots):
            for topic, take in ((interfaces.GOAL, self._on_goal), (interfaces.TRAJECTORY, self._on_trajectory)):
                node.create_subscription(topic.kind, topic.of(robot), partial(take, index), topic.subscribe, raw=True)

    def _on_goal(self, index: int, data: bytes) -> None:
        self._breathe()
        with self._telling(index, interfaces.GOAL):
            cdr.require_short(data)
            cdr.require_frame(data, self._world)
            self._follow(index, cdr.setpoint_from_cdr(data))

    def _on_trajectory(self, index: int, data: bytes) -> None:
        self._breathe()
        with self._telling(index, interfaces.TRAJECTORY):
            cdr.require_frame(data, self._world)
            now = self._node.get_clock().now().nanoseconds
            self._follow(index, cdr.trajectory_from_cdr(data, now, self._stamps.origin()))

    @contextmanager
    def _telling(self, index: int, topic: interfaces.Topic) -> Iterator[None]:
        """Tell on a topic of its own, beside the log, why a reference is refused."""
        try:
            yield
        except FlatsatError as error:
            self._refusals.publish(messages.text_message(f"{topic.of(self._robots[index])}: {error}"))
            raise
