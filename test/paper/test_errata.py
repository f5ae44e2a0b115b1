"""docs/errata.md, executed: what the paper prints is implemented here, and here only, and shown to be wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.certificate.gain_bounds import continuous_gain_bound, sampled_gain_bound, settling_time_bound
from flatsat_ros.certificate.lyapunov import closed_form_block, decay_residual
from flatsat_ros.certificate.robust import robust_residual
from flatsat_ros.law.controller import Controller, Memory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0), GRAVITY)
ROBUST_LIMITS = InputSet(2.0 * GRAVITY, math.radians(40.0), GRAVITY)
PRINTED_P = np.array([[0.98, 0.78], [0.78, 1.25]])
PRINTED_Q = np.array([[2.3148, -1.3889], [-1.3889, 1.6667]])
PRINTED_QW = np.array([[2.29, -2.14], [-2.14, 2.07]])  # x and y
PRINTED_QW_Z = np.array([[4.42, -2.14], [-2.14, 2.07]])
DRIFT = math.sqrt(2.0)  # m/s: E E' = 2 diag(1, 1, 0, 0, 0, 0)

Vector = tuple[float, float, float]


def certificate(rate: float) -> Certificate:
    """The closed form for the limits of Table I at the experiment's period."""
    return closed_form_certificate(LIMITS, rate, 0.1, "errata")


def certified_rate(block: np.ndarray) -> float:
    """The largest alpha with A'P + P A - 2 P B B'P + alpha P <= 0."""
    return 1.0 - decay_residual(block, 1.0)


def on_boundary(matrix: np.ndarray, level: float, count: int) -> np.ndarray:
    """States (count, 6) of V = level in random directions."""
    normal = np.random.default_rng(0).normal(size=(count, 6))
    normal *= math.sqrt(level) * (1.0 - 1e-9) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.linalg.solve(np.linalg.cholesky(matrix).T, normal.T).T


# --- the saturation formula, eq. 9 and 10


def candidates(v: Vector) -> list[float]:
    """Eq. 10."""
    square, tangent = v[0] ** 2 + v[1] ** 2, math.tan(LIMITS.tilt_max)
    a1, b1, c1 = square - v[2] ** 2 * tangent**2, -2.0 * tangent**2 * v[2] * GRAVITY, -((tangent * GRAVITY) ** 2)
    a2, b2, c2 = square + v[2] ** 2, 2.0 * v[2] * GRAVITY, GRAVITY**2 - LIMITS.thrust_max**2
    found = []
    if v[2] != 0.0:
        found += [-GRAVITY / v[2], (LIMITS.thrust_max * math.cos(LIMITS.tilt_max) - GRAVITY) / v[2]]
    for a, b, c in ((a1, b1, c1), (a2, b2, c2)):
        if a != 0.0 and b * b >= 4.0 * a * c:
            found += [(-b + sign * math.sqrt(b * b - 4.0 * a * c)) / (2.0 * a) for sign in (1, -1)]
    return found


def printed_factor(v: Vector) -> float | None:
    """Eq. 9: the largest candidate in (0, 1], whether or not it lies in the set."""
    return max((t for t in candidates(v) if 0.0 < t <= 1.0), default=None)


@pytest.mark.parametrize(
    ("v", "true", "printed"),
    [
        ((10.0, 0.0, 5.0), 0.1897, 0.8397),
        ((100.0, 0.0, 0.0), 0.01729768, 0.103),
        ((0.0, 0.0, -30.0), 0.327, 0.8012),
        ((8.0 * math.tan(LIMITS.tilt_max), 0.0, -8.0), 0.613125, None),
    ],
)
def test_the_printed_saturation_leaves_the_input_set(v: Vector, true: float, printed: float | None) -> None:
    assert 1.0 / float(LIMITS.gauge(v)) == pytest.approx(true, rel=5e-4)
    papers = printed_factor(v)
    assert papers == (None if printed is None else pytest.approx(printed, rel=1e-3))
    if papers is not None:
        assert not LIMITS.contains(np.multiply(papers, v))


@pytest.mark.parametrize(("deviation", "share"), [(1.0, 0.0), (2.0, 0.01), (5.0, 0.32), (15.0, 0.89), (100.0, 0.99)])
def test_the_printed_saturation_fails_for_most_vectors_that_are_large(deviation: float, share: float) -> None:
    failures, vectors = 0, np.random.default_rng(0).normal(size=(1000, 3)) * deviation
    for v in vectors:
        if not LIMITS.contains(v):
            factor = printed_factor(tuple(v))
            failures += factor is None or not LIMITS.contains(np.multiply(factor, v))
    assert failures / len(vectors) == pytest.approx(share, abs=0.04)
    assert (failures == 0) == (share == 0.0)


def test_the_largest_candidate_that_the_set_allows_is_the_true_factor_away_from_the_degenerate_directions() -> None:
    """What is missing is the check of membership, and for a_i = 0 the root of the linear equation."""
    for v in np.random.default_rng(1).normal(size=(500, 3)) * 15.0:
        if not LIMITS.contains(v):
            allowed = [t for t in candidates(tuple(v)) if 0.0 < t <= 1.0 and LIMITS.contains(t * v, 1e-9)]
            assert max(allowed) == pytest.approx(1.0 / float(LIMITS.gauge(v)), rel=1e-9)


# --- the step of the proof that skips small states, eq. 19


def test_the_chain_of_inequalities_fails_near_the_origin_and_its_conclusion_holds() -> None:
    proof = certificate(1.2)
    for xi in 0.1 * on_boundary(proof.matrix, proof.level, 50):
        v0 = -(proof.matrix @ xi)[3:]
        assert np.sum(LIMITS.saturate(v0) ** 2) < proof.ball  # printed: at least rho
        law = Controller(proof, Tuning(0.0, 0.05, 1.0, proof.gain_max))
        _, output = law.step(Memory(np.array([7.0])), [xi], [0.0], np.zeros((1, 9)))
        assert output.applied_gain[0] >= 1.0


# --- the sign in the bound of gamma, eq. 25


@given(start=st.floats(0.06, 10.0), mu=st.floats(0.01, 10.0), rate=st.floats(0.1, 5.0))
def test_the_printed_bound_is_not_the_integral_it_stands_for(start: float, mu: float, rate: float) -> None:
    threshold = 0.05
    end = settling_time_bound(start, threshold, rate)
    t = np.linspace(0.0, end, 20001)
    excess = mu * (start * np.exp(-rate * t) - threshold)
    integral = 1.0 + float(((excess[1:] + excess[:-1]) / 2.0 * np.diff(t)).sum())
    printed = 1.0 + mu * (threshold * end + start / rate * (1.0 - math.exp(-rate * end)))
    assert continuous_gain_bound(1.0, mu, start, threshold, rate) == pytest.approx(integral, rel=1e-6)
    assert printed - integral == pytest.approx(2.0 * mu * threshold * end, rel=1e-3, abs=1e-6 * integral)


# --- forward Euler


def sampled_gains(mu: float, threshold: float) -> np.ndarray:
    """Final gains from the boundary of E: the experiment's law at 0.1 s on the exact double integrator."""
    proof, count, h = certificate(1.2), 400, 0.1
    law = Controller(proof, Tuning(np.full(count, mu), threshold, 1.0, proof.gain_max))
    memory, x = law.start(), on_boundary(proof.matrix, proof.level, count)
    for _ in range(80):
        memory, output = law.step(memory, x, np.zeros(count), np.zeros((count, 9)))
        v = output.acceleration
        x = np.hstack([x[:, :3] + h * x[:, 3:] + h * h / 2.0 * v, x[:, 3:] + h * v])
    return memory.gain


@pytest.mark.parametrize(("mu", "threshold"), [(0.1, 0.05), (5.0, 0.05), (0.05, 0.005)])
def test_euler_breaks_the_bound_of_the_continuous_law_and_not_the_sampled_one(mu: float, threshold: float) -> None:
    proof = certificate(1.2)
    gains = sampled_gains(mu, threshold).max()
    assert gains > continuous_gain_bound(1.0, mu, proof.level, threshold, proof.rate)
    assert gains <= sampled_gain_bound(1.0, mu, proof.level, threshold, proof.block, 0.1)


def test_for_a_small_threshold_euler_breaks_even_the_bound_as_printed() -> None:
    proof, mu, threshold = certificate(1.2), 0.05, 0.005
    end = settling_time_bound(proof.level, threshold, proof.rate)
    area = proof.level / proof.rate * (1.0 - math.exp(-proof.rate * end))
    assert sampled_gains(mu, threshold).max() > 1.0 + mu * (threshold * end + area)


# --- the disturbance matrix and the printed disturbance, Table II


def test_the_printed_disturbance_is_larger_than_the_paper_allows_and_fits_twice_the_square() -> None:
    t = np.linspace(0.0, 200.0, 200001)
    for w_y in (np.cos(0.15), np.cos(0.15 * t)):  # as printed, and as meant
        square = np.sin(1.5 * t + math.pi / 8.0) ** 2 + w_y**2
        assert square.max() > 1.97
        assert square.max() <= DRIFT**2
    assert math.cos(0.15) ** 2 + 1.0 == pytest.approx(1.978, abs=5e-4)


@given(
    beta=st.floats(0.01, 100.0),
    q11=st.floats(0.01, 1e3),
    q22=st.floats(0.01, 1e3),
    correlation=st.floats(-0.999, 0.999),
)
def test_with_the_identity_as_disturbance_matrix_no_matrix_satisfies_the_condition(
    beta: float, q11: float, q22: float, correlation: float
) -> None:
    q12 = correlation * math.sqrt(q11 * q22)
    inverse = np.linalg.inv([[q11, q12], [q12, q22]])
    assert robust_residual(inverse, beta, 1.0, 1.0) > 0.0


def largest_beta(drift: float, bound: float) -> float:
    """The smaller root of e^2 b^2 - (4 + 2 e^2 vbar^2) b + 4 vbar^2, where the box condition is active."""
    square = drift**2
    half = 2.0 + square * bound**2
    return (half - math.sqrt(half**2 - 4.0 * square * bound**2)) / square


def test_twice_the_square_gives_what_the_paper_prints_and_once_does_not() -> None:
    bound = float(ROBUST_LIMITS.inner_box[0])
    beta = largest_beta(DRIFT, bound)
    assert beta == pytest.approx(0.9668, abs=5e-5)
    assert largest_beta(1.0, bound) == pytest.approx(1.8678, abs=5e-5)
    inverse = np.array([[4.0 / beta**3 - 2.0 / beta**2, -2.0 / beta**2], [-2.0 / beta**2, 2.0 / beta]])
    np.testing.assert_allclose(inverse, PRINTED_QW, atol=5e-3)
    block = np.linalg.inv(inverse)
    assert robust_residual(block, beta, DRIFT, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert block[1, 1] == pytest.approx(bound**2, rel=1e-12)


# --- the robust conditions, eq. 32


def test_without_its_relation_the_robust_condition_says_nothing() -> None:
    """A matrix for which the expression is positive: V grows on the boundary of E_w under an allowed disturbance."""
    block = np.linalg.inv([[2.2, -1.2], [-1.2, 2.0]])
    assert robust_residual(block, 0.9668, DRIFT, 0.0) > 0.0
    assert block[1, 1] <= ROBUST_LIMITS.inner_box[0] ** 2
    growth = []
    for angle in np.linspace(0.0, 2.0 * math.pi, 361):
        x = np.linalg.solve(np.linalg.cholesky(block).T, [math.cos(angle), math.sin(angle)])
        gradient = block @ x
        flow = np.array([x[1] + DRIFT * np.sign(gradient[0]), -gradient[1]])
        growth.append(2.0 * gradient @ flow)
    assert max(growth) > 0.1


@given(q11=st.floats(0.1, 10.0), q22=st.floats(0.1, 10.0), share=st.floats(-0.99, 0.99), bound=st.floats(0.1, 10.0))
def test_the_box_condition_bounds_a_diagonal_entry_of_p_by_the_square(
    q11: float, q22: float, share: float, bound: float
) -> None:
    inverse = np.array([[q11, share * math.sqrt(q11 * q22)], [share * math.sqrt(q11 * q22), q22]])
    column = np.array([[0.0], [1.0]])  # r_i(B')', not the r_i(B) that is printed: that row is too short
    matrix = np.block([[np.array([[bound**2]]), column.T], [column, inverse]])
    slack = bound**2 - np.linalg.inv(inverse)[1, 1]
    if abs(slack) > 1e-6 * bound**2:
        assert (np.linalg.eigvalsh(matrix)[0] > 0.0) == (slack > 0.0)


@given(gain=st.floats(1.0, 100.0), entries=st.tuples(*[st.floats(0.2, 5.0)] * 2), share=st.floats(-0.9, 0.9))
def test_the_closed_loop_term_of_the_robust_proof_is_twice_the_input_and_without_p(
    gain: float, entries: tuple[float, float], share: float
) -> None:
    q12 = share * math.sqrt(entries[0] * entries[1])
    Q, A, B = (
        np.array([[entries[0], q12], [q12, entries[1]]]),
        np.array([[0.0, 1.0], [0.0, 0.0]]),
        np.array([[0.0, 1.0]]).T,
    )
    closed = A - gain * B @ B.T @ np.linalg.inv(Q)
    expected = Q @ A.T + A @ Q - 2.0 * B @ B.T - 2.0 * (gain - 1.0) * B @ B.T
    np.testing.assert_allclose(Q @ closed.T + closed @ Q, expected, atol=1e-9 * gain)


# --- the rounded matrices


def test_the_rounded_matrices_do_not_certify_their_rates() -> None:
    assert certified_rate(PRINTED_P) == pytest.approx(1.2414, abs=5e-5)
    assert certified_rate(np.linalg.inv(PRINTED_Q)) == pytest.approx(1.19994, abs=5e-6)
    assert certified_rate(closed_form_block(1.25)) == pytest.approx(1.25, rel=1e-12)


def test_v_decays_more_slowly_than_the_printed_p_promises() -> None:
    """A state of the experiment's set whose V' is above -1.25 V, with the gain of 1 that the theorem allows."""
    x = np.linalg.eig(np.linalg.solve(PRINTED_P, _decay(PRINTED_P)))
    worst = x.eigenvectors[:, np.argmax(x.eigenvalues)]
    eta = PRINTED_P[1] @ worst
    derivative = 2.0 * (PRINTED_P @ worst) @ [worst[1], -eta]
    assert derivative > -1.2415 * (worst @ PRINTED_P @ worst)


def _decay(block: np.ndarray) -> np.ndarray:
    """A'P + P A - 2 P B B'P."""
    system = np.array([[0.0, 1.0], [0.0, 0.0]])
    return system.T @ block + block @ system - 2.0 * np.outer(block[1], block[1])


def test_the_rounded_robust_matrix_certifies_no_rate_at_all() -> None:
    block, vertical = np.linalg.inv(PRINTED_QW), np.linalg.inv(PRINTED_QW_Z)
    assert all(robust_residual(block, beta, DRIFT, 0.0) > 0.0 for beta in np.linspace(0.01, 5.0, 5000))
    assert robust_residual(vertical, 0.9654, 0.0, 0.0) < 0.0
    assert robust_residual(vertical, 0.9668, 0.0, 0.0) > 0.0


def test_the_vertical_entry_of_the_robust_matrix_is_cut_off_not_rounded() -> None:
    beta = largest_beta(DRIFT, float(ROBUST_LIMITS.inner_box[0]))
    assert round(4.0 / beta**3, 2) == 4.43
    assert math.floor(100.0 * 4.0 / beta**3) / 100.0 == PRINTED_QW_Z[0, 0]


# --- Test 1


def test_test_1_starts_outside_its_invariant_set_and_inside_a_larger_one() -> None:
    proof = certificate(1.25)
    error = np.array([-0.6, -0.6, 0.0, 0.0, 0.0, 0.0]) - [0.6, 0.6, 0.8, 0.0, 0.0, 0.0]
    start = float(error @ proof.matrix @ error)
    assert start == pytest.approx(3.4375, rel=1e-12)
    assert start > proof.level == pytest.approx(2.3215, abs=5e-5)
    assert float(proof.sets.kappa(error)) == pytest.approx(0.8517, abs=5e-5)
    assert proof.sets.classify(error[np.newaxis]).guaranteed[0]
