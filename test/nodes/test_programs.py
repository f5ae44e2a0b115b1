"""The console scripts of the nodes where something that they need is missing."""

from __future__ import annotations

import subprocess
import sys

import pytest

from flatsat_ros.nodes import programs

NAMES = ("controller", "sim_drone", "sim_server", "cflib_bridge", "mocap_player", "record")


@pytest.mark.parametrize("name", NAMES)
def test_without_ros_one_line_says_what_to_source(name: str) -> None:
    hidden = "import sys; sys.modules['rclpy'] = None"
    script = f"{hidden}; from flatsat_ros.nodes import programs; sys.exit(programs.{name}())"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 2
    assert run.stderr.startswith("error: ")
    assert run.stderr.endswith("; source ROS 2 Jazzy first: . /opt/ros/jazzy/setup.bash\n")
    assert run.stderr.count("\n") == 1


def test_another_missing_library_is_named_without_a_hint_to_ros(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(_name: str) -> None:
        raise ModuleNotFoundError("No module named 'tqdm'")

    monkeypatch.setattr(programs, "import_module", missing)
    assert programs.mocap_player([]) == 2
    assert capsys.readouterr().err == "error: No module named 'tqdm'\n"
