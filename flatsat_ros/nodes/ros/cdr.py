"""Messages read from their bytes, without building them: cheap, and refused by their size before anything is decoded.

What every subscription of the controller takes is the serialised message, in plain CDR: a header of 4 bytes, of which
the second tells the byte order, then the fields in order, each aligned to its own size, counted from the end of the
header. A string and a sequence begin with their length, 4 bytes; a string ends with a zero that counts.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple, TypeVar, cast

import numpy as np
from rclpy.serialization import deserialize_message

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import FARTHEST_PLACE
from flatsat_ros.base.errors import FlatsatError, one_line, refusal, require
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.ros.messages import NANOSECONDS

M = TypeVar("M")

# a trajectory's points: decoding, joining and checking so many takes less than a tick of 10 ms
POINTS_MAX = 2000
# what a header may say beside its stamp, and a joint be called, characters
_NAME_MAX = 255
# a message is no longer than this, bytes, a trajectory with all its points no longer than this and its points
_SIZE_MAX = 1024

_HEADER = 4  # bytes before the first field

# nothing in a flying room is faster or more sudden: m/s, m/s^2
_FASTEST, _HARDEST = 1e3, 1e3
# a trajectory starts within this time of now, s: beyond, its stamp is of another clock
_EARLIEST = 3600.0
# a quaternion that was typed with one digit is no farther from unit length
_LENGTH_ERROR = 0.1

# one point with one transform, velocity and acceleration each: fields, their types and numbers of values
_POINT = (
    ("transforms", "u4", 1), ("_transforms", "u4", 1), ("position", "f8", 3), ("rotation", "f8", 4),
    ("velocities", "u4", 1), ("_velocities", "u4", 1), ("velocity", "f8", 3), ("_turn", "f8", 3),
    ("accelerations", "u4", 1), ("_accelerations", "u4", 1), ("acceleration", "f8", 3), ("_twist", "f8", 3),
    ("sec", "i4", 1), ("nanosec", "u4", 1),
)  # fmt: skip


class StampedPose(NamedTuple):
    """One PoseStamped.

    Attributes:
        stamp: ns.
        position: (3,) m.
        quaternion: (4,) x, y, z, w, body -> world.
    """

    stamp: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]


def pose_from_cdr(data: bytes) -> StampedPose:
    """Read a serialised PoseStamped, whatever its numbers are.

    Raises:
        FlatsatError: the bytes are not a PoseStamped.
    """
    order = _order(data)
    try:
        sec, nanosec, length = struct.unpack_from(order + "iII", data, _HEADER)
        offset = _HEADER + (12 + length + 7) // 8 * 8
        values = struct.unpack_from(order + "7d", data, offset)
    except struct.error as error:
        raise FlatsatError(f"{len(data)} bytes are not a serialised PoseStamped: {error}") from error
    return StampedPose(sec * NANOSECONDS + nanosec, values[:3], values[3:])


def message_from_cdr(data: bytes, kind: type[M]) -> M:
    """Return a message of a kind from its bytes, for kinds that come seldom and are short.

    Raises:
        FlatsatError: the bytes are not such a message.
    """
    try:
        return cast(M, deserialize_message(data, kind))
    except Exception as error:  # of rmw, or of Python for text that is not UTF-8
        raise FlatsatError(f"{len(data)} bytes are not a serialised {kind.__name__}: {one_line(str(error))}") from error


def frame_from_cdr(data: bytes) -> bytes:
    """Return the frame_id of a serialised message that begins with a header, or as much of it as is there."""
    (length,) = struct.unpack_from(_order(data) + "I", data, _HEADER + 8) if len(data) >= _HEADER + 12 else (1,)
    return data[_HEADER + 12 : _HEADER + 11 + min(length, _NAME_MAX)]


def require_frame(data: bytes, world: bytes) -> None:
    """Refuse a serialised message of another frame than the world's; an empty frame_id means the world.

    Raises:
        FlatsatError: names the frame and the world's.
    """
    frame = frame_from_cdr(data)
    if frame and frame != world:
        require_world(frame.decode(errors="replace"), world.decode())


def require_world(frame: str, world: str) -> None:
    """Refuse a frame_id that is neither the world's nor empty.

    Raises:
        FlatsatError: names the frame and the world's.
    """
    if frame not in ("", world):
        raise refusal("frame_id", frame, "", f"{world!r} or empty")


def require_short(data: bytes) -> None:
    """Refuse a serialised message that is too long to be what it should be.

    Raises:
        FlatsatError: names its length and the largest.
    """
    require(len(data) <= _SIZE_MAX, "length of the message", len(data), "bytes", f"at most {_SIZE_MAX}")


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return psi, rad, of a quaternion of about unit length; the all-zero quaternion of an unset field means 0.

    Raises:
        FlatsatError: the quaternion has another length, or a value is not finite.
    """
    length = math.hypot(x, y, z, w)
    if length == 0.0:
        return 0.0
    good = abs(length - 1.0) <= _LENGTH_ERROR
    require(good, "orientation", (x, y, z, w), "", f"of length 1 +- {_LENGTH_ERROR:g}, or left at zeros")
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def setpoint_from_cdr(data: bytes) -> Trajectory:
    """Return the set-point that a serialised goal, a PoseStamped, asks for: position and yaw.

    Raises:
        FlatsatError: the bytes are not a PoseStamped, or a value is not finite or too large.
    """
    pose = pose_from_cdr(data)
    _require_within("position", np.array([pose.position]), FARTHEST_PLACE, "m")
    return Trajectory.hold(pose.position, yaw_from_quaternion(*pose.quaternion))


def trajectory_from_cdr(data: bytes, now: int, origin: int) -> Trajectory:
    """Return the trajectory of a serialised MultiDOFJointTrajectory of one joint.

    Every point has a position, a velocity and an acceleration.

    Args:
        data: its header's stamp is the start; a zero stamp means now.
        now: ns.
        origin: ns; the trajectory's times are seconds after it.

    Raises:
        FlatsatError: the bytes are not such a message, it has too many points, a point lacks something, a value is not
            finite or too large, times do not increase, or it does not end at rest.
    """
    order = _order(data)
    try:
        sec, nanosec, length = struct.unpack_from(order + "iII", data, _HEADER)
        at = _aligned(_HEADER + 12 + length, 4)
        (joints,) = struct.unpack_from(order + "I", data, at)
        at += 4
        require(joints <= 1, "number of joints", joints, "", "1")
        if joints:
            (length,) = struct.unpack_from(order + "I", data, at)
            at = _aligned(at + 4 + length, 4)
        (count,) = struct.unpack_from(order + "I", data, at)
    except struct.error as error:
        raise FlatsatError(f"{len(data)} bytes are not a serialised trajectory: {error}") from error
    require(1 <= count <= POINTS_MAX, "number of points", count, "", f"1 to {POINTS_MAX}")
    points = _points(data, order, at + 4, count)
    for name, most, unit in (("position", FARTHEST_PLACE, "m"), ("velocity", _FASTEST, "m/s"),
                             ("acceleration", _HARDEST, "m/s^2")):  # fmt: skip
        _require_within(name, points[name], most, unit)
    start = (sec * NANOSECONDS + nanosec) or now
    ahead = (start - now) / NANOSECONDS
    require(abs(ahead) <= _EARLIEST, "start of the trajectory minus now", ahead, "s", f"within {_EARLIEST:g} s")
    elapsed = points["sec"].astype(np.int64) * NANOSECONDS + points["nanosec"]
    return Trajectory.through(
        (start - origin + elapsed) / NANOSECONDS,
        points["position"],
        points["velocity"],
        points["acceleration"],
        yaw_from_quaternion(*points["rotation"][-1].tolist()),
    )


def _points(data: bytes, order: str, at: int, count: int) -> np.ndarray:
    """Return the points (count,) of a trajectory whose sequence begins at an offset."""
    kind = np.dtype([(name, order + form, (number,) if number > 1 else ()) for name, form, number in _POINT])
    # the first length stands right before the doubles, or 4 bytes before them where those need no more room
    early = (at - _HEADER) % 8 == 4
    begin = at - 4 if early else at
    end = begin + count * kind.itemsize
    points = np.frombuffer(data[:end].ljust(end, b"\0"), kind, count, begin).copy()
    if early:
        points["transforms"][0] = points["_transforms"][0]
    # behind a sequence of another length nothing is where it is looked for: the first such length is the one to tell
    parts = ("transforms", "velocities", "accelerations")
    lengths = np.stack([points[part] for part in parts], axis=1)
    if (lengths != 1).any():
        point, part = map(int, np.argwhere(lengths != 1)[0])
        raise refusal(f"number of {parts[part]} of point {point}", lengths[point, part], "", "1, of one joint")
    if len(data) < end:
        raise FlatsatError(f"{len(data)} bytes are not a serialised trajectory of {count} points: must be {end}")
    return points


def _require_within(name: str, values: FloatArray, most: float, unit: str) -> None:
    """Refuse coordinates (..., 3) that are not finite or beyond a limit: such numbers overflow where they are used."""
    good = np.abs(values) <= most
    if not good.all():
        raise refusal(name, values[~good].flat[0], unit, f"within {most:g} {unit}")


def _order(data: bytes) -> str:
    return "<" if len(data) > 1 and data[1] == 1 else ">"


def _aligned(offset: int, size: int) -> int:
    """Return the next offset at which a value of a size may stand."""
    return _HEADER + (offset - _HEADER + size - 1) // size * size
