"""The reports of a node: once a period, one message with a status for each robot."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.diagnostics import PERIOD, Diagnostics, Level, RobotCondition

pytestmark = pytest.mark.in_process

NOW = 1_500_000_000  # ns


class Node:
    """As much of a node as reports need."""

    def __init__(self) -> None:
        self.published: list[Any] = []
        self.timers: list[tuple[float, Callable[[], None]]] = []

    def get_name(self) -> str:
        return "controller"

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=NOW))

    def create_publisher(self, kind: Any, name: str, _qos: Any) -> Any:
        assert (kind, name) == (interfaces.DIAGNOSTICS_KIND, "/diagnostics")
        return SimpleNamespace(publish=self.published.append)

    def create_timer(self, period: float, callback: Callable[[], None]) -> None:
        self.timers.append((period, callback))


def test_every_period_each_robot_has_a_status_in_one_message() -> None:
    node, asked = Node(), []

    def collect(now: int) -> list[RobotCondition]:
        asked.append(now)
        return [
            RobotCondition("cf1", "cf1", Level.OK, "FLY", {"gamma": "1.5"}),
            RobotCondition("cf2", "udp://a:1", Level.ERROR, "CUT", {"armed": True}),
        ]

    Diagnostics(node, collect)
    ((period, publish),) = node.timers
    assert period == PERIOD == 1.0
    publish()
    (message,) = node.published
    assert asked == [NOW]
    assert messages.nanoseconds_from_stamp(message.header.stamp) == NOW
    said = [(s.name, s.hardware_id, s.level, s.message, [(p.key, p.value) for p in s.values]) for s in message.status]
    assert said == [
        ("controller: cf1", "cf1", b"\0", "FLY", [("gamma", "1.5")]),
        ("controller: cf2", "udp://a:1", b"\2", "CUT", [("armed", "True")]),
    ]


def test_nothing_to_report_is_no_message() -> None:
    node = Node()
    Diagnostics(node, lambda _: [])
    node.timers[0][1]()
    assert node.published == []
