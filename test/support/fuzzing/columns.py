"""Column maps of flight logs: whatever is read has what a log needs, each once, with a factor."""

from __future__ import annotations

import math

from flatsat_ros.base.resources import config_path
from flatsat_ros.identification.columns import ColumnMap, load_columns
from fuzzing.damage import damaged
from fuzzing.kind import of_file

EXAMPLE = config_path("vicon_100hz", "logs").read_text(encoding="utf-8")


def _law(known: ColumnMap) -> None:
    assert {"time", "x", "y", "z", "roll_setpoint", "pitch_setpoint", "thrust_setpoint"} <= known.columns.keys()
    assert all(math.isfinite(column.factor) and column.factor != 0.0 for column in known.columns.values())
    needed = {column.name for column in known.columns.values() if not column.optional}
    assert known.missing(needed) == []
    assert set(known.missing([])) == needed


COLUMNS = of_file(damaged(EXAMPLE), load_columns, _law, "columns.yaml")
