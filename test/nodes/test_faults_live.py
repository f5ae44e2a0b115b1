"""A row of `faults --live`: real processes, a measured fall, and nothing left behind."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flatsat_ros.falsification.faults.live import LiveFlight
from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS
from flatsat_ros.flight.modes import Mode


def test_there_are_as_many_live_faults_as_there_should_be() -> None:
    assert len(LIVE_FAULTS) >= 15
    assert all(name == fault.name and fault.meaning for name, fault in LIVE_FAULTS.items())
    assert all(list(fault.steps) == sorted(fault.steps, key=lambda step: step[0]) for fault in LIVE_FAULTS.values())


class Climb(LiveFlight):
    """Two drones on a clock of their own: the second one's take-offs are given up, or its first flight ends early."""

    def __init__(self, *ends: float) -> None:
        """Let the second drone stand again so long, s, after each of its take-offs, in order."""
        self.clock, self.asked, self.rose = 0.0, 0, [0.0, 0.0]
        self.ends = [*ends, math.inf]
        self.conductor = self  # type: ignore[assignment]

    def now(self) -> float:
        return self.clock

    def let_pass(self, seconds: float) -> None:
        self.clock += max(seconds, 0.1)

    def take_off(self) -> None:
        self.asked += 1
        self.rose[1] = self.clock

    def heights(self) -> np.ndarray:
        end = self.ends[min(self.asked, len(self.ends)) - 1]
        aloft = [min(self.clock - rose, 1.0) for rose in self.rose]
        return np.array([aloft[0], aloft[1] if self.clock < self.rose[1] + end else 0.0])

    def robots_in(self, *modes: Mode) -> list[str]:
        shown = [Mode.FLY if height > 0.0 or not self.clock else Mode.IDLE for height in self.heights()]
        return [str(drone) for drone, mode in enumerate(shown) if mode in modes]


@pytest.mark.parametrize(("ends", "asked"), [((), 1), ((0.0,), 2), ((4.0,), 2), ((0.0, 0.0, 5.0), 4)])
def test_the_fault_waits_until_the_drones_have_hovered(ends: tuple[float, ...], asked: int) -> None:
    flight = Climb(*ends)
    assert flight.hover(0.85)
    assert flight.asked == asked
    assert flight.clock - flight.rose[1] == pytest.approx(5.8, abs=0.21)


def test_drones_that_never_hover_are_not_waited_for_without_end() -> None:
    flight = Climb(*[2.0] * 100)
    assert not flight.hover(0.85)
    assert flight.clock == pytest.approx(60.0, abs=0.2)


def test_drones_that_are_not_heard_of_do_not_hover(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Climb()
    heard = flight.heights
    monkeypatch.setattr(flight, "heights", lambda: heard() if flight.clock < 3.0 else np.full(2, np.nan))
    assert not flight.hover(0.85)


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
