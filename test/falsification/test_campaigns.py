"""The campaigns find nothing against what is proved, and whatever is made wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.falsification import adversary
from flatsat_ros.falsification.adversary import SwingingReferences
from flatsat_ros.falsification.campaigns import CAMPAIGNS, RUNS, STEPS, CampaignOutcome, Pool, run
from flatsat_ros.falsification.claims import ROUNDING
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.nominal import synthesize
from flatsat_ros.synthesis.robust_design import synthesize_paper_robust

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def pool() -> Pool:
    limits = InputSet(1.45 * GRAVITY, math.radians(10.0))
    lags = [(0.1, 0.1, 0.05, 1.0), (0.02, 0.08, 0.03, 0.7)]
    return {
        "lag": [synthesize(limits, 1.25, h, "lag", lag=tau, delay=d, lowest=least) for h, tau, d, least in lags],
        "robust": [synthesize_paper_robust()],
    }


def claims(outcome: CampaignOutcome) -> set[str]:
    """What failed."""
    return {violation.claim for violation in outcome.violations}


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_no_claim_fails(campaign: str, pool: Pool) -> None:
    for seed in range(2):
        outcome = run(campaign, seed, pool)
        assert outcome.violations == []
        assert max(outcome.tightest.values()) <= ROUNDING


@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_a_seed_and_an_index_determine_a_run_to_the_last_bit(campaign: str, pool: Pool) -> None:
    first, again, other = (run(campaign, seed, pool, watched=17) for seed in (5, 5, 6))
    assert len(first.history) == STEPS
    assert first.tightest == again.tightest
    for one, two in zip(first.history, again.history, strict=True):
        assert all(np.array_equal(one[name], two[name]) for name in one)
    assert not np.array_equal(first.history[0]["xi"], other.history[0]["xi"])


def larger_level(proven: Certificate) -> Certificate:
    return replace(proven, level=1.05 * proven.level)


def larger_gain(proven: Certificate) -> Certificate:
    return replace(proven, gain_max=1.01 * proven.gain_max)


def far_larger_gain(proven: Certificate) -> Certificate:
    return replace(proven, gain_max=3.0 * proven.gain_max)


def smaller_kappa(proven: Certificate) -> Certificate:
    return replace(proven, gain_min=0.9 * proven.gain_min)


def stronger_wind(proven: Certificate) -> Certificate:
    assert proven.robust is not None
    return replace(proven, robust=replace(proven.robust, drift=1.05 * proven.robust.drift))


@pytest.mark.parametrize(
    ("tamper", "campaign", "claim"),
    [
        (larger_level, "hold", "k >= min(gamma, kappa)"),
        (larger_level, "lag", "k >= min(gamma, kappa)"),
        (larger_level, "continuous", "k >= min(gamma, kappa)"),
        (larger_gain, "hold", "V_h does not grow at samples"),
        (larger_gain, "lag", "W_h does not grow at samples"),
        (far_larger_gain, "hold", "V_h does not grow between samples"),
        (far_larger_gain, "robust", "V does not grow at samples"),
        (smaller_kappa, "hold", "V_v does not grow at samples"),
        (stronger_wind, "storm", "V' <= alpha (w'w - (2 kappa - 1) V)"),
    ],
)
def test_a_wrong_certificate_is_refused_and_flown_all_the_same_it_is_caught(
    tamper: Callable[[Certificate], Certificate], campaign: str, claim: str, pool: Pool
) -> None:
    outcomes = [run(campaign, seed, pool, tamper) for seed in range(2)]
    for outcome in outcomes:
        with pytest.raises(FlatsatError, match="fails by"):
            outcome.certificate.verify()
    assert claim in claims(outcomes[0]) | claims(outcomes[1])


def test_a_level_too_large_costs_the_rate(pool: Pool) -> None:
    outcome = run("continuous", 0, pool, larger_level)
    # V' + alpha V = 2 (1 - k) |eta|^2 with k = 1 / sqrt(1.05) and |eta|^2 = alpha V: nearly 5 % of alpha V
    excess = outcome.tightest["V' <= alpha (w'w - (2 kappa - 1) V)"]
    assert excess == pytest.approx(2.0 * (1.0 - 1.05**-0.5), rel=0.05)


def test_a_gain_far_too_large_drives_runs_out_of_their_set(pool: Pool) -> None:
    assert run("lag", 0, pool, far_larger_gain).tightest["no set is left"] > 0.0


def test_the_history_of_a_run_shows_its_violation(pool: Pool) -> None:
    violations = run("hold", 0, pool, larger_gain).violations
    violation = next(one for one in violations if one.claim == "V_h does not grow at samples" and one.step < STEPS - 1)
    history = run("hold", 0, pool, larger_gain, watched=violation.index).history
    before, after = (float(history[violation.step + later]["V_h"]) for later in (0, 1))
    assert after / before - 1.0 == pytest.approx(violation.excess)


def test_a_saturation_that_gives_too_much_is_caught(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    true = InputSet.reach_of_finite

    def generous(self: InputSet, base: FloatArray, v: FloatArray, most: FloatArray) -> FloatArray:
        return np.minimum(most, 1.0001 * true(self, base, v, most))

    monkeypatch.setattr(InputSet, "reach_of_finite", generous)
    for campaign in ("hold", "tracking"):
        excess = run(campaign, 0, pool).tightest
        assert excess["v lies in the input set"] > ROUNDING
        assert max(excess["T <= T_max"], excess["T >= T_min"], excess["|phi|, |theta| <= eps_max"]) > ROUNDING


def test_a_gain_law_without_its_cap_is_caught(pool: Pool, monkeypatch: pytest.MonkeyPatch) -> None:
    def uncapped(gain: FloatArray, lyapunov: FloatArray, *_: object) -> FloatArray:
        return gain + lyapunov

    monkeypatch.setattr("flatsat_ros.law.gain.adapt", uncapped)
    assert "gamma stays within its bounds" in claims(run("hold", 0, pool))


@given(seed=seeds)
def test_certificates_are_drawn_verified_and_runs_start_where_they_are_guaranteed(seed: int) -> None:
    random = np.random.default_rng(seed)
    proven = adversary.certificate(random)
    proven.verify()
    z = adversary.starts(random, proven, RUNS)
    ellipsoid, larger = proven.sets.scale_ellipsoid(z), proven.sets.scale_larger(z)
    assert proven.sets.classify(z).guaranteed.all()
    for scale in (ellipsoid, larger, larger * proven.gain_min):
        assert np.count_nonzero(np.abs(scale - 1.0) < 1e-8) > RUNS / 8


@given(seed=seeds, time=st.floats(0.0, 100.0))
def test_references_keep_their_margin(seed: int, time: float) -> None:
    random = np.random.default_rng(seed)
    proven = adversary.certificate(random)
    margin = proven.limits.inner_radius * random.random(RUNS)
    reference = SwingingReferences.draw(random, proven, margin).at(time)
    assert (proven.limits.margin(reference[:, 6:]) >= margin - 1e-12 * proven.limits.thrust_max).all()
