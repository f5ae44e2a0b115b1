"""The loop with lag and delay: exact to the matrix exponential, and a plain hold without either."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_contraction, hold_transition
from flatsat_ros.certificate.sampled_loop import Timing

periods = st.floats(0.005, 0.5)
lags = st.one_of(st.just(0.0), st.floats(0.01, 1.0))
delays = st.one_of(st.integers(0, 5).map(float), st.floats(0.0, 5.0))  # in periods
seeds = st.integers(0, 2**32 - 1)


def flown(timing: Timing, start: np.ndarray, commands: np.ndarray, past: np.ndarray) -> np.ndarray:
    """(p, v) after len(commands) periods, from one exponential for every stretch of constant drive."""
    h, tau, d = timing.period, timing.lag, timing.delay
    given_at = np.arange(-len(past), len(commands)) * h + d  # when each command begins to drive
    values = np.concatenate([past[::-1], commands])
    end = len(commands) * h
    edges = np.unique(np.clip(np.concatenate([[0.0, end], given_at]), 0.0, end))
    system = np.zeros((4, 4))
    system[0, 1] = 1.0
    if tau > 0.0:
        system[1, 2], system[2, 2], system[2, 3] = 1.0, -1.0 / tau, 1.0 / tau
    else:
        system[1, 3] = 1.0
    state = np.concatenate([start, np.zeros(4 - len(start))])
    for begin, finish in itertools.pairwise(edges):
        state[3] = values[np.searchsorted(given_at, (begin + finish) / 2.0) - 1]
        state = expm(system * (finish - begin)) @ state
    return state[:2]


@given(h=periods, tau=lags, delay=delays, seed=seeds)
def test_the_discretisation_is_exact(h: float, tau: float, delay: float, seed: int) -> None:
    timing = Timing(h, tau if tau >= 0.01 * h else 0.0, delay * h)
    random = np.random.default_rng(seed)
    past, commands = random.standard_normal(math.ceil(delay) + 2), random.standard_normal(4)
    body = random.standard_normal(2 + (timing.lag > 0.0))
    z = np.concatenate([body, past[: timing.size - len(body)]])
    F, G = timing.transition
    for u in commands:
        z = F @ z + G[:, 0] * u
    np.testing.assert_allclose(z[:2], flown(timing, body, commands, past), rtol=1e-8, atol=1e-8)


@given(h=periods, rate=st.floats(0.1, 3.0), gain=st.floats(0.5, 20.0))
def test_without_lag_and_delay_it_is_the_plain_hold(h: float, rate: float, gain: float) -> None:
    timing, block = Timing(h), closed_form_block(rate)
    assert timing.immediate
    np.testing.assert_allclose(timing.closed_loop(block, gain), hold_transition(block, h, gain), rtol=1e-14)
    assert timing.contraction(block, block, gain) == pytest.approx(hold_contraction(block, h, gain), rel=1e-12)


@pytest.mark.parametrize(
    ("timing", "size"),
    [
        (Timing(0.1), 2),
        (Timing(0.1, 0.05), 3),
        (Timing(0.1, 0.0, 0.1), 3),
        (Timing(0.1, 0.0, 0.04), 3),
        (Timing(0.1, 0.0, 0.14), 4),
        (Timing(0.1, 0.05, 3 * 0.1), 6),  # 0.30000000000000004 / 0.1 is above 3
        (Timing(0.3, 0.05, 0.9), 6),
        (Timing(0.01, 0.08, 0.03), 6),
    ],
)
def test_a_command_is_remembered_as_long_as_it_is_needed(timing: Timing, size: int) -> None:
    assert timing.size == size
    assert timing.transition[0].shape == (size, size)


@given(h=periods, tau=lags, delay=delays, seed=seeds)
def test_what_is_not_measured_follows_from_the_commands(h: float, tau: float, delay: float, seed: int) -> None:
    timing = Timing(h, tau if tau >= 0.01 * h else 0.0, delay * h)
    random = np.random.default_rng(seed)
    z, command = random.standard_normal((5, timing.size, 3)), random.standard_normal((5, 3))
    F, G = timing.transition
    following = timing.advance(z, command)
    # terms may cancel: rounding is relative to what is added up
    gathered = np.einsum("ij,njk->nik", np.abs(F), np.abs(z)) + np.abs(G * command[:, np.newaxis])
    error = np.abs(timing.follow(z[:, 2:].reshape(5, -1), command).reshape(5, -1, 3) - following[:, 2:])
    assert (error <= 2.0 * timing.size * np.finfo(float).eps * gathered[:, 2:]).all()


def test_what_is_constant_of_a_timing_is_computed_once_and_for_all() -> None:
    timing = Timing(0.02, 0.14, 0.03)
    assert timing.transition[0] is timing.transition[0]
    for matrix in timing.transition:
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 2.0
    assert timing == Timing(0.02, 0.14, 0.03)  # the stored matrices are no part of what it is


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((0.0,), "period (h) = 0.0 s"),
        ((0.1, -0.1), "lag (tau) = -0.1 s: must be a number from 0 to"),
        ((0.1, math.nan), "lag (tau) = nan s"),
        ((0.1, "0.1"), "lag (tau) = '0.1' s"),
        ((0.1, 0.0, math.inf), "delay (d) = inf s"),
        ((0.1, True), "lag (tau) = True s"),
        ((0.1, 1e-5), "must be 0 or at least 0.0001 s"),
        ((0.01, 0.1, 0.5), "delay (d) = 0.5 s: must be at most 0.4 s, 40 periods"),
    ],
)
def test_impossible_timings_are_refused(values: tuple[float, ...], text: str) -> None:
    with pytest.raises(FlatsatError) as refused:
        Timing(*values)
    assert text in str(refused.value)
