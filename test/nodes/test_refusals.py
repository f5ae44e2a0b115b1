"""What nodes refuse at the start: in one line, with exit code 2, and before they touch any drone."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from flatsat_ros.identification.recording import COLUMNS
from flatsat_ros.nodes import programs

pytestmark = pytest.mark.in_process

HEADER = ",".join(COLUMNS) + "\n"
NO_ROBOTS = "parameter robot_names = []: must be of type string array and not empty"

CONTROLLER: list[tuple[dict[str, Any], str]] = [
    ({"mu": 2}, "decimal point"),
    ({"mu": -2.0}, "parameter mu = -2.0 1/s: must be from 0.0 to 100.0"),
    ({"mu": []}, "parameter mu = []: must be of type double and not empty"),
    ({"robots__cf1__mu": []}, "parameter robots.cf1.mu = []: must be a floating-point number"),
    ({"robot_names": []}, NO_ROBOTS),
    ({"pose_timeout": 0.6}, "parameter pose_timeout = 0.6 s: must be from 0.01 to 0.5"),
    ({"v_inf": 0.0}, "must be from"),
    ({"robots__cf1__mu": -1.0}, "must be from 0 to"),
    ({"robots__cf1__mu": 1}, "decimal point"),
    ({"gamma_max": 50.0}, "must be at most the certificate's"),
    ({"certificate": "paper_simulatoin"}, "paper_simulation"),
    ({"vehicle": "cf2x_2025"}, "lifts"),
    ({"backend": "rust"}, "auto, cpp, cflib"),
    ({"pose_source": "vicon"}, "auto, pose, poses, tf, odom"),
    ({"yaw_mode": "absolute"}, "parameter yaw_mode = 'absolute': must be one of rate, angle"),
]
SIM_DRONE: list[tuple[dict[str, Any], str]] = [
    ({"pose_rate": 50}, "decimal point"),
    ({"drop_out": 1.5}, "parameter drop_out = 1.5: must be from 0.0 to 1.0"),
    ({"robot_names": ["cf1", "cf1"]}, "must be given once"),
    ({"robot_names": []}, NO_ROBOTS),
    ({"wind": []}, "parameter wind = []: must be of type double array and not empty"),
    ({"wind": [1.0]}, "entries of parameter wind = 1: must be 3"),
    ({"wind": [0.0, 1e300, 0.0]}, "entry of parameter wind = 1e+300 m/s: must be a number from -100 to 100"),
    ({"start_positions": [0.0, 0.0, -1e12]}, "parameter start_positions = -1000000000000.0 m: must be"),
    ({"start_positions": [0.0, 1.0]}, "entries of parameter start_positions = 2: must be 3"),
    ({"dynamics": "wrong"}, "identified or ideal"),
    ({"vehicle": "wrong"}, "cf21"),
    ({"robots__cf9__vehicle": "cf21"}, "robots.cf9.vehicle: not known here; the nearest is robots.cf1.vehicle"),
    ({"robot_types__big__vehicle": "cf21"}, "parameter robot_types.big.vehicle: not known here"),
]
CFLIB_BRIDGE: list[tuple[dict[str, Any], str]] = [
    ({"uris": ["tcp://here"]}, "must be radio://"),
    ({"uris": ["udp://127.0.0.1:1", "udp://localhost:1"], "robot_names": ["cf1", "cf2"]}, "must be given once"),
    (
        {"uris": ["udp://127.0.0.1:1"], "robot_names": ["cf1", "cf2"]},
        "entries of parameter uris = 1: must be 2: one per robot",
    ),
    ({"robot_names": []}, NO_ROBOTS),
    ({"rate": 500.0, "spacing": 0.01}, "to fit 1 streams"),
    ({"on_shutdown": "fall"}, "stop, land"),
    ({"pose_rate": 10.0, "external_pose": "pose", "external_pose_topic": "pose"}, "own estimate"),
]
MOCAP_PLAYER: list[tuple[str | None, dict[str, Any], str]] = [
    (None, {}, "cannot be read"),
    ("t,x\n1,2\n", {}, "line 1"),
    (HEADER + "1,2,3,4,5,6,7,eight\n", {}, "line 2"),
    (HEADER + "1,2,3,4,5,6,7,8\n", {"topic": "/pose"}, "must be empty for a CSV"),
    (HEADER + "1,2,3,4,5,6,7,8\n", {"rate": 0.0}, "parameter rate = 0.0: must be from 0.001 to 1000.0"),
    (HEADER + "1,2,3,4,5,6,7,8\n", {"robot_name": "1cf"}, "the first a letter"),
]


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """How to run a program with parameters, `__` in a name for a dot, that it must refuse; returns the line."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def run(program: str, **parameters: object) -> str:
        arguments = [program, "--ros-args"]
        for name, value in parameters.items():
            text = str(value) if name == "uris" else str(value).replace("'", "")
            arguments += ["-p", f"{name.replace('__', '.')}:={text}"]
        assert getattr(programs, program)(arguments) == 2
        said = capfd.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        return said.err

    return run


@pytest.mark.parametrize(("parameters", "reason"), CONTROLLER)
def test_the_controller_refuses(refused: Any, parameters: dict[str, Any], reason: str) -> None:
    given = {"robot_names": ["cf1"], "pose_timeout": 0.5, "certificate": "paper_experiment"}
    assert reason in refused("controller", **{**given, **parameters})


def test_a_profile_that_cannot_lift_what_the_certificate_allows_is_refused_by_robot(
    refused: Any, root: Path, tmp_path: Path
) -> None:
    stock = (root / "config" / "vehicles" / "cf21.yaml").read_text(encoding="utf-8")
    heavy = tmp_path / "heavy.yaml"
    heavy.write_text(stock.replace("mass: 0.029", "mass: 0.032").replace("name: cf21", "name: heavy"), encoding="utf-8")
    said = refused("controller", robot_names=["cf1", "cf2"], robots__cf2__vehicle=heavy)
    assert "but cf2, vehicle 'heavy', lifts 13.73" in said


@pytest.mark.parametrize(("parameters", "reason"), SIM_DRONE)
def test_the_simulated_drones_refuse(refused: Any, parameters: dict[str, Any], reason: str) -> None:
    assert reason in refused("sim_drone", **parameters)


@pytest.mark.skipif(not find_spec("cflib"), reason="the bridge is an extra")
@pytest.mark.parametrize(("parameters", "reason"), CFLIB_BRIDGE)
def test_the_bridge_refuses(refused: Any, parameters: dict[str, Any], reason: str) -> None:
    # each its own: a bridge that is refused late keeps its links for as long as the process lives
    own = [f"udp://127.0.0.1:{19800 + CFLIB_BRIDGE.index((parameters, reason))}"]
    uris = json.dumps(parameters.get("uris", own))  # rcl wants URIs in quotation marks
    assert reason in refused("cflib_bridge", **{**parameters, "uris": uris})


@pytest.mark.parametrize(("content", "parameters", "reason"), MOCAP_PLAYER)
def test_what_cannot_be_played_is_refused(
    refused: Any, tmp_path: Path, content: str | None, parameters: dict[str, Any], reason: str
) -> None:
    file = tmp_path / "recording.csv"
    if content is not None:
        file.write_text(content, encoding="utf-8")
    assert reason in refused("mocap_player", file=file, **parameters)
