"""Inequalities are decided exactly: what rounding would hide is seen, and what holds by nothing holds."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.certificate.exact import decaying, product, rationals, semidefinite
from flatsat_ros.certificate.lowered import lowered
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.law.input_set import InputSet


@given(n=st.integers(1, 12), rank=st.integers(1, 12), seed=st.integers(0, 2**32 - 1))
def test_a_product_with_its_transpose_is_semidefinite_and_less_than_that_is_not(n: int, rank: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    factor = rationals(random.integers(-9, 10, size=(n, rank)) * 1.1 ** random.integers(-60, 30))
    matrix = product(factor, factor.T)
    if n < 9:  # large matrices are only told where something is left
        assert semidefinite(matrix)
    assert semidefinite(matrix + Fraction(1, 10**20) * np.eye(n, dtype=int))
    if rank < n:
        row = rationals(random.standard_normal(n))  # hardly ever one of what the columns span
        assert not semidefinite(matrix - Fraction(1, 10**60) * np.outer(row, row))


@given(exponent=st.floats(0.0, 1000.0))
def test_bounds_of_the_exponential_are_on_both_sides(exponent: float) -> None:
    low, high = decaying(Fraction(repr(exponent)))
    assert 0 <= low <= high <= 1
    assert high - low <= Fraction(3, 10**36)
    assert float(low) == pytest.approx(math.exp(-exponent), rel=2e-16 * (10.0 + exponent), abs=1e-35)


@given(
    h=st.floats(0.005, 0.5),
    tau=st.one_of(st.just(0.0), st.floats(0.01, 1.0)),
    delay=st.one_of(st.integers(0, 5).map(float), st.floats(0.0, 5.0)),
)
def test_the_transition_in_floating_point_is_that_of_the_corners(h: float, tau: float, delay: float) -> None:
    timing = Timing(h, tau, delay * h)
    assert len(timing.corners) in (1, 2, 4)
    for exact in timing.corners:
        for corner, computed in zip(exact, timing.transition, strict=True):
            assert corner.shape == computed.shape
            assert all(isinstance(entry, int | Fraction) for entry in corner.ravel().tolist())
            np.testing.assert_allclose(corner.astype(float), computed, rtol=1e-11, atol=1e-13 * (1.0 + h + tau) ** 2)


def test_a_claim_too_large_by_its_last_digit_is_refused() -> None:
    """All of what the closed form claims is tight: after lowering it holds, and one more digit is too much."""
    limits = InputSet(14.2, 0.17)
    for rate in (1.25, 1.2345678901234567, math.pi):
        certificate = closed_form_certificate(limits, rate, 0.1, "tight")
        assert min(certificate.verify().values()) >= 0.0
        for claim, share in (("level", 1e-15), ("ball", 1e-15), ("rate", 1e-15), ("gain_max", 1e-14)):
            larger = replace(certificate, **{claim: getattr(certificate, claim) * (1.0 + share)})
            with pytest.raises(FlatsatError, match=r"fails by .* or be claimed a little weaker: synthesize it again"):
                larger.verify()


def test_only_what_fails_by_rounding_is_lowered_and_by_no_more() -> None:
    rate, low, high = 1.25, *hold_gain_interval(1.25, 0.1)
    ball = InputSet(14.2, 0.17).inner_radius ** 2
    block = closed_form_block(rate)
    tight = Certificate("tight", InputSet(14.2, 0.17), rate, block, ball, ball / rate, 0.1, low, high)
    holding, shares = lowered(tight)
    assert "rate" not in shares  # of 1.25 the block has few decimals
    assert set(shares) <= {"ball", "level", "gain_min", "gain_max"}
    assert max(shares.values()) <= 1e-14
    assert lowered(holding) == (holding, {})
    wrong = replace(tight, level=tight.level * 1.001)
    assert lowered(wrong) == (wrong, {})


@pytest.mark.parametrize("entry", [(0, 1), (1, 0)])
def test_a_matrix_must_be_symmetric_to_the_last_digit(entry: tuple[int, int]) -> None:
    certificate = load_certificate("paper_experiment")
    block = np.array(certificate.block)
    block[entry] *= 1.0 + 1e-15
    with pytest.raises(FlatsatError, match="asymmetry of block"):
        replace(certificate, block=block)
