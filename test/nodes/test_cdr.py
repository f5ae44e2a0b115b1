"""Messages read from their bytes: what comes back is what was written, and whatever else comes is refused by name."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Quaternion, Transform, Twist, Vector3
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.ros import cdr, messages
from flatsat_ros.nodes.ros.messages import NANOSECONDS

pytestmark = pytest.mark.in_process

NUMBERS = st.floats(allow_nan=False)
STAMPS = st.integers(0, 2**31 * NANOSECONDS - 1)


def pose(stamp: int, values: Sequence[float], frame: str = "world") -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    messages.fill_pose(message, stamp, values[:3], values[3:])
    return message


def goal(values: Sequence[float]) -> Trajectory:
    return cdr.setpoint_from_cdr(serialize_message(pose(0, values)))


@given(STAMPS, st.lists(NUMBERS, min_size=7, max_size=7), st.integers(0, 20))
def test_a_pose_read_from_its_bytes_is_the_pose_that_was_written(stamp: int, values: list[float], length: int) -> None:
    data = serialize_message(pose(stamp, values, "w" * length))
    assert cdr.pose_from_cdr(data) == (stamp, tuple(values[:3]), tuple(values[3:]))
    assert cdr.frame_from_cdr(data) == b"w" * length


@given(STAMPS, st.lists(NUMBERS, min_size=7, max_size=7), st.integers(0, 20))
def test_a_pose_of_a_big_endian_machine_is_read_too(stamp: int, values: list[float], length: int) -> None:
    body = struct.pack(">iII", *divmod(stamp, NANOSECONDS), length + 1) + b"w" * length + b"\0"
    body += bytes(-len(body) % 8) + struct.pack(">7d", *values)
    assert cdr.pose_from_cdr(b"\0\0\0\0" + body) == (stamp, tuple(values[:3]), tuple(values[3:]))
    assert cdr.frame_from_cdr(b"\0\0\0\0" + body) == b"w" * length


def test_values_that_are_not_a_number_survive_the_bytes() -> None:
    _, position, quaternion = cdr.pose_from_cdr(serialize_message(pose(1, [math.nan, math.inf, 0.0] + 4 * [math.nan])))
    assert np.array_equal([*position, *quaternion], [math.nan, math.inf, 0.0] + 4 * [math.nan], equal_nan=True)


def test_no_shorter_piece_of_a_pose_is_taken_for_one() -> None:
    data = serialize_message(pose(1, 7 * [1.0]))
    for length in range(len(data)):
        with pytest.raises(FlatsatError, match=f"{length} bytes are not a serialised PoseStamped"):
            cdr.pose_from_cdr(data[:length])


@given(st.binary(max_size=100))
def test_no_bytes_make_a_pose_or_a_goal_fail_otherwise_than_by_refusal(body: bytes) -> None:
    for data in (body, b"\0\1\0\0" + body, b"\0\1\0\0" + bytes(8) + b"\6\0\0\0world\0" + body):
        for read in (cdr.pose_from_cdr, cdr.setpoint_from_cdr, lambda d: cdr.require_frame(d, b"world")):
            with suppress(FlatsatError):
                read(data)
        assert len(cdr.frame_from_cdr(data)) < 256


@pytest.mark.parametrize("frame", ["", "world"])
def test_the_world_and_no_frame_at_all_are_the_world(frame: str) -> None:
    cdr.require_frame(serialize_message(pose(0, 7 * [0.0], frame)), b"world")


@pytest.mark.parametrize("frame", ["map", "worl", "world2", "World", "x" * 300])
def test_another_frame_is_refused_with_its_name(frame: str) -> None:
    with pytest.raises(FlatsatError, match=rf"frame_id = '{frame[:20]}.*: must be 'world' or empty"):
        cdr.require_frame(serialize_message(pose(0, 7 * [0.0], frame)), b"world")


def test_a_message_that_is_much_too_long_is_refused_by_its_length() -> None:
    data = serialize_message(pose(0, 7 * [0.0], "w" * 10_000_000))
    with pytest.raises(FlatsatError, match=f"length of the message = {len(data)} bytes: must be at most 1024"):
        cdr.require_short(data)
    cdr.require_short(serialize_message(pose(0, 7 * [0.0], "w" * 255)))


@given(st.floats(-math.pi, math.pi), st.floats(0.9 + 1e-12, 1.1 - 1e-12))
def test_yaw_survives_its_quaternion_of_about_unit_length(yaw: float, length: float) -> None:
    q = messages.quaternion_from_yaw(yaw)
    back = cdr.yaw_from_quaternion(q.x * length, q.y * length, q.z * length, q.w * length)
    assert math.remainder(back - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_yaw_of_a_tilted_drone_is_that_of_its_heading() -> None:
    # Rz(0.5) Ry(0.3)
    sin, cos = math.sin, math.cos
    tilted = (-sin(0.25) * sin(0.15), cos(0.25) * sin(0.15), sin(0.25) * cos(0.15), cos(0.25) * cos(0.15))
    assert cdr.yaw_from_quaternion(*tilted) == pytest.approx(0.5)


def test_an_orientation_that_was_left_unset_means_yaw_0() -> None:
    assert cdr.yaw_from_quaternion(0.0, 0.0, 0.0, 0.0) == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200, -1e308, 5e-324, 0.89, -1.11])
def test_an_orientation_of_another_length_is_refused(bad: float) -> None:
    with pytest.raises(FlatsatError, match=r"orientation = .*must be of length 1 \+- 0.1, or left at zeros"):
        goal([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, bad])


def test_a_goal_is_held_for_ever() -> None:
    held = goal([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    assert held.sample(1e6).tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert held.yaw == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1.7e308, 1e5])
def test_a_goal_that_is_not_in_this_world_is_refused(bad: float) -> None:
    with pytest.raises(FlatsatError, match=r"position = .* m: must be within 10000 m"):
        goal([1.0, bad, 3.0, 0.0, 0.0, 0.0, 1.0])


POINTS = st.lists(st.floats(-5.0, 5.0), min_size=9, max_size=9)
# s; whole milliseconds, which the message's nanoseconds hold exactly: in a fast leg a nanosecond more would show
DURATIONS = st.integers(100, 5000).map(lambda milliseconds: milliseconds / 1000.0)
NAMES = st.text("abc", max_size=9)


@given(
    st.lists(st.tuples(DURATIONS, POINTS), max_size=4),
    st.floats(-3.0, 3.0),
    st.integers(0, 10**9 * NANOSECONDS),
    NAMES,
    st.lists(NAMES, max_size=1),
)
def test_a_trajectory_survives_its_message(
    legs: list[tuple[float, list[float]]], yaw: float, origin: int, frame: str, joints: list[str]
) -> None:
    times = np.concatenate([[0.0], np.cumsum([duration for duration, _ in legs])])
    points = np.array([[1.0, 2.0, 3.0] + 6 * [0.0]] + [point for _, point in legs])
    points[-1, 3:] = 0.0
    path = Trajectory.through(times, points[:, :3], points[:, 3:6], points[:, 6:], yaw)

    start = origin + 3 * NANOSECONDS
    message = messages.message_from_trajectory(path, start)
    message.header.frame_id, message.joint_names = frame, joints
    data = serialize_message(message)
    back = cdr.trajectory_from_cdr(data, now=origin, origin=origin)
    assert back.yaw == pytest.approx(yaw, abs=1e-9)
    assert back.times == pytest.approx(times + 3.0, abs=1e-12)
    for t in np.linspace(-0.5, times[-1] + 0.5, 20):
        assert back.sample(t + 3.0) == pytest.approx(path.sample(t), abs=1e-5)
    assert cdr.frame_from_cdr(data) == frame.encode()


class Writer:
    """Plain CDR, written field by field."""

    def __init__(self, order: str) -> None:
        self._order, self.body = order, bytearray()

    def put(self, form: str, *values: float) -> None:
        for value in values:
            self.body += bytes(-len(self.body) % struct.calcsize(form)) + struct.pack(self._order + form, value)

    def text(self, text: bytes) -> None:
        self.put("I", len(text) + 1)
        self.body += text + b"\0"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("joints", [[], [b"base"], [b"link"], [b"abcdefgh"]])
@pytest.mark.parametrize("frame", [b"", b"abc", b"abcd", b"world"])
def test_a_trajectory_is_read_however_its_fields_are_aligned(order: str, joints: list[bytes], frame: bytes) -> None:
    writer = Writer(order)
    writer.put("i", 7)
    writer.put("I", 500_000_000)
    writer.text(frame)
    writer.put("I", len(joints))
    for joint in joints:
        writer.text(joint)
    writer.put("I", 2)
    for x, v, sec, nanosec in ((1.0, 0.5, 0, 0), (2.0, 0.0, 1, 250_000_000)):
        writer.put("I", 1)
        writer.put("d", x, 2.0, 3.0, 0.0, 0.0, math.sin(0.2), math.cos(0.2))
        writer.put("I", 1)
        writer.put("d", v, 0.0, 0.0, 9.0, 9.0, 9.0)
        writer.put("I", 1)
        writer.put("d", 0.0, v, 0.0, 9.0, 9.0, 9.0)
        writer.put("i", sec)
        writer.put("I", nanosec)
    data = (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + bytes(writer.body)
    path = cdr.trajectory_from_cdr(data, now=7 * NANOSECONDS, origin=0)
    assert path.times.tolist() == [7.5, 8.75]
    assert path.sample(7.5).tolist() == [1.0, 2.0, 3.0, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0]
    assert path.end == pytest.approx([2.0, 2.0, 3.0])
    assert path.yaw == pytest.approx(0.4)
    for length in range(4, len(data)):
        with pytest.raises(FlatsatError):
            cdr.trajectory_from_cdr(data[:length], now=7 * NANOSECONDS, origin=0)


def test_a_trajectory_without_a_stamp_starts_now() -> None:
    data = serialize_message(messages.message_from_trajectory(Trajectory.hold([0.0, 0.0, 1.0]), 0))
    assert cdr.trajectory_from_cdr(data, now=9_500_000_000, origin=2_000_000_000).times.tolist() == [7.5]


def point(**changes: object) -> MultiDOFJointTrajectoryPoint:
    parts = {"transforms": [Transform()], "velocities": [Twist()], "accelerations": [Twist()]}
    return MultiDOFJointTrajectoryPoint(**{**parts, **changes})


def read(points: list[MultiDOFJointTrajectoryPoint], **fields: object) -> Trajectory:
    message = MultiDOFJointTrajectory(points=points, **fields)
    return cdr.trajectory_from_cdr(serialize_message(message), now=1, origin=0)


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        ([], "number of points = 0: must be 1 to 2000"),
        ([point(velocities=[])], "number of velocities of point 0 = 0: must be 1, of one joint"),
        ([point(accelerations=[])], "number of accelerations of point 0 = 0"),
        ([point(transforms=[Transform(), Transform()])], "number of transforms of point 0 = 2"),
        ([point(), point(transforms=[])], "number of transforms of point 1 = 0"),
        ([point(), point()], "must be above the time before it"),
        ([point(velocities=[Twist(linear=Vector3(x=1.0))])], "velocity of the last point"),
        ([point(transforms=[Transform(translation=Vector3(z=math.nan))])], "position = nan m: must be within 10000 m"),
        ([point(transforms=[Transform(translation=Vector3(z=1e300))])], "position = 1e.300 m: must be within 10000 m"),
        ([point(velocities=[Twist(linear=Vector3(y=-math.inf))]), point()], "velocity = -inf m/s"),
        ([point(accelerations=[Twist(linear=Vector3(y=1e9))]), point()], "acceleration = 1000000000.0 m/s.2"),
        ([point(transforms=[Transform(rotation=Quaternion(w=math.inf))])], "must be of length 1"),
    ],
)
def test_a_trajectory_that_lacks_something_is_refused(points: list[MultiDOFJointTrajectoryPoint], reason: str) -> None:
    with pytest.raises(FlatsatError, match=reason):
        read(points)


def test_a_trajectory_of_several_joints_or_of_another_clock_is_refused() -> None:
    with pytest.raises(FlatsatError, match="number of joints = 2: must be 1"):
        read([point()], joint_names=["a", "b"])
    data = serialize_message(messages.message_from_trajectory(Trajectory.hold([0.0, 0.0, 1.0]), 10**9 * NANOSECONDS))
    with pytest.raises(FlatsatError, match=r"start of the trajectory minus now = 999999999.0 s: must be within 3600 s"):
        cdr.trajectory_from_cdr(data, now=NANOSECONDS, origin=0)


@pytest.mark.parametrize("claimed", [2001, 100_000, 2**32 - 1])
def test_too_many_points_are_refused_by_their_number_before_they_are_looked_at(claimed: int) -> None:
    data = bytearray(serialize_message(MultiDOFJointTrajectory(points=[point()])))
    at = data.index(struct.pack("<I", 1), 16)
    data[at : at + 4] = struct.pack("<I", claimed)
    with pytest.raises(FlatsatError, match=f"number of points = {claimed}: must be 1 to 2000"):
        cdr.trajectory_from_cdr(bytes(data), now=1, origin=0)


@given(st.binary(max_size=400), st.integers(0, 3))
def test_no_bytes_make_a_trajectory_fail_otherwise_than_by_refusal(body: bytes, count: int) -> None:
    start = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + b"\0\0\0\0" + bytes(4) + struct.pack("<I", count)
    for data in (body, b"\0\1\0\0" + body, start + body, start + struct.pack("<I", 1) + body):
        with suppress(FlatsatError):
            cdr.trajectory_from_cdr(data, now=1, origin=0)
