"""Recorded flights: whatever of a bag's messages is read becomes a page, and its times are finite."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.bag import read_flight
from flatsat_ros.viewing.flight import Flight
from flatsat_ros.viewing.page import encode
from fuzzing.cdr import poses
from fuzzing.damage import FLOATS, corrupted
from fuzzing.kind import of_file

_STORE = get_typestore(Stores.ROS2_JAZZY)
_T = _STORE.types
_TEXTS = st.sampled_from(
    ["", "{}", "[]", "null", "NaN", "1e999", '{"robot_names": null}', '{"thrust_max": NaN, "x": [1e400]}', "[" * 20_000,
     '{"a": ' * 300 + "1" + "}" * 300, "9" * 5000, '{"thrust_max": "high", "1": {}}', "\u2028</script>", "cf1: cf1: x"]
)  # fmt: skip


def _serialised(message: object, kind: str) -> bytes:
    return bytes(_STORE.serialize_cdr(message, kind))


def _telemetry(values: list[float], label: str) -> bytes:
    dimension = _T["std_msgs/msg/MultiArrayDimension"](label, len(values), len(values))
    layout = _T["std_msgs/msg/MultiArrayLayout"]([dimension], 0)
    kind = "std_msgs/msg/Float64MultiArray"
    return _serialised(_T[kind](layout, np.array(values)), kind)


def _twist(values: list[float]) -> bytes:
    vector, kind = _T["geometry_msgs/msg/Vector3"], "geometry_msgs/msg/Twist"
    return _serialised(_T[kind](vector(*values[:3]), vector(*values[3:6])), kind)


def _log(text: str) -> bytes:
    time, kind = _T["builtin_interfaces/msg/Time"](0, 0), "rcl_interfaces/msg/Log"
    return _serialised(_T[kind](time, 40, "controller", text, "", "", 0), kind)


def _string(text: str) -> bytes:
    return _serialised(_T["std_msgs/msg/String"](text), "std_msgs/msg/String")


_NUMBERS = st.lists(FLOATS, min_size=6, max_size=6)
_MESSAGES = {
    ("/cf1/pose", "geometry_msgs/msg/PoseStamped"): poses(),
    ("/cf1/cmd_vel_legacy", "geometry_msgs/msg/Twist"): _NUMBERS.map(_twist),
    ("/cf1/flatsat/telemetry", "std_msgs/msg/Float64MultiArray"): st.builds(
        _telemetry, st.lists(FLOATS, max_size=len(FIELDS) + 1), st.sampled_from([",".join(FIELDS), "mode", "", "a,b"])
    ),
    ("/flatsat/setup", "std_msgs/msg/String"): _TEXTS.map(_string),
    ("/rosout", "rcl_interfaces/msg/Log"): _TEXTS.map(_log),
}


@st.composite
def _bags(draw: st.DrawFn) -> bytes:
    """A bag of a few messages, of which some are damaged."""
    times = st.sampled_from([0, 1, 10**9, 2**62, 2**63 - 1])
    with tempfile.TemporaryDirectory(prefix="flatsat_ros-fuzz-") as folder:
        bag = Path(folder, "bag")
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics: dict[tuple[str, str], Connection] = {}
            key = draw(st.sampled_from(list(_MESSAGES)))  # few definitions of types, of which each takes its time
            for _ in range(draw(st.integers(1, 4))):
                data = draw(_MESSAGES[key])
                data = draw(corrupted(data)) if draw(st.integers(0, 3)) == 3 else data
                topics[key] = topics.get(key) or writer.add_connection(*key, typestore=_STORE)
                writer.write(topics[key], draw(times), data)
        return (bag / "bag.mcap").read_bytes()


def _law(flight: Flight) -> None:
    assert flight.tracks
    assert np.isfinite(flight.duration)
    for track in flight.tracks:
        for channel in track.channels.values():
            assert channel.samples.shape[1] == 1 + len(channel.fields)
            assert (np.diff(channel.times) >= 0.0).all()
    assert all(np.isfinite(event.time) for event in flight.events)
    assert encode(flight)


FLIGHT = of_file(_bags(), read_flight, _law, "flight.mcap")
