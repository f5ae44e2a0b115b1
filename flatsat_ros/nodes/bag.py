"""Recordings that lie in a ROS 2 bag, MCAP or SQLite, read with rosbags: no ROS tool is needed."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np

from flatsat_ros.core.errors import FlatsatError
from flatsat_ros.core.recording import Recording
from flatsat_ros.nodes import messages

_KIND = "geometry_msgs/msg/PoseStamped"


def read_bag(path: str, topic: str = "") -> Recording:
    """Read one PoseStamped topic of a bag.

    Args:
        path: the bag's folder, or its .mcap or .db3 file.
        topic: its name; empty means the only one of its kind.

    Returns:
        The poses in recorded order, at the stamps of their headers; a zero stamp means the time of recording.

    Raises:
        FlatsatError: rosbags is not installed, the bag cannot be read, or it has no such topic.
    """
    try:
        from rosbags.rosbag2 import Reader, ReaderError
    except ImportError as error:
        raise FlatsatError(f"recording {path!r} is a bag: reading one needs rosbags, pip install rosbags") from error
    try:
        with Reader(Path(path)) as reader:
            topics = {c.topic: c for c in reader.connections if c.msgtype == _KIND}
            chosen = topic or (next(iter(topics)) if len(topics) == 1 else "")
            if chosen not in topics:
                valid = f"must be one of its {_KIND} topics: {', '.join(topics) or 'none'}"
                raise FlatsatError(f"recording {path!r}, topic {topic!r}: {valid}")
            entries = []
            for _, recorded, data in reader.messages([topics[chosen]]):
                stamp, position, quaternion = messages.pose_from_cdr(bytes(data))
                entries.append((stamp or recorded, position, quaternion))
    except (ReaderError, OSError, sqlite3.Error) as error:
        raise FlatsatError(f"recording {path!r} cannot be read: {error}") from error
    if not entries:
        raise FlatsatError(f"recording {path!r}: topic {chosen} has no messages")
    first = entries[0][0]
    return Recording(
        np.array([(stamp - first) / messages.NANOSECONDS for stamp, _, _ in entries]),
        np.array([position for _, position, _ in entries]),
        np.array([quaternion for _, _, quaternion in entries]),
    )
