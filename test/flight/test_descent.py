"""The descent without position: its motors run until the drone is down, however it moved before."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.flight.descent import BlindDescent

LEVEL, DRAG, PERIOD = 0.95, 0.4, 0.02  # of g; 1/s; s
NO = np.zeros(1, dtype=bool)


@given(height=st.floats(0.0, 5.0), climb=st.floats(-1.0, 1.0))
def test_a_drone_that_gives_what_is_commanded_is_down_before_its_motors_stop(height: float, climb: float) -> None:
    descent = BlindDescent(GRAVITY, DRAG, LEVEL, 1)
    descent.begin(0, 0.0, height, climb, None)
    z, velocity, now = height, climb, 0.0
    while z > 0.0:
        assert not descent.over(now, lambda: NO, NO)[0]
        velocity += (float(descent.thrust(now)[0]) - GRAVITY) * PERIOD
        z += velocity * PERIOD
        now += PERIOD
    assert descent.over(now + 30.0, lambda: NO, NO)[0]


@given(gain=st.floats(0.8, 1.1), height=st.floats(0.0, 2.0), climb=st.floats(-1.0, 1.0))
def test_so_is_one_with_up_to_a_tenth_more_thrust_that_has_moved_unseen(
    gain: float, height: float, climb: float
) -> None:
    descent = BlindDescent(GRAVITY, DRAG, LEVEL, 1)
    descent.begin(0, 0.0, height, climb, None, unsure=True)
    z, velocity, now = height, climb, 0.0
    while z > 0.0:
        assert not descent.over(now, lambda: NO, NO)[0]
        velocity += (gain * float(descent.thrust(now)[0]) - GRAVITY - DRAG * velocity) * PERIOD
        z += velocity * PERIOD
        now += PERIOD
    assert descent.over(now + 40.0, lambda: NO, NO)[0]


@given(height=st.floats(0.0, 5.0), climb=st.floats(-1.0, 1.0))
def test_one_that_is_seen_in_the_air_gets_more_time_but_not_for_ever(height: float, climb: float) -> None:
    descent = BlindDescent(GRAVITY, DRAG, LEVEL, 1)
    descent.begin(0, 0.0, height, climb, 0.0)
    end = next(0.1 * n for n in range(1000) if descent.over(0.1 * n, lambda: NO, NO)[0])
    assert not descent.over(2.9 * end - 0.3, lambda: ~NO, NO)[0]
    assert descent.over(3.0 * end, lambda: ~NO, NO)[0]
