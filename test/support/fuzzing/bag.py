"""Bags: whatever is read of a damaged MCAP or SQLite file, or of its metadata, can be played."""

from __future__ import annotations

import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path

from geometry_msgs.msg import PoseStamped
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.bag import read_bag
from fuzzing import recording
from fuzzing.damage import corrupted, damaged
from fuzzing.kind import Attempt, Kind, require_one_line, rewrite

_KIND = "geometry_msgs/msg/PoseStamped"
_MAGIC = 8  # bytes before the first record of an MCAP file


def _write(folder: Path, plugin: StoragePlugin) -> None:
    """Write a bag of three poses."""
    pose = PoseStamped()
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/cf1/pose", _KIND, typestore=get_typestore(Stores.ROS2_JAZZY))
        for number in range(3):
            messages.fill_pose(pose, 1_000 * number, (0.1 * number, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
            writer.write(connection, number, serialize_message(pose))


def _sound(plugin: StoragePlugin) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, "bag")
        _write(bag, plugin)
        return {file.name: file.read_bytes() for file in bag.iterdir()}


_BAGS = {"mcap": _sound(StoragePlugin.MCAP), "db3": _sound(StoragePlugin.SQLITE3)}


def _records(data: bytes) -> list[bytes]:
    """Return what stands between the magic numbers of an MCAP file: records of a kind, a length and so many bytes."""
    records, at = [], _MAGIC
    while at < len(data) - _MAGIC:
        (length,) = struct.unpack_from("<Q", data, at + 1)
        records.append(data[at : at + 9 + length])
        at += 9 + length
    return records


@st.composite
def _mcap(draw: st.DrawFn) -> bytes:
    """A record lost, doubled, moved, of another kind or of another length, or damaged."""
    sound = _BAGS["mcap"]["bag.mcap"]
    records = _records(sound)
    for _ in range(draw(st.integers(1, 2))):
        first, second = (draw(st.integers(0, len(records) - 1)) for _ in range(2))
        record = records[first]
        match draw(st.integers(0, 5)):
            case 0:
                records[first] = b""
            case 1:
                records.insert(second, record)
            case 2:
                records[first] = bytes([draw(st.integers(0, 20))]) + record[1:]
            case 3:
                length = draw(st.sampled_from([0, 1, 8, 2**31, 2**63, 2**64 - 1]))
                records[first] = record[:1] + struct.pack("<Q", length) + record[9:]
            case _:
                content = draw(corrupted(record[9:]))
                records[first] = record[:1] + struct.pack("<Q", len(content)) + content
    return sound[:_MAGIC] + b"".join(records) + sound[-_MAGIC:]


_VALUES = (
    "NULL", "''", "'text'", "-1", "0", "1", "9223372036854775807", "-9223372036854775808", "1e308", "'nan'", "x'00'",
    "x'0001000001'", "zeroblob(100000)", "'/cf1/pose'", f"'{_KIND}'",
)  # fmt: skip
_COLUMNS = {
    "messages": ("id", "topic_id", "timestamp", "data"),
    "topics": ("id", "name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"),
    "schema": ("schema_version", "ros_distro"),
    "message_definitions": ("topic_type", "encoding", "encoded_message_definition"),
}
_STATEMENTS = (
    *(f"UPDATE {table} SET {column} = {{}}" for table, columns in _COLUMNS.items() for column in columns),
    *(f"{what} {table}" for what in ("DELETE FROM", "DROP TABLE") for table in _COLUMNS),
    "INSERT INTO messages SELECT id + 9, {}, timestamp, data FROM messages",
    "INSERT INTO topics SELECT id + 9, {}, type, serialization_format, offered_qos_profiles, '' FROM topics",
    "ALTER TABLE messages RENAME COLUMN data TO content",
)


@st.composite
def _tables(draw: st.DrawFn) -> bytes:
    """The tables of a bag changed by SQL."""
    with tempfile.TemporaryDirectory(prefix="flatsat_ros-fuzz-") as folder:
        file = Path(folder, "bag.db3")
        file.write_bytes(_BAGS["db3"]["bag.db3"])
        with closing(sqlite3.connect(file, isolation_level=None)) as base:
            base.execute("PRAGMA synchronous = OFF")
            base.execute("PRAGMA journal_mode = MEMORY")
            for _ in range(draw(st.integers(1, 2))):
                with suppress(sqlite3.Error):
                    base.execute(draw(st.sampled_from(_STATEMENTS)).format(draw(st.sampled_from(_VALUES))))
        return file.read_bytes()


@contextmanager
def _open(folder: Path, *, bag: str, victim: str) -> Iterator[Attempt]:
    path = folder / "bag"
    path.mkdir()
    for name, content in _BAGS[bag].items():
        (path / name).write_bytes(content)

    def attempt(data: bytes) -> bool:
        rewrite(path / victim, data)
        try:
            content = read_bag(str(path))
        except FlatsatError as refused:
            require_one_line(refused, path)
            return False
        recording.law(content)
        return True

    yield attempt


MCAP = Kind(st.one_of(_mcap(), corrupted(_BAGS["mcap"]["bag.mcap"])), partial(_open, bag="mcap", victim="bag.mcap"))
DB3 = Kind(st.one_of(_tables(), corrupted(_BAGS["db3"]["bag.db3"])), partial(_open, bag="db3", victim="bag.db3"))
METADATA = Kind(damaged(_BAGS["mcap"]["metadata.yaml"].decode()), partial(_open, bag="mcap", victim="metadata.yaml"))
