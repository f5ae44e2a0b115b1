"""`synthesize --flight` and `--designs`: what is refused before anything is searched."""

from __future__ import annotations

from pathlib import Path

import pytest

from flatsat_ros.cli.synthesize import main

pytestmark = pytest.mark.in_process


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--flight"], "--flight needs --vehicle"),
        (["--flight", "--vehicle", "cf21", "--rate", "1.0"], "--rate: not used with --flight"),
        (["--flight", "--vehicle", "cf21", "--gain-max", "0.5"], "--gain-max = 0.5: must be at least 1"),
        (["--flight", "--vehicle", "cf21", "--assume", "no_such.yaml"], "no_such.yaml: cannot be read"),
        (["--flight", "--vehicle", "cf21_markers"], "margin of the reference = -0."),
        (["--thrust-max-g", "1.4", "--assume", "still"], "--assume goes with --flight"),
        (["--designs", "no_such.yaml"], "no_such.yaml: cannot be read"),
    ],
)
def test_what_cannot_be_is_refused_at_once(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert text in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
