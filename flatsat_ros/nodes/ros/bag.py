"""ROS 2 bags, read (MCAP or SQLite) and written (MCAP) with rosbags: no ROS tool is needed."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.base.errors import FlatsatError, one_line, refusal
from flatsat_ros.base.files import located, unwritable
from flatsat_ros.identification.recording import POSES, Recording
from flatsat_ros.nodes.ros import messages
from flatsat_ros.viewing.bag import POSE_READERS, opened


def read_bag(path: str, topic: str = "", body: str = "") -> Recording:
    """Read the poses of one drone out of a bag.

    Args:
        path: the bag's folder, or its .mcap or .db3 file.
        topic: its name; empty means the only one whose type has poses, /tf_static aside.
        body: where messages name whose pose they tell, as on crazyswarm2's /poses and on /tf: its name, there the
            child's frame; empty means the only one.

    Returns:
        The poses in recorded order, at the stamps of their headers; a zero stamp means the time of recording.

    Raises:
        FlatsatError: rosbags is not installed, the bag cannot be read, it has no such topic or body, or more than POSES
            poses.
    """
    with opened(Path(path)) as reader:
        try:
            return _recording(reader, topic, body)
        except FlatsatError as error:
            raise located(path, one_line(str(error))) from error


def _recording(reader: Any, topic: str, body: str) -> Recording:
    topics = {c.topic: c for c in reader.connections if c.msgtype in POSE_READERS}
    movable = [name for name in topics if not name.endswith("/tf_static")]
    chosen = topic or (movable[0] if len(movable) == 1 else "")
    if chosen not in topics:
        found = ", ".join(f"{name} ({c.msgtype.rpartition('/')[2]})" for name, c in topics.items()) or "none"
        known = "" if topics else f"; known are {', '.join(name.rpartition('/')[2] for name in POSE_READERS)}"
        raise refusal("topic", topic, "", f"one of its topics with poses: {found}{known}")
    read = POSE_READERS[topics[chosen].msgtype]
    entries: list[tuple[int, tuple[float, ...]]] = []
    bodies: dict[str, None] = {}  # in the order in which they are seen first
    for connection, recorded, data in reader.messages([c for c in reader.connections if c.topic == chosen]):
        for seen in read(reader.deserialize(data, connection.msgtype)):
            bodies.setdefault(seen.name)
            if seen.name == (body or next(iter(bodies))):
                entries.append((seen.stamp or recorded, seen.values))
        if len(entries) > POSES:
            raise refusal("number of poses", len(entries), "or more", f"at most {POSES}")
    if bodies and (body not in bodies if body else len(bodies) > 1):
        named = f"one of those of {chosen}: {', '.join(bodies)}" if any(bodies) else f"empty: {chosen} names no bodies"
        raise refusal("body", body, "", named)
    first = entries[0][0] if entries else 0
    values = np.array([values for _, values in entries]).reshape(-1, 7)
    time = np.array([(stamp - first) / messages.NANOSECONDS for stamp, _ in entries])
    return Recording(time, values[:, :3], values[:, 3:])


@dataclass(frozen=True)
class Recorded:
    """One message as it came: arrival (ns), topic, ROS type name, serialised bytes (CDR)."""

    time: int
    topic: str
    kind: str
    cdr: bytes


def write_bag(folder: Path, recorded: Sequence[Recorded]) -> None:
    """Write messages into an MCAP bag, replacing the folder; a failure leaves the old one.

    Raises:
        FlatsatError: rosbags is not installed, or the bag cannot be written.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise unwritable(folder, "a bag needs rosbags, pip install rosbags") from error
    typestore = get_typestore(Stores.ROS2_JAZZY)
    # rosbags names the file after the folder it is written to: same name, one level down
    partial = folder.parent / ".part" / folder.name
    try:
        shutil.rmtree(partial.parent, ignore_errors=True)
        partial.parent.mkdir(parents=True)
        with Writer(partial, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=typestore)
                for topic, kind in {entry.topic: entry.kind for entry in recorded}.items()
            }
            for entry in recorded:
                writer.write(connections[entry.topic], entry.time, entry.cdr)
        shutil.rmtree(folder, ignore_errors=True)
        partial.rename(folder)
        partial.parent.rmdir()
    except (WriterError, OSError) as error:
        raise unwritable(folder, error) from error
