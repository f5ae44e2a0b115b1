"""Recordings of motion capture: the poses of one drone and their stamps, read from a CSV file.

What motion capture did wrong belongs to the recording and is kept: bursts, gaps, duplicates, stamps out of order, NaN,
jumps. What damaged the file does not: a line that breaks off where the recorder was interrupted is left out and
reported, and anything else that is not a pose is refused.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, quoted, refusal
from flatsat_ros.base.files import located, read_text, unreadable
from flatsat_ros.base.numerals import number_of

COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")

CSV_BYTES = 16 * 1024 * 1024  # half an hour at 100 Hz
POSES = 200_000  # lines of a file, poses of a bag: half an hour at 100 Hz
SPAN = 1e5  # s, more than a day, between the first stamp and any other: played slowly, later ones have no ROS time

# as seconds, a stamp from here on would lie millions of years ahead: it counts nanoseconds since 1970
_NANOSECONDS_FROM = 1e15
_NUMERALS = set("0123456789+-.eE")


@dataclass(frozen=True, eq=False)
class Recording:
    """The poses of one drone in the order in which they came.

    Attributes:
        time: (M,) stamps, s after the first pose's; at most SPAN from it, not necessarily increasing.
        position: (M, 3) m, world frame; entries may be NaN.
        quaternion: (M, 4) x, y, z, w, body -> world; entries may be NaN.
        torn: numbers, counted from 1, of the lines of the file that were left out because they break off.

    Raises:
        FlatsatError: there is no pose, shapes differ, or a stamp is not finite or too far from the first.
    """

    time: FloatArray
    position: FloatArray
    quaternion: FloatArray
    torn: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.time)
        if count == 0:
            raise FlatsatError("the recording has no poses: must have at least one")
        shapes = self.time.shape, self.position.shape, self.quaternion.shape
        if shapes != ((count,), (count, 3), (count, 4)):
            raise refusal("shapes of time, position and quaternion", shapes, "", "(M,), (M, 3), (M, 4)")
        valid = np.abs(self.time - self.time[0]) <= SPAN
        if not valid.all():
            raise refusal(
                "stamp",
                self.time[~valid][0],
                "s",
                f"finite, s of any epoch or ns since 1970, within {SPAN:g} s of the first",
            )

    @property
    def duration(self) -> float:
        """From the first pose to the latest stamp, s."""
        return float(self.time.max())

    def due(self) -> FloatArray:
        """Return the times (M,), s after the first pose, at which to play: in order, each at its stamp or later."""
        return np.maximum.accumulate(self.time)


def read_csv(path: str | os.PathLike[str]) -> Recording:
    """Read a CSV recording with the columns t (s of any epoch, or ns since 1970), x, y, z (m), qx, qy, qz, qw.

    An empty cell is a number that is not known, NaN: motion capture lost the body. A line that breaks off, that is one
    in which only columns at the end are missing or a last number is not complete, is left out wherever it stands:
    recorders are interrupted and start again. Empty lines do not count.

    Args:
        path: of the file.

    Raises:
        FlatsatError: the file cannot be read or is larger than the bounds above, its first line is not the column
            names, a line is neither a pose nor torn, or there is no pose; the text names the line.
    """
    lines = read_text(path, CSV_BYTES).removeprefix("\ufeff").splitlines()
    if len(lines) > POSES:
        raise unreadable(path, f"it has more than {POSES} lines, the most that is read")
    header = tuple(column.strip() for column in lines[0].split(",")) if lines else ()
    if header != COLUMNS:
        raise located(path, f"line 1: {quoted(','.join(header))}: must be {','.join(COLUMNS)!r}")
    rows, torn = [], []
    for number, line in enumerate(lines[1:], start=2):
        if not line or line.isspace():
            continue
        row = _row(line)
        if row is None:
            torn.append(number)
        elif len(row) != len(COLUMNS) or not math.isfinite(row[0]):
            numbers = f"must be {len(COLUMNS)} numbers with a finite t first"
            raise located(path, f"line {number}: {quoted(line.strip())}: {numbers}")
        else:
            rows.append(row)
    table = np.array(rows, dtype=np.float64).reshape(-1, len(COLUMNS))
    try:
        with np.errstate(over="ignore"):  # such stamps are refused
            time = table[:, 0] - table[:1, 0]
            if (table[:1, 0] >= _NANOSECONDS_FROM).any():
                time *= 1e-9
            return Recording(time, table[:, 1:4], table[:, 4:], tuple(torn))
    except FlatsatError as error:
        raise located(path, error) from error


def _row(line: str) -> list[float] | None:
    """Return the numbers of a line, none of them if one is not a number, or None if the line breaks off."""
    *whole, last = line.split(",", len(COLUMNS))
    # with an empty cell before the last one, an empty last one is a part of what was lost, not of what was written
    lost = len(whole) == len(COLUMNS) - 1 and not last.strip() and not all(part.strip() for part in whole)
    try:
        row = [number_of(part) if part.strip() else math.nan for part in whole]
    except ValueError:
        return []
    try:
        row.append(math.nan if lost else number_of(last))
    except ValueError:
        return None if len(row) < len(COLUMNS) and _NUMERALS.issuperset(last.strip()) else []
    return row if len(row) >= len(COLUMNS) else None
