"""mocap_player: a recording comes out as it was recorded, and the controller survives what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from flatsat_ros.flight.modes import Mode
from flatsat_ros.identification.recording import COLUMNS
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.bag import Recorded, write_bag

if TYPE_CHECKING:
    from conftest import Lab

    Column = Any

EPOCH = 1_700_000_000.0
LEVEL_TIME = 1.0


def faulty_recording() -> np.ndarray:
    """A drone that hovers at 1 m before a motion capture system with every fault seen in real ones, rows as COLUMNS."""
    rows = []
    t = 0.0
    for step in range(300):
        rows.append([t, 0.1 * np.sin(t), 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
        if step % 7 == 3:
            rows.append([t + 0.00013, *rows[-1][1:]])  # a burst
        t += 0.01
        if step == 120:
            t += 0.6
        if step == 220:
            t += 2.0 + LEVEL_TIME  # a hole in which the motors are cut
    rows[40] = rows[39].copy()  # a duplicate
    rows[50], rows[51] = rows[51], rows[50]  # out of order
    rows[60][4:] = 4 * [np.nan]
    rows[70][1] += 0.5  # a jump
    rows[71][1:4] = 3 * [np.nan]
    return np.array(rows)


def write_csv(file: Path, rows: np.ndarray) -> Path:
    lines = [",".join(COLUMNS), *(",".join(map(repr, [EPOCH + t, *pose])) for t, *pose in rows.tolist())]
    file.write_text("\n".join(lines) + f"\n{EPOCH + 99.0},0.1,0.", encoding="utf-8")
    return file


def stamps(poses: list[Any]) -> np.ndarray:
    return np.array([messages.nanoseconds_from_stamp(pose.header.stamp) for pose in poses])


def numbers(poses: list[Any]) -> np.ndarray:
    """Position and quaternion, (M, 7)."""
    parts = [(pose.pose.position, pose.pose.orientation) for pose in poses]
    return np.array([[p.x, p.y, p.z, q.x, q.y, q.z, q.w] for p, q in parts])


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_recording_is_played_in_its_order_with_its_own_stamps(lab: Lab, tmp_path: Path, rate: float) -> None:
    rows = faulty_recording()[:150]  # with the gap of 0.6 s
    player = lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", rows), rate=rate)
    poses = lab.watch(interfaces.POSE, "cf1")
    player.expected = True
    lab.wait(lambda: player.returncode is not None, "the end of the recording")
    assert player.returncode == 0
    lab.wait(lambda: len(poses) >= len(rows), "all poses")
    assert np.array_equal(numbers(poses), rows[:, 1:], equal_nan=True)
    # a Unix time in a float leaves a quarter of a microsecond
    assert stamps(poses) - stamps(poses)[0] == pytest.approx(rows[:, 0] * 1e9 / rate, abs=300)
    assert f"line {len(rows) + 2} breaks off" in player.output


def test_no_pose_comes_before_its_stamp(lab: Lab, tmp_path: Path) -> None:
    rows = faulty_recording()[:100]
    early: list[float] = []

    def take(pose: Any) -> None:
        early.append(messages.nanoseconds_from_stamp(pose.header.stamp) - lab.node.get_clock().now().nanoseconds)

    lab.node.create_subscription(interfaces.POSE.kind, "cf1/pose", take, 1000)
    lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", rows)).expected = True
    lab.wait(lambda: len(early) >= len(rows), "all poses")
    assert max(early) <= 0.0


def test_a_loop_begins_again_with_new_stamps(lab: Lab, tmp_path: Path) -> None:
    rows = faulty_recording()[:30]
    player = lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", rows), loop=True, robot_name="cf7")
    poses = lab.watch(interfaces.POSE, "cf7")
    lab.wait(lambda: len(poses) >= 3 * len(rows), "three rounds")
    assert np.array_equal(numbers(poses)[: 3 * len(rows)], np.tile(rows[:, 1:], (3, 1)))
    assert (np.diff(stamps(poses)) > 0).all()
    assert player.stop() == 0


def test_a_bag_is_played_too(lab: Lab, tmp_path: Path) -> None:
    rows = faulty_recording()[:30]
    poses = lab.watch(interfaces.POSE, "cf1")
    recorded = []
    for topic, offset in (("/lab/cf1/pose", 0.0), ("/lab/cf2/pose", 5.0)):
        for row in rows:
            pose = interfaces.POSE.kind()
            messages.fill_pose(pose, round((EPOCH + row[0]) * 1e9), row[1:4] + offset, row[4:])
            data = serialize_message(pose)
            recorded.append(Recorded(round((EPOCH + row[0]) * 1e9), topic, "geometry_msgs/msg/PoseStamped", data))
    write_bag(tmp_path / "bag", sorted(recorded, key=lambda entry: entry.time))
    lab.start("mocap_player", file=tmp_path / "bag", topic="/lab/cf2/pose").expected = True
    lab.wait(lambda: len(poses) >= len(rows), "all poses")
    assert numbers(poses)[:, :3] == pytest.approx(rows[:, 1:4] + 5.0)
    assert stamps(poses) - stamps(poses)[0] == pytest.approx(rows[:, 0] * 1e9, abs=300)


def test_the_controller_survives_every_fault(lab: Lab, tmp_path: Path, column: Column) -> None:
    commands, telemetry = lab.watch(interfaces.COMMAND, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    status = lab.watch_diagnostics("flatsat_controller: cf1")
    controller = lab.fly("cf1", level_time=LEVEL_TIME, pose_timeout=0.3)
    lab.go_to("cf1", (0.5, 0.0, 1.0), linked=False)
    player = lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", faulty_recording()))
    player.expected = True
    lab.wait(lambda: player.returncode is not None, "the end of the recording")
    assert player.returncode == 0
    ends = len(status)
    lab.wait(lambda: len(status) > ends and telemetry, "a last report")
    lab.wait(lambda: column(telemetry[-1:], "mode")[0] == Mode.CUT, "the end of the descent")
    # the gap levels the drone, the hole lets it sink until the motors stop, and without a new goal they rest
    modes = [Mode(int(mode)) for mode in column(telemetry, "mode")]
    changes = [mode for before, mode in zip([None, *modes], modes, strict=False) if mode is not before]
    assert changes[-2:] == [Mode.DESCEND, Mode.CUT]
    assert changes.count(Mode.FLY) >= 2
    assert Mode.UNLOCK not in changes
    assert int({pair.key: pair.value for pair in status[-1].values}["poses refused"]) >= 4
    assert controller.stop() == 0
    lab.require_within_limits(commands)
    assert "Traceback" not in controller.output
