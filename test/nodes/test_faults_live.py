"""A row of `faults --live`: real processes, a measured fall, and nothing left behind."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS


def test_there_are_as_many_live_faults_as_there_should_be() -> None:
    assert len(LIVE_FAULTS) >= 15
    assert all(name == fault.name and fault.meaning for name, fault in LIVE_FAULTS.items())
    assert all(list(fault.steps) == sorted(fault.steps, key=lambda step: step[0]) for fault in LIVE_FAULTS.values())


def test_drones_whose_link_is_killed_fall_and_no_process_is_left(ros_domain: int, tmp_path: Path) -> None:
    program = [sys.executable, "-m", "flatsat_ros.cli.faults", "--live", "--fault", "relay_killed"]
    finished = subprocess.run([*program, "--output", str(tmp_path)], capture_output=True, text=True, timeout=120)
    assert finished.stdout.startswith("1 rows: ") or "FAILED relay_killed:live" in finished.stdout, finished.stderr
    (row,) = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))["rows"]
    assert (row["fault"], row["phase"]) == ("relay_killed", "live")
    assert finished.returncode == (0 if row["passed"] else 1)
    # the firmware stops the motors after 2 s, about a metre above the floor
    assert 2.0 < row["impact_m_s"] < 6.0
    assert row["distance_m"] < 0.5
    assert "| `relay_killed` |" in (tmp_path / "faults.md").read_text(encoding="utf-8")
    left = [line for line in map(command_line, Path("/proc").glob("[0-9]*")) if "__ns:=/faults/relay_killed" in line]
    assert left == []


def command_line(process: Path) -> str:
    try:
        return (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:  # it has ended
        return ""
