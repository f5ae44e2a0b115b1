"""Plays a motion capture recording to a robot's pose topic, with all its faults, at its own pace or another."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import numpy as np
from rclpy.duration import Duration

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.base.files import user_path
from flatsat_ros.identification.recording import Recording, read_csv
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.bag import read_bag
from flatsat_ros.nodes.ros.parameters import declare, declare_robot_name, require_known_parameters
from flatsat_ros.nodes.ros.runtime import ENDING_TIME, ProgramNode, run

# stamps stay as far apart as they were recorded while the clock is not set by more than this, ns
_CLOCK_TOLERANCE = 50_000_000
# how often it looks whether someone listens, s
_PATIENCE = 0.05
# from the first subscription to the first pose, s
_SETTLING = 0.5


class MocapPlayer(ProgramNode):
    """One recording for one robot.

    It begins half a second after the first subscription to the pose topic is there. A pose recorded at t is stamped
    with the time of the beginning + (t - t0) / rate and sent then; one whose stamp is older than its predecessor's is
    sent right after it. So bursts, gaps and disorder stay what they are. Poses that are due together are sent one after
    the other.

    Attributes:
        done: whether everything was sent.
    """

    def __init__(self) -> None:
        """Read the parameters and the whole recording."""
        super().__init__(interfaces.PLAYER_NODE)
        path = declare(self, "file", "", "recording: a .csv file, or a bag: its folder, .mcap or .db3 file")
        robot = declare_robot_name(self, "whose pose topic is played to")
        topic = declare(self, "topic", "", "topic of the bag with poses; empty: its only one")
        body = declare(self, "body", "", "whose poses are played, where the topic names several; empty: the only one")
        self._rate = declare(self, "rate", 1.0, "pace; 2.0 is twice as fast as recorded", bounds=(1e-3, 1e3))
        self._loop = declare(self, "loop", False, "begin again at the end")
        require_known_parameters(self)
        self._recording = _read(path, topic, body)
        for line in self._recording.torn:
            self.get_logger().warning(f"{path}, line {line} breaks off: left out")

        nanoseconds = messages.NANOSECONDS / self._rate
        self._stamps = np.rint(self._recording.time * nanoseconds).astype(np.int64).tolist()
        self._due = np.rint(self._recording.due() * nanoseconds).astype(np.int64).tolist()
        self._next = 0
        self._start: int | None = None  # on steady time, ns
        self._offset = self.get_clock().now().nanoseconds - time.monotonic_ns()  # of stamps, ns
        self._pose = messages.pose_message()
        self._publisher = self.create_publisher(
            interfaces.POSE.kind, interfaces.POSE.of(robot), interfaces.POSE.publish
        )
        self._timer = self.create_timer(_PATIENCE, self._on_timer)
        self.get_logger().info(
            f"{path}: {len(self._stamps)} poses, {self._recording.duration / self._rate:.1f} s at rate {self._rate:g}; "
            f"waiting for a subscription to {self._publisher.topic}"
        )

    def finish(self) -> None:
        """Let the last poses arrive."""
        self._publisher.wait_for_all_acked(Duration(seconds=ENDING_TIME))

    def _on_timer(self) -> None:
        now = time.monotonic_ns()
        self._follow_clock(now)
        if self._start is None:
            if self._publisher.get_subscription_count() == 0:
                return
            self._start = now + round(_SETTLING * messages.NANOSECONDS)
        while self._next < len(self._due) and self._start + self._due[self._next] <= now:
            self._publish(self._start, self._next)
            self._next += 1
        if self._next < len(self._due):
            self._sleep(self._start + self._due[self._next] - now)
        elif self._loop:
            self._next, self._start = 0, None
            self._sleep(round(_PATIENCE * messages.NANOSECONDS))
        else:
            self.done = True
            self._timer.cancel()

    def _publish(self, start: int, index: int) -> None:
        recording, stamp = self._recording, start + self._stamps[index] + self._offset
        messages.fill_pose(self._pose, stamp, recording.position[index], recording.quaternion[index])
        self._publisher.publish(self._pose)

    def _follow_clock(self, now: int) -> None:
        """Learn what stamps are at a steady time, ns, again when the clock was set."""
        offset = self.get_clock().now().nanoseconds - now
        if abs(offset - self._offset) > _CLOCK_TOLERANCE:
            self._offset = offset

    def _sleep(self, nanoseconds: int) -> None:
        """Call the timer back after that long."""
        self._timer.timer_period_ns = nanoseconds
        self._timer.reset()


def _read(path: str, topic: str, body: str) -> Recording:
    """Read a recording of either kind.

    Raises:
        FlatsatError: it is missing, not readable, or a topic or body is asked of a CSV file.
    """
    if not path:
        raise FlatsatError("parameter file is empty: must be a recording, a .csv file or a bag")
    file = user_path(path)
    if file.suffix.lower() != ".csv":
        return read_bag(str(file), topic, body)
    for name, value in (("topic", topic), ("body", body)):
        if value:
            raise refusal(f"parameter {name}", value, "", "empty for a CSV recording")
    return read_csv(file)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the player."""
    return run(MocapPlayer, argv)


if __name__ == "__main__":
    sys.exit(main())
