"""The file that touches message fields, beside `marker_messages` and, for crazyswarm2's packages, `server_messages`.

Everything it returns is SI, radians, floats in seconds.

`cdr` reads from their bytes the messages that come often or may be long. A test searches all other files of `nodes` and
`demo` for names of message fields.
"""

from __future__ import annotations

import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseStamped, Quaternion, Transform, Twist, Vector3
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    Log,
    Parameter,
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String
from std_srvs.srv import SetBool
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import NANOSECONDS as NANOSECONDS
from flatsat_ros.crazyflie.link import SupervisorInfo
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.flight.trajectory import Trajectory


def stamp_from_nanoseconds(nanoseconds: int) -> Time:
    """Return a message stamp."""
    return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def nanoseconds_from_stamp(stamp: Time) -> int:
    """Return a message stamp as nanoseconds."""
    return int(stamp.sec * NANOSECONDS + stamp.nanosec)


def pose_message() -> PoseStamped:
    """Return a pose message of the world frame, which `fill_pose` fills."""
    message = PoseStamped()
    message.header.frame_id = "world"
    return message


def fill_pose(
    message: PoseStamped,
    nanoseconds: int,
    position: Sequence[float] | FloatArray,
    quaternion: Sequence[float] | FloatArray,
) -> None:
    """Write stamp, position (m) and quaternion (x, y, z, w) into a pose message."""
    message.header.stamp = stamp_from_nanoseconds(nanoseconds)
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = (float(value) for value in position)
    q.x, q.y, q.z, q.w = (float(value) for value in quaternion)


def set_frame(message: PoseStamped, frame: str) -> None:
    """Write the frame that a pose is said to be in."""
    message.header.frame_id = frame


def pose_from_message(message: PoseStamped) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Return stamp (ns), position (3,), m, and quaternion (4,), x, y, z, w, of a pose message."""
    p, q = message.pose.position, message.pose.orientation
    return nanoseconds_from_stamp(message.header.stamp), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


class Body(NamedTuple):
    """One body in a message about several.

    Attributes:
        name: of the body.
        frame: in which it is seen.
        stamp: ns.
        position: (3,) m.
        quaternion: (4,) x, y, z, w, body -> frame.
    """

    name: str
    frame: str
    stamp: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]


def named_poses_from_message(message: Any) -> Iterator[Body]:
    """Return the bodies of motion_capture_tracking_interfaces' NamedPoseArray."""
    header = message.header
    stamp, frame = nanoseconds_from_stamp(header.stamp), str(header.frame_id)
    for entry in message.poses:
        p, q = entry.pose.position, entry.pose.orientation
        yield Body(str(entry.name), frame, stamp, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def transforms_from_message(message: Any) -> Iterator[Body]:
    """Return the bodies of tf2_msgs' TFMessage: its frames, each seen in its parent's."""
    for entry in message.transforms:
        header, p, q = entry.header, entry.transform.translation, entry.transform.rotation
        stamp = nanoseconds_from_stamp(header.stamp)
        yield Body(str(entry.child_frame_id), str(header.frame_id), stamp, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def odometry_from_message(message: Odometry) -> tuple[str, int, tuple[float, ...], tuple[float, ...]]:
    """Return frame, stamp (ns), position (3,), m, and quaternion (4,), x, y, z, w, of nav_msgs' Odometry.

    Its twist is left alone: crazyswarm2's back ends do not agree on it.
    """
    header, pose = message.header, message.pose.pose
    p, q = pose.position, pose.orientation
    return str(header.frame_id), nanoseconds_from_stamp(header.stamp), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def text_message(text: str) -> String:
    """Return a message of text."""
    return String(data=text)


def text_from_message(message: String) -> str:
    """Return the text of a message."""
    return str(message.data)


def line_from_message(message: Log) -> tuple[int, str, str]:
    """Return severity (10 debug to 50 fatal), logger and text of a line of the log."""
    return int(message.level), str(message.name), str(message.msg)


def fill_command(message: Twist, setpoint: WireSetpoint) -> None:
    """Write a set-point into a cmd_vel_legacy message."""
    message.linear.x, message.linear.y, message.linear.z = setpoint.pitch, setpoint.roll, setpoint.thrust
    message.angular.z = setpoint.yaw


def command_from_message(message: Twist) -> WireSetpoint:
    """Read the set-point of a cmd_vel_legacy message."""
    return WireSetpoint(message.linear.y, message.linear.x, message.angular.z, message.linear.z)


def quaternion_from_yaw(yaw: float) -> Quaternion:
    """Return the level orientation with the given psi, rad."""
    return Quaternion(z=float(np.sin(yaw / 2.0)), w=float(np.cos(yaw / 2.0)))


def message_from_trajectory(trajectory: Trajectory, start: int) -> MultiDOFJointTrajectory:
    """Return the message of a trajectory whose times count from start, ns; its points are the ends of the segments."""
    message = MultiDOFJointTrajectory(joint_names=["base_link"])
    message.header.stamp = stamp_from_nanoseconds(start)
    message.header.frame_id = "world"
    for t in trajectory.times:
        sample = trajectory.sample(float(t))
        nanoseconds = round(float(t) * NANOSECONDS)
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[
                    Transform(translation=_message_vector(sample[:3]), rotation=quaternion_from_yaw(trajectory.yaw))
                ],
                velocities=[Twist(linear=_message_vector(sample[3:6]))],
                accelerations=[Twist(linear=_message_vector(sample[6:]))],
                time_from_start=Duration(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS),
            )
        )
    return message


def arming_request(kind: type[Any], wanted: bool) -> Any:
    """Return the request to arm or disarm a drone: std_srvs' SetBool or crazyflie_interfaces' Arm."""
    return kind.Request(data=wanted) if kind is SetBool else kind.Request(arm=wanted)


def arming_from_request(request: Any) -> bool:
    """Return whether a request of std_srvs' SetBool or crazyflie_interfaces' Arm is to arm, or to disarm."""
    return bool(request.data if isinstance(request, SetBool.Request) else request.arm)


def hold_request(kind: type[Any], seconds: int) -> Any:
    """Return the request of crazyflie_interfaces' GoTo to come to rest where the drone is, within whole seconds."""
    return kind.Request(relative=True, duration=Duration(sec=seconds))


def fill_answer(answer: Any, done: bool, text: str) -> None:
    """Write into the answer of std_srvs' Trigger or SetBool whether it was done, and what there is to say."""
    answer.success, answer.message = done, text


def failure_answer(answer: Any, text: str) -> Any:
    """Return the answer to a request that failed, with the reason where its kind has room for one."""
    if "success" in answer.get_fields_and_field_types():
        fill_answer(answer, False, text)
    return answer


def refusal_from_answer(answer: Any) -> str:
    """Return why a service refused, nothing if it did not; crazyswarm2's services answer nothing and never refuse."""
    return "" if getattr(answer, "success", True) else str(answer.message)


def refusal_of_parameters(answer: Any) -> str:
    """Return why parameters were not set, nothing if all were; of rcl_interfaces' SetParameters."""
    return "; ".join(result.reason for result in answer.results if not result.successful)


def outcome_from_answer(answer: Any) -> tuple[str, str]:
    """Return why a service refused, nothing if it did not, and what else it says; of services and of parameters."""
    if hasattr(answer, "results"):
        return refusal_of_parameters(answer), ""
    return refusal_from_answer(answer), str(getattr(answer, "message", ""))


def parameters_request(values: Mapping[str, float]) -> SetParameters.Request:
    """Return the request of rcl_interfaces' SetParameters to set floating-point parameters by name."""
    return SetParameters.Request(
        parameters=[
            Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value))
            for name, value in values.items()
        ]
    )


def battery_message(nanoseconds: int, voltage: float) -> BatteryState:
    """Return the state of a battery of which only the voltage, V, is known; NaN stands for the rest, as it should."""
    unknown = float("nan")
    message = BatteryState(voltage=voltage, temperature=unknown, current=unknown, charge=unknown, capacity=unknown)
    message.design_capacity = message.percentage = unknown
    message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    message.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO
    message.present = True
    message.header.stamp = stamp_from_nanoseconds(nanoseconds)
    return message


def voltage_from_message(message: Any) -> float:
    """Return the voltage, V, that sensor_msgs' BatteryState or crazyflie_interfaces' Status tells."""
    return float(message.voltage if isinstance(message, BatteryState) else message.battery_voltage)


def armed_from_message(message: Any) -> bool | None:
    """Return whether crazyflie_interfaces' Status says that the drone is armed; sensor_msgs' BatteryState does not."""
    return None if isinstance(message, BatteryState) else bool(message.supervisor_info & SupervisorInfo.ARMED)


def telemetry_message() -> Float64MultiArray:
    """Return a telemetry message with its layout; only `fill_telemetry` is needed per tick."""
    size = len(FIELDS)
    dimension = MultiArrayDimension(label=",".join(FIELDS), size=size, stride=size)
    return Float64MultiArray(layout=MultiArrayLayout(dim=[dimension]), data=array.array("d", bytes(8 * size)))


def fill_telemetry(message: Float64MultiArray, row: FloatArray) -> None:
    """Write one drone's row, ordered as flight.telemetry.FIELDS."""
    message.data = array.array("d", row.tobytes())


def telemetry_from_message(message: Float64MultiArray) -> FloatArray:
    """Return one drone's row, ordered as flight.telemetry.FIELDS."""
    return np.array(message.data, dtype=np.float64)


def diagnostics_message(nanoseconds: int, statuses: Iterable[DiagnosticStatus]) -> DiagnosticArray:
    """Return a message of /diagnostics."""
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = stamp_from_nanoseconds(nanoseconds)
    return message


def diagnostic_status(
    name: str, hardware: str, level: bytes, text: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    """Return one status of a message of /diagnostics."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=text, hardware_id=hardware, values=pairs)


def statuses_from_message(message: DiagnosticArray) -> list[tuple[str, str, int, str]]:
    """Return name, hardware, severity (0 well, 1 warning, 2 error, 3 out of date) and text of each status."""
    return [
        (str(s.name), str(s.hardware_id), int.from_bytes(s.level, "little"), str(s.message)) for s in message.status
    ]


def parameter_descriptor(
    meaning: str,
    *,
    unit: str = "",
    bounds: tuple[float, float] | tuple[int, int] | None = None,
    changeable: bool = False,
    may_be_unset: bool = False,
) -> ParameterDescriptor:
    """Return what `ros2 param describe` tells of a parameter.

    Args:
        meaning: one sentence.
        unit: of the value.
        bounds: smallest and largest valid value; two integers for an integer parameter.
        changeable: it may be set while the node runs.
        may_be_unset: it needs no value.
    """
    text = meaning + (f" [{unit}]" if unit else "")
    descriptor = ParameterDescriptor(description=text, read_only=not changeable, dynamic_typing=may_be_unset)
    if bounds is not None and all(isinstance(bound, int) for bound in bounds):
        descriptor.integer_range = [IntegerRange(from_value=int(bounds[0]), to_value=int(bounds[1]), step=1)]
    elif bounds is not None:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(bounds[0]), to_value=float(bounds[1]))]
    return descriptor


def parameters_answer(refusal: str = "") -> SetParametersResult:
    """Return the answer to a request to set parameters: taken, or refused with the reason."""
    return SetParametersResult(successful=not refusal, reason=refusal)


def _nanoseconds(duration: Duration) -> int:
    return int(duration.sec * NANOSECONDS + duration.nanosec)


def _vector(v: Vector3 | Point) -> list[float]:
    return [v.x, v.y, v.z]


def _message_vector(v: FloatArray) -> Vector3:
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))
