"""The faults command: its files, its exit codes, and the one command that flies a row again."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE
from flatsat_ros.cli.faults import main
from flatsat_ros.falsification.faults import accepted
from flatsat_ros.falsification.faults.accepted import Accepted
from flatsat_ros.falsification.faults.criteria import Criteria, End

pytestmark = pytest.mark.in_process

KEYS = {"fault", "phase", "passed", "accepted", "impact_m_s", "distance_m", "said", "seed", "certificate"}


def test_rows_are_flown_and_written_beside_those_that_are_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["--fault", "nothing", "--phase", "take-off", "--workers", "2", "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert re.match(r"1 rows: 1 passed, 0 accepted, 0 failed. In \d+ s; see ", capsys.readouterr().out)
    (row,) = json.loads((tmp_path / "out" / "table.json").read_text(encoding="utf-8"))["rows"]
    assert set(row) >= KEYS
    assert (row["fault"], row["phase"], row["passed"]) == ("nothing", "take-off", True)
    assert "| `nothing` |" in (tmp_path / "out" / "faults.md").read_text(encoding="utf-8")
    # a row that is listed as one that may fail, and passes, has passed, and that is told
    bounds, text = Criteria(End.SAFE), "It does not."
    monkeypatch.setattr(accepted, "ACCEPTED", (Accepted("emergency_early", ("take-off",), bounds, text, text),))
    assert main(["--fault", "emergency_early", *arguments[2:-4], "--workers", "1", *arguments[-2:]]) == 0
    shown = capsys.readouterr().out
    assert "1 rows: 1 passed, 0 accepted, 0 failed." in shown
    assert "\nemergency_early keeps its bounds in all phases in which it is accepted: it can be taken off" in shown
    assert row["certificate"] == DEFAULT_CERTIFICATE
    assert "2 rows: 2 passed" in (tmp_path / "out" / "faults.md").read_text(encoding="utf-8")


def test_a_replay_comes_to_the_same_as_the_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["--fault", "emergency", "--phase", "take-off", "--workers", "1", "--output", str(tmp_path)])
    capsys.readouterr()
    (row,) = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))["rows"]
    assert code == (0 if row["passed"] or row["accepted"] else 1)
    assert main(["--replay", f"emergency:take-off:{row['seed']}"]) == code
    shown = capsys.readouterr().out
    assert f"impact {row['impact_m_s']} m/s, distance {row['distance_m']} m" in shown
    assert re.findall(r"^BROKEN: (.*)$", shown, re.MULTILINE) == row["broken"]
    # the history: ends with the drone on the floor
    assert re.search(r"^ *\d+\.\d\d +0 \w+ +-?\d\.\d{3} +-?\d\.\d{3} +0\.000", shown, re.MULTILINE)


def test_another_certificate_is_flown_but_not_into_the_same_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--fault", "nothing", "--phase", "take-off", "--workers", "1", "--output", str(tmp_path)]
    assert main([*arguments, "--certificate", "soft"]) == 2
    assert "'soft'" in capsys.readouterr().err
    assert main([*arguments, "--certificate", "cf21_tight_50hz"]) == 0
    (row,) = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))["rows"]
    assert row["certificate"] == "cf21_tight_50hz"
    capsys.readouterr()
    assert main(arguments) == 2
    assert "= 'cf21_tight_50hz': must be" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["--replay", "nothing"],
        ["--replay", "nothings:hover"],
        ["--replay", "nothing:hovering"],
        ["--replay", "nothing:hover:-1"],
        ["--replay", "poses_late_0.2s_from_start:hover"],
        ["--fault", "poses_late_0.2s_from_start", "--phase", "hover"],
        ["--workers", "0"],
        ["--fault", "nothings"],
        ["--live", "--fault", "nothing"],
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert re.fullmatch(r"error: .* must be .*\n", capsys.readouterr().err)
