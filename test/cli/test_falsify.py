"""The falsify command: what it reports, its exit codes, and the one command that replays a run."""

from __future__ import annotations

import re

import pytest

from flatsat_ros.cli.falsify import main

pytestmark = pytest.mark.in_process

QUICK = ["--campaign", "hold", "--workers", "1"]


def test_true_certificates_pass_in_worker_processes_as_in_one(capsys: pytest.CaptureFixture[str]) -> None:
    reports = []
    for workers in ("1", "2"):
        assert main(["--campaign", "hold", "--runs", "2500", "--seed", "7", "--workers", workers]) == 0
        first, *report = capsys.readouterr().out.splitlines()
        assert re.fullmatch(r"3000 runs in \S+ s, \d+ a second; certificates as proven", first)
        reports.append(report)
    assert reports[0] == reports[1]
    assert "no claim failed" in reports[0]


@pytest.mark.parametrize(
    ("sabotage", "campaign"),
    [("eps", "hold"), ("gain", "hold"), ("kappa", "hold"), ("gain", "lag"), ("disturbance", "storm")],
)
def test_a_sabotaged_certificate_is_caught_and_the_printed_command_replays_it(
    sabotage: str, campaign: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--campaign", campaign, "--workers", "1", "--runs", "1000", "--sabotage", sabotage]) == 1
    claim, excess, step, command = re.findall(
        r"VIOLATED in \d+ runs: (.*)\n  by (\S+) at step (\d+): falsify (.*)\n", capsys.readouterr().out
    )[0]
    assert main(command.split()) == 1
    replay = capsys.readouterr().out
    found, amount = re.findall(r"VIOLATED at step (\d+), by (\S+) \(relative\)", replay)[0]
    assert found == step
    assert float(amount) == pytest.approx(float(excess), rel=0.01)
    assert replay.rstrip().endswith(claim)
    assert re.search(rf"^ *{step} ", replay, flags=re.MULTILINE)


def test_a_run_that_keeps_its_claims_is_replayed_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--replay", "tracking:3:999"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("no claim failed")


def test_the_time_is_bounded(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*QUICK, "--seconds", "1e-9"]) == 0
    assert capsys.readouterr().out.startswith("1000 runs in")


@pytest.mark.parametrize(
    "arguments",
    [
        ["--replay", "hold:1"],
        ["--replay", "held:1:1"],
        ["--replay", "hold:1:1000"],
        ["--runs", "0"],
        ["--sabotage", "disturbance", "--campaign", "hold"],
        ["--sabotage", "disturbance", "--replay", "lag:0:1"],
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert re.fullmatch(r"error: .* must be .*\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("option", "value", "text"),
    [
        ("--runs", "0", "--runs = 0: must be at least 1"),
        ("--workers", "-1", "--workers = -1: must be from 1 to 512"),
        ("--seconds", "nan", "--seconds = nan s: must be above 0"),
        ("--seed", "-5", "--seed = -5: must be at least 0"),
    ],
)
def test_a_refused_option_is_named_with_its_value(
    option: str, value: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([f"{option}={value}"]) == 2
    assert capsys.readouterr().err == f"error: {text}\n"
