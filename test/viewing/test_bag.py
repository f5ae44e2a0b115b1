"""Bags of ours and of others become flights; what cannot be shown is refused in one line."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.cli.report import main
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.bag import read_flight

STORE = get_typestore(Stores.ROS2_JAZZY)
NAMED = "motion_capture_tracking_interfaces/msg/NamedPoseArray"
STORE.register(
    get_types_from_msg("string name\ngeometry_msgs/Pose pose\n", NAMED.replace("Array", ""))
    | get_types_from_msg(f"std_msgs/Header header\n{NAMED.replace('Array', '').replace('/msg', '')}[] poses\n", NAMED)
)
STATUS = "crazyflie_interfaces/msg/Status"
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nuint16 supervisor_info\nfloat32 battery_voltage\nuint8 pm_state\nuint8 rssi\n"
        "uint32 num_rx_broadcast\nuint32 num_tx_broadcast\nuint32 num_rx_unicast\nuint32 num_tx_unicast\n"
        "uint16 latency_unicast\n",
        STATUS,
    )
)
T = STORE.types


def stamp() -> Any:
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "world")


def pose(x: float) -> Any:
    place, turn = T["geometry_msgs/msg/Point"](x, 2.0, 3.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    return T["geometry_msgs/msg/Pose"](place, turn)


def stamped(x: float) -> Any:
    return T["geometry_msgs/msg/PoseStamped"](stamp(), pose(x))


def covered(x: float) -> Any:
    return T["geometry_msgs/msg/PoseWithCovariance"](pose(x), np.zeros(36))


def twist(roll: float) -> Any:
    vector = T["geometry_msgs/msg/Vector3"]
    return T["geometry_msgs/msg/Twist"](vector(-1.0, roll, 40000.0), vector(0.0, 0.0, 5.0))


def telemetry(**values: float) -> Any:
    label = T["std_msgs/msg/MultiArrayDimension"](",".join(FIELDS), len(FIELDS), len(FIELDS))
    row = np.array([values.get(name, 0.0) for name in FIELDS])
    return T["std_msgs/msg/Float64MultiArray"](T["std_msgs/msg/MultiArrayLayout"]([label], 0), row)


def transform(x: float, name: str) -> Any:
    place, turn = T["geometry_msgs/msg/Vector3"](x, 2.0, 3.0), T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    motion = T["geometry_msgs/msg/Transform"](place, turn)
    return T["tf2_msgs/msg/TFMessage"]([T["geometry_msgs/msg/TransformStamped"](stamp(), name, motion)])


def log(text: str) -> Any:
    time = T["builtin_interfaces/msg/Time"](0, 0)
    return T["rcl_interfaces/msg/Log"](time, 40, "controller", text, "", "", 0)


def write(folder: Path, messages: Iterable[tuple[str, Any]], plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """A bag with a message each 0.1 s."""
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for number, (topic, message) in enumerate(messages):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], 10**9 + number * 10**8, STORE.serialize_cdr(message, kind))
    return folder


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_flight_of_ours_is_read_as_it_was_recorded(tmp_path: Path, plugin: StoragePlugin) -> None:
    setup = T["std_msgs/msg/String"]('{"thrust_max": 14.2, "certificate": "mine"}')
    written = [
        ("/lab/flatsat/setup", setup),
        ("/lab/cf1/pose", stamped(1.0)),
        ("/lab/cf1/goal_pose", stamped(9.0)),
        ("/lab/cf1/flatsat/telemetry", telemetry(mode=0.0, gamma=1.5)),
        ("/lab/cf1/flatsat/telemetry", telemetry(mode=2.0, gamma=2.5)),
        ("/lab/cf1/cmd_vel_legacy", twist(3.0)),
        ("/lab/cf2/pose", stamped(2.0)),
        ("/rosout", log("cf1: land refused: the drone is in IDLE")),
    ]
    flight = read_flight(write(tmp_path / "bag", written, plugin))
    assert [track.name for track in flight.tracks] == ["cf1", "cf2"]
    first, second = flight.tracks
    np.testing.assert_allclose(first.channels["pose"].samples, [[0.1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]])
    np.testing.assert_allclose(first.channels["tick"].column("gamma"), [1.5, 2.5])
    np.testing.assert_allclose(first.channels["command"].samples, [[0.5, 3.0, -1.0, 5.0, 40000.0]])
    np.testing.assert_allclose(second.channels["pose"].column("x"), [2.0])
    assert flight.setup == {"thrust_max": 14.2, "certificate": "mine"}
    assert [(event.drone, event.text) for event in flight.events] == [
        ("cf1", "IDLE → FLY"),
        ("cf1", "controller: cf1: land refused: the drone is in IDLE"),
    ]
    assert flight.notes == ["cf2: no telemetry of this controller was recorded."]


def test_the_battery_is_read_from_either_topic(tmp_path: Path) -> None:
    state, unknown = T["sensor_msgs/msg/BatteryState"], np.empty(0, dtype=np.float32)
    own = state(stamp(), 3.9, *[0.0] * 6, 0, 0, 0, True, unknown, unknown, "", "")
    status = T[STATUS](stamp(), 0, 3.7, 0, 50, 1, 2, 3, 4, 5)
    flight = read_flight(
        write(tmp_path / "bag", [("/a/battery", own), ("/b/status", status), ("/b/pose", stamped(1.0))])
    )
    found = {track.name: track.channels["battery"].column("voltage").tolist() for track in flight.tracks}
    assert found == {"a": [pytest.approx(3.9)], "b": [pytest.approx(3.7)]}


def test_poses_of_others_come_in_many_forms(tmp_path: Path) -> None:
    entry = T[NAMED.replace("Array", "")]
    speed = T["geometry_msgs/msg/TwistWithCovariance"](twist(0.0), np.zeros(36))
    written = [
        ("/a/pose_cov", T["geometry_msgs/msg/PoseWithCovarianceStamped"](stamp(), covered(1.0))),
        ("/b/odom", T["nav_msgs/msg/Odometry"](stamp(), "b", covered(2.0), speed)),
        ("/tf", transform(3.0, "c")),
        ("/poses", T[NAMED](stamp(), [entry("d", pose(4.0)), entry("e", pose(5.0))])),
    ]
    flight = read_flight(write(tmp_path / "bag", written))
    found = {track.name: track.channels["pose"].column("x").tolist() for track in flight.tracks}
    assert found == {"a": [1.0], "b": [2.0], "c": [3.0], "d": [4.0], "e": [5.0]}


def test_a_second_source_of_the_same_drone_is_left_out_and_said(tmp_path: Path) -> None:
    flight = read_flight(write(tmp_path / "bag", [("/cf1/odometry", stamped(1.0)), ("/cf1/pose", stamped(2.0))]))
    assert len(flight.tracks) == 1
    assert flight.notes[0] == "cf1: there are several sources of pose; /cf1/pose is not shown."


def test_a_bag_without_drones_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "bag", [("/chatter", T["std_msgs/msg/String"]("hello"))])
    with pytest.raises(FlatsatError, match="nothing in it can be shown"):
        read_flight(folder)


def test_the_program_writes_the_page_beside_the_bag_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write(tmp_path / "flown", [("/cf1/pose", stamped(1.0)), ("/cf1/pose", stamped(1.1))])
    assert main([str(bag)]) == 0
    page = tmp_path / "flown.html"
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert str(page) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nowhere"], "nowhere"),
        ([".", "-o", "taken/x.html"], "taken"),
        ([], "the following arguments are required: BAG"),
    ],
)
def test_the_program_refuses_in_one_line(
    arguments: list[str],
    reason: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("error: ")
    assert reason in said
