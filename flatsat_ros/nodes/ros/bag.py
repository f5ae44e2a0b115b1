"""ROS 2 bags, read (MCAP or SQLite) and written (MCAP) with rosbags: no ROS tool is needed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.base.errors import FlatsatError, one_line, refusal
from flatsat_ros.base.files import located, unwritable
from flatsat_ros.identification.recording import POSES, Recording
from flatsat_ros.nodes.ros import messages
from flatsat_ros.viewing.bag import POSE_READERS, known_types, opened


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


class BagWriter:
    """An MCAP bag that is written message by message, and can be read once it is closed."""

    def __init__(self, folder: Path) -> None:
        """Make the bag, a new folder.

        Raises:
            FlatsatError: rosbags is not installed, or the folder exists or cannot be made.
        """
        try:
            from rosbags.rosbag2 import StoragePlugin, Writer
        except ImportError as error:
            raise unwritable(folder, "a bag needs rosbags, pip install rosbags") from error
        self._folder, self._typestore = folder, known_types()
        self._connections: dict[str, Any] = {}
        with self._told():
            self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()

    def write(self, entry: Recorded) -> None:
        """Write one message; all of a topic have the same type.

        Raises:
            FlatsatError: the bag cannot be written.
            LookupError: the definition of the type is not to be had, without which nobody can read it.
        """
        connection = self._connections.get(entry.topic)
        if connection is None:
            if entry.kind not in self._typestore.fielddefs:
                self._define(entry.kind)
            with self._told():
                connection = self._writer.add_connection(entry.topic, entry.kind, typestore=self._typestore)
            self._connections[entry.topic] = connection
        with self._told():
            self._writer.write(connection, entry.time, entry.cdr)

    def close(self) -> None:
        """Write what is left.

        Raises:
            FlatsatError: the bag cannot be written.
        """
        with self._told():
            self._writer.close()

    def _define(self, kind: str) -> None:
        """Take the types of a package from where it is installed.

        Raises:
            LookupError: there are no such definitions.
        """
        from ament_index_python import get_package_share_directory
        from rosbags.typesys import TypesysError, get_types_from_msg

        package = kind.partition("/")[0]
        try:
            folder = Path(get_package_share_directory(package), "msg")
            found: dict[str, Any] = {}
            for file in folder.glob("*.msg"):
                found |= get_types_from_msg(file.read_text(encoding="utf-8"), f"{package}/msg/{file.stem}")
            self._typestore.register(
                {name: fields for name, fields in found.items() if name not in self._typestore.types}
            )
        except (LookupError, OSError, ValueError, TypesysError) as error:
            raise LookupError(f"the definition of {kind} is not to be had: {one_line(str(error))}") from error
        if kind not in self._typestore.fielddefs:
            raise LookupError(f"the definition of {kind} is not in {folder}")

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Refuse in one line what rosbags cannot write."""
        from rosbags.rosbag2 import WriterError

        try:
            yield
        except (WriterError, OSError) as error:
            raise unwritable(self._folder, error) from error


def write_bag(folder: Path, recorded: Sequence[Recorded]) -> None:
    """Write messages into an MCAP bag, replacing the folder; a failure leaves the old one.

    Raises:
        FlatsatError: rosbags is not installed, or the bag cannot be written.
    """
    # rosbags names the file after the folder it is written to: same name, one level down
    partial = folder.parent / ".part" / folder.name
    try:
        shutil.rmtree(partial.parent, ignore_errors=True)
        partial.parent.mkdir(parents=True)
        writer = BagWriter(partial)
        for entry in recorded:
            writer.write(entry)
        writer.close()
        shutil.rmtree(folder, ignore_errors=True)
        partial.rename(folder)
        partial.parent.rmdir()
    except OSError as error:
        raise unwritable(folder, error) from error
