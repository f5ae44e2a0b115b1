"""What the bridge refuses at the start, in one line and before it touches any drone."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from conftest import Lab


@pytest.mark.skipif(not find_spec("cflib"), reason="the bridge is an extra")
@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"uris": ["tcp://here"]}, "must be radio://"),
        ({"uris": ["udp://127.0.0.1:1", "udp://localhost:1"], "robot_names": ["cf1", "cf2"]}, "must be given once"),
        (
            {"uris": ["udp://127.0.0.1:1"], "robot_names": ["cf1", "cf2"]},
            "entries of parameter uris = 1: must be 2: one per robot",
        ),
        ({"robot_names": []}, "parameter robot_names = []: must be of type string array and not empty"),
        ({"rate": 500.0, "spacing": 0.01}, "to fit 1 streams"),
        ({"on_shutdown": "fall"}, "stop, land"),
        ({"pose_rate": 10.0, "external_pose": "pose", "external_pose_topic": "pose"}, "own estimate"),
    ],
)
def test_bad_parameters_are_refused_in_one_line(lab: Lab, parameters: dict[str, Any], reason: str) -> None:
    uris = json.dumps(parameters.pop("uris", ["udp://127.0.0.1:1"]))  # rcl wants URIs in quotation marks
    process = lab.start("cflib_bridge", uris=uris, **parameters)
    assert process.wait() == 2
    assert process.output.startswith("error: ")
    assert reason in process.output
    assert process.output.count("\n") == 1


def test_without_cflib_one_line_says_what_to_install(lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    absent = tmp_path / "absent"
    absent.mkdir()
    (absent / "cflib.py").write_text("raise ModuleNotFoundError(\"No module named 'cflib'\")\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(absent), prepend=":")
    process = lab.start("cflib_bridge")
    assert process.wait() == 2
    assert process.output == (
        "error: No module named 'cflib': cflib_bridge needs cflib: pip install \"flatsat_ros[crazyflie]\"\n"
    )
