"""The fields of what crazyswarm2's server takes and publishes: crazyflie_interfaces and what it uses beside them.

Beside `messages` the only file that touches message fields. The types are not imported: they may not be installed.
Everything that is returned is SI, radians, floats in seconds.
"""

from __future__ import annotations

import array
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from nav_msgs.msg import Odometry

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import NANOSECONDS
from flatsat_ros.nodes.ros import messages
from flatsat_ros.sim.position_controller import PositionSetpoint, SetpointMode
from flatsat_ros.sim.trajectories import Piece

_STILL = (0.0, 0.0, 0.0)


def rise_from_request(request: Any) -> dict[str, Any]:
    """Return what crazyflie_interfaces' Takeoff or Land asks for, as `SimulatedFleet` takes it.

    It names no yaw: both of crazyswarm2's back ends send a command that turns the drone to 0.
    """
    height, duration = float(request.height), _seconds(request.duration)
    return {"height": height, "duration": duration, "yaw": 0.0, "group": int(request.group_mask)}


def way_from_request(request: Any) -> dict[str, Any]:
    """Return the way that crazyflie_interfaces' GoTo asks for, as `Uplink.go_to` takes it.

    The interface says that its yaw is in degrees; crazyswarm2's server hands it on as the firmware's radians, and its
    users' scripts count on that.
    """
    return {
        "position": _vector(request.goal),
        "yaw": request.yaw,
        "duration": _seconds(request.duration),
        "relative": request.relative,
        "group": int(request.group_mask),
    }


def trajectory_from_request(request: Any) -> tuple[int, int, list[Piece]]:
    """Return number, first place and pieces of crazyflie_interfaces' UploadTrajectory.

    Raises:
        FlatsatError: a piece is none.
    """
    pieces = [
        Piece.of(_seconds(piece.duration), _columns(piece.poly_x, piece.poly_y, piece.poly_z, piece.poly_yaw))
        for piece in request.pieces
    ]
    return int(request.trajectory_id), int(request.piece_offset), pieces


def start_from_request(request: Any) -> dict[str, Any]:
    """Return what crazyflie_interfaces' StartTrajectory asks for, as `Uplink.start_trajectory` takes it."""
    return {
        "trajectory": int(request.trajectory_id),
        "time_scale": float(request.timescale),
        "reverse": bool(request.reversed),
        "relative": bool(request.relative),
        "group": int(request.group_mask),
    }


def full_state_from_message(message: Any) -> PositionSetpoint:
    """Return the set-point of crazyflie_interfaces' FullState: place and yaw, all that the PID controller takes.

    Raises:
        FlatsatError: a value is not finite.
    """
    q = message.pose.orientation
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return PositionSetpoint.of(SetpointMode.FULL_STATE, _vector(message.pose.position), _STILL, yaw)


def position_from_message(message: Any) -> PositionSetpoint:
    """Return the set-point of crazyflie_interfaces' Position, whose yaw goes to the drone as it is: in degrees.

    Raises:
        FlatsatError: a value is not finite.
    """
    return PositionSetpoint.of(SetpointMode.POSITION, _vector(message), _STILL, math.radians(message.yaw))


def velocity_from_message(message: Any) -> PositionSetpoint:
    """Return the set-point of crazyflie_interfaces' VelocityWorld, whose yaw rate goes as it is: in degrees per second.

    Raises:
        FlatsatError: a value is not finite.
    """
    return PositionSetpoint.of(SetpointMode.VELOCITY, _STILL, _vector(message.vel), math.radians(message.yaw_rate))


def hover_from_message(message: Any) -> PositionSetpoint:
    """Return the set-point of crazyflie_interfaces' Hover: ahead and left, m/s, height, m, yaw rate, rad/s.

    Raises:
        FlatsatError: a value is not finite.
    """
    velocity, place = (message.vx, message.vy, 0.0), (0.0, 0.0, message.z_distance)
    return PositionSetpoint.of(SetpointMode.HOVER, place, velocity, message.yaw_rate)


def status_message(kind: type[Any], nanoseconds: int, robot: str, voltage: float, info: int, low: bool) -> Any:
    """Return crazyflie_interfaces' Status as crazyswarm2's server fills it; nothing is known of the radio.

    Args:
        kind: crazyflie_interfaces' Status.
        nanoseconds: its stamp, ns.
        robot: its name.
        voltage: of the battery, V.
        info: flags of the firmware's supervisor.
        low: the firmware takes the battery for low.
    """
    state = kind.PM_STATE_LOW_POWER if low else kind.PM_STATE_BATTERY
    message = kind(supervisor_info=info, battery_voltage=voltage, pm_state=state)
    message.header.stamp, message.header.frame_id = messages.stamp_from_nanoseconds(nanoseconds), robot
    return message


def odometry_message(
    nanoseconds: int, robot: str, position: FloatArray, quaternion: FloatArray, velocity: FloatArray, rates: FloatArray
) -> Odometry:
    """Return the odometry of a drone in the world, its twist in the drone's own frame, as REP 147 wants it.

    Args:
        nanoseconds: its stamp, ns.
        robot: name of the drone's frame.
        position: (3,) m, world.
        quaternion: (4,) x, y, z, w; body -> world.
        velocity: (3,) m/s, body.
        rates: (3,) rad/s, body.
    """
    message = Odometry(child_frame_id=robot)
    message.header.frame_id = "world"
    message.header.stamp = messages.stamp_from_nanoseconds(nanoseconds)
    _fill_pose(message.pose.pose, position, quaternion)
    twist = message.twist.twist
    twist.linear.x, twist.linear.y, twist.linear.z = velocity.tolist()
    twist.angular.x, twist.angular.y, twist.angular.z = rates.tolist()
    return message


def named_poses_message(
    kind: type[Any], pose: type[Any], nanoseconds: int, named: Iterable[tuple[str, FloatArray, FloatArray]]
) -> Any:
    """Return motion_capture_tracking_interfaces' NamedPoseArray.

    Args:
        kind: NamedPoseArray.
        pose: NamedPose.
        nanoseconds: its stamp, ns.
        named: name, position (3,), m, and quaternion (4,), x, y, z, w, of each body.
    """
    message = kind()
    message.header.frame_id = "world"
    message.header.stamp = messages.stamp_from_nanoseconds(nanoseconds)
    for name, position, quaternion in named:
        entry = pose(name=name)
        _fill_pose(entry.pose, position, quaternion)
        message.poses.append(entry)
    return message


def transforms_message(
    kind: type[Any], transform: type[Any], nanoseconds: int, named: Iterable[tuple[str, FloatArray, FloatArray]]
) -> Any:
    """Return tf2_msgs' TFMessage, from the world to each body; see named_poses_message."""
    message = kind()
    for name, position, quaternion in named:
        entry = transform(child_frame_id=name)
        entry.header.frame_id = "world"
        entry.header.stamp = messages.stamp_from_nanoseconds(nanoseconds)
        place, turn = entry.transform.translation, entry.transform.rotation
        place.x, place.y, place.z = position.tolist()
        turn.x, turn.y, turn.z, turn.w = quaternion.tolist()
        message.transforms.append(entry)
    return message


def log_message(kind: type[Any], nanoseconds: int, milliseconds: int, logged: Sequence[float]) -> Any:
    """Return crazyflie_interfaces' LogDataGeneric, stamped here, ns, and on board, ms since its boot."""
    message = kind(timestamp=milliseconds, values=array.array("f", logged))
    message.header.stamp = messages.stamp_from_nanoseconds(nanoseconds)
    return message


def logging_from_request(request: Any) -> tuple[str, int, list[str]]:
    """Return topic, frequency, Hz, and variables of crazyflie_interfaces' AddLogging."""
    return str(request.topic_name), int(request.frequency), [str(name) for name in request.vars]


def topic_from_request(request: Any) -> str:
    """Return the topic of crazyflie_interfaces' RemoveLogging."""
    return str(request.topic_name)


def fill_success(answer: Any, done: bool) -> None:
    """Write into the answer of crazyflie_interfaces' AddLogging or RemoveLogging whether it was done."""
    answer.success = done


def _fill_pose(pose: Any, position: FloatArray, quaternion: FloatArray) -> None:
    p, q = pose.position, pose.orientation
    p.x, p.y, p.z = position.tolist()
    q.x, q.y, q.z, q.w = quaternion.tolist()


def _seconds(duration: Duration) -> float:
    return float(duration.sec + duration.nanosec / NANOSECONDS)


def _vector(v: Any) -> list[float]:
    return [float(v.x), float(v.y), float(v.z)]


def _columns(*polynomials: Sequence[float]) -> FloatArray | list[list[float]]:
    """Return polynomials of one length as columns; others as they are, for whoever refuses them."""
    rows = [list(polynomial) for polynomial in polynomials]
    return np.array(rows).T if len({len(row) for row in rows}) == 1 else rows
