"""`reproduce`: the table's verdicts, the runs behind them, and that both can come out differently."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.cli import reproduce
from flatsat_ros.paper import runs as paper_runs
from flatsat_ros.paper.runs import V_INF, Runs, run_all, run_campaign
from flatsat_ros.paper.table import VERDICTS, Table, compare

WRONG = {
    "Q as printed certifies alpha",
    "eq. 25 is the integral that it stands for, surplus",
    "Q_w, entries of z",
    "Q_w as printed certifies beta, x and y",
    "Q_w as printed certifies beta, z",
    "largest w'w of the printed disturbance",
    "P as printed certifies its rate",
    "Test 1 starts in E, V(0)",
}
AMBIGUOUS = {
    "bound of t_inf, s",
    "beta, 1/s",
    "height of the way-points, m",
    "RMS tracking error of cf1, m",
    "RMS tracking error of cf2, m",
    "RMS tracking error of cf3, m",
    "average computation time, ms",
}
FIGURES = (
    "study1_gain", "study1_inputs", "study2_plane", "study2_inputs", "test1_errors", "test1_gain", "test1_inputs",
    "gain_laws", "computation_time", "test2/paths", "test2/gain", "test2/inputs",
)  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    """Everything that `reproduce` computes, with fewer adversarial runs: 10,000 take half a minute."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper_runs, "CAMPAIGN_RUNS", 500)
        return run_all(tmp_path_factory.mktemp("runs"))


def test_the_command_writes_the_table_and_every_figure(
    runs: Runs, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paper_runs, "run_all", lambda _: runs)
    assert reproduce.main(["--output", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    rows = content["rows"]
    assert {row["quantity"] for row in rows if row["verdict"] == "wrong"} == WRONG
    assert {row["quantity"] for row in rows if row["verdict"] == "ambiguous"} == AMBIGUOUS
    assert content["verdicts"] == {verdict: sum(row["verdict"] == verdict for row in rows) for verdict in VERDICTS}
    assert all(all(row.values()) for row in rows)
    document, printed = (tmp_path / "table.md").read_text(encoding="utf-8"), capsys.readouterr().out
    for row in rows:
        assert row["quantity"] in document
        assert row["recomputed"] in printed
    for name in FIGURES:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@given(value=st.floats(-1e3, 1e3), decimals=st.integers(1, 6))
def test_a_rounded_number_is_recognised_and_one_more_unit_is_wrong(value: float, decimals: int) -> None:
    printed = f"{value:.{decimals}f}"
    assert compare(printed, value) in ("exact", "rounded")
    assert compare(printed, float(printed)) == "exact"
    for sign in (-1.0, 1.0):
        assert compare(f"{float(printed) + sign * 10.0**-decimals:.{decimals}f}", float(printed)) == "wrong"


def test_verdicts_of_several_numbers_and_of_several_readings() -> None:
    table = Table()
    table.at("somewhere")
    table.number("all exact", "1, 2.5", [1.0, 2.5], "-")
    table.number("one rounded", "1, 2.5", [1.0, 2.49], "-")
    table.number("one wrong", "1, 2.5", [1.0, 2.43], "-")
    table.number("both readings", "2.5", {"a": 2.5, "b": 2.51}, "-")
    table.number("one reading", "2.5", {"a": 2.5, "b": 2.6}, "-")
    table.number("no reading", "2.5", {"a": 2.4, "b": math.nan}, "-")
    table.number("undetermined", "2.5", 2.4, "-", undetermined=True)
    table.claim("a claim", "x", True, "y", "-")
    table.claim("no claim | at all", "x", False, "y", "-")
    verdicts = [row.verdict for row in table.rows]
    assert verdicts == ["exact", "rounded", "wrong", "rounded", "ambiguous", "wrong", "ambiguous", "exact", "wrong"]
    assert "9 printed numbers and claims: 2 exact, 2 rounded, 2 ambiguous, 3 wrong" in table.text()
    assert "no claim \\| at all" in table.markdown()


def test_study_1_agrees_with_a_fine_integrator(runs: Runs) -> None:
    history = runs.study_1
    chosen = [0, 1, 3, 5]
    at = {t: history.lyapunov[history.index(t)][chosen] for t in (0.0, 1.0, 2.0, 3.0)}
    np.testing.assert_allclose(at[0.0], 2.4159984, atol=1e-7)
    np.testing.assert_allclose(at[1.0], [0.727685, 0.415455, 0.346866, 0.344557], atol=1e-4)
    np.testing.assert_allclose(at[2.0], [0.219174, 0.081646, 0.085215, 0.091984], atol=1e-4)
    np.testing.assert_allclose(at[3.0], [0.066014, 0.015578, 0.021411, 0.024879], atol=1e-4)
    np.testing.assert_allclose(history.settling(V_INF)[chosen], [3.231537, 2.301256, 2.385407, 2.465958], atol=1e-4)
    np.testing.assert_allclose(history.gain[-1, chosen], [1.0, 2.289760, 4.423301, 6.656436], atol=1e-4)


@pytest.mark.parametrize("gain", [1.0, 10.0, 100.0])
def test_the_adversary_keeps_to_the_robust_set_but_not_if_it_is_stronger_than_certified(
    gain: float, runs: Runs
) -> None:
    assert runs.campaign[gain] <= 1.0 + 1e-9
    assert runs.robust.robust is not None
    stronger = dataclasses.replace(runs.robust.robust, drift=1.2 * runs.robust.robust.drift)
    assert run_campaign(dataclasses.replace(runs.robust, robust=stronger), gain, runs=500) > 1.01


def test_the_printed_disturbance_keeps_to_the_robust_set(runs: Runs) -> None:
    for history in runs.study_2.values():
        assert history.lyapunov[0] == pytest.approx(1.0)
        assert history.lyapunov.max() <= 1.0 + 1e-9


def test_the_papers_failure_appears_behind_lag_and_delay_and_the_cap_removes_it(runs: Runs) -> None:
    law, capped, cap = runs.test_1, runs.test_1_capped, runs.cap
    assert cap == pytest.approx(5.10, abs=0.02)
    late = law.time > 20.0
    assert law.lyapunov[0] == pytest.approx(3.4375)
    assert (law.lyapunov[late].max(axis=0) > V_INF).tolist() == [False, False, False, True, True]
    assert (np.ptp(law.gain[late], axis=0) > 0.05).tolist() == [False, False, False, True, True]
    assert (capped.lyapunov[late] < 1e-6).all()
    assert capped.gain.max() == cap


def test_over_repeated_set_points_only_the_papers_gain_leads_to_a_limit_cycle(runs: Runs) -> None:
    flown = runs.gain_laws
    last = flown.time > flown.time[-1] - 3.0  # five seconds after the last set-point
    swing = np.degrees(flown.tilt[last]).max(axis=0)
    assert swing[0] > 9.0, "the paper's law ends at full tilt"
    assert (swing[1:] < 4.0).all(), "capped, leaky and restarting laws come to rest"
    assert flown.gain[:, 1].max() == pytest.approx(flown.cap)
    assert flown.disturbed_gain[-1, 0] == pytest.approx(runs.experiment.gain_max)
    assert flown.disturbed_gain[-1, 1] == pytest.approx(flown.disturbed_gain[-600, 1], rel=1e-2)
