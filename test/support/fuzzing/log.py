"""Flight logs: whatever is read has channels of one length each, and screening takes it or refuses it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.identification.columns import load_columns
from flatsat_ros.identification.log import FlightLog, read_log
from flatsat_ros.identification.screening import screen
from fuzzing.damage import damaged
from fuzzing.kind import of_file, require_one_line

_NAMES = [column.name for column in load_columns("cflib").columns.values()]
_ROWS = ([0.02 * row] + [0.001 * row * (1 + column) for column in range(len(_NAMES) - 1)] for row in range(12))
EXAMPLE = "\n".join([",".join(_NAMES), *(",".join(f"{value:.6f}" for value in row) for row in _ROWS)])


def _law(log: FlightLog) -> None:
    assert len(log.pose_time) >= 2
    assert np.isfinite(log.pose_time).all()
    assert np.isfinite(log.command_time).all()
    with suppress(FlatsatError):
        _screened(log)


def _screened(log: FlightLog) -> None:
    try:
        screen(log)
    except FlatsatError as refused:
        require_one_line(refused)
        raise


LOG = of_file(damaged(EXAMPLE), read_log, _law, "flight.csv")
