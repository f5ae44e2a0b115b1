"""A flight read from any ROS 2 bag, MCAP or SQLite, with rosbags: no ROS is needed, and no topic must be there.

What is known by its type: poses of several kinds, the set-points of crazyswarm2, our telemetry, batteries, lines of the
log, and what our controller says of itself. All times are those at which the messages were recorded: stamps of several
machines need not agree. Those of poses are kept beside them.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flatsat_ros.base.errors import FlatsatError, one_line
from flatsat_ros.base.files import check_folder, check_regular, located, unreadable
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.flight import (
    COMMAND_FIELDS,
    POSE_FIELDS,
    Channel,
    Flight,
    LoggedEvent,
    Track,
    with_mode_events,
)

_NANOSECONDS = 1e9
MESSAGES = 5_000_000  # more are not read
_SEVERITIES = {10: "info", 20: "info", 30: "warning", 40: "error", 50: "error"}
# poses that are wishes, not measurements
_WISHES = ("goal_pose", "cmd_position", "target", "setpoint")

# crazyswarm2's motion capture: what a bag may hold without saying what it is
NAMED_POSES = "motion_capture_tracking_interfaces/msg/NamedPoseArray"
_NAMED_POSE = NAMED_POSES.removesuffix("Array")
_DEFINITIONS = {
    _NAMED_POSE: "string name\ngeometry_msgs/Pose pose\n",
    NAMED_POSES: f"std_msgs/Header header\n{_NAMED_POSE.replace('/msg', '')}[] poses\n",
}


class BodyPose(NamedTuple):
    """One body in one message.

    Attributes:
        stamp: ns, of its header.
        name: of the body; empty where the topic tells whose pose it is.
        values: position, m, and quaternion x, y, z, w, body -> world.
    """

    stamp: int
    name: str
    values: tuple[float, ...]


# what a message says: a channel's kind, a robot's name below its topic (empty: the topic's own), the values
Sample = tuple[str, str, tuple[Any, ...]]


def read_flight(path: Path, progress: Callable[[Iterable[Any], int], Iterable[Any]] = lambda items, _: items) -> Flight:
    """Read all that can be shown out of a bag.

    Args:
        path: the bag's folder, or its .mcap or .db3 file.
        progress: wraps the messages, of which there are as many as its second argument says.

    Returns:
        The flight; its times count from the first message that is shown.

    Raises:
        FlatsatError: rosbags is not installed, the bag cannot be read, or nothing in it can be shown.
    """
    collected = _Collected()
    with opened(path) as reader:
        shown = [each for each in reader.connections if each.msgtype in reader.typestore.fielddefs]
        shown = [each for each in shown if _reader_of(each) is not None]
        count = sum(connection.msgcount for connection in shown)
        if count > MESSAGES:
            raise located(path, f"it has {count} messages that can be shown, at most {MESSAGES} are read")
        # without a choice of connections, all messages would come
        for connection, time, raw in progress(reader.messages(shown), count) if shown else ():
            read = _reader_of(connection)
            assert read is not None
            collected.add(time, connection.topic, read(reader.deserialize(raw, connection.msgtype)))
        flight = collected.flight(f"{path.resolve().parent.name}/{path.name}")
    if not flight.tracks:
        kinds = ", ".join(sorted({kind.rpartition("/")[2] for kind in READERS}))
        raise located(path, f"nothing in it can be shown: it has no poses or set-points of drones; known are {kinds}")
    return flight


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a bag, and refuse in one line what is found to be wrong with it until it is closed.

    Types are known as the bag defines them, and those of ROS 2 Jazzy and motion_capture_tracking without that.

    Args:
        path: the bag's folder, or its .mcap or .db3 file.

    Yields:
        The `rosbags.highlevel.AnyReader`.

    Raises:
        FlatsatError: rosbags is not installed, or the bag cannot be read.
    """
    try:
        from rosbags.highlevel import AnyReader
    except ImportError as error:
        raise unreadable(path, "a bag needs rosbags, pip install rosbags") from error
    _check_bag(path)
    try:
        known = known_types()
        with AnyReader([path], default_typestore=known) as reader:
            if any(connection.msgtype not in reader.typestore.fielddefs for connection in reader.connections):
                defined = reader.typestore.fielddefs
                reader.typestore.register({k: v for k, v in known.fielddefs.items() if k not in defined})
            yield reader
    except FlatsatError:
        raise
    except Exception as error:  # a damaged bag lets errors of a dozen kinds escape from rosbags and what it stands on
        text = one_line(str(error), 150)
        reason = text if " " in text else f"{type(error).__name__} {text}".strip()  # a key alone says nothing
        raise unreadable(path, f"{reason}; if it is damaged, {_remedy(path)} may help") from error


def known_types() -> Any:
    """Return rosbags' store of the types that need no definition: those of ROS 2 Jazzy and motion_capture_tracking."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    known = get_typestore(Stores.ROS2_JAZZY)
    for name, definition in _DEFINITIONS.items():
        known.register(get_types_from_msg(definition, name))
    return known


def _check_bag(path: Path) -> None:
    """Refuse what rosbags would wait for or choke on: pipes and devices, and metadata that are not strictly YAML."""
    if not path.is_dir():
        check_regular(path)
        return
    check_folder(path)
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        raise unreadable(path, "it has no metadata.yaml: must be a bag; ros2 bag reindex writes one that was lost")
    read_yaml(metadata)


def _remedy(path: Path) -> str:
    """Return what saves messages out of a bag that was not closed or is damaged, by the kind of its file."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    kinds = {file.suffix for file in files}
    return "mcap recover" if ".mcap" in kinds else "sqlite3 FILE .recover" if ".db3" in kinds else "ros2 bag reindex"


def _pose(pose: Any) -> tuple[float, ...]:
    place, turn = pose.position, pose.orientation
    return (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * int(_NANOSECONDS) + int(header.stamp.nanosec)


def _transforms(message: Any) -> list[BodyPose]:
    seen: list[BodyPose] = []
    for entry in message.transforms:
        place, turn = entry.transform.translation, entry.transform.rotation
        values = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        seen.append(BodyPose(_stamp(entry.header), str(entry.child_frame_id), values))
    return seen


# by message type: the poses in a message
POSE_READERS: Mapping[str, Callable[[Any], list[BodyPose]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: [BodyPose(_stamp(m.header), "", _pose(m.pose))],
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: [BodyPose(_stamp(m.header), "", _pose(m.pose.pose))],
    "nav_msgs/msg/Odometry": lambda m: [BodyPose(_stamp(m.header), "", _pose(m.pose.pose))],
    "tf2_msgs/msg/TFMessage": _transforms,
    NAMED_POSES: lambda m: [BodyPose(_stamp(m.header), str(entry.name), _pose(entry.pose)) for entry in m.poses],
}


def _telemetry(message: Any) -> list[Sample]:
    labels = message.layout.dim[0].label.split(",") if message.layout.dim else []
    row = dict(zip((label.strip() for label in labels), message.data.tolist(), strict=False))
    return [("tick", "", tuple(row.get(name, np.nan) for name in FIELDS))] if "mode" in row else []


def _shown(read: Callable[[Any], list[BodyPose]]) -> Callable[[Any], list[Sample]]:
    """Return what makes samples of the poses in a message, the stamp, ns, behind their values."""
    return lambda message: [("pose", seen.name, (*seen.values, seen.stamp)) for seen in read(message)]


# by message type: the samples in a message
READERS: Mapping[str, Callable[[Any], list[Sample]]] = {
    **{kind: _shown(read) for kind, read in POSE_READERS.items()},
    "geometry_msgs/msg/Twist": lambda m: [("command", "", (m.linear.y, m.linear.x, m.angular.z, m.linear.z))],
    "std_msgs/msg/Float64MultiArray": _telemetry,
    "sensor_msgs/msg/BatteryState": lambda m: [("battery", "", (m.voltage,))],
    "crazyflie_interfaces/msg/Status": lambda m: [("battery", "", (m.battery_voltage,))],
    "rcl_interfaces/msg/Log": lambda m: [("log", str(m.name), (m.level, m.msg))],
    "std_msgs/msg/String": lambda m: [("setup", "", (m.data,))],
}
# which topics of a type are meant, by the end of their names; all where nothing stands here
_ENDINGS = {
    "geometry_msgs/msg/Twist": "cmd_vel_legacy",
    "std_msgs/msg/Float64MultiArray": "flatsat/telemetry",
    "std_msgs/msg/String": "flatsat/setup",
}
_FIELDS = {"pose": POSE_FIELDS, "command": COMMAND_FIELDS, "tick": FIELDS, "battery": ("voltage",)}


def _reader_of(connection: Any) -> Callable[[Any], list[Sample]] | None:
    """Return what reads the messages of a connection, None for one that is not shown."""
    topic, kind = connection.topic, connection.msgtype
    if not topic.endswith(_ENDINGS.get(kind, "")) or topic.rpartition("/")[2] in _WISHES:
        return None
    return READERS.get(kind)


class _Collected:
    """The samples of a bag so far."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, str, str], list[tuple[float, ...]]] = defaultdict(list)
        self._log: list[tuple[int, str, str]] = []
        self._setup: dict[str, object] = {}
        self._begin: int | None = None

    def add(self, time: int, topic: str, samples: list[Sample]) -> None:
        """Take in the samples of one message, recorded at a time, ns."""
        if self._begin is None:
            self._begin = time
        seconds = (time - self._begin) / _NANOSECONDS
        for kind, name, values in samples:
            if kind == "log":
                self._log.append((time, _SEVERITIES.get(values[0], "info"), f"{name}: {values[1]}"))
            elif kind == "setup":
                self._setup |= _setup_of(values[0])
            elif kind == "pose":
                # a stamp of 0 is none
                stamp = (values[-1] - self._begin) / _NANOSECONDS if values[-1] else seconds
                self._samples[kind, topic, name].append((seconds, *values[:-1], stamp))
            else:
                self._samples[kind, topic, name].append((seconds, *values))

    def flight(self, title: str) -> Flight:
        """Return what was collected."""
        tracks: dict[str, dict[str, Channel]] = defaultdict(dict)
        notes = []
        for (kind, topic, name), rows in sorted(self._samples.items()):
            drone = name or _drone_of(topic, kind)
            if kind in tracks[drone]:
                notes.append(f"{drone}: there are several sources of {kind}; {topic} is not shown.")
                continue
            samples = np.array(rows, dtype=np.float64)
            samples = samples[np.argsort(samples[:, 0], kind="stable")]
            stamps = samples[:, -1] if kind == "pose" else None
            tracks[drone][kind] = Channel(_FIELDS[kind], samples[:, : 1 + len(_FIELDS[kind])], stamps)
        common = _common_prefix(list(tracks))
        short = {drone: drone[len(common) :].strip("/") or drone for drone in sorted(tracks)}
        named = [Track(name, tracks[drone]) for drone, name in short.items()]
        notes += [
            f"{track.name}: no {word} was recorded."
            for track in named
            for kind, word in (("pose", "pose"), ("tick", "telemetry of this controller"))
            if kind not in track.channels
        ]
        begin = self._begin or 0
        events = [
            LoggedEvent((time - begin) / _NANOSECONDS, _drone_named(text, named), severity, text)
            for time, severity, text in self._log
        ]
        return with_mode_events(Flight(title, named, events, self._setup, notes))


def _drone_of(topic: str, kind: str) -> str:
    """Return the name of the drone that a topic belongs to."""
    parts = topic.strip("/").split("/")
    dropped = 2 if kind == "tick" else 1
    return "/".join(parts[:-dropped]) or parts[0]


def _common_prefix(names: list[str]) -> str:
    """Return the namespace, with its slash, below which all names are; empty for none."""
    spaces = {name.rpartition("/")[0] for name in names}
    return f"{spaces.pop()}/" if len(spaces) == 1 and all("/" in name for name in names) else ""


def _drone_named(text: str, tracks: list[Track]) -> str:
    """Return whose a line of the log is: of `node: drone: what happened`."""
    words = text.split(": ")
    names = {track.name for track in tracks}
    return words[1] if len(words) > 2 and words[1] in names else ""


def _setup_of(text: str) -> dict[str, object]:
    """Return what our controller says of itself; nothing from a text of another kind."""
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
