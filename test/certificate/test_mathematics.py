"""What docs/mathematics.md proves and no other test checks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.law.controller import Controller, Memory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
RATE, THRESHOLD = 1.25, 0.05
RADIUS = LIMITS.inner_radius

seeds = st.integers(0, 2**32 - 1)
gains = st.floats(1.0, 15.0)


PROOF = closed_form_certificate(LIMITS, RATE, 0.1, "test")


def states(seed: int, level: float, count: int = 50) -> np.ndarray:
    """States (count, 6) of V = level in random directions."""
    normal = np.random.default_rng(seed).normal(size=(count, 6))
    normal *= math.sqrt(level) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.linalg.solve(np.linalg.cholesky(PROOF.matrix).T, normal.T).T


def fly(xi: np.ndarray, gain: float, v_ref: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V' without disturbance, the gradient xi'P and the applied gain at N states."""
    law = Controller(PROOF, Tuning(np.zeros(len(xi)), THRESHOLD, 1.0, PROOF.gain_max))
    reference = np.zeros((len(xi), 9))
    if v_ref is not None:
        reference[:, 6:] = v_ref
    _, output = law.step(Memory(np.full(len(xi), gain)), xi, np.zeros(len(xi)), reference)
    gradient = xi @ PROOF.matrix
    flow = np.hstack([xi[:, 3:], output.acceleration - reference[:, 6:]])
    return 2.0 * (gradient * flow).sum(axis=1), gradient, output.applied_gain


@given(seed=seeds, level=st.floats(0.01, 10.0))
def test_v_is_the_nominal_input_and_the_position_in_squares(seed: int, level: float) -> None:
    xi = states(seed, level)
    eta = (xi @ PROOF.matrix)[:, 3:]
    split = (eta**2).sum(axis=1) / RATE + RATE**3 / 4.0 * (xi[:, :3] ** 2).sum(axis=1)
    np.testing.assert_allclose(split, level, rtol=1e-12)


@given(seed=seeds, gain=gains, kappa=st.floats(0.51, 1.0))
def test_in_a_kappa_set_v_decays_at_its_rate(seed: int, gain: float, kappa: float) -> None:
    xi = states(seed, PROOF.level)
    xi *= 1.0 / (kappa * PROOF.sets.scale_larger(xi))[:, np.newaxis]
    derivative, gradient, applied = fly(xi, gain)
    assert (applied >= kappa * (1.0 - 1e-9)).all()
    assert (derivative <= -(RATE * (2.0 * kappa - 1.0) - 1e-9) * (gradient * xi).sum(axis=1)).all()


@given(seed=seeds, gain=gains, share=st.floats(0.0, 0.5))
def test_a_matched_disturbance_up_to_half_the_inner_radius_keeps_the_ellipsoid_invariant(
    seed: int, gain: float, share: float
) -> None:
    derivative, gradient, _ = fly(states(seed, PROOF.level), gain)
    worst = 2.0 * share * RADIUS * np.linalg.norm(gradient[:, 3:], axis=1)
    assert (derivative + worst <= 1e-9).all()


def test_a_larger_matched_disturbance_does_not() -> None:
    block = PROOF.block
    x = np.linalg.solve(block, block[1])  # where |eta|^2 = alpha V
    x *= math.sqrt(PROOF.level / (x @ block @ x))
    derivative, gradient, _ = fly(np.array([[x[0], 0.0, 0.0, x[1], 0.0, 0.0]]), 1.0)
    assert derivative[0] + 2.0 * 0.55 * RADIUS * np.linalg.norm(gradient[0, 3:]) > 0.0


@given(seed=seeds, gain=gains, share=st.floats(0.0, 0.99))
def test_on_the_ellipsoid_of_its_margin_a_reference_leaves_a_gain_of_at_least_one(
    seed: int, gain: float, share: float
) -> None:
    direction = np.random.default_rng(seed).normal(size=3)
    v_ref = share * LIMITS.saturate(1e3 * direction)
    margin = float(LIMITS.margin(v_ref))
    derivative, gradient, applied = fly(xi := states(seed, margin**2 / RATE), gain, v_ref)
    assert (applied >= 1.0 - 1e-9).all()
    assert (derivative <= -(RATE - 1e-9) * (gradient * xi).sum(axis=1) + 1e-12).all()


@pytest.mark.parametrize("gain", [1.0, 2.0, 5.0])
def test_under_a_constant_drift_v_settles_at_the_same_level_for_every_gain(gain: float) -> None:
    block, w = PROOF.block, 0.25
    x = np.zeros(2)
    for _ in range(40_000):
        x = x + 5e-4 * np.array([x[1] + w, -gain * (block[1] @ x)])
    np.testing.assert_allclose(x, [2.0 * w / RATE, -w], rtol=1e-5)
    assert x @ block @ x == pytest.approx(RATE * w**2, rel=1e-5)


def test_with_a_leak_the_gain_settles_where_growth_and_leak_balance() -> None:
    mu, nu, w = 2.0, 0.2, 0.25
    proof, start = PROOF, np.array([[2.0 * w / RATE, 0.0, 0.0, -w, 0.0, 0.0]])
    law = Controller(proof, Tuning(mu, THRESHOLD, 1.0, proof.gain_max, nu))
    memory = law.start()
    for _ in range(1000):
        memory, _ = law.step(memory, start, np.zeros(1), np.zeros((1, 9)))
    assert memory.gain[0] == pytest.approx(1.0 + mu * (RATE * w**2 - THRESHOLD) / nu, rel=1e-6)
