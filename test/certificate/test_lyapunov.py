"""The Lyapunov matrix and the zero-order hold, against direct simulation of the held double integrator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.lyapunov import (
    bernstein_coefficients,
    closed_form_block,
    decay_rate,
    decay_residual,
    hold_contraction,
    hold_gain_interval,
    hold_growth,
)

rates = st.floats(-1.0, 1.0).map(lambda exponent: 10.0**exponent)
holds = st.floats(0.01, 1.6)  # alpha h
shares = st.floats(0.0, 1.0)

# states of one axis in all directions; scale does not matter
ANGLES = np.linspace(0.0, math.pi, 721)
STATES = np.array([np.cos(ANGLES), np.sin(ANGLES)])


def value(block: np.ndarray, x: np.ndarray) -> np.ndarray:
    """V of states (2, ...)."""
    return block[0, 0] * x[0] ** 2 + 2.0 * block[0, 1] * x[0] * x[1] + block[1, 1] * x[1] ** 2


def held(block: np.ndarray, gain: float, x: np.ndarray, t: float) -> np.ndarray:
    """States (2, ...) after t seconds with the command of the beginning held, by the kinematics of a thrown stone."""
    v = -gain * (block[1, 0] * x[0] + block[1, 1] * x[1])
    return np.array([x[0] + t * x[1] + t * t / 2.0 * v, x[1] + t * v])


def on_level_set(block: np.ndarray) -> np.ndarray:
    """States (2, 721) of V = 1 in all directions of the set, so that no eigenvector is missed."""
    return np.linalg.solve(np.linalg.cholesky(block).T, STATES)


@given(rate=rates, x=st.tuples(*[st.floats(-5.0, 5.0)] * 6), gain=st.floats(0.5, 20.0))
def test_v_decays_exactly_as_the_closed_form_says(rate: float, x: tuple[float, ...], gain: float) -> None:
    block = closed_form_block(rate)
    matrix, xi = np.kron(block, np.eye(3)), np.array(x)
    eta = (matrix @ xi)[3:]
    flow = np.concatenate([xi[3:], -gain * eta])
    derivative = 2.0 * xi @ matrix @ flow
    expected = -rate * (xi @ matrix @ xi) + 2.0 * (1.0 - gain) * (eta @ eta)
    scale = (1.0 + gain) * (1.0 + rate) ** 6 * (1.0 + xi @ xi)
    assert derivative == pytest.approx(expected, abs=1e-12 * scale)


@given(rate=rates)
def test_the_decay_condition_is_tight_at_the_closed_form(rate: float) -> None:
    block = closed_form_block(rate)
    assert abs(decay_residual(block, rate)) < 1e-12
    assert decay_residual(block, rate * 1.001) > 0.0
    np.testing.assert_allclose(
        np.linalg.inv(block), [[4.0 / rate**3, -2.0 / rate**2], [-2.0 / rate**2, 2.0 / rate]], rtol=1e-12
    )


@pytest.mark.parametrize(("period", "cap"), [(0.1, 15.87), (0.05, 31.87), (0.02, 79.87), (0.01, 159.87)])
def test_the_gain_caps_of_the_experiment(period: float, cap: float) -> None:
    assert hold_gain_interval(1.25, period)[1] == pytest.approx(cap, abs=5e-3)


@given(rate=rates, hold=holds)
def test_the_gain_interval_is_the_papers_formula_without_its_cancellation(rate: float, hold: float) -> None:
    lower, upper = hold_gain_interval(rate, hold / rate)
    root, scale = math.sqrt(4.0 - 2.0 * hold), 2.0 * hold * (1.0 + hold / 16.0)
    assert lower == pytest.approx((2.0 + hold / 2.0 - root) / scale, rel=1e-9)
    assert upper == pytest.approx((2.0 + hold / 2.0 + root) / scale, rel=1e-12)
    assert lower < 1.0 <= upper


@given(rate=rates, hold=holds, shares=st.lists(shares, min_size=12, max_size=12))
def test_gains_within_the_interval_let_v_grow_neither_at_nor_between_samples(
    rate: float, hold: float, shares: list[float]
) -> None:
    block, period = closed_form_block(rate), hold / rate
    lower, upper = hold_gain_interval(rate, period)
    x = on_level_set(block)
    for share in shares:
        gain = lower + share * (upper - lower)
        before = value(block, x)
        for t in np.linspace(0.0, period, 9)[1:]:
            assert (value(block, held(block, gain, x, t)) <= before * (1.0 + 1e-12)).all()
        x = held(block, gain, x, period)


@given(rate=rates, hold=holds)
def test_gains_beyond_the_interval_let_some_state_grow(rate: float, hold: float) -> None:
    block, period = closed_form_block(rate), hold / rate
    lower, upper = hold_gain_interval(rate, period)
    for gain in (lower * 0.99, upper * 1.01):
        assert value(block, held(block, gain, on_level_set(block), period)).max() > 1.0


@given(rate=rates, hold=holds, share=shares)
def test_the_contraction_is_the_worst_of_a_direct_simulation(rate: float, hold: float, share: float) -> None:
    block, period = closed_form_block(rate), hold / rate
    gain = share * 1.5 * hold_gain_interval(rate, period)[1]
    worst = value(block, held(block, gain, on_level_set(block), period)).max()
    contraction = hold_contraction(block, period, gain)
    assert worst <= contraction * (1.0 + 1e-12)
    assert worst >= contraction * (1.0 - 1e-3)


@given(rate=rates, hold=holds, first=shares, second=shares, mix=shares)
def test_between_two_gains_the_larger_contraction_of_the_two_bounds(
    rate: float, hold: float, first: float, second: float, mix: float
) -> None:
    block, period = closed_form_block(rate), hold / rate
    a, b = 20.0 * first, 20.0 * second
    bound = max(hold_contraction(block, period, a), hold_contraction(block, period, b))
    assert hold_contraction(block, period, mix * a + (1.0 - mix) * b) <= bound * (1.0 + 1e-12)


@given(rate=rates, hold=holds, share=shares)
def test_the_growth_bound_is_above_every_simulated_growth_and_not_far(rate: float, hold: float, share: float) -> None:
    block, period = closed_form_block(rate), hold / rate
    gain = share * 1.5 * hold_gain_interval(rate, period)[1]
    x = on_level_set(block)
    fractions = np.linspace(0.0, 1.0, 65)[1:]
    slopes = [((value(block, held(block, gain, x, s * period)) - 1.0) / s).max() for s in fractions]
    bound = hold_growth(block, period, gain)
    assert max(slopes) <= bound + 1e-9
    assert max(slopes) >= bound - 0.15 * (1.0 + abs(bound))


@given(rate=rates, hold=holds)
def test_the_growth_bound_proves_the_gain_interval_and_nothing_beyond(rate: float, hold: float) -> None:
    block, period = closed_form_block(rate), hold / rate
    for gain, outward in zip(hold_gain_interval(rate, period), (0.99, 1.01), strict=True):
        assert hold_growth(block, period, gain) <= 1e-9
        assert hold_growth(block, period, gain * outward) > 0.0


@given(
    coefficients=st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=6),
    start=st.floats(-2.0, 2.0),
    length=st.floats(0.01, 2.0),
)
def test_a_polynomial_lies_between_its_bernstein_coefficients(
    coefficients: list[float], start: float, length: float
) -> None:
    control = bernstein_coefficients(np.array(coefficients), start, start + length)
    t = np.linspace(start, start + length, 33)
    values = np.polynomial.polynomial.polyval(t, coefficients)
    slack = 1e-9 * sum(abs(c) * 4.0**i for i, c in enumerate(coefficients))
    assert control.min() - slack <= values.min()
    assert values.max() <= control.max() + slack
    np.testing.assert_allclose([control[0], control[-1]], [values[0], values[-1]], rtol=0.0, atol=slack)


@settings(max_examples=30)
@given(st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=4), st.floats(0.0, 1.0))
def test_bernstein_coefficients_evaluate_to_the_polynomial(coefficients: list[float], s: float) -> None:
    control = bernstein_coefficients(np.array(coefficients), 0.5, 1.5)
    basis = [math.comb(3, i) * s**i * (1.0 - s) ** (3 - i) for i in range(4)]
    assert basis @ control == pytest.approx(np.polynomial.polynomial.polyval(0.5 + s, coefficients), abs=1e-11)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, True, "1", None])
def test_rates_and_periods_that_are_not_positive_numbers_are_refused(bad: float) -> None:
    for call in (
        lambda: closed_form_block(bad),
        lambda: hold_gain_interval(bad, 0.1),
        lambda: hold_gain_interval(1.2, bad),
    ):
        with pytest.raises(FlatsatError, match="must be a number above 0, from 1e-12 to"):
            call()


def test_a_period_too_long_for_any_gain_is_refused_with_a_valid_one() -> None:
    with pytest.raises(FlatsatError, match=r"rate \* period = 2\.0: must be below 2 .*a period below 1\.6 s"):
        hold_gain_interval(1.25, 1.6)
    with pytest.raises(FlatsatError, match=r"must be smaller: the gain cap would be 0\.7"):
        hold_gain_interval(1.25, 1.52)


@given(rate=st.floats(0.1, 10.0), kappa=st.floats(0.3, 1.0))
def test_at_a_gain_below_one_the_rate_is_alpha_times_two_kappa_less_one(rate: float, kappa: float) -> None:
    assert decay_rate(closed_form_block(rate), kappa) == pytest.approx(rate * (2.0 * kappa - 1.0), rel=1e-9, abs=1e-9)
