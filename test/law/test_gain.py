"""The gain law: it never falls, it rests below the threshold, and it stays below its bounds."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.gain_bounds import continuous_gain_bound, sampled_gain_bound, settling_time_bound
from flatsat_ros.certificate.lyapunov import hold_gain_interval
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning, adapt

CERTIFICATE = Certificate.load(Path(__file__).parents[2] / "config" / "paper_simulation.yaml")
THRESHOLD = 0.05


def boundary_states(count: int) -> np.ndarray:
    """States (count, 6) on the boundary of the invariant set, in random directions."""
    normal = np.random.default_rng(0).normal(size=(count, 6))
    normal *= math.sqrt(CERTIFICATE.level) * (1.0 - 1e-9) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.linalg.solve(np.linalg.cholesky(CERTIFICATE.matrix).T, normal.T).T


def final_gains(period: float, mu: float, seconds: float, count: int) -> np.ndarray:
    """Gains (count,) after a flight of the sampled law on the exact double integrator."""
    gain_min, gain_max = hold_gain_interval(CERTIFICATE.rate, period)
    certificate = dataclasses.replace(CERTIFICATE, period=period, gain_min=gain_min, gain_max=gain_max)
    controller = Controller(certificate, Tuning(np.full(count, mu), THRESHOLD, 1.0, gain_max))
    memory, x, rest = controller.start(), boundary_states(count), np.zeros((count, 9))
    for _ in range(round(seconds / period)):
        following, output = controller.step(memory, x, np.zeros(count), rest)
        assert (following.gain >= memory.gain).all()
        v, memory = output.acceleration, following
        x = np.hstack([x[:, :3] + period * x[:, 3:] + period**2 / 2.0 * v, x[:, 3:] + period * v])
    assert (output.lyapunov < THRESHOLD).all()
    return memory.gain


@given(
    gain=st.floats(1.0, 16.0), lyapunov=st.floats(0.0, 1e300), mu=st.floats(0.0, 100.0), threshold=st.floats(1e-6, 10.0)
)
def test_the_gain_never_falls_nor_passes_its_cap_and_rests_below_the_threshold(
    gain: float, lyapunov: float, mu: float, threshold: float
) -> None:
    following = adapt(np.array([gain]), np.array([lyapunov]), Tuning(mu, threshold, 1.0, 16.0), 0.1)[0]
    assert gain <= following <= 16.0
    if lyapunov <= threshold or mu == 0.0:
        assert following == gain
    elif following < 16.0:
        assert following == pytest.approx(gain + 0.1 * mu * (lyapunov - threshold), rel=1e-12)


def test_every_drone_has_its_own_tuning() -> None:
    tuning = Tuning([0.0, 1.0, 2.0, 9.0], [0.1, 0.1, 0.6, 0.1], 1.0, [5.0, 5.0, 5.0, 1.2])
    gains = adapt(np.full(4, 1.0), np.full(4, 1.1), tuning, 0.1)
    assert gains == pytest.approx([1.0, 1.1, 1.1, 1.2])


def test_scalars_are_spread_and_nothing_can_be_changed_afterwards() -> None:
    tuning = Tuning(2.0, THRESHOLD, [1.0, 1.5], 10.0)
    assert tuning.adaptation_rate.tolist() == [2.0, 2.0]
    assert tuning.gain_max.tolist() == [10.0, 10.0]
    with pytest.raises(ValueError, match="read-only"):
        tuning.adaptation_rate[0] = 9.0


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((-0.1, 0.05, 1.0, 10.0), "adaptation_rate (mu) = -0.1 1/s: must be from 0 to 1e+12"),
        ((1.0, 0.0, 1.0, 10.0), "threshold (V_inf) = 0.0: must be above 0, from 1e-12 to 1e+12"),
        ((1.0, 0.05, 0.9, 10.0), "gain_initial (gamma_0) = 0.9: must be from 1 to gain_max = 10"),
        ((1.0, 0.05, 11.0, 10.0), "gain_initial (gamma_0) = 11"),
        ((1.0, 0.05, 1.0, 0.5), "gain_max = 0.5: must be from 1 to 1e+12"),
        (([1.0, -2.0], 0.05, 1.0, 10.0), "adaptation_rate (mu) = -2"),
        ((math.nan, 0.05, 1.0, 10.0), "an entry of adaptation_rate = nan"),
        ((1.0, math.inf, 1.0, 10.0), "an entry of threshold = inf"),
        (([1.0, 2.0], [0.1, 0.1, 0.1], 1.0, 10.0), "give one value for all drones or one for each"),
    ],
)
def test_tunings_out_of_range_are_refused(values: tuple[float, ...], text: str) -> None:
    with pytest.raises(FlatsatError) as refused:
        Tuning(*values)
    assert text in str(refused.value)


def test_the_settling_time_bound_is_the_papers() -> None:
    assert settling_time_bound(2.4159984, 0.05, 1.2) == pytest.approx(3.2315, abs=1e-4)
    assert settling_time_bound(CERTIFICATE.level, 0.05, 1.2) == pytest.approx(3.2323, abs=5e-5)
    assert settling_time_bound(0.04, 0.05, 1.2) == 0.0
    with pytest.raises(FlatsatError, match="threshold"):
        settling_time_bound(1.0, 0.0, 1.2)
    with pytest.raises(FlatsatError, match="rate"):
        settling_time_bound(1.0, 0.05, 0.0)


@given(start=st.floats(0.06, 10.0), mu=st.floats(0.01, 10.0), rate=st.floats(0.1, 5.0))
def test_the_continuous_bound_is_the_integral_of_the_slowest_decay(start: float, mu: float, rate: float) -> None:
    t = np.linspace(0.0, settling_time_bound(start, THRESHOLD, rate), 20001)
    excess = start * np.exp(-rate * t) - THRESHOLD
    integral = float(((excess[1:] + excess[:-1]) / 2.0 * np.diff(t)).sum())
    assert continuous_gain_bound(1.0, mu, start, THRESHOLD, rate) == pytest.approx(1.0 + mu * integral, rel=1e-6)


def test_below_the_threshold_the_gain_is_bounded_by_where_it_started() -> None:
    assert continuous_gain_bound(1.5, 5.0, 0.04, THRESHOLD, 1.2) == 1.5
    assert sampled_gain_bound(1.5, 5.0, 0.04, THRESHOLD, CERTIFICATE.block, 0.1) == 1.5


@pytest.mark.parametrize("mu", [0.01, 0.1, 1.0, 5.0])
def test_at_a_fine_step_the_gain_stays_below_the_continuous_bound(mu: float) -> None:
    bound = continuous_gain_bound(1.0, mu, CERTIFICATE.level, THRESHOLD, CERTIFICATE.rate)
    # an Euler sum over a falling function exceeds its integral by at most one step of the first value
    assert final_gains(0.002, mu, 5.0, 30).max() <= bound + 0.002 * mu * CERTIFICATE.level


def test_at_the_experiments_period_euler_breaks_the_continuous_bound() -> None:
    bound = continuous_gain_bound(1.0, 0.1, CERTIFICATE.level, THRESHOLD, CERTIFICATE.rate)
    assert final_gains(0.1, 0.1, 6.0, 200).max() > bound


@pytest.mark.parametrize("mu", [0.01, 0.1, 1.0, 3.0, 5.0])
def test_at_the_experiments_period_the_sampled_bound_holds_and_is_not_idle(mu: float) -> None:
    bound = sampled_gain_bound(1.0, mu, CERTIFICATE.level, THRESHOLD, CERTIFICATE.block, 0.1)
    gains = final_gains(0.1, mu, 6.0, 200)
    assert gains.max() <= bound
    assert gains.max() - 1.0 >= 0.8 * (bound - 1.0)


def test_where_the_hold_no_longer_contracts_there_is_no_sampled_bound() -> None:
    assert sampled_gain_bound(1.0, 20.0, CERTIFICATE.level, THRESHOLD, CERTIFICATE.block, 0.1) == math.inf


@settings(max_examples=30)
@given(mu=st.floats(0.01, 3.0), period=st.floats(0.001, 0.1))
def test_the_sampled_bound_is_above_the_continuous_one_and_meets_it_at_short_periods(mu: float, period: float) -> None:
    continuous = continuous_gain_bound(1.0, mu, CERTIFICATE.level, THRESHOLD, CERTIFICATE.rate)
    sampled = sampled_gain_bound(1.0, mu, CERTIFICATE.level, THRESHOLD, CERTIFICATE.block, period)
    assert continuous <= sampled * (1.0 + 1e-9)
    assert sampled - 1.0 <= (continuous - 1.0) * (1.0 + 1.2 * period)
