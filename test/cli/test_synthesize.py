"""The synthesize command line: what it writes, what it prints, and one clear line for whatever it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flatsat_ros.base.strict_yaml import write_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.cli.synthesize import main
from flatsat_ros.crazyflie.vehicle import load_vehicle, profile_document

pytestmark = pytest.mark.in_process

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
    for text in (
        "certificate mine",
        "1.45 g",
        "12 deg",
        "gain interval",
        "gain_max",
        "agrees with closed form",
        str(target),
    ):
        assert text in printed


def test_the_table_shows_the_papers_figures_and_without_output_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*PAPER_LIMITS, "--rate", "1.2"]) == 0
    printed = capsys.readouterr().out
    for text in ("2.901873", "2.418228", "[[0.864, 0.72], [0.72, 1.2]]", "1.673 ", "1151 ", "16.5388", "not written"):
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
    assert "paper_experiment.yaml: cannot be written: it exists" in capsys.readouterr().err
    assert main(["--paper", "all", "--output-dir", str(tmp_path), "--force"]) == 0
    written = sorted(file.name for file in tmp_path.iterdir())
    assert written == ["paper_experiment.yaml", "paper_robust.yaml", "paper_simulation.yaml"]


def test_the_profile_gives_lag_and_delay_unless_they_are_given(tmp_path: Path) -> None:
    target = tmp_path / "own.yaml"
    assert main(["--vehicle", "cf21", "--output", str(target)]) == 0
    vehicle = load_vehicle("cf21")
    certificate = Certificate.load(target)
    assert (certificate.lag, certificate.delay) == (vehicle.lag, vehicle.delay)
    assert certificate.loop is not None
    assert main(["--vehicle", "cf21", "--lag", "0", "--delay", "0", "--output", str(target), "--force"]) == 0
    assert Certificate.load(target).timing.immediate


def test_lag_and_delay_lower_the_cap_and_the_worst_case_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*PAPER_LIMITS, "--lag", "0.1", "--delay", "0.05"]) == 0
    printed = capsys.readouterr().out
    for text in ("0.1 s, 0.1 s, 0.05 s", "[1, 5.09649]", "from 6.81463 on with 1: 3 periods of it, 3 of 1", "8.54203"):
        assert text in printed
    assert "WARNING" not in printed
    assert main([*PAPER_LIMITS, "--lag", "0.3", "--delay", "0.35"]) == 0
    assert "WARNING                   the cap is below 1.5, close to 1" in capsys.readouterr().out


def test_a_cap_and_a_kappa_of_ones_own(tmp_path: Path) -> None:
    target = tmp_path / "own.yaml"
    options = ["--lag", "0.08", "--delay", "0.03", "--period", "0.02", "--kappa", "0.7", "--gain-max", "4"]
    assert main([*PAPER_LIMITS, *options, "--output", str(target)]) == 0
    certificate = Certificate.load(target)
    assert (certificate.gain_min, certificate.gain_max) == (0.7, 4.0)


def test_the_papers_first_test_is_covered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "own.yaml"
    assert main([*PAPER_LIMITS, "--cover", "1.2,1.2,0.8", "--output", str(target)]) == 0
    certificate = Certificate.load(target)
    assert certificate.rate == pytest.approx(1.15362, abs=2e-5)
    found = certificate.sets.classify(np.array([[-1.2, -1.2, -0.8, 0.0, 0.0, 0.0]]))
    assert found.guaranteed[0]
    assert found.kappa[0] == 1.0
    assert main([*PAPER_LIMITS, "--cover", "1.2,1.2,0.8", "--rate", "1.25"]) == 0
    assert "with kappa = 0.8517; rate at kappa, undelayed: 0.8794 1/s" in capsys.readouterr().out


def test_a_disturbance_makes_a_robust_certificate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "own.yaml"
    limits = ["--thrust-max-g", "2", "--tilt-max-deg", "40", "--period", "0.01"]
    assert main([*limits, "--drift", "1.4142135623730951,0", "--output", str(target)]) == 0
    printed = capsys.readouterr().out
    for text in ("0.96683047 1/s", "[[2.286392, -2.139584], [-2.139584, 2.068615]]", "3.8804, 3.27 m/s^2"):
        assert text in printed
    goals = ["--drift", "0.5", "--push", "0.3", "--cover", "2,2,1"]
    assert main([*limits, *goals, "--output", str(target), "--force"]) == 0
    certificate = Certificate.load(target)
    assert certificate.robust is not None
    assert list(certificate.robust.drift) == [0.5, 0.5]
    assert certificate.sets.classify(np.array([[2.0, -2.0, 1.0, 0.0, 0.0, 0.0]])).guaranteed[0]


@pytest.mark.parametrize(
    ("ending", "options"), [("png", ["--lag", "0.1"]), ("svg", ["--drift", "0.3", "--period", "0.01"])]
)
def test_a_page_of_pictures_is_drawn(tmp_path: Path, ending: str, options: list[str]) -> None:
    target = tmp_path / f"page.{ending}"
    assert main([*PAPER_LIMITS, *options, "--plot", str(target)]) == 0
    assert target.stat().st_size > 20_000


def test_a_certificate_is_verified_and_a_wrong_one_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = root / "config" / "paper_experiment.yaml"
    assert main(["--verify", str(shipped)]) == 0
    printed = capsys.readouterr().out
    assert f"certificate paper_experiment in {shipped} holds" in printed
    assert "V does not grow during a period at gain_max" in printed
    bold = tmp_path / "bold.yaml"
    bold.write_text(shipped.read_text(encoding="utf-8").replace("level: 2.32", "level: 2.44"), encoding="utf-8")
    assert main(["--verify", str(bold)]) == 2
    assert "'V <= eps implies |B'P xi|^2 <= rho' fails by 0.05" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "no thrust limit"),
        (["--thrust-max", "9.81"], "must be above gravity = 9.81 m/s^2, or it cannot hover"),
        (["--thrust-max-g", "0.9"], "cannot hover"),
        (["--thrust-max", "nan"], "thrust_max = nan m/s^2: must be a number above 0"),
        (["--thrust-max", "much"], "invalid number value: 'much'"),
        (["--thrust-max", "14", "--thrust-max-g", "1.4"], "not allowed with"),
        ([*PAPER_LIMITS, "--tilt-max-deg", "90"], "must be from 1e-12 to below pi/2 rad, which is 90 deg"),
        ([*PAPER_LIMITS, "--tilt-max-deg", "0"], "which is 90 deg"),
        ([*PAPER_LIMITS, "--rate", "-1"], "rate (alpha) = -1.0"),
        ([*PAPER_LIMITS, "--rate", "25"], "or V grows whatever the gain"),
        ([*PAPER_LIMITS, "--rate", "19.5"], "gain cap would be 0."),
        ([*PAPER_LIMITS, "--rate", "9", "--lag", "0.15", "--delay", "0.1"], "unstable at gain 1 already"),
        ([*PAPER_LIMITS, "--lag", "-0.1"], "lag (tau) = -0.1 s"),
        ([*PAPER_LIMITS, "--delay", "9"], "delay (d) = 9.0 s: must be at most 4 s, 40 periods"),
        ([*PAPER_LIMITS, "--lag", "0.1", "--kappa", "1.5"], "--kappa = 1.5: must be above 0 and at most 1"),
        ([*PAPER_LIMITS, "--gain-max", "0.5"], "--gain-max = 0.5: must be at least 1"),
        ([*PAPER_LIMITS, "--cover", "1,2"], "cover = [1.0, 2.0] m and m/s: must be 3 or 6 magnitudes"),
        ([*PAPER_LIMITS, "--cover", "1,-2,1"], "must be 3 or 6 magnitudes of at least 0"),
        ([*PAPER_LIMITS, "--cover", "1,far,1"], "invalid"),
        ([*PAPER_LIMITS, "--cover", "90000,1,1"], "no rate from 0.01 to 100 1/s covers these start errors"),
        ([*PAPER_LIMITS, "--cover", "2.4,2.4,1.6", "--rate", "1.25"], "errors need kappa = 0.4259, certified"),
        ([*PAPER_LIMITS, "--drift", "1,1,1"], "--drift = [1.0, 1.0, 1.0]: must be one number, or two as H,V"),
        ([*PAPER_LIMITS, "--push", "0.9"], "push on x and y = 0.9 m/s^2: must be at most 0.576589 m/s^2"),
        ([*PAPER_LIMITS, "--push", "0.1", "--lag", "0.1"], "--delay, --kappa, --gain-max, or give --flight"),
        (["--vehicle", "cf21", "--push", "0.1"], "cf21 has a lag of 0.140465 s and a delay of 0.002 s: give"),
        ([*PAPER_LIMITS, "--kappa", "0.7"], "--kappa goes with --lag, --delay or --vehicle"),
        ([*PAPER_LIMITS, "--force"], "--force overwrites files; without --output and --plot none is written"),
        (
            [*PAPER_LIMITS, "--plot", "page.gif"],
            "--plot = 'page.gif': must be a file whose name ends in .png, .pdf, .svg",
        ),
        ([*PAPER_LIMITS, "--plot", "missing/x.png"], "the folder missing does not exist"),
        ([*PAPER_LIMITS, "--plot", "taken.yaml"], "taken.yaml: cannot be written: it exists: give --force"),
        (["--verify", "taken.yaml"], "must be a mapping"),
        (["--verify", "missing.yaml"], "cannot be read"),
        ([*PAPER_LIMITS, "--period", "0"], "period (h) = 0.0"),
        (["--vehicle", "cf21", "--thrust-max-g", "1.6"], "must be at most 15.1538 m/s^2 (1.545 g), what cf21 lifts"),
        (["--vehicle", "cf21", "--thrust-max-g", "1.6"], "with 28 g to take off, not 29 g, it would do"),
        (["--vehicle", "zeppelin"], "no packaged configuration 'zeppelin'"),
        (["--vehicle", "missing/zeppelin.yaml"], "missing/zeppelin.yaml: cannot be read: No such file"),
        ([*PAPER_LIMITS, "--output", "missing/x.yaml"], "the folder missing does not exist"),
        ([*PAPER_LIMITS, "--output", "taken.yaml"], "taken.yaml: cannot be written: it exists: give --force"),
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
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert text in err
    assert [file.name for file in tmp_path.iterdir()] == ["taken.yaml"]
    assert Path("taken.yaml").read_text(encoding="utf-8") == "precious"


def test_the_voltage_that_suffices_is_named_where_flights_tell_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drone = replace(load_vehicle("cf21"), thrust_voltage=0.5, voltage=3.5)
    write_yaml(path := tmp_path / "charged.yaml", profile_document(drone), "")
    assert main(["--vehicle", str(path), "--thrust-max-g", "1.6"]) == 2
    assert "g, it would do; so it would at 3.75 V under load, not 3.5 V" in capsys.readouterr().err
    write_yaml(path := tmp_path / "heavy.yaml", profile_document(replace(drone, name="heavy", mass=0.041)), "")
    assert main(["--vehicle", str(path), "--flight"]) == 2
    assert "take off with below 40.1 g or above 3.66 V under load, not 3.5 V" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--vehicle", "cf21_markers"], "cf21_markers lacks 1.05 m/s^2 of thrust, take off with below 28.7 g"),
        (["--vehicle", "cf21", "--tilt-max-deg", "5"], "give up tilt_max or acceleration"),
    ],
)
def test_a_drone_without_room_for_a_tube_is_told_what_it_lacks(
    options: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--flight", *options]) == 2
    error = capsys.readouterr().err
    assert "margin of the reference" in error
    assert text in error
