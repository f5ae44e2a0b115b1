"""A soak as a user starts it: short, its figures and verdict, and nothing left behind, also after Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from flatsat_ros.cli.soak import main

# whether ticks are missed is not judged
pytestmark = pytest.mark.beside_flights

PROGRAM = [sys.executable, "-m", "flatsat_ros.cli.soak"]


def running() -> list[str]:
    """Return the command lines of the nodes of soaks that run, somebody else's, too."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:  # it has ended
            continue
        found += [line] if "__ns:=/soak" in line else []
    return sorted(found)


def test_a_short_soak_has_figures_a_verdict_and_leaves_nothing_behind(ros_domain: int, tmp_path: Path) -> None:
    arguments, others = ["--minutes", "0.1", "--output", str(tmp_path)], running()
    finished = subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, timeout=150)
    figures = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert finished.returncode == (0 if figures["passed"] else 1), finished.stderr
    assert finished.stdout.count(" min: ") >= 4
    assert ("passed; see " if figures["passed"] else "FAILED; see ") in finished.stdout
    # whether ticks are missed depends on what else this machine does
    assert [problem for problem in figures["problems"] if "ticks" not in problem] == []
    assert (figures["drones"], figures["flights"], figures["left_behind"]) == (10, 1, [])
    assert figures["ticks"] + figures["ticks_missed"] > 50 * 6
    assert set(figures["processes"]) == {"controller", "sim_drone"}
    assert all(usage["memory_mib"][1] > 20.0 for usage in figures["processes"].values())
    assert running() == others


def test_ctrl_c_in_flight_leaves_nothing_behind(ros_domain: int, tmp_path: Path) -> None:
    others = running()
    soak = subprocess.Popen(
        [*PROGRAM, "--drones", "1", "--minutes", "5", "--output", str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert soak.stdout is not None
    assert " min: " in soak.stdout.readline()
    soak.send_signal(signal.SIGINT)
    soak.communicate(timeout=60)
    assert soak.returncode == 130
    assert running() == others


@pytest.mark.parametrize("arguments", [["--minutes", "0"], ["--minutes", "nan"], ["--drones", "0"], ["--drones", "50"]])
def test_what_cannot_be_flown_is_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert "must be" in capsys.readouterr().err
