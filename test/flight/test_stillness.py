"""Coordinates that repeat: which are taken for old ones, and which are not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.flight.stillness import Stillness

PERIOD = 0.01
AXES = st.integers(0, 2)


def first_still(
    places: np.ndarray,
    *,
    acceleration: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    velocity: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    period: float = PERIOD,
    begin: int = 0,
    airborne: bool = True,
) -> tuple[float, int]:
    """Since when, s, and of which axis, a coordinate of places (K, 3), m, is an old one; infinite and -1 for never.

    The acceleration is commanded always, (3,), or from pose to pose, (K, 3), and so is the velocity estimated. The
    drone rests until it begins, at the place of that number, to fly.
    """
    stillness = Stillness(1)
    commanded, speeds = (np.broadcast_to(each, places.shape) for each in (acceleration, velocity))
    for number, place in enumerate(places.tolist()):
        estimate = [0.0, 0.0, 0.0, *(speeds[number] * (number >= begin)), 0.0, 0.0, 0.0]
        found = stillness.look(0, number * period, tuple(place), commanded[number].tolist(), estimate, airborne)
        if found is not None and found.limit:
            assert found.lasted >= found.limit
            return number * period, found.axis
    return math.inf, -1


def noisy(count: int, deviation: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, deviation, (count, 3))


# with 2 mm changes of less than 50 um, which show that poses are fine, are rare: 17 of 1000 take longer, up to 1.7 s
@given(axis=AXES, deviation=st.floats(5e-5, 1e-3), seed=st.integers(0, 999), airborne=st.booleans())
@settings(max_examples=25)
def test_a_coordinate_without_noise_beside_noisy_ones_is_an_old_one_even_at_rest(
    axis: int, deviation: float, seed: int, airborne: bool
) -> None:
    places = noisy(400, deviation, seed)
    places[200:, axis] = places[200, axis]
    since, found = first_still(places, airborne=airborne)
    assert (2.0 + 0.14 < since < 2.4, found) == (True, axis)


@given(deviation=st.floats(1e-6, 5e-3), seed=st.integers(0, 999), step=st.sampled_from([0.0, 1e-4, 1e-3]))
@settings(max_examples=25)
def test_noisy_coordinates_are_never_rounded_or_not(deviation: float, seed: int, step: float) -> None:
    places = noisy(400, deviation, seed)
    if step:
        places = step * np.round(places / step)
    assert first_still(places, acceleration=(0.3, 0.2, -0.1), velocity=(0.01, 0.0, 0.01)) == (math.inf, -1)


@given(
    axis=AXES, amplitude=st.floats(1e-5, 0.05), seconds=st.floats(0.3, 5.0), period=st.sampled_from([0.01, 0.02, 0.05])
)
@settings(max_examples=15)
def test_a_coordinate_at_rest_may_repeat_for_ever_beside_one_that_swings_without_noise(
    axis: int, amplitude: float, seconds: float, period: float
) -> None:
    turns = 40
    times = np.arange(0.0, turns * seconds / 2.0, period)[:, np.newaxis]
    places = amplitude * np.sin(2.0 * np.pi * times / seconds * [1.0, 0.8, 0.6])
    places[:, axis] = 1.0
    assert first_still(places, period=period) == (math.inf, -1)


@given(axis=AXES, commanded=st.floats(-5.0, 5.0))
@settings(max_examples=25)
def test_a_coordinate_of_a_smooth_flight_that_stands_still_is_an_old_one_if_it_is_told_to_move(
    axis: int, commanded: float
) -> None:
    times = PERIOD * np.arange(100)[:, np.newaxis]
    places = times**3 * [1.0, 2.0, 3.0]  # from rest
    places[:, axis] = 1.0
    acceleration = np.where(np.arange(3) == axis, commanded, 0.0).tolist()
    since, found = first_still(places, acceleration=acceleration)
    size = abs(commanded)
    limit = 0.15 if size >= 0.05 else 0.6 if size >= 1e-3 else math.inf
    assert since == pytest.approx(limit, abs=2.0 * PERIOD)
    assert found == (axis if math.isfinite(limit) else -1)


@given(axis=AXES, begin=st.integers(10, 400), commanded=st.floats(1e-3, 2.0), delay=st.integers(1, 14))
@settings(max_examples=25)
def test_a_coordinate_that_rests_in_a_flight_without_noise_may_wait_for_what_is_commanded_at_last(
    axis: int, begin: int, commanded: float, delay: int
) -> None:
    number = np.arange(500)[:, np.newaxis]
    places = (PERIOD * number) ** 3 * [1.0, 2.0, 3.0]
    places[:, axis] = 1.0 + PERIOD**2 * commanded * np.maximum(number[:, 0] - begin - delay, 0) ** 2 / 2.0
    acceleration = commanded * (number >= begin) * (np.arange(3) == axis)
    assert first_still(places, acceleration=acceleration) == (math.inf, -1)
    places[:, axis] = 1.0
    since, found = first_still(places, acceleration=acceleration)
    limit = 0.15 if commanded >= 0.05 else 0.6
    assert since <= begin * PERIOD + limit + 2.0 * PERIOD
    assert found == axis


@given(axis=AXES, speed=st.floats(0.4, 2.0), sign=st.sampled_from([-1.0, 1.0]), period=st.sampled_from([0.01, 0.02]))
@settings(max_examples=15)
def test_in_poses_of_whole_millimetres_a_moving_coordinate_does_not_stand_still(
    axis: int, speed: float, sign: float, period: float
) -> None:
    way = sign * speed * period * np.maximum(np.arange(200) - 100, 0)[:, np.newaxis]
    whole = 1e-3 * np.round((way + noisy(200, 5e-4, 1)) / 1e-3)
    flight = {"velocity": [sign * speed] * 3, "period": period, "begin": 110}
    assert first_still(whole, **flight)[1] == -1
    whole[110:, axis] = whole[110, axis]
    since, found = first_still(whole, **flight)
    assert (since < 110 * period + 0.3, found) == (True, axis)


def test_a_whole_position_that_repeats_and_what_is_not_commanded_are_other_matters() -> None:
    assert first_still(np.ones((200, 3)), acceleration=(1.0, 1.0, 1.0)) == (math.inf, -1)
    along_x = np.outer(np.arange(200.0), [1e-2, 0.0, 0.0])
    assert first_still(along_x, acceleration=(1.0, 0.0, 0.0), velocity=(1.0, 0.0, 0.0)) == (math.inf, -1)


@given(
    amplitude=st.floats(0.0, 5e-3),
    velocity=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    acceleration=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
)
@settings(max_examples=15)
def test_of_a_hover_without_noise_in_poses_of_whole_millimetres_nothing_is_taken_for_old(
    amplitude: float, velocity: tuple[float, ...], acceleration: tuple[float, ...]
) -> None:
    sway = 1.0 + amplitude * np.sin(2.0 * PERIOD * np.arange(300)[:, np.newaxis] * [1.0, 1.7, 2.3])
    whole = 1e-3 * np.round(sway / 1e-3)
    assert first_still(whole, velocity=velocity, acceleration=acceleration) == (math.inf, -1)


@given(
    axis=AXES,
    push=st.floats(-0.5, 0.5),
    step=st.sampled_from([-1, 1]),
    earlier=st.lists(st.integers(0, 180), max_size=4),
)
@settings(max_examples=15)
def test_what_the_last_step_of_rounded_poses_had_a_drone_commanded_is_not_what_balances_it(
    axis: int, push: float, step: int, earlier: list[int]
) -> None:
    """In whole millimetres each step is taken for a start, and braked with 0.12 m/s^2, beside the push of the wind."""
    begin, along = 200, (np.arange(3) == axis).astype(float)
    places = 1e-3 * np.round(noisy(800, 4e-4, 1) / 1e-3)
    places[:, axis] = 0.0
    kicks = np.zeros((len(places), 1))
    for number in [*sorted(earlier), begin]:
        step = -step
        places[number:, axis] += 1e-3 * step
        kicks[number:, 0] = step * np.exp(-PERIOD * np.arange(len(places) - number) / 0.1)
    commanded, speed = (-push - 0.12 * kicks) * along, 0.017 * kicks * along
    assert first_still(places, acceleration=commanded, velocity=speed) == (math.inf, -1)
    commanded[begin + 50 :] += along
    since, found = first_still(places, acceleration=commanded, velocity=speed)
    assert (0.5 < since - begin * PERIOD < 2.0, found) == (True, axis)


def test_what_a_drone_did_before_it_stood_moves_nothing_when_it_flies() -> None:
    """In whole millimetres, without noise, y repeats from a touch-down on, and goes on to in the next climb."""
    stillness = Stillness(1)
    for number in range(1300):
        time, climbing = number * PERIOD, max(number * PERIOD - 12.0, 0.0)
        place = (1e-3 * round(12.0 * climbing), 0.1, 1e-3 * round(300.0 * climbing))
        estimate = [0.0, 0.0, 0.0, 0.0, 0.2 if number < 10 else 0.0, 0.0, 0.0, 0.0, 0.0]
        assert stillness.look(0, time, place, (0.0, 0.0, 0.3), estimate, climbing > 0.0) is None
