"""CSV recordings: whatever is read can be played."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.identification.recording import COLUMNS, SPAN, Recording, read_csv
from fuzzing.damage import corrupted, damaged
from fuzzing.kind import of_file

EPOCH = 1_700_000_000.0
_ROWS = [f"{EPOCH + 0.01 * row!r},{0.1 * row!r},0.0,1.0,0.0,0.0,0.0,1.0" for row in range(5)]
EXAMPLE = "\n".join([",".join(COLUMNS), *_ROWS])


def law(recording: Recording) -> None:
    """Require of a recording, from whatever file, what the player counts on."""
    due, count = recording.due(), len(recording.time)
    assert count > 0
    assert recording.position.shape == (count, 3)
    assert recording.quaternion.shape == (count, 4)
    assert (np.abs(recording.time) <= SPAN).all()
    assert (np.diff(due) >= 0.0).all()
    assert recording.duration <= due[-1] <= SPAN


RECORDING = of_file(st.one_of(damaged(EXAMPLE), corrupted(EXAMPLE.encode())), read_csv, law, "recording.csv")
