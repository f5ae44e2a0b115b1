"""The synthesize command line: what it writes, what it prints, and one clear line for whatever it refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from flatsat_ros.cli.synthesize import main
from flatsat_ros.core.certificate import Certificate

PAPER_LIMITS = ["--thrust-max-g", "1.45"]


def test_a_certificate_is_written_named_after_its_file_and_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "mine.yaml"
    options = ["--tilt-max-deg", "12", "--rate", "1.1", "--period", "0.05"]
    assert main([*PAPER_LIMITS, *options, "--output", str(target)]) == 0
    certificate = Certificate.load(target)
    assert certificate.name == "mine"
    assert (certificate.rate, certificate.period) == (1.1, 0.05)
    assert certificate.provenance["inputs"] == {"thrust_max": "1.45 g", "tilt_max": "12.0 deg"}
    printed = capsys.readouterr().out
    for text in ("certificate mine", "1.45 g", "12 deg", "gain interval", "gain_max", "difference in Q", str(target)):
        assert text in printed


def test_the_table_shows_the_papers_figures_and_without_output_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*PAPER_LIMITS, "--rate", "1.2"]) == 0
    printed = capsys.readouterr().out
    for text in ("2.901873", "2.418228", "[[0.864, 0.72], [0.72, 1.2]]", "1.673 m", "16.5388", "not written"):
        assert text in printed
    assert list(tmp_path.iterdir()) == []


def test_the_profile_gives_the_thrust_limit(tmp_path: Path) -> None:
    target = tmp_path / "cf21.yaml"
    assert main(["--vehicle", "cf21", "--name", "stock", "--output", str(target)]) == 0
    certificate = Certificate.load(target)
    assert certificate.name == "stock"
    assert certificate.limits.thrust_max == pytest.approx(0.480 * 60000 / 65535 / 0.029, rel=1e-12)
    assert certificate.provenance["inputs"]["vehicle"] == "cf21"


def test_a_limit_within_the_profile_is_taken_from_the_user(tmp_path: Path) -> None:
    target = tmp_path / "own.yaml"
    assert main(["--vehicle", "cf21", "--thrust-max", "14.0", "--output", str(target)]) == 0
    assert Certificate.load(target).limits.thrust_max == 14.0


def test_the_papers_certificates_are_written_and_not_overwritten_unasked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--paper", "experiment", "--output-dir", str(tmp_path)]) == 0
    assert [file.name for file in tmp_path.iterdir()] == ["paper_experiment.yaml"]
    assert main(["--paper", "all", "--output-dir", str(tmp_path)]) == 2
    assert "paper_experiment.yaml exists" in capsys.readouterr().err
    assert main(["--paper", "all", "--output-dir", str(tmp_path), "--force"]) == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ["paper_experiment.yaml", "paper_simulation.yaml"]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "no thrust limit"),
        (["--thrust-max", "9.81"], "cannot hover: must be above gravity"),
        (["--thrust-max-g", "0.9"], "cannot hover"),
        (["--thrust-max", "nan"], "must be a finite number"),
        (["--thrust-max", "much"], "invalid float value: 'much'"),
        (["--thrust-max", "14", "--thrust-max-g", "1.4"], "not allowed with"),
        ([*PAPER_LIMITS, "--tilt-max-deg", "90"], "(90 deg): must lie in"),
        ([*PAPER_LIMITS, "--tilt-max-deg", "0"], "(0, 90) deg"),
        ([*PAPER_LIMITS, "--rate", "-1"], "rate (alpha) = -1.0"),
        ([*PAPER_LIMITS, "--rate", "25"], "no gain keeps V from growing"),
        ([*PAPER_LIMITS, "--period", "0"], "period (h) = 0.0"),
        (["--vehicle", "cf21", "--thrust-max-g", "1.6"], "more than cf21 lifts: must be at most 15.1538"),
        (["--vehicle", "zeppelin"], "no packaged configuration 'zeppelin'"),
        (["--vehicle", "missing/zeppelin.yaml"], "there is no file"),
        ([*PAPER_LIMITS, "--output", "missing/x.yaml"], "the folder missing does not exist"),
        ([*PAPER_LIMITS, "--output", "taken.yaml"], "taken.yaml exists: give --force"),
        ([*PAPER_LIMITS, "--output-dir", "."], "--output-dir goes with --paper"),
        (["--paper", "all", "--rate", "1.0", "--vehicle", "cf21"], "--rate, --vehicle"),
        (["--paper", "hardware"], "invalid choice"),
        (["--paper", "all"], "the folder config does not exist"),
        (["--speed", "1"], "unrecognized arguments: --speed"),
    ],
)
def test_whatever_cannot_be_used_is_refused_in_one_line(
    arguments: list[str],
    text: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken.yaml").write_text("precious", encoding="utf-8")
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("synthesize: ")
    assert err.count("\n") == 1
    assert text in err
    assert [file.name for file in tmp_path.iterdir()] == ["taken.yaml"]
    assert Path("taken.yaml").read_text(encoding="utf-8") == "precious"


def test_it_runs_as_a_module_where_ros_is_not_installed(tmp_path: Path) -> None:
    without_ros = "import sys, runpy; sys.modules['rclpy'] = None; "
    run = f"sys.argv = ['synthesize', '--thrust-max', '14', '--output', {str(tmp_path / 'x.yaml')!r}]; "
    module = "runpy.run_module('flatsat_ros.cli.synthesize', run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", without_ros + run + module], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert Certificate.load(tmp_path / "x.yaml").limits.thrust_max == 14.0
