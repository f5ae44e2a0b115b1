"""The demo on simulated time as a user starts it, and the figures it computes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from demo_output import KEYS, PICTURES, ROBOT_KEYS

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.cli import demo

pytestmark = pytest.mark.in_process


def fly(folder: Path, *arguments: str) -> dict[str, object]:
    """Fly headless and return summary.json."""
    assert demo.main(["--headless", "--output", str(folder), *arguments]) == 0
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


def test_the_headless_swap_keeps_the_promises_and_writes_everything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = fly(tmp_path, "--paper")
    assert set(summary) == KEYS
    robots = summary["robots"]
    assert isinstance(robots, dict)
    assert list(robots) == ["cf1", "cf2", "cf3"]
    assert all(set(robot) == ROBOT_KEYS for robot in robots.values())
    assert [robot["rms_paper_m"] for robot in robots.values()] == [0.0703, 0.0826, 0.0602]
    assert all(0.0 < robot["rms_m"] < 0.10 for robot in robots.values())
    assert all(robot["landed"] for robot in robots.values())
    assert all(GRAVITY < robot["thrust_max"] <= 1.45 * GRAVITY for robot in robots.values())
    assert (summary["violations"], summary["dynamics"], summary["rate_hz"], summary["seconds"]) == (
        0, "identified", 10.0, 12.0,
    )  # fmt: skip
    assert all((tmp_path / name).stat().st_size > 10_000 for name in PICTURES)
    printed = capsys.readouterr().out
    assert all(f"{100 * robot['rms_m']:.2f}" in printed for robot in robots.values())


def test_by_default_the_drones_stay_in_their_tubes_which_are_claimed_nearly_all_the_time(tmp_path: Path) -> None:
    summary = fly(tmp_path)
    robots = summary["robots"]
    assert isinstance(robots, dict)
    for robot in robots.values():
        assert set(robot) == ROBOT_KEYS
        assert robot["guaranteed_share"] >= 0.95
        assert 0.0 < robot["error_max_m"] < robot["tube_m"] < 0.1
        assert 0.0 < robot["error_z_max_m"] < robot["tube_z_m"] < 0.1
        assert robot["rms_m"] < 0.02
        assert robot["landed"]
    assert (summary["violations"], summary["rate_hz"]) == (0, 50.0)


def test_the_headless_flight_repeats_itself_and_one_drone_has_no_separation(tmp_path: Path) -> None:
    first, second = (fly(tmp_path / name, "--paper", "--seconds", "4", "--robots", "1") for name in "ab")
    assert first["robots"] == second["robots"]
    assert first["separation_min_m"] is None


def test_other_numbers_rates_and_dynamics_fly_too(tmp_path: Path) -> None:
    summary = fly(tmp_path, "--paper", "--robots", "5", "--rate", "50", "--dynamics", "ideal", "--seconds", "5")
    robots = summary["robots"]
    assert isinstance(robots, dict)
    assert len(robots) == 5
    assert all(robot["rms_m"] < 0.02 and robot["rms_paper_m"] is None for robot in robots.values())
    assert (summary["rate_hz"], summary["seconds"], summary["dynamics"]) == (50.0, 8.0, "ideal")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--robots", "0"], "--robots = 0: must be from 1 to 64"),
        (["--paper", "--robots", "65"], "--robots = 65: must be from 1 to 64"),
        (["--robots", "4", "--seconds", "5"], "--seconds: not used with --robots"),
        (["--plan", "plan.yaml", "--robots", "4"], "--robots: not used with --plan"),
        (["--wind", "0.5"], "--wind: used with --plan or --robots only"),
        (["--paper", "--robots", "4", "--wind", "0.5"], "--wind: used with --plan or --robots only"),
        (["--seconds", "-1"], "--seconds = -1.0 s: must be above 0 and at most 3600"),
        (["--seconds", "nan"], "--seconds = nan s"),
        (["--paper", "--rate", "0.2"], "--rate = 0.2 Hz: must be from 1 to 500"),
        (["--rate", "50"], "--rate: not used without --paper"),
        (["--dynamics", "ideal"], "--dynamics ideal: not used without --paper"),
        (["--console"], "--console: not used with --headless"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(
    arguments: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo.main(["--headless", "--output", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
