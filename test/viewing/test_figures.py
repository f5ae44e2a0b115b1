"""The figures of a flight against flights whose figures are known."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.figures import COLUMNS, figures_of, separation
from flatsat_ros.viewing.flight import POSE_FIELDS, Channel, Flight, LoggedEvent, Track, with_mode_events

TIMES = np.arange(0.0, 10.0, 0.1)


def poses(place: np.ndarray) -> Channel:
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (len(place), 1))
    return Channel(POSE_FIELDS, np.column_stack([TIMES[: len(place)], place, turn]))


def ticks(**columns: object) -> Channel:
    rows = np.zeros((TIMES.size, len(FIELDS)))
    for name, values in columns.items():
        rows[:, FIELDS.index(name)] = values
    return Channel(FIELDS, np.column_stack([TIMES, rows]))


def figures(track: Track) -> dict[str, float | None]:
    (row,) = figures_of(Flight("", [track]))["rows"]
    return dict(zip([column.name for column in COLUMNS], row["values"], strict=True))


def test_errors_are_those_in_flight_and_shares_count_from_two_seconds_after_lift_off() -> None:
    flying = (TIMES >= 1.0) & (TIMES < 8.0)
    found = figures(
        Track(
            "cf1",
            {
                "tick": ticks(
                    mode=np.where(flying, Mode.FLY, Mode.REST),
                    error_x=np.where(flying, 0.03, 9.0),
                    error_y=np.where(flying, 0.04, 9.0),
                    guaranteed=(TIMES >= 5.0) & flying,
                    T=np.where(flying, 9.0 + TIMES, 0.0),
                    phi=np.where(flying, 0.1, 2.0),
                )
            },
        )
    )
    assert found["error RMS"] == found["error max"] == pytest.approx(5.0)
    assert found["guaranteed"] == pytest.approx(60.0)  # 5 to 8 s of 3 to 8 s
    assert (found["T min"], found["T max"]) == pytest.approx((10.0, 16.9))
    assert found["tilt max"] == pytest.approx(np.degrees(0.1))


def test_a_reference_that_sinks_through_the_floor_to_land_makes_no_error() -> None:
    height = np.clip(1.0 - 0.2 * TIMES, 0.0, None)
    reference = 0.98 - 0.2 * TIMES  # sinks on when the drone stands
    place = np.column_stack([np.zeros((TIMES.size, 2)), height])
    found = figures(Track("cf1", {"pose": poses(place), "tick": ticks(mode=Mode.FLY, error_z=height - reference)}))
    assert found["error RMS"] == pytest.approx(2.0)
    assert found["error max"] == pytest.approx(2.0)


@pytest.mark.parametrize("absurd", [1e200, -1e308, np.inf, np.nan])
def test_telemetry_that_cannot_be_true_makes_no_noise(absurd: float) -> None:
    channel = ticks(mode=Mode.FLY, **dict.fromkeys(["error_x", "error_y", "T", "phi", "gamma", "tick_us"], absurd))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert figures(Track("cf1", {"tick": channel}))["guaranteed"] == 0.0


def test_what_is_not_recorded_is_left_open() -> None:
    assert set(figures(Track("cf1", {})).values()) == {None}
    grounded = figures(Track("cf1", {"tick": ticks(mode=Mode.IDLE, tick_us=7.0)}))
    assert grounded.pop("tick 99 %") == 7.0
    assert set(grounded.values()) == {None}


@given(st.integers(0, 2**32 - 1), st.integers(2, 4))
def test_the_smallest_distance_is_that_of_the_nearest_pair(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    places = random.normal(size=(count, TIMES.size, 3))
    flight = Flight("", [Track(str(i), {"pose": poses(place)}) for i, place in enumerate(places)])
    nearest = separation(flight)
    assert nearest is not None
    distance, one, other, time = nearest
    assert one != other
    at_samples = min(np.linalg.norm(places[i] - places[j], axis=1).min() for i in range(count) for j in range(i))
    assert distance <= at_samples + 1e-9
    between = [np.array([np.interp(time, TIMES, places[int(k)][:, axis]) for axis in range(3)]) for k in (one, other)]
    assert distance == pytest.approx(np.linalg.norm(between[0] - between[1]), abs=1e-6)


def test_one_drone_has_no_distance_and_a_gap_says_nothing() -> None:
    apart = np.zeros((TIMES.size, 3))
    assert separation(Flight("", [Track("a", {"pose": poses(apart)})])) is None
    late = Channel(POSE_FIELDS, poses(apart).samples[[0, 1, -2, -1]] + [0.0, 5.0, 0, 0, 0, 0, 0, 0])
    late.samples[1, 1] = 1.0  # near, but in the middle of the gap they might meet
    nearest = separation(Flight("", [Track("a", {"pose": poses(apart)}), Track("b", {"pose": late})]))
    assert nearest is not None
    assert nearest[3] <= 0.1 or nearest[3] >= 9.7


def test_changes_of_modes_are_events_in_the_order_of_time() -> None:
    modes = np.select([TIMES < 1.0, TIMES < 5.0], [Mode.IDLE, Mode.FLY], Mode.LEVEL)
    flight = Flight("", [Track("cf1", {"tick": ticks(mode=modes)})], [LoggedEvent(2.0, "", "warning", "windy")])
    events = with_mode_events(flight).events
    assert [(event.text, event.severity) for event in events] == [
        ("IDLE → FLY", "info"),
        ("windy", "warning"),
        ("FLY → LEVEL", "error"),
    ]
    assert events[0].time == pytest.approx(1.0)
