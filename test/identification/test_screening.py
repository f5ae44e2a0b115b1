"""Every fault of a log is found, counted and masked, and nothing else is."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.identification.log import FlightLog
from flatsat_ros.identification.screening import STEP, Samples, screen, smooth_velocity

FAULTY = slice(400, 430)  # 0.3 s


def changed(log: FlightLog, **fields: Callable[[np.ndarray], object]) -> FlightLog:
    """The log with copies of some of its arrays changed in place."""
    arrays = {name: getattr(log, name).copy() for name in fields}
    for name, change in fields.items():
        change(arrays[name])
    return replace(log, **arrays)


def setting(value: object, *columns: int) -> Callable[[np.ndarray], None]:
    """What sets the faulty rows, in some columns, to a value."""

    def change(array: np.ndarray) -> None:
        for column in columns:
            array[FAULTY, column] = value

    return change


def lines(array: np.ndarray) -> None:
    """Connect the ends of the faulty rows by straight lines, but keep the thrust."""
    share = np.linspace(0.0, 1.0, FAULTY.stop - FAULTY.start)[:, None]
    first, last = array[FAULTY.start, :2], array[FAULTY.stop - 1, :2] + 0.05
    array[FAULTY, :2] = first + share * (last - first)


def test_a_clean_log_is_usable_but_for_its_beginning(logs: list[FlightLog]) -> None:
    samples = screen(logs[0])
    assert samples.faults == {}
    assert samples.notes == ()
    assert samples.seconds == pytest.approx(12.0 - 0.6, abs=0.05)
    assert samples.pose_noise == pytest.approx(3e-4, rel=0.15)
    assert_allclose(samples.position[:-1], logs[0].position[: len(samples.position) - 1], atol=1e-6)
    assert_allclose(samples.command[5:-1], logs[0].command[5 : len(samples.command) - 1], atol=1e-12)


def test_stamps_that_are_rounded_otherwise_are_the_same(logs: list[FlightLog]) -> None:
    log = replace(logs[0], command_time=logs[0].command_time[::2], command=logs[0].command[::2])
    rounded = replace(log, command_time=log.command_time + np.resize((0.0, 1e-9, -1e-9), len(log.command_time)))
    assert_allclose(screen(rounded).command, screen(log).command, rtol=0.0, atol=0.0)


@pytest.mark.parametrize(
    ("fault", "count", "fields"),
    [
        ("without a position", 30, {"position": setting(np.nan, 0)}),
        ("with a pose that stands still", 30, {"position": lambda p: p.__setitem__(FAULTY, p[FAULTY.start])}),
        ("with a pose that jumps", 4, {"position": setting(5.0, 0)}),
        ("with an impossible command", 30, {"command": setting(70000.0, 2)}),
        ("with an impossible command", 30, {"command": setting(-1.0, 2)}),
        ("with an impossible command", 30, {"command": setting(np.nan, 1)}),
        ("with an impossible command", 30, {"command": setting(2.0, 0)}),
        ("with commands on a straight line", 30, {"command": lines}),
    ],
)
def test_a_fault_is_counted_and_masked(
    fault: str, count: int, fields: dict[str, Callable[[np.ndarray], object]], logs: list[FlightLog]
) -> None:
    samples, whole = screen(changed(logs[0], **fields)), screen(logs[0])
    # where a pose that stood still moves on, it jumps
    assert {fault} <= samples.faults.keys() <= {fault, "with a pose that jumps"}
    assert abs(samples.faults[fault] - count) <= 2
    masked = np.flatnonzero(whole.usable & ~samples.usable) * STEP
    begin, end = FAULTY.start * STEP, FAULTY.stop * STEP
    if "position" in fields:
        around = 0.2 if "with a pose that jumps" in samples.faults else 0.0
        assert 0.25 < len(masked) * STEP < 0.36 + 2.0 * around
        assert begin - 0.03 - around <= masked.min() <= masked.max() <= end + 0.03 + around
    else:
        assert len(masked) * STEP == pytest.approx(0.3 + 0.6, abs=0.05)  # the attitude still answers to what was there
        assert begin - 0.03 <= masked.min() <= masked.max() <= end + 0.63


def test_duplicated_rows_are_counted_and_change_nothing(logs: list[FlightLog]) -> None:
    log, rows = logs[0], np.sort(np.concatenate([np.arange(len(logs[0].pose_time)), np.arange(500, 550)]))
    twice = replace(
        log,
        **{name: getattr(log, name)[rows] for name in ("pose_time", "position", "angles", "command_time", "command")},
    )
    samples, whole = screen(twice), screen(log)
    assert samples.faults == {"duplicated or out of order": 50}
    for field in ("position", "angles", "command", "usable"):
        assert_allclose(getattr(samples, field), getattr(whole, field))


def test_a_gap_between_poses_is_not_filled(logs: list[FlightLog]) -> None:
    log = logs[0]
    kept = np.r_[0:400, 430 : len(log.pose_time)]
    gone = replace(log, pose_time=log.pose_time[kept], position=log.position[kept], angles=log.angles[kept])
    lost = np.count_nonzero(screen(log).usable & ~screen(gone).usable) * STEP
    assert lost == pytest.approx(0.3, abs=0.03)


def test_what_stands_on_the_ground_is_no_flight(logs: list[FlightLog]) -> None:
    def stand(position: np.ndarray) -> None:
        position[:300] = np.array([0.0, 0.0, 0.05]) + 1e-5 * np.arange(900).reshape(300, 3)
        rising = np.linspace(0.0, 1.0, 60)[:, None]
        position[300:360] = position[299] + rising * (position[360] - position[299])

    grounded = changed(logs[0], position=stand, command=lambda command: command[:250].__setitem__((..., 2), 0.0))
    samples = screen(grounded)
    assert not samples.usable[:300].any()
    assert samples.usable[450:].all()


def test_interpolated_commands_are_said(logs: list[FlightLog]) -> None:
    def halve(command: np.ndarray) -> None:
        rows = np.arange(len(command))
        for column in range(3):
            command[:, column] = np.interp(rows, rows[::4], command[::4, column])

    assert any("interpolated" in note for note in screen(changed(logs[0], command=halve)).notes)


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"command": lambda c: c.__setitem__((..., 1), -c[:, 1])}, "pitch answers with the opposite sign"),
        ({"angles": lambda a: a.__setitem__((..., 0), -a[:, 0])}, "roll answers with the opposite sign"),
        (
            {"command": lambda c: c.__setitem__((..., 0), c[:, 0] / 57.3)},
            "roll moves .* in degrees and read as radians",
        ),
        ({"angles": lambda a: a.__imul__(57.3)}, "roll moves .* in degrees and read as radians"),
        ({"command": lambda c: c.__setitem__((..., 2), 40000.0)}, "the commanded thrust never changes"),
        ({"angles": lambda a: a.fill(np.nan)}, "it has no orientation"),
        (
            {"position": lambda p: p[:-400].fill(np.nan)},
            "only 4.0 s of flight are usable .800 rows without a position.",
        ),
        (
            {name: lambda t: t[-1:].fill(1e9) for name in ("pose_time", "command_time")},
            "duration = 1000000000.0 s: must be at most 3600 s",
        ),
        (
            {"pose_time": lambda t: t.__imul__(-1.0)},
            "poses are earlier than one before: must be in the order of time",
        ),
        (
            {"command_time": lambda t: t[100:].fill(0.0)},
            r"[0-9] of [0-9]+ commands are earlier than one before",
        ),
        (
            {"position": lambda p: p.__imul__(1000.0)},
            "poses are faster than 8 m/s: must have positions in m; of others",
        ),
        ({"command_time": lambda t: t.__iadd__(1000.0)}, "have less than 5.0 s in common"),
    ],
)
def test_a_log_that_tells_nothing_or_the_wrong_thing_is_refused(
    fields: dict[str, Callable[[np.ndarray], object]], complaint: str, logs: list[FlightLog]
) -> None:
    with pytest.raises(FlatsatError, match=complaint) as refusal:
        screen(changed(logs[0], **fields))
    assert logs[0].name in str(refusal.value)


def test_velocity_is_exact_for_cubics_and_yaw_has_no_jumps(logs: list[FlightLog]) -> None:
    time = np.arange(200) * STEP
    place = np.stack([time**3, time**2 - time, np.ones_like(time)], axis=-1)
    assert_allclose(
        smooth_velocity(place), np.stack([3.0 * time**2, 2.0 * time - 1.0, np.zeros_like(time)], -1), atol=1e-9
    )
    turning = changed(
        logs[0], angles=lambda a: a.__setitem__((..., 2), np.angle(np.exp(1j * np.linspace(0.0, 20.0, len(a)))))
    )
    samples: Samples = screen(turning)
    assert np.abs(np.diff(samples.angles[:, 2])).max() < 0.1
    assert dataclasses.is_dataclass(samples)
