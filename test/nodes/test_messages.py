"""Golden values and round trips of the one file that touches message fields."""

from __future__ import annotations

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import Backend, WireSetpoint, setpoint_from_command
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import messages

pytestmark = pytest.mark.in_process

NUMBERS = st.floats(allow_nan=False)
STAMPS = st.integers(0, 2**31 * messages.NANOSECONDS - 1)


def pose(stamp: int, values: list[float], frame: str = "world") -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = frame
    messages.fill_pose(message, stamp, values[:3], values[3:])
    return message


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
