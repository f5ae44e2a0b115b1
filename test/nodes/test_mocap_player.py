"""mocap_player: a recording comes out as it was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from faulty_recording import EPOCH, faulty_recording, write_csv
from rclpy.serialization import serialize_message

from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.bag import Recorded, write_bag

if TYPE_CHECKING:
    from conftest import Lab

pytestmark = pytest.mark.beside_flights


def stamps(poses: list[Any]) -> np.ndarray:
    return np.array([messages.nanoseconds_from_stamp(pose.header.stamp) for pose in poses])


def numbers(poses: list[Any]) -> np.ndarray:
    """Position and quaternion, (M, 7)."""
    parts = [(pose.pose.position, pose.pose.orientation) for pose in poses]
    return np.array([[p.x, p.y, p.z, q.x, q.y, q.z, q.w] for p, q in parts])


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_recording_is_played_in_its_order_with_its_own_stamps(lab: Lab, tmp_path: Path, rate: float) -> None:
    rows = faulty_recording()[:150]  # with the gap of 0.6 s
    player = lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", rows), rate=rate)
    poses = lab.watch(interfaces.POSE, "cf1")
    player.expected = True
    lab.wait(lambda: player.returncode is not None, "the end of the recording")
    assert player.returncode == 0
    lab.wait(lambda: len(poses) >= len(rows), "all poses")
    assert np.array_equal(numbers(poses), rows[:, 1:], equal_nan=True)
    # a Unix time in a float leaves a quarter of a microsecond
    assert stamps(poses) - stamps(poses)[0] == pytest.approx(rows[:, 0] * 1e9 / rate, abs=300)
    assert f"line {len(rows) + 2} breaks off" in player.output


def test_no_pose_comes_before_its_stamp(lab: Lab, tmp_path: Path) -> None:
    rows = faulty_recording()[:100]
    early: list[float] = []

    def take(pose: Any) -> None:
        early.append(messages.nanoseconds_from_stamp(pose.header.stamp) - lab.node.get_clock().now().nanoseconds)

    lab.node.create_subscription(interfaces.POSE.kind, "cf1/pose", take, 1000)
    lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", rows)).expected = True
    lab.wait(lambda: len(early) >= len(rows), "all poses")
    assert max(early) <= 0.0


def test_a_loop_begins_again_with_new_stamps(lab: Lab, tmp_path: Path) -> None:
    rows = faulty_recording()[:30]
    player = lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", rows), loop=True, robot_name="cf7")
    poses = lab.watch(interfaces.POSE, "cf7")
    lab.wait(lambda: len(poses) >= 3 * len(rows), "three rounds")
    assert np.array_equal(numbers(poses)[: 3 * len(rows)], np.tile(rows[:, 1:], (3, 1)))
    assert (np.diff(stamps(poses)) > 0).all()
    assert player.stop() == 0


def test_a_bag_is_played_too(lab: Lab, tmp_path: Path) -> None:
    rows = faulty_recording()[:30]
    poses = lab.watch(interfaces.POSE, "cf1")
    recorded = []
    for topic, offset in (("/lab/cf1/pose", 0.0), ("/lab/cf2/pose", 5.0)):
        for row in rows:
            pose = interfaces.POSE.kind()
            messages.fill_pose(pose, round((EPOCH + row[0]) * 1e9), row[1:4] + offset, row[4:])
            data = serialize_message(pose)
            recorded.append(Recorded(round((EPOCH + row[0]) * 1e9), topic, "geometry_msgs/msg/PoseStamped", data))
    write_bag(tmp_path / "bag", sorted(recorded, key=lambda entry: entry.time))
    lab.start("mocap_player", file=tmp_path / "bag", topic="/lab/cf2/pose").expected = True
    lab.wait(lambda: len(poses) >= len(rows), "all poses")
    assert numbers(poses)[:, :3] == pytest.approx(rows[:, 1:4] + 5.0)
    assert stamps(poses) - stamps(poses)[0] == pytest.approx(rows[:, 0] * 1e9, abs=300)
