"""Bags: what is written is read back, and what cannot be read is refused in one line."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.bag import Recorded, read_bag, write_bag
from flatsat_ros.viewing.bag import POSE_READERS

pytestmark = pytest.mark.in_process

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
    with pytest.raises(FlatsatError, match=r"must be one of its .*: /cf1/pose \(PoseStamped\), /cf2/pose \(PoseSt"):
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
    with pytest.raises(FlatsatError, match=r"bag: cannot be read: .*; if it is damaged, mcap recover may help"):
        read_bag(str(tmp_path / "bag"))


STORE = get_typestore(Stores.ROS2_JAZZY)
NAMED = "motion_capture_tracking_interfaces/msg/NamedPoseArray"
STORE.register(
    get_types_from_msg("string name\ngeometry_msgs/Pose pose\n", NAMED.replace("Array", ""))
    | get_types_from_msg(f"std_msgs/Header header\n{NAMED.replace('Array', '').replace('/msg', '')}[] poses\n", NAMED)
)
T = STORE.types
PLACE = (0.1, 2.0, 3.0)


def of_kind(kind: str, name: str, nanosec: int) -> Any:
    """A message of a kind in which a body of a name is at PLACE, level."""
    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](1, nanosec), "world")
    turn = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    pose = T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](*PLACE), turn)
    covered = T["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
    still = T["geometry_msgs/msg/TwistWithCovariance"](
        T["geometry_msgs/msg/Twist"](*2 * [vector(0, 0, 0)]), np.zeros(36)
    )
    match kind.rpartition("/")[2]:
        case "PoseStamped":
            return T[kind](header, pose)
        case "PoseWithCovarianceStamped":
            return T[kind](header, covered)
        case "Odometry":
            return T[kind](header, name, covered, still)
        case "TFMessage":
            move = T["geometry_msgs/msg/Transform"](vector(*PLACE), turn)
            return T[kind]([T["geometry_msgs/msg/TransformStamped"](header, name, move)])
    return T[kind](header, [T[NAMED.replace("Array", "")](name, pose)])


def vector(x: float, y: float, z: float) -> Any:
    return T["geometry_msgs/msg/Vector3"](float(x), float(y), float(z))


def write_kind(folder: Path, kind: str, bodies: Sequence[str], plugin: StoragePlugin, **options: Any) -> Path:
    """A bag with two messages about each body, 0.25 s apart."""
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if options:
        writer.set_compression(**options)
    with writer:
        connection = writer.add_connection("/lab/poses", kind, typestore=STORE)
        for number, name in enumerate([*bodies, *bodies]):
            message = of_kind(kind, name, 250_000_000 * (number // len(bodies)))
            writer.write(connection, 10**9 + number, STORE.serialize_cdr(message, kind))
    return folder


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize("kind", POSE_READERS)
def test_poses_of_every_kind_are_read(tmp_path: Path, kind: str, plugin: StoragePlugin) -> None:
    named = kind.endswith(("Array", "TFMessage"))
    bag = write_kind(tmp_path / "bag", kind, ["cf1", "person"] if named else ["cf1"], plugin)
    if named:
        with pytest.raises(FlatsatError, match=r"body = '': must be one of those of /lab/poses: cf1, person"):
            read_bag(str(bag))
    recording = read_bag(str(bag), body="cf1" if named else "")
    assert recording.time.tolist() == [0.0, 0.25]
    assert recording.position.tolist() == [list(PLACE), list(PLACE)]
    assert recording.quaternion.tolist() == 2 * [[0.0, 0.0, 0.0, 1.0]]
    with pytest.raises(FlatsatError, match=r"body = 'cf9': must be "):
        read_bag(str(bag), body="cf9")


def test_types_without_a_definition_in_the_bag_are_known(tmp_path: Path) -> None:
    bag = write_kind(tmp_path / "bag", NAMED, ["cf1"], StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(bag / "bag.db3", isolation_level=None)) as base:
        base.execute("DELETE FROM message_definitions")
    assert len(read_bag(str(bag)).time) == 2


@pytest.mark.parametrize("mode", ["file", "message", "storage"])
def test_compressed_bags_are_read(tmp_path: Path, mode: str) -> None:
    plugin = StoragePlugin.MCAP if mode == "storage" else StoragePlugin.SQLITE3
    compression = {"fmt": CompressionFormat.ZSTD, "mode": CompressionMode[mode.upper()]}
    bag = write_kind(tmp_path / "bag", NAMED, ["cf1"], plugin, **compression)
    assert len(read_bag(str(bag)).time) == 2
