"""The node of a soak: asks and hears like a conductor, but keeps nothing that grows."""

from __future__ import annotations

import time
from collections import Counter

from rclpy.qos import QoSProfile

from flatsat_ros.nodes.conductor import Conductor
from flatsat_ros.nodes.ros.interfaces import TELEMETRY, Topic

_DEPTH = 1000  # messages that wait while this process is held up: it must not miss what the controller did not


class SoakLab(Conductor):
    """A conductor that keeps the newest message of each topic, and counts them."""

    def record(self, topic: Topic, name: str, mark: bytes = b"") -> None:
        """Keep the newest message of a topic, by its name, and count; marks are not looked for."""
        if not hasattr(self, "_counts"):  # called by the constructor of Conductor
            self._counts: Counter[str] = Counter()
            self._heard: dict[str, float] = {}  # s, when the newest one came

        def keep(data: bytes) -> None:
            self._newest[name] = data
            self._counts[name] += 1
            self._heard[name] = time.monotonic()

        quality = QoSProfile(depth=_DEPTH, reliability=topic.subscribe.reliability)
        self.create_subscription(topic.kind, name, keep, quality, raw=True)

    def ticks_made(self) -> tuple[int, float]:
        """Return how many ticks the controller has made so far, and when the newest one was heard of, s."""
        name = TELEMETRY.of(self._robots[0])
        return self._counts[name], self._heard[name]
