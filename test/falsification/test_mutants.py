"""Copies of certificates that claim less or more: the checker tells which hold, and would be told on if it did not."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_flight import BACK, NONE, certificate_of, flight_of

from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.cli.falsify import main
from flatsat_ros.falsification.mutants import KINDS, MutantTally, judged

ASSUMPTIONS = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66)


@pytest.fixture(scope="module")
def small() -> Certificate:
    design = Design.predicting(0.02, Plant(0.03, 0.14), (0.357, 3.93, 14.2), 30.0, 18.0)
    axis = Axis(PlantBox(Plant(0.0298, 0.139), Plant(0.0302, 0.141)), False, design, ("",), NONE, BACK)
    return certificate_of(flight_of(axis, axis, ASSUMPTIONS, 1.05, 2.2, 0.45), 1.05)


def tally_of(certificate: Certificate, count: int) -> MutantTally:
    tally = MutantTally()
    for mutant, misjudged in judged(certificate, 0, count):
        tally.add(mutant, misjudged)
    return tally


def test_every_mutant_of_a_flight_certificate_is_judged_rightly(small: Certificate) -> None:
    tally = tally_of(small, 60)
    assert tally.wrong == []
    assert [sum(n for (_, kind), n in tally.judged.items() if kind == each) for each in range(len(KINDS))] == [60] * 3
    claims = {claim for claim, _ in tally.judged}
    assert {"all inputs", "horizontal tube position", "margin", "disturbance"} < claims
    assert {"level", "ball and level", "rate", "gain_max"} < claims


@pytest.mark.parametrize("name", ["paper_simulation", "paper_robust", "cf21_50hz"])
def test_every_mutant_of_a_certificate_of_the_ideal_loop_is_judged_rightly(name: str) -> None:
    assert tally_of(load_certificate(name), 15).wrong == []


@pytest.mark.parametrize(("slack", "kind"), [(1.0, "beyond the slack"), (-1e-6, "weaker")])
def test_a_checker_that_gives_away_or_takes_a_little_is_found(
    slack: float, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificate, verify = load_certificate("paper_simulation"), Certificate.check

    def other(self: Certificate, margins: dict[str, float]) -> None:
        verify(self, {name: margin + slack for name, margin in margins.items()})

    results = judged(certificate, 0, 20)
    found = [next(results)]  # of the certificate itself the slacks are known by now
    monkeypatch.setattr(Certificate, "check", other)
    found += results
    assert {kind} <= {KINDS[mutant.kind] for mutant, misjudged in found if misjudged}


def test_the_command_reports_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper_experiment", "--mutants", "4", "--seed", "3"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("certificate 'paper_experiment': 12 mutants in ")
    assert " 0 misjudged\n" in printed
    assert main(["--mutants", "4"]) == 2
    assert "--mutants: used with a CERTIFICATE only" in capsys.readouterr().err
    assert main(["paper_experiment", "--mutants", "0"]) == 2
    assert "--mutants = 0: must be at least 1" in capsys.readouterr().err
