"""Files that say what is asked; wrong ones are refused in one line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from asked_missions import CERTIFICATE, LIMITS, written

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.planning import Wishes, read_mission

BOXED = "drones: {{a: [[0, 0, 1], [1, 0, 1]]}}\nobstacles: {{wall: {{type: {}}}}}\n"
JSON = {
    "quadrotors": {"crazyflie": {"radius": 0.1, "downwash": 3.0, "max_vel": [1, 1, 1]}},
    "world": [{"dimension": [-2, -2, 0.2, 2, 2, 2.5]}],
    "agents": [
        {"type": "crazyflie", "cid": 7, "start": [0, 0, 1], "goal": [1, 0, 1]},
        {"type": "crazyflie", "start": [1, 1, 1], "goal": [0, 1, 1]},
    ],
    "obstacles": [],
}


def test_files_say_what_is_asked(tmp_path: Path) -> None:
    table = "x,y,z,yaw,t\n0,0,-0.2,1.5,3\n0,0,1,1.5,7\n"
    one = read_mission(written(tmp_path, "a.csv", table), CERTIFICATE, Wishes(), "a")
    assert one.bounds.lower.tolist() == [-0.5, -0.5, -0.2]  # the floor is at the first row's height
    assert one.drones[0].yaw == 1.5
    assert one.times is not None
    assert one.times.tolist() == [0.0, 4.0]
    assert one.bounds.margin == LIMITS.inner_radius / 2
    many = "drones: {a: [[0, 0, 1], [1, 0, 1]], b: [[0, 1, 1], [1, 1, 1]]}\nbody: 0.1\ntimes: [0, 5]\n"
    two = read_mission(written(tmp_path, "b.yaml", many), CERTIFICATE, Wishes(floor=0.1, tube=0.07), "b")
    assert [drone.name for drone in two.drones] == ["a", "b"]
    assert two.distances.tolist() == [[0.0, pytest.approx(0.34)], [pytest.approx(0.34), 0.0]]
    assert two.bounds.lower[2] == 0.1
    assert two.laps is None
    loop = written(tmp_path, "d.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 1]]}\nlaps: 4\n")
    assert read_mission(loop, CERTIFICATE, Wishes(), "d").laps == 4
    assert read_mission(loop, CERTIFICATE, Wishes(laps=2), "d").laps == 2
    three = read_mission(written(tmp_path, "c.json", json.dumps(JSON)), CERTIFICATE, Wishes(), "c")
    assert [drone.name for drone in three.drones] == ["cf7", "cf2"]
    assert (three.downwash, three.bounds.upper.tolist()) == (3.0, [2.0, 2.0, 2.5])


def test_goals_are_gone_to_from_present_places(tmp_path: Path) -> None:
    places = {"a": [0.0, 0.0, 1.5], "b": [1.0, 0.0, 0.4]}

    def present(names: Sequence[str]) -> dict[str, list[float]]:
        assert list(names) == ["a", "b"]
        return places

    goals = written(tmp_path, "a.yaml", "drones: {a: [[1, 1, 1]], b: [0, 1, 0.5]}\n")
    found = read_mission(goals, CERTIFICATE, Wishes(), "a", present)
    assert found.waypoints.tolist() == [[[0, 0, 1.5], [1, 1, 1]], [[1, 0, 0.4], [0, 1, 0.5]]]
    assert found.bounds.lower.tolist() == [-0.5, -0.5, 0.4]  # the lowest place of all
    near = written(tmp_path, "b.yaml", "drones: {a: [[1, 1, 1]], b: [0, 1, 0.5]}\nbody: 0.6\n")
    for path, text in (
        (near, "distance of a and b at way-point 2 = 1.03"),
        (
            written(tmp_path, "c.yaml", "drones: {a: pp1.csv, b: [0, 1, 1]}\n"),
            "goals of a = 'pp1.csv': must be a place",
        ),
        (written(tmp_path, "d.csv", "x,y,z\n0,0,1\n0,1,1\n"), "must be one whose name ends in .yaml: goals of drones"),
    ):
        with pytest.raises(FlatsatError, match=text):
            read_mission(path, CERTIFICATE, Wishes(), "a", present)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.csv", "0,0,1\n1,1,1\n", "first line = '0,0,1': must be the names of the columns"),
        ("a.csv", "x,y,z\n0,0,1\n1,one,1\n", "way-point 2 = '1,one,1': must be numbers"),
        ("a.csv", "x,y,z\n0,0,1\n1,1\n", "way-point 2 = '1,1': must be 3 numbers"),
        ("a.csv", "x,y,z\n0,0,1\n1,1,nan\n", "way-point 2 = '1,1,nan': must be finite numbers"),
        ("a.csv", "x,y,z,yaw\n0,0,1,0\n1,1,1,1\n", r"yaw = \[0.0, 1.0\] rad: must be the same in all lines"),
        ("a.csv", "x,y,z\n0,0,1\n0,0,0.9\n", "z of way-point 2 of cf1 = 0.9 m: must be from 1 to 1.5 m"),
        ("a.csv", "x,y,z,t\n0,0,1,2\n0,0,1.2,2\n", "times of way-points = .* s: must be increasing from 0"),
        (
            "a.csv",
            "x,y,z,radius\n0,0,1,0.1\n0,0,1.2,0\n",
            r"radii of start and goal of cf1 = \[0.1, 0.0\] m: must be 0",
        ),
        (
            "a.csv",
            "x,y,z,radius\n0,0,1,0\n0,1,1,-1\n0,0,1.2,0\n",
            "smallest radius of cf1 = -1.0 m: must be at least 0",
        ),
        ("a.csv", "x,y,z\n0,0,1\n1e308,0,1\n", r"a way-point of cf1 = 1e\+308 m: must be within 500 m"),
        (
            "a.csv",
            "x,y,z\n0,0,1\n0,0,1\n",
            "distance of way-point 2 of cf1 from the one before = 0.0 m: must be at least",
        ),
        ("a.yaml", "drones: [1]", "drones = .*: must be a mapping from names"),
        ("a.yaml", "drones: {}", "drones = {}: must be a mapping from names"),
        ("a.yaml", "drones: {a b: [[0, 0, 1], [1, 0, 1]]}", "name of a drone = 'a b': must be a letter, then letters"),
        ("a.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1]]}\nbody: -1", "body = -1 m: must be a number above 0"),
        ("a.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1]]}\nspeed: 1.0", "unknown key 'speed'"),
        ("a.json", "{", "cannot be read"),
        (
            "a.json",
            json.dumps(JSON | {"obstacles": [{"type": "chasing"}]}),
            "type of obstacle obstacle1 = 'chasing': must be 'box'",
        ),
        ("a.yaml", "drones: {a: [[0, 0, 1], [1, 0, 1]]}\nobstacles: [1]", r"obstacles = \[1\]: must be a mapping from"),
        ("a.yaml", BOXED.format("mesh, file: a.stl"), "type of obstacle wall = 'mesh': must be 'box'"),
        ("a.yaml", BOXED.format("box, lower: [0, 0, 0], upper: [1, 0, 1]"), "upper y of wall = 0.0 m: must be above"),
        ("a.yaml", BOXED.format("box, lower: [0, 0, 0]"), "obstacle wall: key 'upper' is missing"),
        (
            "a.yaml",
            BOXED.format("box, lower: [1.1, -1, 0], upper: [1.3, 1, 2]"),
            "distance of a from wall at way-point 2 = 0.1 m: must be at least 0.2 m, body, tube",
        ),
        ("a.json", json.dumps(JSON | {"agents": [{"type": "crazyflie", "start": [0, 0, 1]}]}), "goal is missing"),
        ("a.json", json.dumps(JSON | {"agents": [{"type": 10**400, "start": 0, "goal": 0}]}), "quadrotors: must be"),
        ("a.json", json.dumps(JSON).replace("{", '{"agents": 0, ', 1), "key 'agents' stands there twice"),
        (
            "a.yaml",
            f"drones: {{a: [[0, 0, 1], [1, 0, 1]]}}\nobstacles: {{{'w' * 600}: {{type: box, lower: 1, upper: 2}}}}",
            r"w\.\.\. = \(\): must be",
        ),
        ("a.txt", "", "must be one whose name ends in .csv, .yaml, .json"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, name: str, text: str, reason: str) -> None:
    path = written(tmp_path, name, text)
    with pytest.raises(FlatsatError, match=reason) as refused:
        read_mission(path, CERTIFICATE, Wishes(), "a")
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < len(str(path)) + 500
