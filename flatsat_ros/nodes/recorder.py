"""Records all topics of given robots into a bag (MCAP), for those who have no ros2 bag: until Ctrl-C.

Beside what lies below the robots' names it keeps motion capture's /poses and /tf, the log, /diagnostics and what the
controller says of itself. Rosbags, Foxglove, mocap_player and report read the bag.
"""

from __future__ import annotations

import shutil
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from flatsat_ros.base.errors import FlatsatError, require
from flatsat_ros.base.files import unwritable, user_path
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.nodes.ros.bag import BagWriter, Recorded
from flatsat_ros.nodes.ros.parameters import declare, declare_robots, require_known_parameters
from flatsat_ros.nodes.ros.runtime import ProgramNode, run

# what is recorded beside the robots' own topics
_COMMON = (
    interfaces.SETUP.suffix, interfaces.REFUSALS.suffix, interfaces.MARKERS.suffix, interfaces.LOG.suffix,
    interfaces.DIAGNOSTICS, "/poses", "/tf", "/tf_static",
)  # fmt: skip
_LOOK_PERIOD = 0.5  # s between two looks for new topics
_PROGRESS_LOOKS = 20  # of them between two lines of progress
_SPARE = 64 * 1024 * 1024  # bytes left free on the disk: the bag must still be closed, and others live on it, too
_DEPTH = 1000  # messages of a topic that may wait


class RecorderNode(ProgramNode):
    """One recording.

    Attributes:
        done: whether it is over before it was stopped.
        exit_code: 2 if it had to end.
        counts: messages recorded, by topic.
    """

    def __init__(self) -> None:
        """Read the parameters, make the bag, begin to look for topics."""
        super().__init__(interfaces.RECORDER_NODE)
        robots = [robot.name for robot in declare_robots(self)]
        output = declare(self, "output", "", "bag to write: path of a folder that does not exist yet")
        require_known_parameters(self)
        require(bool(output), "parameter output", output, "", "the path of a folder that does not exist yet")
        self._folder = user_path(output)
        self._prefixes = tuple(f"{self.resolve_topic_name(robot)}/" for robot in robots)
        self._common = {self.resolve_topic_name(name) for name in _COMMON}
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        self.counts: Counter[str] = Counter()
        self._left_out: set[str] = set()
        self._bytes = self._looks = 0
        self._require_room()
        self._bag = BagWriter(self._folder)
        self.create_timer(_LOOK_PERIOD, self._on_timer)
        self.get_logger().info(f"recording {', '.join(robots)} into {self._folder}, until Ctrl-C")

    def finish(self) -> None:
        """Close the bag and say what is in it."""
        try:
            self._bag.close()
        except FlatsatError as error:
            self._fail(error)
        print(f"{self._progress()}: {self._folder}")
        for topic in sorted(self.counts):
            print(f"{self.counts[topic]:>8}  {topic}")

    def _on_timer(self) -> None:
        try:
            self._require_room()
        except FlatsatError as error:
            self._fail(error)
            return
        for topic, kinds in self.get_topic_names_and_types():
            if topic in self._common or topic.startswith(self._prefixes):
                self._look_at(topic, kinds)
        self._looks += 1
        if self._looks % _PROGRESS_LOOKS == 0:
            self.get_logger().info(self._progress())

    def _progress(self) -> str:
        count, topics = self.counts.total(), len(self.counts)
        return f"{count} messages of {topics} topics, {self._bytes / 1e6:.1f} MB"

    def _look_at(self, topic: str, kinds: Sequence[str]) -> None:
        """Listen to a topic as long as somebody publishes it, as reliably as its publishers all are."""
        publishers = self.get_publishers_info_by_topic(topic)
        if topic in self._left_out or not publishers:
            return
        kind = _message_type(kinds[0]) if len(kinds) == 1 else None
        if kind is None:
            self._leave_out(topic, f"its type {', '.join(kinds)} is not installed here, or not one")
            return
        reliable = all(p.qos_profile.reliability is ReliabilityPolicy.RELIABLE for p in publishers)
        kept = all(p.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
        quality = QoSProfile(
            depth=_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        )
        known = self._subscriptions_by_topic.get(topic)
        if known is not None:
            if (known.qos_profile.reliability, known.qos_profile.durability) == (
                quality.reliability,
                quality.durability,
            ):
                return
            self.destroy_subscription(known)
        self._subscriptions_by_topic[topic] = self.create_subscription(
            kind, topic, self._keep(topic, kinds[0]), quality, raw=True
        )

    def _keep(self, topic: str, kind: str) -> Callable[[bytes], None]:
        def keep(data: bytes) -> None:
            if self.done or topic in self._left_out:
                return
            try:
                self._bag.write(Recorded(self.get_clock().now().nanoseconds, topic, kind, data))
            except FlatsatError as error:
                self._fail(error)
            except LookupError as error:
                self._leave_out(topic, str(error))
            else:
                self.counts[topic] += 1
                self._bytes += len(data)

        return keep

    def _leave_out(self, topic: str, why: str) -> None:
        self._left_out.add(topic)
        self.get_logger().warning(f"{topic} is left out: {why}")

    def _require_room(self) -> None:
        """Refuse to fill the disk.

        Raises:
            FlatsatError: there is no room, or no such folder.
        """
        try:
            free = shutil.disk_usage(self._folder.parent).free
        except OSError as error:
            raise unwritable(self._folder, error) from error
        if free < _SPARE:
            raise unwritable(self._folder, f"{free / 1e6:.0f} MB are free on the disk, must be {_SPARE / 1e6:.0f} MB")

    def _fail(self, error: FlatsatError) -> None:
        """End with a reason; what came before is in the bag."""
        if not self.exit_code:
            print(f"error: {error}", file=sys.stderr)
        self.done, self.exit_code = True, 2


def _message_type(name: str) -> Any | None:
    """Return the class of a message type, None where it is not installed."""
    package, _, kind = name.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), kind, None)
    except ImportError:
        return None


def main(argv: Sequence[str] | None = None) -> int:
    """Run the recorder."""
    return run(RecorderNode, argv)


if __name__ == "__main__":
    sys.exit(main())
