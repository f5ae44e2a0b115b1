"""Goals: the rate that covers given start errors is the largest, in D, for every loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis import goals
from flatsat_ros.synthesis.common_function import BreakdownError
from flatsat_ros.synthesis.goals import rate_covering, robust_rate_covering, start_corners
from flatsat_ros.synthesis.nominal import synthesize
from flatsat_ros.synthesis.robust_design import synthesize_robust

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
STRONG = InputSet(2.0 * GRAVITY, math.radians(40.0))

magnitudes = st.lists(st.floats(0.05, 3.0), min_size=6, max_size=6)


def certified_rate(rate: float, start: np.ndarray) -> float:
    """The rate alpha (2 kappa - 1) of the paper's matrix for this alpha."""
    sets = synthesize(LIMITS, rate, 0.01, "one").sets
    return rate * (2.0 * float(sets.kappa(start).min()) - 1.0)


def test_velocities_count_along_and_against_the_position() -> None:
    np.testing.assert_array_equal(start_corners([1.0, 2.0, 3.0])[:, 3:], 0.0)
    found = start_corners([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert (np.abs(found) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).all()
    assert {tuple(np.sign(row[[3, 5]])) for row in found} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


@settings(max_examples=20, deadline=None)
@given(errors=magnitudes)
def test_the_start_lies_on_the_boundary_of_d_and_its_box_inside(errors: list[float]) -> None:
    rate = rate_covering(LIMITS, errors, Timing(0.01))
    sets = synthesize(LIMITS, rate, 0.01, "cover").sets
    assert float(sets.scale_larger(start_corners(errors)).max()) == pytest.approx(1.0, abs=1e-4)
    inside = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 6)) * errors
    assert (sets.scale_larger(inside) <= 1.0).all()
    assert sets.classify(inside).guaranteed.all()


@settings(max_examples=10, deadline=None)
@given(errors=magnitudes, factor=st.floats(1.01, 1.5))
def test_no_other_rate_has_a_kappa_set_that_is_faster(errors: list[float], factor: float) -> None:
    start = start_corners(errors)
    rate = rate_covering(LIMITS, errors, Timing(0.01))
    best = certified_rate(rate, start)
    assert best == pytest.approx(rate, rel=1e-3)
    assert certified_rate(rate * factor, start) < best
    assert certified_rate(rate / factor, start) < best


@pytest.mark.parametrize("timing", [Timing(0.1, 0.1, 0.05), Timing(0.02, 0.14, 0.002)], ids=str)
def test_with_lag_and_delay_the_first_test_of_the_paper_is_covered_from_hover(timing: Timing) -> None:
    errors = [1.2, 1.2, 0.8]
    rate = rate_covering(LIMITS, errors, timing)
    certificate = synthesize(LIMITS, rate, timing.period, "cover", lag=timing.lag, delay=timing.delay)
    assert certificate.sets.classify(start_corners(errors)).guaranteed.all()
    assert 1.05 < rate < 1.16


def test_a_breakdown_does_not_decide_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(timing: Timing, block: np.ndarray, *arguments: float) -> None:
        raise BreakdownError("out of luck") if block[1, 1] < 1.5 else FlatsatError("unstable")

    monkeypatch.setattr(goals, "gain_cap", fail)
    with pytest.raises(BreakdownError, match="out of luck"):
        rate_covering(LIMITS, [1.2, 1.2, 0.8], Timing(0.1, 0.1, 0.05))


def test_under_disturbance_the_start_is_guaranteed_and_a_faster_rate_would_not_do() -> None:
    errors, drift, push = [1.0, 1.0, 0.5], np.array([0.5, 0.2]), np.array([0.3, 0.3])
    rate = robust_rate_covering(STRONG, errors, 0.01, drift, push)

    def certificate(at: float) -> Certificate:
        return synthesize_robust(STRONG, drift, push, 0.01, "cover", rate=at)

    assert certificate(rate).sets.classify(start_corners(errors)).guaranteed.all()
    assert not certificate(rate * 1.02).sets.classify(start_corners(errors)).guaranteed.all()


@pytest.mark.parametrize("errors", [[], [1.0, 1.0], [1.0] * 5, [0.0] * 3, [1.0, -1.0, 1.0], [1.0, math.inf, 1.0]])
def test_other_start_errors_are_refused(errors: list[float]) -> None:
    with pytest.raises(FlatsatError, match="cover"):
        start_corners(errors)


def test_what_no_rate_covers_is_refused() -> None:
    with pytest.raises(FlatsatError, match=r"no rate from 0[.]01 to 100 1/s covers these start errors"):
        rate_covering(LIMITS, [1e6, 1.0, 1.0], Timing(0.01))
