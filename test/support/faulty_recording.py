"""A recording of motion capture with every fault seen in real ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flatsat_ros.identification.recording import COLUMNS

EPOCH = 1_700_000_000.0  # s, of its first stamp
LEVEL_TIME = 1.0  # s, `level_time` of a controller that its holes are made for


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
