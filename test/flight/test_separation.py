"""How near references come, and who is near whom: laws against dense samples and against every pair by itself."""

from __future__ import annotations

import itertools
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.separation import (
    DOWNWASH,
    IN_THE_AIR,
    STANDING,
    TOLERANCE,
    PreparedTrajectory,
    closest_approaches,
    near_pairs,
)
from flatsat_ros.flight.trajectory import Trajectory

number = st.floats(-2.0, 2.0)
vector = st.tuples(number, number, number)


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Between one and four points within 2 m, with velocities and accelerations; they begin within 3 s."""
    count = draw(st.integers(1, 4))
    times = draw(st.floats(-1.0, 3.0)) + np.cumsum(draw(st.lists(st.floats(0.2, 2.0), min_size=count, max_size=count)))
    places, velocities, accelerations = (
        np.array(draw(st.lists(vector, min_size=count, max_size=count))) for _ in range(3)
    )
    velocities[-1] = accelerations[-1] = 0.0
    return Trajectory.through(times, places, velocities, accelerations)


scales = st.sampled_from([IN_THE_AIR, STANDING])


def sampled(one: Trajectory, other: Trajectory, scale: FloatArray, times: FloatArray) -> FloatArray:
    """The distances at times."""
    away = np.array([one.sample(t)[:3] - other.sample(t)[:3] for t in times.tolist()])
    return np.asarray(np.linalg.norm(away * scale, axis=1))


@given(trajectories(), trajectories(), scales, st.floats(0.0, 2.0))
def test_the_distance_found_is_the_least_and_never_above_it(
    one: Trajectory, other: Trajectory, scale: FloatArray, now: float
) -> None:
    found, when = closest_approaches(
        PreparedTrajectory(one), [PreparedTrajectory(other)], scale[np.newaxis], np.array([math.inf]), now
    )
    least = sampled(one, other, scale, np.linspace(now, now + 12.0, 400)).min()
    assert found[0] <= least + 1e-9
    assert sampled(one, other, scale, when)[0] <= found[0] + TOLERANCE + 1e-9
    assert when[0] >= now


@given(trajectories(), trajectories(), scales)
def test_it_is_the_same_from_either_side(one: Trajectory, other: Trajectory, scale: FloatArray) -> None:
    first, second = PreparedTrajectory(one), PreparedTrajectory(other)
    there, back = (
        closest_approaches(a, [b], scale[np.newaxis], np.array([math.inf]), 0.0)[0][0]
        for a, b in ((first, second), (second, first))
    )
    assert abs(there - back) <= TOLERANCE


@given(trajectories(), st.lists(trajectories(), min_size=2, max_size=4), st.floats(0.05, 2.0), st.floats(0.5, 4.0))
def test_many_at_once_are_as_one_by_one_and_small_distances_are_told(
    one: Trajectory, others: list[Trajectory], enough: float, until: float
) -> None:
    own, tracks = PreparedTrajectory(one), [PreparedTrajectory(other) for other in others]
    weights, most = np.tile(IN_THE_AIR, (len(tracks), 1)), np.full(len(tracks), enough)
    found, _ = closest_approaches(own, tracks, weights, most, 0.0, until)
    alone = [closest_approaches(own, [track], weights[:1], most[:1], 0.0, until)[0][0] for track in tracks]
    assert np.allclose(found, alone)
    for distance, other in zip(found, others, strict=True):
        least = sampled(one, other, IN_THE_AIR, np.linspace(0.0, until, 100)).min()
        assert distance <= least + 1e-9
        assert distance <= enough


@given(st.lists(vector, min_size=1, max_size=8), st.floats(0.05, 3.0), st.data())
def test_near_pairs_are_all_and_only_those_in_the_air(
    places: list[tuple[float, ...]], limit: float, data: st.DataObject
) -> None:
    aloft = np.array(data.draw(st.lists(st.booleans(), min_size=len(places), max_size=len(places))))
    points = np.array(places)
    apart = {
        (i, j): float(np.linalg.norm((points[i] - points[j]) * IN_THE_AIR))
        for i, j in itertools.combinations(np.flatnonzero(aloft).tolist(), 2)
    }
    pairs, least = near_pairs(points, aloft, limit)
    # squares are compared: what is this near to the limit may be taken for either
    certain = {pair for pair, distance in apart.items() if distance < limit - 1e-6}
    possible = {pair for pair, distance in apart.items() if distance < limit + 1e-6}
    assert certain <= {(i, j) for i, j, _ in pairs} <= possible
    assert math.isclose(least, min(apart.values(), default=math.inf), abs_tol=1e-6)
    assert all(math.isclose(distance, apart[i, j], abs_tol=1e-6) for i, j, distance in pairs)


def test_a_drone_below_another_must_be_farther_away_than_one_beside_it() -> None:
    here, below = np.zeros(3), np.array([0.0, 0.0, -0.7])
    assert near_pairs(np.array([here, below]), np.ones(2, dtype=bool), 0.4)[0]
    assert not near_pairs(np.array([here, DOWNWASH * below]), np.ones(2, dtype=bool), 0.4)[0]
    assert not near_pairs(np.array([here, below[[2, 1, 0]]]), np.ones(2, dtype=bool), 0.4)[0]
