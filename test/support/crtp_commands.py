"""What a Crazyflie does with commands that are no set-points of attitude: the packets, handed to a simulated drone.

Of crazyflie-firmware, release 2026.08: crtp_commander_high_level.c, crtp_commander_generic.c, mem.c. See crtp_endpoint.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.position_controller import PositionSetpoint, SetpointMode
from flatsat_ros.sim.trajectories import Piece

TRAJECTORY_MEMORY = 4096  # bytes; TRAJECTORY_MEMORY_SIZE
_MEMORY_TYPE = 0x12  # mem.h MEM_TYPE_TRAJ
_PIECE = struct.Struct("<33f")  # struct poly4d: eight coefficients of x, y, z and yaw, and the duration, s
_REFUSED = 5  # EIO
_STILL = (0.0, 0.0, 0.0)


class Layout(NamedTuple):
    """How the packet of a command is laid out, without its first byte, and what is done with the fields."""

    fields: str
    act: Callable[..., Any]


class Commands:
    """One drone's high-level commander, generic commander and memory of trajectories, as packets reach them."""

    def __init__(self, fleet: SimulatedFleet, index: int) -> None:
        """Begin with an empty memory."""
        self._fleet, self._index = fleet, index
        self._memory = bytearray(TRAJECTORY_MEMORY)
        self._high_level = {
            0: Layout("B", self._set_group),
            3: Layout("B", self._stop),
            6: Layout("BBBIB", self._define),
            7: Layout("Bff?f", self._take_off),
            8: Layout("Bff?f", self._land),
            12: Layout("B??5f", self._go_to),
            13: Layout("B???Bf", self._start),
        }
        self._setpoints = {
            6: Layout("9hI3h", _full_state),
            7: Layout("4f", lambda x, y, z, yaw: _setpoint(SetpointMode.POSITION, (x, y, z), _STILL, yaw)),
            8: Layout("4f", lambda x, y, z, rate: _setpoint(SetpointMode.VELOCITY, _STILL, (x, y, z), rate)),
            10: Layout("4f", lambda x, y, rate, z: _setpoint(SetpointMode.HOVER, (0.0, 0.0, z), (x, y, 0.0), rate)),
        }

    def on_high_level(self, data: bytes) -> bytes:
        """Take a packet of the high-level commander's port, and return the answer to it."""
        fields, act = self._high_level[data[0]]
        act(*struct.unpack_from("<" + fields, data, 1))
        return data[:3] + b"\0"

    def on_setpoint(self, data: bytes) -> None:
        """Take a packet of the generic commander's port."""
        fields, read = self._setpoints[data[0]]
        self._fleet.command_position(self._index, read(*struct.unpack_from("<" + fields, data, 1)))

    def on_memory_question(self, data: bytes) -> bytes:
        """Answer how many memories there are, and what the only one is."""
        if data[0] == 1:
            return bytes([1, 1])
        return bytes([2, 0, _MEMORY_TYPE]) + struct.pack("<I8x", TRAJECTORY_MEMORY)

    def on_write(self, data: bytes) -> bytes:
        """Write into the memory what fits, and answer whether it does."""
        (place,) = struct.unpack_from("<I", data, 1)
        fits = place + len(data) - 5 <= TRAJECTORY_MEMORY
        if fits:
            self._memory[place : place + len(data) - 5] = data[5:]
        return data[:5] + bytes([0 if fits else _REFUSED])

    def _set_group(self, mask: int) -> None:
        self._fleet.firmware.high_level.group_mask[self._index] = mask

    def _stop(self, group: int) -> None:
        if self._fleet.firmware.high_level.is_addressed(self._index, group):
            self._fleet.firmware.high_level.stop(self._index)

    def _take_off(self, group: int, height: float, yaw: float, keeps_yaw: bool, duration: float) -> None:
        self._fleet.take_off(self._index, height, duration, None if keeps_yaw else yaw, group=group)

    def _land(self, group: int, height: float, yaw: float, keeps_yaw: bool, duration: float) -> None:
        self._fleet.land(self._index, height, duration, None if keeps_yaw else yaw, group=group)

    def _go_to(self, group: int, relative: bool, _: bool, *way: float) -> None:
        *place, yaw, duration = way
        self._fleet.go_to(self._index, place, yaw, duration, relative=relative, group=group)

    def _define(self, trajectory: int, _location: int, _kind: int, offset: int, count: int) -> None:
        pieces = []
        for *coefficients, duration in _PIECE.iter_unpack(self._memory[offset : offset + count * _PIECE.size]):
            pieces.append(Piece.of(duration, np.reshape(coefficients, (4, 8)).T))
        self._fleet.upload_trajectory(self._index, trajectory, offset // _PIECE.size, pieces)

    def _start(
        self, group: int, relative: bool, _turned: bool, backward: bool, trajectory: int, time_scale: float
    ) -> None:
        self._fleet.start_trajectory(
            self._index, trajectory, time_scale=time_scale, reverse=backward, relative=relative, group=group
        )


def _setpoint(
    mode: SetpointMode, place: tuple[float, ...], velocity: tuple[float, ...], yaw: float
) -> PositionSetpoint:
    return PositionSetpoint.of(mode, place, velocity, math.radians(yaw))


def _full_state(*fields: int) -> PositionSetpoint:
    """Return a set-point from millimetres, of which velocity, acceleration and rates are not used, and an attitude."""
    x, y, z, w = quaternion(fields[9])
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return PositionSetpoint.of(SetpointMode.FULL_STATE, np.array(fields[:3]) / 1000.0, _STILL, yaw)


def quaternion(packed: int) -> FloatArray:
    """Return the quaternion x, y, z, w of 32 bits: which number is the largest, and the others: quatcompress.h."""
    largest, unpacked = packed >> 30, np.zeros(4)
    for position in (number for number in (3, 2, 1, 0) if number != largest):
        size = (packed & 0x1FF) / 0x1FF / math.sqrt(2.0)
        unpacked[position] = -size if packed & 0x200 else size
        packed >>= 10
    unpacked[largest] = math.sqrt(max(1.0 - float(unpacked @ unpacked), 0.0))
    return unpacked
