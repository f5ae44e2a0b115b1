"""The figures of a flight's record, and what of them breaks a promise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flatsat_ros.demo.record import FlightRecord, RobotRecord, failures
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(14.0, 0.2)


def record(
    offset: float = 0.0,
    thrust: float = 10.0,
    roll: float = 0.0,
    second: float = 1.0,
    end: Mode = Mode.IDLE,
    height: float = 0.0,
) -> FlightRecord:
    """Two drones that hover `offset` off their references, `second` metres apart, and are at last at that height."""
    times = np.arange(0.0, 5.0, 0.1)
    row = np.zeros(1 + len(FIELDS))
    row[1 + FIELDS.index("T")], row[1 + FIELDS.index("mode")] = thrust, Mode.FLY
    robots = {}
    for name, x in (("a", 0.0), ("b", second)):
        poses = np.stack([times, np.full_like(times, x + offset), 0.0 * times, 0.0 * times + 1.0], axis=1)
        ticks = np.tile(row, (len(times), 1))
        ticks[:, 0] = ticks[:, 1 + FIELDS.index("gamma")] = times
        poses[-1, 3], ticks[-1, 1 + FIELDS.index("mode")] = height, end
        commands = np.tile([0.0, thrust, roll, 0.0, 0.0], (len(times), 1))
        robots[name] = RobotRecord(poses, ticks, commands, Trajectory.hold([x, 0.0, 1.0]))
    return FlightRecord(robots, LIMITS, 2.0, 0.05, 10.0, 10.0, "ideal", (1.0, 4.0))


def test_the_tracking_error_is_the_distance_to_the_reference() -> None:
    summary = record(offset=0.07).summary()
    assert [robot["rms_m"] for robot in summary["robots"].values()] == pytest.approx([0.07, 0.07])
    assert failures(summary) == []


def test_ten_centimetres_break_the_promise() -> None:
    assert len(failures(record(offset=0.1001).summary())) == 2


@pytest.mark.parametrize("wrong", [{"thrust": 14.001}, {"roll": -0.2001}, {"thrust": float("nan")}])
def test_every_command_outside_the_limits_is_counted(wrong: dict[str, float]) -> None:
    summary = record(**wrong).summary()
    assert summary["violations"] == 100
    assert any("100 commands outside the limits" in sentence for sentence in failures(summary))


@pytest.mark.parametrize("right", [{"thrust": 14.0, "roll": 0.2}, {"thrust": 0.0}])
def test_commands_on_the_limits_and_resting_motors_are_within(right: dict[str, float]) -> None:
    assert record(**right).summary()["violations"] == 0


def test_the_final_gain_is_that_at_the_end_of_the_swap() -> None:
    assert [robot["gamma_final"] for robot in record().summary()["robots"].values()] == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize("state", [{"height": 0.051}, {"height": -0.051}, {"end": Mode.FLY}, {"end": Mode.CUT}])
def test_a_drone_that_does_not_rest_on_the_floor_breaks_the_promise(state: dict[str, Any]) -> None:
    summary = record(**state).summary()
    assert not any(robot["landed"] for robot in summary["robots"].values())
    assert failures(summary) == [f"{name}: does not stand on the floor, promised to land" for name in "ab"]


@pytest.mark.parametrize("state", [{"height": 0.049, "end": Mode.REST}, {"height": -0.049}])
def test_a_drone_at_rest_on_the_floor_landed(state: dict[str, Any]) -> None:
    assert failures(record(**state).summary()) == []


def test_the_separation_is_the_smallest_distance() -> None:
    assert record(second=0.8).summary()["separation_min_m"] == pytest.approx(0.8)
