"""Flight logs: what was commanded and where the drone was, from a CSV file of any form that a column map describes.

What is wrong in a log is kept here, as NaN where there is no number; `screening` finds, masks and counts it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.base.files import located, read_text, unreadable
from flatsat_ros.base.numerals import number_of
from flatsat_ros.identification.columns import ColumnMap, recognise

LOG_BYTES = 256 * 1024 * 1024  # an hour at 100 Hz with 60 columns
ROWS = 500_000


@dataclass(frozen=True, eq=False)
class ClaimedFlight:
    """What our controller claimed and how it went, tick by tick.

    Attributes:
        error: (T, 3) m, position less reference.
        tube: (T, 2) m, the largest error that the certificate flown allows, horizontally and vertically; NaN for none.
        claimed: (T,) whether all was as the certificate assumes, so that the error must be in the tube.
    """

    error: FloatArray
    tube: FloatArray
    claimed: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class FlightLog:
    """One flight of one drone. The three channels have times of their own, s, on one clock.

    Attributes:
        name: of the log.
        pose_time: (M,) of the poses.
        position: (M, 3) m, world frame.
        angles: (M, 3) roll, pitch, yaw of the marker frame, rad, ZYX, body FLU to world ENU; NaN for none.
        command_time: (K,) of the commands.
        command: (K, 3) commanded roll and pitch, rad, positive toward -y and +x, and thrust, PWM; each holds until the
            next.
        voltage_time: (B,) of the battery readings; there may be none.
        voltage: (B,) V.
        damaged: number of lines of the file that are no rows of numbers.
        flown: of the ticks in which our controller flew by its law; None for a flight of another.
        arrived: (M,) s, when the poses came to where the commands come from; None: when they were measured.

    Raises:
        FlatsatError: shapes differ, or a channel of poses or commands is empty.
    """

    name: str
    pose_time: FloatArray
    position: FloatArray
    angles: FloatArray
    command_time: FloatArray
    command: FloatArray
    voltage_time: FloatArray
    voltage: FloatArray
    damaged: int = 0
    flown: ClaimedFlight | None = None
    arrived: FloatArray | None = None

    def __post_init__(self) -> None:
        poses, commands = len(self.pose_time), len(self.command_time)
        came = self.pose_time if self.arrived is None else self.arrived
        shapes = self.position.shape, self.angles.shape, self.command.shape, self.voltage.shape, came.shape
        expected = (poses, 3), (poses, 3), (commands, 3), self.voltage_time.shape, (poses,)
        require(shapes == expected, "shapes of position, angles, command, voltage, arrived", shapes, "", str(expected))
        for channel, count in (("poses", poses), ("commands", commands)):
            if count < 2:
                raise FlatsatError(f"{self.name}: it has {count} {channel}: must have at least 2")


def ages(log: FlightLog) -> FloatArray:
    """Return how old the newest pose with a position was when it came and when the next one did, (n, 2), s.

    From the first command with thrust to the last: what comes before and behind is no flight.
    """
    came = log.pose_time if log.arrived is None else log.arrived
    order = np.argsort(came, kind="stable")
    order = order[np.isfinite(log.position[order]).all(axis=1)]
    came, newest = came[order], np.maximum.accumulate(log.pose_time[order])
    found = np.stack([came[:-1], came[1:]], axis=-1) - newest[:-1, np.newaxis]
    told = log.command_time[log.command[:, 2] > 0.0]
    if len(told):
        found = found[(came[1:] > told[0]) & (came[:-1] < told[-1])]
    return found


def read_log(path: str | os.PathLike[str], columns: ColumnMap | None = None) -> FlightLog:
    """Read a CSV log.

    Args:
        path: of the file; its first line has the names of the columns.
        columns: what they are; None: a form that the package knows, recognised by the header.

    Raises:
        FlatsatError: the file cannot be read, is larger than LOG_BYTES or ROWS, has columns that are missing or not
            known, or no rows.
    """
    lines = read_text(path, LOG_BYTES).removeprefix("\ufeff").splitlines()
    if len(lines) > ROWS:
        raise unreadable(path, f"it has more than {ROWS} lines, the most that is read")
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    try:
        known = columns or recognise(header)
        lacking = known.missing(header)
        if lacking:
            raise refusal("columns", header, "", f"also {', '.join(lacking)}, as the column map {known.name} says")
        return _log(Path(path).stem, lines[1:], header, known)
    except FlatsatError as error:
        raise located(path, error) from error


def _log(name: str, lines: Sequence[str], header: Sequence[str], known: ColumnMap) -> FlightLog:
    """Return the log of the lines below a header."""
    used = [(quantity, column) for quantity, column in known.columns.items() if column.name in header]
    places = [header.index(column.name) for _, column in used]
    rows, damaged = [], 0
    for line in lines:
        if not line or line.isspace():
            continue
        parts = line.split(",")
        row = [_number(parts[place]) for place in places] if len(parts) == len(header) else []
        damaged += any(value is None for value in row) or not row
        rows.append([math.nan if value is None else value for value in row] or [math.nan] * len(places))
    table = np.array(rows, dtype=np.float64).reshape(-1, len(places))
    column = {quantity: table[:, k] * each.factor for k, (quantity, each) in enumerate(used)}
    time = column["time"]
    finite = np.isfinite(time)
    if not finite.any():
        raise FlatsatError("it has no row of numbers: must have 5 s of flight below its header")
    column = {quantity: values[finite] for quantity, values in column.items()}
    time = column["time"] - column["time"][0]
    angles = [column[each] for each in ("roll", "pitch", "yaw")] if "roll" in column else None
    read = "voltage" in column
    return FlightLog(
        name=name,
        pose_time=time,
        position=np.stack([column[axis] for axis in "xyz"], axis=-1),
        angles=np.stack(angles, axis=-1) if angles else angles_of([column[f"q{axis}"] for axis in "xyzw"]),
        command_time=time,
        command=np.stack([column[f"{each}_setpoint"] for each in ("roll", "pitch", "thrust")], axis=-1),
        voltage_time=time if read else np.empty(0),
        voltage=column["voltage"] if read else np.empty(0),
        damaged=damaged,
    )


def _number(text: str) -> float | None:
    """Return a number, NaN for an empty field, None for what is no number."""
    try:
        return number_of(text) if text.strip() else math.nan
    except ValueError:
        return None


def angles_of(quaternion: Sequence[FloatArray]) -> FloatArray:
    """Return roll, pitch, yaw (M, 3), rad, ZYX, of quaternions x, y, z, w, (M,) each; NaN where the norm is not 1."""
    x, y, z, w = (np.asarray(part, dtype=np.float64) for part in quaternion)
    with np.errstate(invalid="ignore", over="ignore"):
        norm = x * x + y * y + z * z + w * w
        roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        angles = np.stack([roll, pitch, yaw], axis=-1)
        return np.where((np.abs(norm - 1.0) < 0.05)[:, None], angles, np.nan)
