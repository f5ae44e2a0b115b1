"""The plan command line: from way-points to a file that is proved again, and one clear line for what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.cli.plan import main
from flatsat_ros.plans import Plan

pytestmark = pytest.mark.in_process


@pytest.fixture(scope="module")
def waypoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "tour.csv"
    path.write_text("x,y,z\n0,0,0\n0,0,1\n1,0,1\n")
    return path


@pytest.fixture(scope="module")
def planned(waypoints: Path) -> Path:
    target = waypoints.parent / "flight.yaml"
    assert main([str(waypoints), "--output", str(target)]) == 0
    return target


def test_a_plan_is_written_and_proved_again(planned: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert Plan.load(planned).name == "flight"
    assert main(["--verify", str(planned), "--certificate", "cf21_adaptive_50hz"]) == 0
    printed = capsys.readouterr().out
    flight = load_certificate("cf21_adaptive_50hz").flight
    assert flight is not None
    radius = math.hypot(flight.horizontal.tube.position, flight.vertical.tube.position / 2.0)  # heights count half
    for text in (
        "plan flight in",
        "holds: proved with integers",
        f"jerk at most {flight.assumptions.jerk / 1.1:.6g} m/s^3",  # a tenth is set aside for changes of pace
        f"tubes of {math.ceil(1e4 * radius) / 1e4:.4f} m: proved by cf21_adaptive_50hz",
    ):
        assert text in printed


def test_a_tube_that_no_certificate_proves_is_found_out_without_naming_one(
    planned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = Plan.load(planned)
    drones = tuple(replace(drone, tube=replace(drone.tube, radius=0.01)) for drone in plan.drones)
    replace(plan, drones=drones).save(tmp_path / "forged.yaml")
    assert main(["--verify", str(tmp_path / "forged.yaml")]) == 2
    assert "tube of cf1 = 0.01 m: must be at least 0.0" in capsys.readouterr().err
    replace(plan, drones=drones, certificate="somebodys").save(tmp_path / "forged.yaml")
    assert main(["--verify", str(tmp_path / "forged.yaml")]) == 0
    assert "that it proves the tubes was not looked at" in capsys.readouterr().out


def test_the_help_names_the_certificate_that_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert f"default: {DEFAULT_CERTIFICATE}" in " ".join(capsys.readouterr().out.split())


def test_present_places_come_from_a_process_and_its_refusal_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "goals.yaml").write_text("drones: {cf1: [1, 0, 1]}\n")
    answers = [
        CompletedProcess([], 0, '{"cf1": [0.0, 0.0, 0.5]}\n', ""),
        CompletedProcess([], 2, "", "told\nerror: cf1: no poses\n"),
    ]
    asked: list[list[str]] = []

    def run(command: list[str], **_: Any) -> CompletedProcess[str]:
        asked.append(command)
        return answers.pop(0)

    monkeypatch.setattr("subprocess.run", run)
    target = tmp_path / "plan.yaml"
    assert main([str(tmp_path / "goals.yaml"), "--from-poses", "--output", str(target)]) == 0
    assert asked[0][1:] == ["-m", "flatsat_ros.nodes.present_places", "--ros-args", "-p", "robot_names:=[cf1]"]
    assert Plan.load(target).trajectory("cf1").sample(0.0)[:3] == pytest.approx([0.0, 0.0, 0.5])
    assert main([str(tmp_path / "goals.yaml"), "--from-poses"]) == 2
    assert "present places are not known: cf1: no poses" in capsys.readouterr().err


@pytest.fixture(scope="module")
def other(waypoints: Path) -> Path:
    """A certificate for another thrust."""
    certificate = load_certificate("paper_experiment")
    target = waypoints.parent / "other.yaml"
    replace(certificate, name="other", limits=replace(certificate.limits, thrust_max=14.0)).save(target)
    return target


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ([], "error: no way-points: give a file, or --verify with a plan"),
        (["{file}", "--output", "{plan}"], "it exists: give --force to overwrite it"),
        (["{file}", "--margin", "3"], "margin = 3.0 m/s^2: must be below 1.7"),
        (["{file}", "--tube", "-1"], "radius = -1.0 m: must be"),
        (["{file}", "--floor", "0.5"], "z of way-point 1 of cf1 = 0.0 m: must be from 0.5"),
        (["{file}", "--seconds", "0"], "seconds = 0.0 s: must be a number above 0"),
        (["{file}", "--laps", "2"], "distance of the last way-point of cf1 from the first = 1.41"),
        (["{file}", "--laps", "2.5"], "argument --laps: invalid integer value: '2.5'"),
        (["{file}", "--laps", "1_0"], "argument --laps: invalid integer value: '1_0'"),
        (["{file}", "--trade", "--output", "{file}.yaml"], "--output: not used with --trade"),
        (["{file}", "--trade", "--seconds", "3"], "--seconds: not used with --trade"),
        (["{file}", "--force"], "--force overwrites the output"),
        (["--verify", "{plan}", "--tube", "0.1"], "--tube: not used with --verify"),
        (
            ["--verify", "{plan}", "--certificate", "{other}"],
            "of certificate 'other' = 14.0: must be 14.2245",
        ),
        (["--verify", "{file}"], "tour.csv: "),
        (["nowhere.csv"], "nowhere.csv: cannot be read"),
    ],
)
def test_what_is_refused_is_one_line(
    options: list[str],
    text: str,
    waypoints: Path,
    planned: Path,
    other: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("flatsat_ros.certificate.certificate.DEFAULT_CERTIFICATE", "paper_experiment")  # soon loaded
    capsys.readouterr()
    assert main([option.format(file=waypoints, plan=planned, other=other) for option in options]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
