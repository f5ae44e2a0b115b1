"""Bags: what is written is read back, and what cannot be read is refused in one line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.bag import Recorded, read_bag, write_bag

KIND = "geometry_msgs/msg/PoseStamped"


def recorded(topic: str, arrival: int, stamp: int, x: float) -> Recorded:
    pose = PoseStamped()
    messages.fill_pose(pose, stamp, (x, 2.0, 3.0), (0.0, 0.0, np.nan, 1.0))
    return Recorded(arrival, topic, KIND, serialize_message(pose))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two drones; the second pose of cf1 is late, the third has no stamp."""
    entries = [
        recorded("/cf1/pose", 5_000, 1_000, 0.1),
        recorded("/cf1/pose", 6_000, 400, 0.2),
        recorded("/cf2/pose", 6_500, 6_400, 9.0),
        recorded("/cf1/pose", 7_000, 0, 0.3),
    ]
    write_bag(tmp_path / "bag", entries)
    return tmp_path / "bag"


def test_a_bag_gives_the_poses_of_a_topic_in_recorded_order_at_their_own_stamps(bag: Path) -> None:
    recording = read_bag(str(bag), "/cf1/pose")
    assert recording.time == pytest.approx([0.0, -600e-9, 6_000e-9], abs=1e-15)
    assert recording.position.tolist() == [[0.1, 2.0, 3.0], [0.2, 2.0, 3.0], [0.3, 2.0, 3.0]]
    assert np.isnan(recording.quaternion[:, 2]).all()
    assert recording.due().tolist() == pytest.approx([0.0, 0.0, 6_000e-9], abs=1e-15)


def test_its_file_is_a_bag_as_well_and_the_only_topic_need_not_be_named(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", [recorded("/cf1/pose", 5_000, 1_000, 0.1)])
    (file,) = (tmp_path / "bag").glob("*.mcap")
    assert read_bag(str(file)).position.tolist() == [[0.1, 2.0, 3.0]]


@pytest.mark.parametrize("topic", ["", "/cf3/pose"])
def test_a_topic_that_is_not_there_is_refused_with_those_that_are(bag: Path, topic: str) -> None:
    with pytest.raises(FlatsatError, match=r"must be one of its .*: /cf1/pose, /cf2/pose"):
        read_bag(str(bag), topic)


def test_what_is_no_bag_is_refused_in_one_line(bag: Path, tmp_path: Path) -> None:
    (file,) = bag.glob("*.mcap")
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    text, database, folder = tmp_path / "text.mcap", tmp_path / "text.db3", tmp_path / "folder"
    text.write_text("t,x\n")
    database.write_text("t,x\n")
    folder.mkdir()
    for path in (torn, text, database, folder, tmp_path / "missing", tmp_path / "missing.mcap", tmp_path / "odd.txt"):
        with pytest.raises(FlatsatError, match=r": cannot be read: .+") as caught:
            read_bag(str(path))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["metadata.yaml", "bag.mcap"])
def test_a_pipe_in_a_bag_is_not_waited_for(bag: Path, name: str) -> None:
    (bag / name).unlink()
    os.mkfifo(bag / name)
    with pytest.raises(FlatsatError, match=rf"{name}: cannot be read: it is a device, pipe or socket"):
        read_bag(str(bag))


def test_bytes_that_are_no_pose_are_refused(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", [Recorded(1, "/cf1/pose", KIND, b"\0\1\0\0short")])
    with pytest.raises(FlatsatError, match="9 bytes are not a serialised PoseStamped"):
        read_bag(str(tmp_path / "bag"))
