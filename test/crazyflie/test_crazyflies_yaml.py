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
        Robot("cf7", "radio://*/90/1M?safelink=0", (0.0, 0.0, 0.0), ""),
    ]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("fileversion: 3\nrobots: {cf1: {uri: 'udp://a:1'}}", []),
        ("robots: {cf1: {uri: 'udp://a:1'}}", ["has no fileversion: its robots are read as those of version 3"]),
        (
            "fileversion: 3\nrobots: {cf1: {uri: 'udp://a:1', type: cf21, id: 0x01}, me: {type: marker, id: 01,\n"
            "initial_position: [01, here, 1_0]}, cf2: {enabled: false, id: 02, initial_position: , type: 0x1}}\n"
            "robot_types: {cf21: {big_quad: false}, marker: {connection: none, marker_id: 017}}",
            ["me is tracked, not flown: connection: none; name it in other_poses to keep drones away"],
        ),
    ],
)
def test_what_a_file_leaves_open_and_whom_it_does_not_fly_is_told(text: str, told: list[str], tmp_path: Path) -> None:
    sentences: list[str] = []
    assert [robot.name for robot in read_crazyflies(write(tmp_path, text), sentences.append)] == ["cf1"]
    assert len(sentences) == len(told)
    assert all(sentence.endswith(expected) for sentence, expected in zip(sentences, told, strict=True))


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
        ("fileversion: 4\nrobots: {cf1: {}}", "fileversion = 4: must be one of 1, 2, 3"),
        (
            "crazyflies: [{id: 44, channel: 100, initialPosition: [0, 0, 0], type: default}]",
            r"crazyswarm 1: must be robots.* cf44: \{enabled: true, uri: radio://0/100/2M/E7E7E7E72C, .*: cf21\}$",
        ),
        ("crazyflies: here", "crazyflies is the list of crazyswarm 1: must be robots"),
        ("robots: {me: {type: marker}}\nrobot_types: {marker: {connection: none}}", "one that is enabled and flies"),
        (
            "robots: {cf1: {type: a}}\nrobot_types: {a: {connection: usb}}",
            "connection = 'usb': must be crazyflie or none",
        ),
        (
            "robots: {cf1: {type: markr}}\nrobot_types: {marker: {connection: none}}",
            r"robots\.cf1\.type = 'markr': must be one of robot_types; the nearest is marker",
        ),
        ("robots: {cf1: {uri: 'udp://a:1'}, cf2: {uri: }}", r"robots\.cf2 has no uri, others have: must have one, be"),
        ("robots:\n  cf1: {}\n  cf1: {}", "cannot be read: line 3: key 'cf1' stands there twice"),
        ("robots: {cf1: }", r"robots\.cf1 is empty: must be enabled, uri, initial_position and type"),
        ("robots: {cf1: {initial_position: }}", r"robots\.cf1\.initial_position is empty: must be \[x, y, z\], in m"),
        ("robots: {cf1: {enabled: }}", r"robots\.cf1\.enabled is empty: must be true or false"),
        *(
            (
                f"robots: {{cf1: {{initial_position: [{number}, 0, 0]}}}}",
                rf"an entry of robots\.cf1\.initial_position = '{number}' m: must be a plain decimal number",
            )
            for number in ("01", "1_0", "0x1", "1:30", "1e3", "0o7")
        ),
        ("fileversion: 03\nrobots: {cf1: {}}", "fileversion = '03': must be one of 1, 2, 3"),
        ("robots: {1: {}}", "cannot be read: line 1: .*must be text"),
    ],
)
def test_what_is_not_such_a_file_is_refused(text: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(FlatsatError, match=complaint):
        read_crazyflies(write(tmp_path, text))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FlatsatError, match="cannot be read"):
        read_crazyflies(tmp_path / "none.yaml")
