"""The flight modes: the whole transition table, and what must never happen in any history."""

from __future__ import annotations

import itertools
import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import AIRBORNE, CONDITIONS, TABLE, Event, Mode, Situation, next_mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.supervisor import Sight, Supervisor

POLICY = Policy(pose_timeout=0.3, level_time=0.5, unlock_time=0.5, level_thrust=0.9)

# mode: the modes that may follow, for each of the flags that must be set for it (a minus: must not be)
ROWS = {
    Mode.IDLE: [
        ("usable requested -standing", Mode.FLY),
        ("usable requested standing", Mode.UNLOCK),
        ("usable -requested unlocking standing", Mode.UNLOCK),
    ],
    Mode.UNLOCK: [
        ("-requested -unlocking", Mode.IDLE),
        ("-requested unlocking -usable", Mode.IDLE),
        ("requested -usable late", Mode.IDLE),
        ("requested usable late -linked", Mode.IDLE),
        ("requested usable over linked", Mode.FLY),
        ("-requested unlocking usable late -linked", Mode.IDLE),
        ("-requested unlocking usable over linked", Mode.IDLE),
    ],
    Mode.FLY: [
        ("-usable grounded", Mode.UNLOCK),
        ("-usable -grounded", Mode.LEVEL),
        ("usable astray", Mode.DESCEND),
        ("usable -astray fell", Mode.FALLEN),
        ("usable -astray -fell touched_down", Mode.REST),
        ("usable -astray -fell -touched_down held", Mode.DESCEND),
    ],
    Mode.LEVEL: [("usable", Mode.FLY), ("-usable over", Mode.DESCEND)],
    Mode.DESCEND: [
        ("held resting tried", Mode.UNLOCK),
        ("held -resting descended", Mode.FALLEN),
        ("held resting -tried descended", Mode.FALLEN),
        ("usable steady -astray -held", Mode.FLY),
        ("usable -steady -astray -held descended", Mode.CUT),
        ("-usable -astray -held descended", Mode.CUT),
        ("astray -held descended", Mode.FALLEN),
    ],
    Mode.CUT: [("usable requested", Mode.UNLOCK)],
    Mode.REST: [("over", Mode.IDLE)],
    Mode.FALLEN: [("rearmed", Mode.IDLE)],
}
FLAGS = [field.name for field in fields(Situation) if field.name not in ("elapsed", "policy", "blind", "taken")]
DURATION = {Mode.UNLOCK: POLICY.unlock_time, Mode.LEVEL: POLICY.level_time, Mode.REST: POLICY.rest_time}


def expected(mode: Mode, flags: dict[str, bool]) -> Mode:
    """The mode that the rows above name; only one may."""
    found = [
        after
        for text, after in ROWS[mode]
        if all(flags[word.removeprefix("-")] is not word.startswith("-") for word in text.split())
    ]
    assert len(found) <= 1, "the rows themselves must exclude one another"
    return found[0] if found else mode


@pytest.mark.parametrize("mode", list(Mode))
def test_every_transition_is_that_of_the_rows_in_every_situation(mode: Mode) -> None:
    limit = DURATION.get(mode, 1.0)
    looked_at = {word.removeprefix("-") for text, _ in ROWS[mode] for word in text.split()}
    conditions = {term.removeprefix("not ") for event, _ in TABLE[mode] for term in CONDITIONS[event]}
    named = [flag for flag in FLAGS if flag in looked_at | conditions | {"requested", "unlocking", "usable"}]
    for values, others in itertools.product(itertools.product([False, True], repeat=len(named)), [False, True]):
        flags = dict.fromkeys(FLAGS, others) | dict(zip(named, values, strict=True))
        for elapsed in (0.0, math.nextafter(limit, 0.0), limit, limit + 60.0):
            times = {"over": elapsed >= limit, "late": elapsed >= limit + 5.0, "tried": elapsed >= 1.5}
            after, event = next_mode(mode, Situation(elapsed, POLICY, taken=elapsed, **flags))
            assert after is expected(mode, flags | times), (mode, flags, elapsed)
            assert (event is None) == (after is mode)


@given(
    losses=st.lists(st.tuples(st.floats(0.05, 0.4), st.floats(0.0, 0.6)), min_size=1, max_size=20),
    lasts=st.floats(0.0, 1.0),
)
def test_poses_that_come_and_go_count_as_lost_when_most_are(losses: list[tuple[float, float]], lasts: float) -> None:
    """What was flown blindly adds up, less a fifth of the time with poses; at `level_time` the drone sinks."""
    supervisor, now, blind = Supervisor(POLICY, 1), 0.0, 0.0
    supervisor.request(0, patient=True)

    def see(usable: bool) -> Mode:
        flags = dict.fromkeys(Sight._fields, np.zeros(1, dtype=bool))
        sight = Sight(**flags | {"height": np.ones(1), "usable": np.array([usable])})
        supervisor.advance(now, sight)
        assert supervisor.flying[0] == (supervisor.mode[0] == Mode.FLY)
        assert supervisor.level[0] == (supervisor.mode[0] in (Mode.LEVEL, Mode.DESCEND))
        return Mode(supervisor.mode[0])

    assert see(True) is Mode.FLY
    for without, seen in losses:
        now, blind = now + seen, max(0.0, blind - 0.2 * seen)
        assert see(False) is Mode.LEVEL
        now, blind = now + without, blind + without
        if abs(blind - POLICY.level_time) < 1e-9:
            return
        if blind > POLICY.level_time:
            assert see(False) is Mode.DESCEND
            break
        assert see(True) is Mode.FLY
    else:
        return
    now += 0.1
    assert see(True) is Mode.DESCEND, "one pose is not enough to land by"
    now += lasts
    assume(abs(lasts - 0.5) > 1e-9)
    assert see(True) is (Mode.FLY if lasts >= 0.5 else Mode.DESCEND)


def test_every_event_is_in_the_table_and_leads_somewhere_else() -> None:
    used = [event for rows in TABLE.values() for event, _ in rows]
    assert set(used) == set(Event)
    assert set(TABLE) == set(Mode)
    assert all(after is not mode for mode, rows in TABLE.items() for _, after in rows)


@pytest.mark.parametrize(
    ("fallen", "steps"),
    [
        (False, ["IDLE -> UNLOCK: flatsat/arm was called and the drone stands on the ground"]),
        (True, ["FALLEN -> IDLE: flatsat/arm was called: it may take off again"]),
    ],
)
def test_what_is_told_of_arming_is_what_is_known_as_the_drone_itself_may_refuse(fallen: bool, steps: list[str]) -> None:
    supervisor = Supervisor(POLICY, 1)
    if fallen:
        supervisor.mode[0] = Mode.FALLEN
    supervisor.arm(0, True, 0.0)
    flags = dict.fromkeys(Sight._fields, np.zeros(1, dtype=bool))
    made = supervisor.advance(0.0, Sight(**flags | {"height": np.zeros(1), "usable": np.ones(1, dtype=bool)}))
    assert [f"{before.name} -> {after.name}: {reason}" for _, before, after, reason in made] == steps


situations = st.tuples(st.floats(0.0, 2.0), *(st.booleans(),) * len(FLAGS))


@given(events=st.lists(situations, min_size=1, max_size=40))
def test_in_no_history_a_drone_is_steered_blindly_or_its_motors_start_unasked(events: list[tuple[Any, ...]]) -> None:
    mode, elapsed, requested = Mode.IDLE, math.inf, False
    for dt, *values in events:
        flags = dict(zip(FLAGS, values, strict=True))
        requested = flags["requested"] = requested or flags["requested"]
        after, _ = next_mode(mode, Situation(elapsed, POLICY, taken=elapsed, **flags))
        if after is Mode.FLY:
            assert flags["usable"] or mode is Mode.FLY
            assert requested
        if mode in (Mode.CUT, Mode.FALLEN) and after is not mode:
            assert requested or flags["rearmed"]
            assert after in (Mode.UNLOCK, Mode.IDLE), "the firmware's lock must be opened again"
        if mode in AIRBORNE:
            assert after is not Mode.IDLE, "a drone in the air is never left alone"
        if after is Mode.REST and mode is not Mode.REST:
            assert flags["touched_down"]
            assert mode is Mode.FLY
        if after in (Mode.CUT, Mode.FALLEN) and mode in AIRBORNE:
            assert flags["descended"] or flags["fell"] or flags["held"], "motors stop in the air for these only"
        elapsed = elapsed + dt if after is mode else dt
        if after in (Mode.CUT, Mode.REST, Mode.FALLEN) and mode is not after:
            requested = False
        mode = after


@pytest.mark.parametrize(
    "name", ["pose_timeout", "level_time", "unlock_time", "lift_off_time", "rest_time", "level_thrust"]
)
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, "1", True])
def test_times_and_thrust_must_be_positive_numbers(name: str, bad: float) -> None:
    with pytest.raises(FlatsatError, match=f"{name} = "):
        Policy(**{name: bad})


def test_a_level_descent_may_not_climb_and_the_room_must_have_an_inside() -> None:
    Policy(level_thrust=1.0)
    with pytest.raises(FlatsatError, match=r"level_thrust = 1\.01 g: must be at most 1 g"):
        Policy(level_thrust=1.01)
    with pytest.raises(FlatsatError, match="floor = nan m"):
        Policy(floor=math.nan)
    with pytest.raises(FlatsatError, match=r"ceiling = 1\.0 m: must be above the floor, 1\.0 m"):
        Policy(floor=1.0, ceiling=1.0)
    with pytest.raises(FlatsatError, match="y_min and y_max in rising order"):
        Policy(walls=(-1.0, 2.0, 1.0, -2.0))
    with pytest.raises(FlatsatError, match="four numbers"):
        Policy(walls=(-1.0, 1.0))  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [-0.1, 0.51, math.nan])
def test_a_thrust_error_beyond_all_reason_is_refused(bad: float) -> None:
    with pytest.raises(FlatsatError, match=f"thrust_error_max = {bad}: must be a number from 0 to 0.5"):
        Policy(thrust_error_max=bad)
