"""Gain caps: the known figures, proofs that hold in simulation, and limits beyond which the loop really fails."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.synthesis import gain_cap as loop
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
    assert cap.gain_max < cap.limit <= cap.gain_max * 1.003
    assert cap.matrix is not None
    assert max(timing.contraction(cap.matrix, BLOCK, k) for k in (1.0, cap.gain_max)) < 1.0


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


def test_beyond_the_circle_criterion_the_program_is_infeasible() -> None:
    timing = Timing(0.1, 0.1, 0.05)
    limit = circle_limit(timing, BLOCK)
    with pytest.raises(FlatsatError):
        loop.common_matrix(timing, BLOCK, 1.0, limit * 1.01)


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


def test_a_failing_solver_is_reported_and_not_taken_for_infeasibility(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: cp.Problem, **options: object) -> None:
        raise cp.error.SolverError("out of luck")

    monkeypatch.setattr(cp.Problem, "solve", fail)
    with pytest.raises(FlatsatError, match="because the solver failed; this does not mean that there is none"):
        gain_cap(Timing(0.1, 0.1), BLOCK)


def test_after_a_failure_the_last_proven_value_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    original, calls = cp.Problem.solve, iter(range(1000))

    def fail_first(self: cp.Problem, **options: object) -> object:
        if next(calls) == 0:
            raise cp.error.SolverError("out of luck")
        return original(self, **options)

    monkeypatch.setattr(cp.Problem, "solve", fail_first)
    timing = Timing(0.1, 0.1)
    cap = gain_cap(timing, BLOCK)
    assert cap.failures == 1
    assert cap.matrix is not None
    assert 7.0 < cap.gain_max < cap.limit
    assert timing.contraction(cap.matrix, BLOCK, cap.gain_max) < 1.0


def test_a_wrong_answer_of_the_solver_is_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(name: str, problem: cp.Problem) -> None:
        for variable in problem.variables():
            variable.value = np.eye(*variable.shape)

    monkeypatch.setattr(loop, "solve", wrong)
    with pytest.raises(FlatsatError, match="no function z'W z was found"):
        gain_cap(Timing(0.1, 0.1), BLOCK)
