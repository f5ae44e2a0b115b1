"""ROS 2 bags, read (MCAP or SQLite) and written (MCAP) with rosbags: no ROS tool is needed."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flatsat_ros.base.errors import FlatsatError, one_line, refusal
from flatsat_ros.base.files import located, unreadable, unwritable
from flatsat_ros.identification.recording import POSES, Recording
from flatsat_ros.nodes.ros import cdr, messages
from flatsat_ros.viewing.bag import check_bag

_KIND = "geometry_msgs/msg/PoseStamped"


def read_bag(path: str, topic: str = "") -> Recording:
    """Read one PoseStamped topic of a bag.

    Args:
        path: the bag's folder, or its .mcap or .db3 file.
        topic: its name; empty means the only one of its kind.

    Returns:
        The poses in recorded order, at the stamps of their headers; a zero stamp means the time of recording.

    Raises:
        FlatsatError: rosbags is not installed, the bag cannot be read, it has no such topic, or more than POSES poses.
    """
    try:
        from rosbags.rosbag2 import Reader
    except ImportError as error:
        raise unreadable(path, "a bag needs rosbags, pip install rosbags") from error
    check_bag(Path(path))
    try:
        with Reader(Path(path)) as reader:
            topics = {c.topic: c for c in reader.connections if c.msgtype == _KIND}
            chosen = topic or (next(iter(topics)) if len(topics) == 1 else "")
            if chosen not in topics:
                raise refusal("topic", topic, "", f"one of its {_KIND} topics: {', '.join(topics) or 'none'}")
            entries = []
            for _, recorded, data in reader.messages([topics[chosen]]):
                stamp, position, quaternion = cdr.pose_from_cdr(bytes(data))
                entries.append((stamp or recorded, position, quaternion))
                if len(entries) > POSES:
                    raise refusal("number of poses", len(entries), "or more", f"at most {POSES}")
        first = entries[0][0] if entries else 0
        return Recording(
            np.array([(stamp - first) / messages.NANOSECONDS for stamp, _, _ in entries]),
            np.array([position for _, position, _ in entries]),
            np.array([quaternion for _, _, quaternion in entries]),
        )
    except FlatsatError as error:
        raise located(path, one_line(str(error))) from error
    except Exception as error:  # a damaged bag lets errors of a dozen kinds escape from rosbags and what it stands on
        raise unreadable(path, error) from error


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
