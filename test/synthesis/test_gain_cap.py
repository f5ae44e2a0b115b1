"""Gain caps: the known figures, proofs that hold in simulation, and limits beyond which the loop really fails."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.synthesis import common_function
from flatsat_ros.synthesis import gain_cap as loop
from flatsat_ros.synthesis.common_function import BreakdownError, common_matrix
from flatsat_ros.synthesis.gain_cap import circle_limit, gain_cap, worst_case

BLOCK = closed_form_block(1.25)

# period, lag, delay, cap
KNOWN = [
    (0.1, 0.05, 0.0, 9.94),
    (0.1, 0.1, 0.0, 7.12),
    (0.1, 0.08, 0.03, 6.31),
    (0.1, 0.1, 0.05, 5.10),
    (0.05, 0.08, 0.03, 7.62),
    (0.02, 0.08, 0.03, 8.68),
    (0.01, 0.08, 0.03, 9.14),
]

# where the period is short beside the delay, or the delay comes without a lag: the circle criterion's limits
DELAYED = [
    (0.01, 0.0, 0.05, 16.26),
    (0.005, 0.0, 0.05, 17.01),
    (0.005, 0.08, 0.03, 9.38),
    (0.01, 0.0, 0.1, 8.72),
    (0.1, 0.0, 0.1, 6.13),
    (0.02, 0.14046511627906977, 0.03, 6.27),
]

timings = st.builds(
    lambda period, lag, delay: Timing(period, lag, delay * period),
    period=st.floats(0.01, 0.1),
    lag=st.floats(0.02, 0.15),
    delay=st.floats(0.0, 3.0),
)


def grows(timing: Timing, low: float, high: float, runs: tuple[int, int]) -> bool:
    """Whether repeating `runs` periods of the high and of the low gain is unstable."""
    steps = [np.linalg.matrix_power(timing.closed_loop(BLOCK, k), n) for k, n in zip((high, low), runs, strict=True)]
    return bool(np.abs(np.linalg.eigvals(steps[0] @ steps[1])).max() > 1.0)


@pytest.mark.parametrize(("period", "lag", "delay", "known"), KNOWN)
def test_the_known_caps_come_out(period: float, lag: float, delay: float, known: float) -> None:
    timing = Timing(period, lag, delay)
    cap = gain_cap(timing, BLOCK)
    assert cap.gain_max == pytest.approx(known, rel=5e-3)
    assert cap.gain_max < cap.limit
    assert cap.matrix is not None
    assert max(timing.contraction(cap.matrix, BLOCK, k) for k in (1.0, cap.gain_max)) < 1.0


@pytest.mark.parametrize(("period", "lag", "delay", "limit"), [*KNOWN, *DELAYED])
def test_the_cap_reaches_the_limit_of_the_circle_criterion(
    period: float, lag: float, delay: float, limit: float
) -> None:
    timing = Timing(period, lag, delay)
    cap = gain_cap(timing, BLOCK)
    assert cap.gain_max >= 0.995 * circle_limit(timing, BLOCK)
    assert cap.matrix is not None
    assert max(timing.contraction(cap.matrix, BLOCK, k) for k in (1.0, cap.gain_max)) < 1.0
    assert cap.limit == pytest.approx(limit, rel=5e-3)


@settings(max_examples=20, deadline=None)
@given(
    rate=st.floats(-1.0, 0.5).map(lambda exponent: 10.0**exponent),
    lowest=st.one_of(st.just(1.0), st.floats(0.6, 1.0)),
    period=st.floats(-2.3, -1.0).map(lambda exponent: 10.0**exponent),
    lag=st.one_of(st.just(0.0), st.floats(0.02, 0.2)),
    delay=st.floats(0.5, 8.0),
)
def test_the_cap_reaches_the_limit_for_any_rate_and_timing(
    rate: float, lowest: float, period: float, lag: float, delay: float
) -> None:
    timing, block = Timing(period, lag, delay * period), closed_form_block(rate)
    try:
        limit = circle_limit(timing, block, lowest)
    except FlatsatError:
        return  # unstable at the lowest gain or at 1 already
    assume(limit > 1.01)
    assert gain_cap(timing, block, lowest).gain_max >= 0.995 * limit


@pytest.mark.parametrize("timing", [Timing(0.1, 0.05), Timing(0.02, 0.14, 0.03), Timing(0.01, 0.0, 0.05)], ids=str)
def test_no_solver_finds_a_w_with_more_starts(timing: Timing) -> None:
    """The semidefinite program once more, by a solver, in coordinates in which the W at hand is the identity."""
    cap = gain_cap(timing, BLOCK)
    root = np.linalg.cholesky(cap.matrix).T
    scaled = cp.Variable((timing.size, timing.size), symmetric=True)
    row = timing.feedback(BLOCK) @ np.linalg.inv(root) / BLOCK[1, 1] ** 0.5
    conditions = [scaled >> row.T @ row]
    for gain in (1.0, cap.gain_max):
        step = root @ timing.closed_loop(BLOCK, gain) @ np.linalg.inv(root)
        conditions.append((scaled - step.T @ scaled @ step) / timing.period >> 0)
    weight = root[:, :2] @ np.linalg.inv(BLOCK) @ root[:, :2].T
    problem = cp.Problem(cp.Minimize(cp.trace(weight @ scaled)), conditions)
    assert problem.solve(solver=cp.CLARABEL) >= (1.0 - 1e-3) * np.trace(weight)


@pytest.mark.parametrize("period", [0.1, 0.05, 0.02, 0.01])
def test_without_lag_and_delay_it_is_the_exact_interval(period: float) -> None:
    cap = gain_cap(Timing(period), BLOCK)
    assert (cap.gain_min, cap.gain_max) == pytest.approx(hold_gain_interval(1.25, period), rel=1e-9)


@pytest.mark.parametrize(("period", "lag", "delay", "known"), KNOWN)
def test_constant_gains_and_switching_fail_in_the_order_they_must(
    period: float, lag: float, delay: float, known: float
) -> None:
    timing = Timing(period, lag, delay)
    worst = worst_case(timing, BLOCK, known)
    assert known < worst.switching < worst.constant  # so the constant gain's limit is no safe cap
    assert grows(timing, 1.0, worst.switching, (worst.high, worst.low))
    assert not grows(timing, 1.0, known, (worst.high, worst.low))
    assert grows(timing, 1.0, worst.constant * 1.001, (1, 0))
    assert not grows(timing, 1.0, worst.constant * 0.999, (1, 0))


@settings(max_examples=15, deadline=None)
@given(timing=timings, seed=st.integers(0, 2**32 - 1), lowest=st.floats(0.6, 1.0))
def test_w_never_grows_at_random_gains(timing: Timing, seed: int, lowest: float) -> None:
    cap = gain_cap(timing, BLOCK, lowest)
    assert cap.gain_min <= lowest
    random = np.random.default_rng(seed)
    z = random.standard_normal((timing.size, 100))
    F, G = timing.transition
    before = np.einsum("in,ij,jn->n", z, cap.matrix, z)
    for _ in range(30):
        k = np.where(random.random(100) < 0.5, random.uniform(lowest, cap.gain_max, 100), cap.gain_max)
        z = F @ z - G * k * (timing.feedback(BLOCK) @ z)
        after = np.einsum("in,ij,jn->n", z, cap.matrix, z)
        assert (after < before).all()
        before = after


@settings(max_examples=15, deadline=None)
@given(timing=timings)
def test_w_bounds_the_nominal_input_as_p_does(timing: Timing) -> None:
    cap = gain_cap(timing, BLOCK)
    feedback = timing.feedback(BLOCK)[0]
    assert feedback @ np.linalg.solve(cap.matrix, feedback) == pytest.approx(BLOCK[1, 1], rel=1e-9)


def test_a_lower_cap_leaves_room_for_more_starts() -> None:
    timing = Timing(0.1, 0.08, 0.03)
    full, half = gain_cap(timing, BLOCK), gain_cap(timing, BLOCK, highest=3.0)
    assert half.gain_max == 3.0
    volumes = [1.0 / np.linalg.det(cap.matrix[:2, :2]) for cap in (full, half)]
    assert volumes[1] > 1.3 * volumes[0]


def test_gains_below_one_cost_some_of_the_cap() -> None:
    timing = Timing(0.02, 0.08, 0.03)
    caps = [gain_cap(timing, BLOCK, lowest).gain_max for lowest in (1.0, 0.8, 0.6)]
    assert caps[0] > caps[1] > caps[2] > 7.0


def test_beyond_the_circle_criterion_there_is_no_w() -> None:
    timing = Timing(0.1, 0.1, 0.05)
    limit = circle_limit(timing, BLOCK)
    for sector in (0.9998 * limit, 1.01 * limit):
        with pytest.raises(FlatsatError, match="broke down"):
            common_matrix(timing, BLOCK, 1.0, 1.005 * limit, sector)


@pytest.mark.parametrize(
    ("timing", "lowest", "text"),
    [
        (Timing(0.1, 0.5, 2.0), 1.0, "unstable at gain 1 already"),
        (Timing(1.55), 1.0, "V grows at gain 1 already"),
        (Timing(0.1, 0.3, 0.4), 0.6, "the cap would be 0.98"),
    ],
)
def test_a_loop_without_room_is_refused(timing: Timing, lowest: float, text: str) -> None:
    with pytest.raises(FlatsatError, match=text):
        gain_cap(timing, BLOCK, lowest)


def test_a_search_that_breaks_down_decides_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*matrices: np.ndarray, **options: np.ndarray) -> None:
        raise np.linalg.LinAlgError("out of luck")

    monkeypatch.setattr(common_function, "solve_discrete_are", fail)
    with pytest.raises(BreakdownError, match=r"broke down .*\(out of luck\); this does not mean that there is none"):
        gain_cap(Timing(0.1, 0.1), BLOCK)


@pytest.mark.parametrize(
    ("sign", "text"),
    [(1.0, r"falls by -[0-9.]+ per period at gain 1: must be at least 1e-12"), (-1.0, "falls by -inf")],
)
def test_a_wrong_w_is_no_proof(sign: float, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "common_matrix", lambda timing, *arguments: np.eye(timing.size))
    monkeypatch.setattr(loop, "round_matrix", lambda matrix: matrix * np.diag([1.0, 1.0, sign]))
    with pytest.raises(BreakdownError, match=text):
        gain_cap(Timing(0.1, 0.1), BLOCK)
