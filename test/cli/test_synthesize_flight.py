"""`synthesize --flight` and `--designs`: what is refused before anything is searched."""

from __future__ import annotations

from pathlib import Path

import pytest

from flatsat_ros.base.errors import FlatsatError
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


@pytest.mark.parametrize(("given", "expected"), [((), "mine"), (("--name", "other"), "other")])
def test_a_certificate_has_the_name_that_is_given_or_that_of_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: tuple[str, ...], expected: str
) -> None:
    """The search, minutes long, is left out: here only what it is told counts."""
    names: list[str] = []

    def proved(_: object, name: str, __: object) -> None:
        names.append(name)
        raise FlatsatError("enough is known")

    monkeypatch.setattr("flatsat_ros.synthesis.flight_trade.searched", lambda *_: None)
    monkeypatch.setattr("flatsat_ros.synthesis.flight_design.FlightDesign", lambda *_: None)
    monkeypatch.setattr("flatsat_ros.synthesis.flight_trade.proved", proved)
    assert main(["--flight", "--vehicle", "cf21", "--output", str(tmp_path / "mine.yaml"), *given]) == 2
    assert names == [expected]
