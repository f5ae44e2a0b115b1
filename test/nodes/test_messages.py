"""Golden values and round trips of the one file that touches message fields."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Quaternion, Transform, Twist, Vector3
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import Backend, WireSetpoint, setpoint_from_command
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.ros import messages

NUMBERS = st.floats(allow_nan=False)
STAMPS = st.integers(0, 2**31 * messages.NANOSECONDS - 1)


def pose(stamp: int, values: list[float], frame: str = "world") -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    messages.fill_pose(message, stamp, values[:3], values[3:])
    return message


@given(STAMPS, st.lists(NUMBERS, min_size=7, max_size=7), st.integers(0, 20))
def test_a_pose_read_from_its_bytes_is_the_pose_that_was_written(stamp: int, values: list[float], length: int) -> None:
    data = serialize_message(pose(stamp, values, "w" * length))
    assert messages.pose_from_cdr(data) == (stamp, tuple(values[:3]), tuple(values[3:]))


@given(STAMPS, st.lists(NUMBERS, min_size=7, max_size=7), st.integers(0, 20))
def test_a_pose_of_a_big_endian_machine_is_read_too(stamp: int, values: list[float], length: int) -> None:
    body = struct.pack(">iII", *divmod(stamp, messages.NANOSECONDS), length + 1) + b"w" * length + b"\0"
    body += bytes(-len(body) % 8) + struct.pack(">7d", *values)
    assert messages.pose_from_cdr(b"\0\0\0\0" + body) == (stamp, tuple(values[:3]), tuple(values[3:]))


def test_values_that_are_not_a_number_survive_the_bytes() -> None:
    _, position, quaternion = messages.pose_from_cdr(
        serialize_message(pose(1, [math.nan, math.inf, 0.0] + 4 * [math.nan]))
    )
    assert np.array_equal([*position, *quaternion], [math.nan, math.inf, 0.0] + 4 * [math.nan], equal_nan=True)


def test_no_shorter_piece_of_a_pose_is_taken_for_one() -> None:
    data = serialize_message(pose(1, 7 * [1.0]))
    for length in range(len(data)):
        with pytest.raises(FlatsatError, match=f"{length} bytes are not a serialised PoseStamped"):
            messages.pose_from_cdr(data[:length])


@given(STAMPS)
def test_a_stamp_keeps_its_nanoseconds(nanoseconds: int) -> None:
    stamp = messages.stamp_from_nanoseconds(nanoseconds)
    assert 0 <= stamp.nanosec < messages.NANOSECONDS
    assert messages.nanoseconds_from_stamp(stamp) == nanoseconds


@pytest.mark.parametrize(
    ("u", "backend", "linear", "angular_z"),
    [
        # T m/s^2, phi, theta rad, yaw rate rad/s -> linear: pitch deg, roll deg, PWM; angular z: deg/s clockwise
        ((GRAVITY, math.pi / 18, 0.0, 0.0), "cpp", (0.0, 10.0, 38841.7753), 0.0),
        ((GRAVITY, 0.0, math.pi / 18, 0.0), "cpp", (10.0, 0.0, 38841.7753), 0.0),
        ((GRAVITY, 0.0, math.pi / 18, 0.0), "cflib", (-10.0, 0.0, 38841.7753), 0.0),
        ((GRAVITY, math.pi / 18, 0.0, 0.0), "cflib", (0.0, 10.0, 38841.7753), 0.0),
        ((GRAVITY, 0.0, 0.0, math.pi / 2), "cpp", (0.0, 0.0, 38841.7753), -90.0),
        ((0.0, 0.0, 0.0, 0.0), "cpp", (0.0, 0.0, 0.0), 0.0),
        ((30.0, 0.0, 0.0, 0.0), "cpp", (0.0, 0.0, 60000.0), 0.0),
    ],
)
def test_a_command_has_the_signs_and_units_of_the_link(
    u: tuple[float, float, float, float], backend: str, linear: tuple[float, float, float], angular_z: float
) -> None:
    vehicle = load_vehicle("cf21")
    message = Twist()
    messages.fill_command(message, setpoint_from_command(*u, 0.0, vehicle, Backend(backend)))
    assert (message.linear.x, message.linear.y) == pytest.approx(linear[:2], abs=1e-12)
    assert message.linear.z == pytest.approx(linear[2], abs=1e-3)
    assert message.angular.z == pytest.approx(angular_z)
    assert (message.angular.x, message.angular.y) == (0.0, 0.0)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_a_command_is_read_as_it_was_written(roll: float, pitch: float, yaw_rate: float, thrust: float) -> None:
    setpoint, message = WireSetpoint(roll, pitch, yaw_rate, thrust), Twist()
    messages.fill_command(message, setpoint)
    assert messages.command_from_message(message) == setpoint


@given(st.floats(-math.pi, math.pi))
def test_yaw_survives_its_quaternion(yaw: float) -> None:
    back = messages.yaw_from_quaternion(messages.quaternion_from_yaw(yaw))
    assert math.remainder(back - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_yaw_of_a_tilted_drone_is_that_of_its_heading() -> None:
    # Rz(0.5) Ry(0.3)
    sin, cos = math.sin, math.cos
    tilted = Quaternion(
        w=cos(0.25) * cos(0.15), x=-sin(0.25) * sin(0.15), y=cos(0.25) * sin(0.15), z=sin(0.25) * cos(0.15)
    )
    assert messages.yaw_from_quaternion(tilted) == pytest.approx(0.5)


def test_an_orientation_that_was_left_unset_means_yaw_0_and_one_that_is_not_finite_is_refused() -> None:
    assert messages.yaw_from_quaternion(Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)) == 0.0
    with pytest.raises(FlatsatError, match=r"orientation .*nan.*must be finite"):
        messages.yaw_from_quaternion(Quaternion(w=math.nan))


def test_a_goal_is_held_for_ever_and_must_be_finite() -> None:
    goal = messages.setpoint_from_goal(pose(0, [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]))
    assert goal.sample(1e6).tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert goal.yaw == 0.0
    with pytest.raises(FlatsatError, match="position"):
        messages.setpoint_from_goal(pose(0, [1.0, math.nan, 3.0, 0.0, 0.0, 0.0, 1.0]))


POINTS = st.lists(st.floats(-5.0, 5.0), min_size=9, max_size=9)
# s; whole milliseconds, which the message's nanoseconds hold exactly: in a fast leg a nanosecond more would show
DURATIONS = st.integers(100, 5000).map(lambda milliseconds: milliseconds / 1000.0)


@given(
    st.lists(st.tuples(DURATIONS, POINTS), min_size=1, max_size=4),
    st.floats(-3.0, 3.0),
    st.integers(0, 10**9 * messages.NANOSECONDS),
)
def test_a_trajectory_survives_its_message(legs: list[tuple[float, list[float]]], yaw: float, origin: int) -> None:
    times = np.concatenate([[0.0], np.cumsum([duration for duration, _ in legs])])
    points = np.array([[1.0, 2.0, 3.0] + 6 * [0.0]] + [point for _, point in legs])
    points[-1, 3:] = 0.0
    path = Trajectory.through(times, points[:, :3], points[:, 3:6], points[:, 6:], yaw)

    start = origin + 3 * messages.NANOSECONDS
    message = messages.message_from_trajectory(path, start)
    back = messages.trajectory_from_message(message, now=-1, origin=origin)
    assert back.yaw == pytest.approx(yaw, abs=1e-9)
    assert back.times == pytest.approx(times + 3.0, abs=1e-12)
    for t in np.linspace(-0.5, times[-1] + 0.5, 20):
        assert back.sample(t + 3.0) == pytest.approx(path.sample(t), abs=1e-5)


def test_a_trajectory_without_a_stamp_starts_now() -> None:
    message = messages.message_from_trajectory(Trajectory.hold([0.0, 0.0, 1.0]), 0)
    assert messages.trajectory_from_message(message, now=9_500_000_000, origin=2_000_000_000).times.tolist() == [7.5]


def point(**changes: object) -> MultiDOFJointTrajectoryPoint:
    parts = {"transforms": [Transform()], "velocities": [Twist()], "accelerations": [Twist()]}
    return MultiDOFJointTrajectoryPoint(**{**parts, **changes})


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        ([], "has no points"),
        ([point(velocities=[])], r"accelerations of point 0 = \(1, 0, 1\): must be \(1, 1, 1\)"),
        ([point(accelerations=[])], r"of point 0 = \(1, 1, 0\)"),
        ([point(transforms=[Transform(), Transform()])], r"of point 0 = \(2, 1, 1\)"),
        ([point(), point()], "must be above the time before it"),
        ([point(velocities=[Twist(linear=Vector3(x=1.0))])], "at rest"),
        ([point(transforms=[Transform(translation=Vector3(z=math.nan))])], "finite"),
        ([point(transforms=[Transform(rotation=Quaternion(w=math.inf))])], "must be finite"),
    ],
)
def test_a_trajectory_that_lacks_something_is_refused(points: list[MultiDOFJointTrajectoryPoint], reason: str) -> None:
    with pytest.raises(FlatsatError, match=reason):
        messages.trajectory_from_message(MultiDOFJointTrajectory(points=points), now=1, origin=0)


def test_telemetry_is_labelled_and_keeps_its_order() -> None:
    message = messages.telemetry_message()
    (dimension,) = message.layout.dim
    assert dimension.label.split(",") == list(FIELDS)
    assert (dimension.size, dimension.stride, message.layout.data_offset) == (len(FIELDS), len(FIELDS), 0)
    row = np.arange(len(FIELDS), dtype=np.float64) / 3.0
    messages.fill_telemetry(message, row)
    assert message.data.tolist() == row.tolist()
    assert serialize_message(message).endswith(row.tobytes())


def test_a_diagnostic_status_says_everything_in_words() -> None:
    status = messages.diagnostic_status(
        "node: cf1", "cf1", DiagnosticStatus.WARN, "low", {"battery V": 3.1, "armed": True}
    )
    assert (status.name, status.hardware_id, status.level, status.message) == ("node: cf1", "cf1", b"\1", "low")
    assert {pair.key: pair.value for pair in status.values} == {"battery V": "3.1", "armed": "True"}
