"""Uploaded trajectories: what the planner makes of them, against the polynomials themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyval
from numpy.testing import assert_allclose

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.sim.high_level import HIGH_LEVEL_PERIOD, HighLevelCommander
from flatsat_ros.sim.trajectories import CAPACITY, NUMBERS, Piece, TrajectoryMemory

COEFFICIENT = st.floats(-1.0, 1.0)
PIECE = st.tuples(st.floats(0.1, 2.0), st.lists(st.tuples(*[COEFFICIENT] * 4), min_size=8, max_size=8))
PLACE = np.array([1.0, -2.0, 0.5])


def planner() -> HighLevelCommander:
    """One that is not blocked and knows that its drone is at PLACE."""
    commander = HighLevelCommander(1)
    look(commander, 0)
    return commander


def look(commander: HighLevelCommander, now: int) -> np.ndarray:
    """Return the goal at a time, ms."""
    commander.update(now, np.zeros(1, dtype=bool), PLACE[None], np.zeros((1, 3)), np.array([0.3]))
    return commander.goal[:, 0].copy()


def evaluate(pieces: list[tuple[float, list[tuple[float, ...]]]], time: float) -> np.ndarray:
    """x, y, z, yaw of a trajectory as it was given, at a time, s; after its end as at its end."""
    for duration, coefficients in pieces[:-1]:
        if time <= duration:
            return np.asarray(polyval(time, np.array(coefficients)))
        time -= duration
    duration, coefficients = pieces[-1]
    return np.asarray(polyval(min(time, duration), np.array(coefficients)))


@settings(max_examples=40)
@given(pieces=st.lists(PIECE, min_size=1, max_size=4), scale=st.floats(0.5, 3.0), part=st.floats(0.0, 1.2))
@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_trajectory_is_followed_stretched_backward_and_shifted_as_asked(
    pieces: list[tuple[float, list[tuple[float, ...]]]], scale: float, part: float, reverse: bool, relative: bool
) -> None:
    """pptraj.c piecewise_eval, piecewise_eval_reversed; planner.c plan_start_trajectory."""
    commander = planner()
    commander.memories[0].upload(3, 2, [Piece.of(*piece) for piece in pieces])
    assert commander.start_trajectory(0, 3, scale, reverse, relative, 1000)
    total = sum(duration for duration, _ in pieces)
    elapsed = round(part * total * scale * 1e3)

    def given_at(time: float) -> np.ndarray:
        time = min(time / scale, total)
        return evaluate(pieces, total - time if reverse else time)

    expected = given_at(elapsed * 1e-3)
    if relative:
        expected[:3] += PLACE - given_at(0.0)[:3]
    # on its way the planner looks every period, as on board; once or often is the same
    if elapsed > 5 * HIGH_LEVEL_PERIOD:
        look(commander, 1000 + elapsed // 2)
    assert_allclose(look(commander, 1000 + elapsed), expected, rtol=1e-7, atol=1e-7)


def test_a_goal_after_the_end_of_a_trajectory_begins_at_rest() -> None:
    """pptraj.c piecewise_eval: behind the end there is neither velocity nor acceleration."""
    commander = planner()
    ramp = np.zeros((8, 4))
    ramp[1, 0] = 1.0
    commander.memories[0].upload(0, 0, [Piece.of(1.0, ramp)])
    assert commander.start_trajectory(0, 0, 1.0, False, False, 0)
    assert_allclose(look(commander, 1500), (1.0, 0.0, 0.0, 0.0), atol=1e-12)
    assert commander.go_to(0, (2.0, 0.0, 0.0), 0.0, 1.0, False, 1500)
    assert look(commander, 1510)[0] == pytest.approx(1.0, abs=1e-5)


def test_a_goal_under_way_goes_on_with_the_trajectorys_velocity() -> None:
    commander = planner()
    ramp = np.zeros((8, 4))
    ramp[1, 0] = 1.0
    commander.memories[0].upload(0, 0, [Piece.of(1.0, ramp), Piece.of(1.0, ramp + np.eye(8, 4))])
    assert commander.start_trajectory(0, 0, 1.0, False, False, 0)
    look(commander, 1490)
    assert commander.go_to(0, (2.0, 0.0, 0.0), 0.0, 1.0, False, 1500)
    assert look(commander, 1510)[0] == pytest.approx(1.51, abs=1e-3)
    assert look(commander, 9000)[0] == pytest.approx(2.0), "no piece of the old trajectory comes back"


def test_a_blocked_planner_or_an_unknown_number_starts_nothing() -> None:
    commander = planner()
    assert not commander.start_trajectory(0, 1, 1.0, False, False, 0)
    commander.memories[0].upload(1, 0, [Piece.of(1.0, np.zeros((8, 4)))])
    commander.update(0, np.ones(1, dtype=bool), PLACE[None], np.zeros((1, 3)), np.zeros(1))
    assert not commander.start_trajectory(0, 1, 1.0, False, False, 0)
    assert not commander.following[0]


def test_trajectories_share_the_places_of_their_memory() -> None:
    """crtp_commander_high_level.c define_trajectory: a number is a row of places, whatever is written there."""
    memory = TrajectoryMemory()
    first, second = (Piece.of(duration, np.zeros((8, 4))) for duration in (1.0, 2.0))
    memory.upload(0, 0, [first, first])
    memory.upload(1, 1, [second])
    assert [piece.duration for piece in memory.pieces_of(0, 1.0, False)] == [1.0, 2.0]
    assert [piece.duration for piece in memory.pieces_of(0, 1.0, True)] == [2.0, 1.0]
    assert memory.pieces_of(2, 1.0, False) == []


@pytest.mark.parametrize(
    ("number", "offset", "count", "reason"),
    [
        (NUMBERS, 0, 1, "number of a trajectory = 31: must be from 0 to 30"),
        (0, 0, 0, "pieces of a trajectory = 0: must be at least 1"),
        (0, 1, CAPACITY, "last place of a trajectory = 256: must be at most 255 pieces"),
    ],
)
def test_what_has_no_place_is_refused(number: int, offset: int, count: int, reason: str) -> None:
    with pytest.raises(FlatsatError, match=reason):
        TrajectoryMemory().upload(number, offset, [Piece.of(1.0, np.zeros((8, 4)))] * count)


@pytest.mark.parametrize(
    ("duration", "shape", "reason"),
    [(0.0, (8, 4), "duration of a piece"), (1.0, (9, 4), r"shape of coefficients of a piece = \(9, 4\)")],
)
def test_a_piece_that_is_none_is_refused(duration: float, shape: tuple[int, int], reason: str) -> None:
    with pytest.raises(FlatsatError, match=reason):
        Piece.of(duration, np.zeros(shape))


@pytest.mark.parametrize(
    ("mask", "group", "addressed"), [(0, 0, True), (0, 1, False), (9, 1, True), (9, 2, False), (9, 0, True)]
)
def test_a_group_is_for_its_members_and_none_for_all(mask: int, group: int, addressed: bool) -> None:
    """crtp_commander_high_level.c isInGroup."""
    commander = HighLevelCommander(1)
    commander.group_mask[0] = mask
    assert commander.is_addressed(0, group) is addressed
