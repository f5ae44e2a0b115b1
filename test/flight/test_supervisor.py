"""The flight modes: the whole transition table, and what must never happen in any history."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.estimator import PREDICTION_MAX
from flatsat_ros.flight.supervisor import Mode, Policy, Situation, next_mode

POLICY = Policy(pose_timeout=0.3, level_time=3.0, unlock_time=0.5, ground_height=0.15, level_thrust=0.9)

# mode, requested, usable, on the ground, its time is over, down, opening, stuck, again: next; None where any will do
TABLE = [
    (Mode.IDLE, False, None, None, None, None, False, None, None, Mode.IDLE),
    (Mode.IDLE, False, False, None, None, None, True, None, None, Mode.IDLE),
    (Mode.IDLE, False, True, True, None, None, True, None, None, Mode.UNLOCK),
    (Mode.IDLE, False, True, False, None, None, True, None, None, Mode.IDLE),
    (Mode.IDLE, True, False, None, None, None, None, None, None, Mode.IDLE),
    (Mode.IDLE, True, True, True, None, None, None, None, None, Mode.UNLOCK),
    (Mode.IDLE, True, True, False, None, None, None, None, None, Mode.FLY),
    (Mode.UNLOCK, False, None, None, None, None, False, None, None, Mode.IDLE),
    (Mode.UNLOCK, False, False, None, None, None, True, None, None, Mode.IDLE),
    (Mode.UNLOCK, False, True, None, False, None, True, None, None, Mode.UNLOCK),
    (Mode.UNLOCK, False, True, None, True, None, True, None, None, Mode.IDLE),
    (Mode.UNLOCK, True, False, None, None, None, None, None, None, Mode.IDLE),
    (Mode.UNLOCK, True, True, None, False, None, None, None, None, Mode.UNLOCK),
    (Mode.UNLOCK, True, True, None, True, None, None, None, None, Mode.FLY),
    (Mode.FLY, None, True, None, None, False, None, False, None, Mode.FLY),
    (Mode.FLY, None, True, None, None, False, None, True, False, Mode.UNLOCK),
    (Mode.FLY, None, True, None, None, False, None, True, True, Mode.CUT),
    (Mode.FLY, None, True, None, None, True, None, None, None, Mode.REST),
    (Mode.FLY, None, False, None, None, None, None, None, None, Mode.LEVEL),
    (Mode.LEVEL, None, True, None, None, None, None, None, None, Mode.FLY),
    (Mode.LEVEL, None, False, None, False, None, None, None, None, Mode.LEVEL),
    (Mode.LEVEL, None, False, None, True, None, None, None, None, Mode.CUT),
    (Mode.CUT, False, None, None, None, None, None, None, None, Mode.CUT),
    (Mode.CUT, True, False, None, None, None, None, None, None, Mode.CUT),
    (Mode.CUT, True, True, None, None, None, None, None, None, Mode.UNLOCK),
    (Mode.REST, None, None, None, False, None, None, None, None, Mode.REST),
    (Mode.REST, None, None, None, True, None, None, None, None, Mode.IDLE),
]

DURATION = {Mode.UNLOCK: POLICY.unlock_time, Mode.LEVEL: POLICY.level_time, Mode.REST: POLICY.rest_time}


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("requested", [False, True])
@pytest.mark.parametrize("usable", [False, True])
def test_every_transition_is_the_tables(mode: Mode, requested: bool, usable: bool) -> None:
    limit = DURATION.get(mode, 1.0)
    ages = {False: (0.0, limit / 2.0, math.nextafter(limit, 0.0)), True: (limit, 10.0 * limit, math.inf)}
    for ground, over, down, opening, stuck, again in itertools.product([False, True], repeat=6):
        present = (mode, requested, usable, ground, over, down, opening, stuck, again)
        rows = [row for row in TABLE if all(a in (None, b) for a, b in zip(row[:-1], present, strict=True))]
        assert len(rows) == 1, "the table itself must be complete and unique"
        for elapsed in ages[over]:
            situation = Situation(elapsed, POLICY, usable, ground, requested, opening, down, stuck, again)
            after, event = next_mode(mode, situation)
            assert after is rows[0][-1]
            assert (event is None) == (after is mode)


@given(
    events=st.lists(
        st.tuples(*(st.booleans(),) * 2, st.floats(-0.5, 2.0), st.floats(0.0, 2.0), *(st.booleans(),) * 3),
        min_size=1,
        max_size=40,
    )
)
def test_in_no_history_a_drone_is_steered_blindly_or_leaves_the_cut_unasked(
    events: list[tuple[bool, bool, float, float, bool, bool, bool]],
) -> None:
    mode, elapsed, requested, powered = Mode.IDLE, math.inf, False, 0.0
    for new_reference, usable, height, dt, down, opening, stuck in events:
        requested = requested or new_reference
        standing = height < POLICY.ground_height
        after, _ = next_mode(mode, Situation(elapsed, POLICY, usable, standing, requested, opening, down, stuck))
        if after is Mode.FLY:
            assert usable
            assert requested
        if mode is Mode.CUT and after is not Mode.CUT:
            assert requested
            assert after is Mode.UNLOCK, "the firmware's lock must be opened again"
        if after is Mode.IDLE:
            assert mode in (Mode.IDLE, Mode.UNLOCK, Mode.REST), "a drone in the air is never left alone"
        if after is Mode.REST and mode is not Mode.REST:
            assert down
            assert mode is Mode.FLY
        elapsed = elapsed + dt if after is mode else dt
        powered = powered + dt if after is Mode.LEVEL and mode is Mode.LEVEL else 0.0
        assert powered <= POLICY.level_time + dt
        if after in (Mode.CUT, Mode.REST) and mode is not after:
            requested = False
        mode = after


@pytest.mark.parametrize(
    "name", ["pose_timeout", "level_time", "unlock_time", "lift_off_time", "rest_time", "level_thrust"]
)
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, "1", True])
def test_times_and_thrust_must_be_positive_numbers(name: str, bad: float) -> None:
    with pytest.raises(FlatsatError, match=f"{name} = "):
        Policy(**{name: bad})


def test_a_level_descent_may_not_climb_and_the_ground_must_be_somewhere() -> None:
    Policy(level_thrust=1.0)
    with pytest.raises(FlatsatError, match=r"level_thrust = 1\.01 g: must be at most 1 g"):
        Policy(level_thrust=1.01)
    with pytest.raises(FlatsatError, match="ground_height = nan m"):
        Policy(ground_height=math.nan)


def test_a_pose_older_than_the_estimate_predicts_is_never_flown_on() -> None:
    Policy(pose_timeout=PREDICTION_MAX)
    with pytest.raises(FlatsatError, match=r"pose_timeout = 0\.51 s: must be at most 0\.5 s"):
        Policy(pose_timeout=0.51)


@pytest.mark.parametrize("bad", [-0.1, 0.51, math.nan])
def test_a_thrust_error_beyond_all_reason_is_refused(bad: float) -> None:
    with pytest.raises(FlatsatError, match=f"thrust_error_max = {bad}: must be a number from 0 to 0.5"):
        Policy(thrust_error_max=bad)
