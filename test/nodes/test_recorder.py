"""record: all topics of given robots go into a bag that can be read, and it ends in order where it cannot go on."""

from __future__ import annotations

import shutil
import time
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.recorder import RecorderNode
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.bag import BagWriter, Recorded, read_bag
from flatsat_ros.viewing.bag import opened

pytestmark = pytest.mark.in_process

DEADLINE = 20.0  # s
Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Callable[[], tuple[RecorderNode, Callable[[Callable[[], bool]], None]]]]:
    """How to start a recorder of cf1 and CF_2, and what lets callbacks run until a condition holds."""
    made: list[Node] = []

    def start() -> tuple[RecorderNode, Callable[[Callable[[], bool]], None]]:
        rclpy.init(
            args=["--ros-args", "-r", "__ns:=/lab", "-p", "robot_names:=[cf1, CF_2]", "-p", f"output:={tmp_path}/bag"]
        )
        recorder = RecorderNode()
        made.append(recorder)
        speaker = Node("speaker", namespace="/lab")
        made.append(speaker)
        pose, setup = interfaces.POSE, interfaces.SETUP
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        publishers = [
            speaker.create_publisher(PoseStamped, name, quality)
            for name, quality in (("cf1/pose", pose.publish), ("CF_2/seen", best_effort), ("cf3/pose", pose.publish))
        ]
        speaker.create_publisher(setup.kind, setup.suffix, setup.publish).publish(messages.text_message("{}"))
        speaker.create_publisher(String, "cf10/text", 10)
        message = messages.pose_message()
        executor = SingleThreadedExecutor()
        for node in made:
            executor.add_node(node)

        def run_until(condition: Callable[[], bool]) -> None:
            end = time.monotonic() + DEADLINE
            while not condition():
                assert time.monotonic() < end
                for publisher in publishers:
                    messages.fill_pose(message, speaker.get_clock().now().nanoseconds, (1, 2, 3), (0, 0, 0, 1))
                    publisher.publish(message)
                executor.spin_once(timeout_sec=0.02)

        return recorder, run_until

    yield start
    for node in made:
        Node.destroy_node(node)
    rclpy.try_shutdown()


def test_all_topics_of_the_robots_are_in_the_bag_and_none_of_others(
    record: Callable[..., tuple[RecorderNode, Callable[..., None]]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder, run_until = record()
    wanted = {"/lab/cf1/pose", "/lab/CF_2/seen", "/lab/flatsat/setup"}
    run_until(lambda: wanted <= set(recorder.counts) and recorder.counts["/lab/CF_2/seen"] >= 5)
    recorder.finish()
    with opened(tmp_path / "bag") as reader:
        topics = {connection.topic: connection.msgcount for connection in reader.connections}
    assert wanted <= set(topics)
    assert not {"/lab/cf3/pose", "/lab/cf10/text"} & set(topics)
    assert topics == dict(recorder.counts)
    assert read_bag(str(tmp_path / "bag"), "/lab/CF_2/seen").position[0].tolist() == [1.0, 2.0, 3.0]
    assert f"{topics['/lab/cf1/pose']:>8}  /lab/cf1/pose" in capsys.readouterr().out


def test_it_ends_with_a_sound_bag_before_the_disk_is_full(
    record: Callable[..., tuple[RecorderNode, Callable[..., None]]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorder, run_until = record()
    run_until(lambda: recorder.counts["/lab/cf1/pose"] >= 5)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 10**6))
    run_until(lambda: recorder.done)
    recorder.finish()
    assert recorder.exit_code == 2
    assert "bag: cannot be written: 1 MB are free on the disk, must be 67 MB" in capsys.readouterr().err
    assert len(read_bag(str(tmp_path / "bag"), "/lab/cf1/pose").time) == recorder.counts["/lab/cf1/pose"]


def test_what_cannot_be_written_ends_it_in_one_line(
    record: Callable[..., tuple[RecorderNode, Callable[..., None]]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recorder, run_until = record()

    def refuse(_: BagWriter, _entry: Recorded) -> None:
        raise FlatsatError("bag: cannot be written: No space left on device")

    monkeypatch.setattr(BagWriter, "write", refuse)
    run_until(lambda: recorder.done)
    recorder.finish()
    assert recorder.exit_code == 2
    assert capsys.readouterr().err == "error: bag: cannot be written: No space left on device\n"


@pytest.mark.parametrize(
    ("made", "given", "reason"),
    [
        ("bag", "", "exists already"),
        ("", "", "cannot be written: No such file or directory"),
        ("other", ":=", "parameter output = '': must be the path of a folder that does not exist yet"),
    ],
)
def test_where_nothing_can_be_recorded_it_does_not_start(tmp_path: Path, made: str, given: str, reason: str) -> None:
    output = tmp_path / "folder" / "bag"
    if made:
        (tmp_path / "folder" / made).mkdir(parents=True)
    rclpy.init(args=[] if given else ["--ros-args", "-p", f"output:={output}"])
    try:
        with pytest.raises(FlatsatError, match=reason):
            RecorderNode()
    finally:
        rclpy.try_shutdown()


def test_a_type_whose_definition_is_not_to_be_had_is_told(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    with pytest.raises(LookupError, match="the definition of nobody_interfaces/msg/Thing is not to be had"):
        bag.write(Recorded(0, "/cf1/thing", "nobody_interfaces/msg/Thing", b""))
    bag.close()
