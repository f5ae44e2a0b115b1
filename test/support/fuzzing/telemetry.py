"""Telemetry from which the thrust of a hover is measured: the factor is a number above 0, or it is refused."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.identification.hover import thrust_scale
from fuzzing.damage import FLOATS
from fuzzing.kind import Attempt, Kind, require_one_line

_ROWS = 25


@st.composite
def _inputs(draw: st.DrawFn) -> bytes:
    """Rows of a hover, as doubles, of which a few entries are wild, here and there or in all rows."""
    rows = np.zeros((_ROWS, len(FIELDS)))
    hover = {"mode": Mode.FLY.value, "T": draw(st.floats(5.0, 15.0)), "thrust_scale": draw(st.floats(0.8, 1.2))}
    for name, value in hover.items():
        rows[:, FIELDS.index(name)] = value
    for _ in range(draw(st.integers(0, 2))):
        column = draw(st.sampled_from(["mode", "T", "thrust_scale", "phi", "theta", "error_vx", "error_vz"]))
        row = draw(st.integers(0, _ROWS))
        rows[slice(None) if row == _ROWS else row, FIELDS.index(column)] = draw(FLOATS)
    return rows.tobytes()[: draw(st.sampled_from([None, None, None, -8, 800]))]


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    size = 8 * len(FIELDS)

    def attempt(data: bytes) -> bool:
        pieces = [data[at : at + size] for at in range(0, len(data) // 8 * 8, size)]
        rows = [np.frombuffer(piece[: len(piece) // 8 * 8]) for piece in pieces]
        try:
            scale, error = thrust_scale(rows, GRAVITY)
        except FlatsatError as refused:
            require_one_line(refused)
            return False
        assert 0.0 < scale < math.inf
        assert 0.0 <= error < math.inf
        return True

    yield attempt


TELEMETRY = Kind(_inputs(), _open)
