"""Nominal synthesis: the paper's figures, agreement of closed form and solver, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.lyapunov import closed_form_block
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis import nominal

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))


@pytest.mark.parametrize(
    ("name", "rate", "level", "gain_max"),
    [("paper_simulation", 1.2, 2.418228, 16.538759), ("paper_experiment", 1.25, 2.321499, 15.871967)],
)
def test_the_papers_figures_come_out(name: str, rate: float, level: float, gain_max: float) -> None:
    certificate = nominal.synthesize_paper(name)
    assert certificate.rate == rate
    assert certificate.period == 0.1
    assert certificate.limits.thrust_max == pytest.approx(1.45 * GRAVITY, rel=1e-15)
    assert certificate.limits.tilt_max == pytest.approx(math.pi / 18, rel=1e-15)
    assert certificate.ball == pytest.approx(2.901873, abs=5e-7)
    assert certificate.level == pytest.approx(level, abs=5e-7)
    assert certificate.gain_max == pytest.approx(gain_max, abs=5e-7)


def test_the_matrices_round_to_those_the_paper_prints() -> None:
    simulation, experiment = nominal.synthesize_paper("paper_simulation"), nominal.synthesize_paper("paper_experiment")
    printed_inverse = np.kron([[2.3148, -1.3889], [-1.3889, 1.6667]], np.eye(3))
    np.testing.assert_allclose(np.linalg.inv(simulation.matrix), printed_inverse, atol=5e-5)
    printed = np.kron([[0.98, 0.78], [0.78, 1.25]], np.eye(3))
    np.testing.assert_allclose(experiment.matrix, printed, atol=5e-3)


@settings(max_examples=25)
@given(
    thrust=st.floats(1.01, 3.0),
    tilt=st.floats(0.02, 1.5),
    rate=st.floats(-2.0, 2.0).map(lambda exponent: 10.0**exponent),
    hold=st.floats(0.001, 1.0),
)
def test_closed_form_and_solver_agree_for_any_vehicle_and_rate(
    thrust: float, tilt: float, rate: float, hold: float
) -> None:
    limits = InputSet(thrust * GRAVITY, tilt)
    certificate = nominal.synthesize(limits, rate, hold / rate, "any")
    certificate.verify()
    factor = np.linalg.cholesky(certificate.matrix)
    agreement = np.linalg.eigvalsh(factor.T @ nominal.solve_decay(rate) @ factor)
    np.testing.assert_allclose(agreement, 1.0, rtol=nominal.TOLERANCE)


def test_the_solver_finds_the_matrix_and_the_level_without_the_closed_form() -> None:
    Q = nominal.solve_decay(1.2)
    np.testing.assert_allclose(Q, np.kron([[4 / 1.2**3, -2 / 1.2**2], [-2 / 1.2**2, 2 / 1.2]], np.eye(3)), atol=1e-6)
    # a matrix that is no closed form: eps = rho / (largest eigenvalue of B'P B)
    assert nominal.solve_level(np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), 1.0, 3.0) == pytest.approx(0.5, rel=1e-6)


def test_provenance_says_how_the_certificate_came_about() -> None:
    provenance = nominal.synthesize(LIMITS, 1.2, 0.1, "mine", {"thrust_max": "1.45 g"}).provenance
    assert provenance["inputs"] == {"thrust_max": "1.45 g"}
    assert provenance["package"].startswith("flatsat_ros ")
    assert provenance["solver"].startswith("Clarabel ")
    assert provenance["cross_check"]["status"] == "optimal"
    assert "continuous time" in nominal.synthesize_paper("paper_simulation").provenance["inputs"]["source"]


@pytest.mark.parametrize(
    ("rate", "period", "text"),
    [
        (0.0, 0.1, "rate"),
        (math.nan, 0.1, "rate"),
        (-1.0, 0.1, "rate"),
        (1e200, 1e-250, r"must be a number from 0.001 to 1000"),
        (1.25, 0.0, "period"),
        (1.25, math.inf, "period"),
        (25.0, 0.1, "or V grows whatever the gain"),
        (19.5, 0.1, "gain cap would be"),
    ],
)
def test_rates_and_periods_without_an_admissible_gain_are_refused(rate: float, period: float, text: str) -> None:
    with pytest.raises(FlatsatError, match=text):
        nominal.synthesize(LIMITS, rate, period, "bad")


def test_a_wrong_closed_form_is_caught_by_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nominal, "closed_form_block", lambda rate: closed_form_block(rate) * (1.0 - 1e-5))
    with pytest.raises(FlatsatError, match="differ in Q by 1e-05"):
        nominal.synthesize(LIMITS, 1.2, 0.1, "wrong")


def test_a_wrong_level_is_caught_by_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nominal, "solve_level", lambda matrix, rate, ball: 1.1 * ball / rate)
    with pytest.raises(FlatsatError, match=r"differ in eps by 0[.]1"):
        nominal.synthesize(LIMITS, 1.2, 0.1, "wrong")
