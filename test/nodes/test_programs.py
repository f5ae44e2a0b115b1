"""The console scripts of the nodes where something that they need is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from ctrl_c import ctrl_c_at

from flatsat_ros.nodes import programs

pytestmark = pytest.mark.beside_flights

NAMES = ("controller", "sim_drone", "sim_server", "cflib_bridge", "mocap_player", "record", "console")


def test_without_ros_one_line_says_what_to_source() -> None:
    hidden = "import sys; sys.modules['rclpy'] = None"
    script = f"{hidden}; from flatsat_ros.nodes import programs; print([getattr(programs, n)() for n in {NAMES}])"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout == f"{[2] * len(NAMES)}\n"
    lines = run.stderr.splitlines()
    assert len(lines) == len(NAMES)
    for line in lines:
        assert line.startswith("error: ")
        assert line.endswith("; source ROS 2 Jazzy first: . /opt/ros/jazzy/setup.bash")


def test_without_cflib_one_line_says_what_to_install(
    executables: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cflib.py").write_text("raise ModuleNotFoundError(\"No module named 'cflib'\")\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    run = subprocess.run([executables / "cflib_bridge"], capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == (
        "error: No module named 'cflib': cflib_bridge needs cflib: pip install \"flatsat_ros[crazyflie]\"\n"
    )


def test_another_missing_library_is_named_without_a_hint_to_ros(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(_name: str) -> None:
        raise ModuleNotFoundError("No module named 'tqdm'")

    monkeypatch.setattr(programs, "import_module", missing)
    assert programs.mocap_player([]) == 2
    assert capsys.readouterr().err == "error: No module named 'tqdm'\n"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("module", ["numpy", "rclpy.node"])
def test_ctrl_c_while_imports_run_is_130_without_a_traceback(name: str, module: str) -> None:
    script = f"from flatsat_ros.nodes import programs\n{ctrl_c_at(module)}\nsys.exit(programs.{name}([{name!r}]))"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "stopped\n")
