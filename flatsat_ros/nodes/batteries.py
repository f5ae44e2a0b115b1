"""The voltages that drones tell: on `<robot>/battery`, and on crazyswarm2's `<robot>/status` where it can be read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.runtime import ProgramNode


def follow_batteries(node: ProgramNode, robots: Sequence[str], take: Callable[[int, float], None]) -> None:
    """Call take with the number of a robot and its voltage, V, for every message of theirs that tells one."""

    def hand_on(index: int, message: Any) -> None:
        take(index, messages.voltage_from_message(message))

    for topic in filter(None, (interfaces.BATTERY, crazyswarm.status_topic())):
        for index, robot in enumerate(robots):
            node.create_subscription(topic.kind, topic.of(robot), partial(hand_on, index), topic.subscribe)
