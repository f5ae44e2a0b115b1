"""The user's crazyflies.yaml: names, addresses, positions and types of the enabled robots, and clear refusals."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzzing.crazyflies import EXAMPLE

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.crazyflies_yaml import Robot, read_crazyflies


def write(folder: Path, text: str) -> Path:
    path = folder / "crazyflies.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_enabled_robots_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    assert read_crazyflies(write(tmp_path, EXAMPLE)) == [
        Robot("cf231", "radio://0/80/2M/E7E7E7E7E7", (0.0, -0.5, 0.0), "cf21"),
        Robot("cf6", "udp://127.0.0.1:19850", (0.0, 0.0, 0.0), "cf21"),
        Robot("cf7", "", (0.0, 0.0, 0.0), ""),
    ]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("robots: [cf1]", r"robots = \['cf1'\]: must be a mapping from names to settings"),
        ("- cf1", "robots = None: must be a mapping"),
        ("robots: {cf1: true}", r"robots\.cf1 = True: must be a mapping"),
        ("robots: {cf1: {enabled: 1}}", r"robots\.cf1\.enabled = 1: must be true or false"),
        ("robots: {cf1: {enabled: false}}", r"robots = \['cf1'\]: must be at least one that is enabled"),
        (
            "robots: {cf1: {initial_position: [0, 0]}}",
            r"shape of robots\.cf1\.initial_position = \(2,\): must be \(3,\)",
        ),
        ("robots: {cf1: {initial_position: [0, .nan, 0]}}", r"an entry of robots\.cf1\.initial_position = nan"),
        ("robots: {cf1: {initial_position: [[0, 0, 0]]}}", r"initial_position = \(1, 3\): must be \(3,\): x, y, z"),
        ("robots: {cf1: {initial_position: [1.0e+300, 0, 0]}}", r"initial_position = 1e\+300 m: must be a number from"),
        (
            "robots: {cf1: {initial_position: here}}",
            r"robots\.cf1\.initial_position = 'here': must be an array of numbers",
        ),
        ("robots: {cf1: {", "cannot be read"),
    ],
)
def test_what_is_not_such_a_file_is_refused(text: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(FlatsatError, match=complaint):
        read_crazyflies(write(tmp_path, text))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FlatsatError, match="cannot be read"):
        read_crazyflies(tmp_path / "none.yaml")
