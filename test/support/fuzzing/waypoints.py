"""Way-points: whatever numbers they are, the path through them is finite, or they are refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.planning.spline import spline_through
from fuzzing.damage import FLOATS
from fuzzing.kind import Attempt, Kind, require_one_line

_PLACES = st.floats(-5.0, 5.0)


@st.composite
def _inputs(draw: st.DrawFn) -> bytes:
    """The time of a leg and the coordinates of way-points, as doubles; a few of them wild."""
    numbers = [draw(st.floats(0.5, 5.0)), *draw(st.lists(_PLACES, max_size=18))]
    for _ in range(draw(st.integers(0, 2))):
        numbers[draw(st.integers(0, len(numbers) - 1))] = draw(FLOATS)
    return np.array(numbers).tobytes()


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    def attempt(data: bytes) -> bool:
        leg_time, *numbers = np.frombuffer(data[: len(data) // 8 * 8] or bytes(8)).tolist()
        places = np.array(numbers)
        try:
            path = spline_through(places.reshape(-1, 3) if places.size % 3 == 0 else places, leg_time)
        except FlatsatError as refused:
            require_one_line(refused)
            return False
        for t in np.linspace(path.times[0], path.times[-1], 9):
            assert np.isfinite(path.sample(float(t))).all()
        assert path.sample(float(path.times[-1]))[:3].tolist() == path.end.tolist()
        return True

    yield attempt


WAYPOINTS = Kind(_inputs(), _open)
