"""The certified sets: the figures for the paper's table, and the laws that make them certified."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval, hold_transition
from flatsat_ros.certificate.sets import Place, Sets
from flatsat_ros.law.input_set import InputSet

seeds = st.integers(0, 2**32 - 1)
loops = st.builds(
    lambda thrust, tilt, floor, rate: make(rate, InputSet(thrust * GRAVITY, tilt, thrust_min=floor * GRAVITY)),
    thrust=st.floats(1.01, 3.0),
    tilt=st.floats(0.02, 1.5),
    floor=st.floats(0.0, 0.9),
    rate=st.floats(0.2, 5.0),
)


def make(rate: float, limits: InputSet, period: float = 0.1) -> Sets:
    """The sets of the closed form."""
    block = closed_form_block(rate)
    return Sets(limits, block, block, rate, rate, limits.inner_radius**2 / rate, hold_gain_interval(rate, period)[0])


PAPER = InputSet(1.45 * GRAVITY, math.radians(10.0))
TABLE, EXPERIMENT = make(1.2, PAPER), make(1.25, PAPER)


def nominal_input(sets: Sets, state: np.ndarray) -> np.ndarray:
    """-B'P xi."""
    return -(state[..., :3] * sets.horizontal[0, 1] + state[..., 3:] * sets.horizontal[1, 1])


def on_boundary(sets: Sets, seed: int, count: int = 200) -> np.ndarray:
    """Random states on the boundary of D."""
    states = np.random.default_rng(seed).standard_normal((count, 6)) @ np.kron(
        np.linalg.cholesky(np.linalg.inv(sets.horizontal)).T, np.eye(3)
    )
    return states / sets.scale_larger(states)[:, np.newaxis]


def test_the_figures_of_the_papers_table() -> None:
    assert TABLE.volume_larger / TABLE.volume_ellipsoid == pytest.approx(5.878997, abs=1e-6)
    assert TABLE.rest_radius == pytest.approx(PAPER.inner_radius * math.sqrt(2.0) / 1.2**2, rel=1e-12)
    assert TABLE.volume_ellipsoid == pytest.approx(math.pi**3 / 6 * 2.418228**3 / (1.2**4 / 4) ** 1.5, rel=1e-6)


def test_the_papers_first_test_starts_outside_its_set_and_inside_a_kappa_set() -> None:
    start = np.array([1.2, 1.2, 0.8, 0.0, 0.0, 0.0])
    assert sum(map(float, EXPERIMENT.levels(start))) == pytest.approx(3.4375)
    assert EXPERIMENT.scale_ellipsoid(start) == pytest.approx(math.sqrt(3.4375 / EXPERIMENT.level))
    kappa = float(EXPERIMENT.kappa(-start))
    assert kappa == pytest.approx(0.8517, abs=5e-5)
    assert 1.25 * (2.0 * kappa - 1.0) == pytest.approx(0.879, abs=5e-4)
    found = EXPERIMENT.classify(start[np.newaxis])
    assert found.place[0] == Place.KAPPA
    assert found.guaranteed[0]


@given(sets=loops, seed=seeds, scale=st.floats(0.01, 100.0))
def test_in_s_d_the_nominal_input_lies_in_s_times_the_input_set(sets: Sets, seed: int, scale: float) -> None:
    states = scale * on_boundary(sets, seed)
    np.testing.assert_allclose(sets.scale_larger(states), scale, rtol=1e-9)
    assert (sets.limits.gauge(nominal_input(sets, states)) <= scale * (1.0 + 1e-9)).all()


@given(sets=loops, seed=seeds)
def test_d_is_the_largest_such_set_of_v_h_and_v_v(sets: Sets, seed: int) -> None:
    # among the states with the same V_h and V_v one has its nominal input on the boundary of the input set
    lateral, upright = sets.levels(on_boundary(sets, seed))
    a, b = np.sqrt(sets.slope_horizontal * lateral), np.sqrt(sets.slope_vertical * upright)
    worst = np.maximum(*(sets.limits.gauge(np.stack([a, 0.0 * a, sign * b], axis=1)) for sign in (1.0, -1.0)))
    np.testing.assert_allclose(worst, 1.0, rtol=1e-9)


@given(sets=loops, seed=seeds)
def test_e_lies_in_d_and_touches_it(sets: Sets, seed: int) -> None:
    states = on_boundary(sets, seed)
    assert (sets.scale_ellipsoid(states) >= 1.0 - 1e-9).all()
    # along the axis in which the ball of radius r_in touches the input set
    angles = np.linspace(-math.pi / 2, math.pi / 2, 4001)
    a, b = sets.limits.inner_radius * np.cos(angles), sets.limits.inner_radius * np.sin(angles)
    touching = sets.limits.gauge(np.stack([a, 0.0 * a, b], axis=1)).max()
    assert touching == pytest.approx(1.0, abs=1e-3)


@settings(max_examples=20)
@given(sets=loops, seed=seeds)
def test_volumes_agree_with_counting(sets: Sets, seed: int) -> None:
    # V_h and V_v of uniform points in { V_h <= H } x { V_v <= T } have densities 2 V_h / H^2 and 1 / T
    random, count = np.random.default_rng(seed), 200_000
    top = min(GRAVITY - sets.limits.thrust_min, sets.limits.thrust_max - GRAVITY)
    wide = float(sets.width(np.linspace(0.0, top, 1001)).max()) ** 2 / sets.slope_horizontal
    tall = top**2 / sets.slope_vertical
    inside = sets._scale(wide * np.sqrt(random.random(count)), tall * random.random(count)) <= 1.0
    determinant = float(np.linalg.det(sets.horizontal))
    whole = math.pi**2 / 2.0 * wide**2 / determinant * math.pi * tall / math.sqrt(determinant)
    share = float(inside.mean())
    deviation = math.sqrt((1.0 - share) / (share * count))
    assert sets.volume_larger == pytest.approx(share * whole, rel=5.0 * deviation + 2e-3)
    assert sets.volume_larger >= sets.volume_ellipsoid * (1.0 - 1e-12)


@given(sets=loops, seed=seeds, share=st.floats(0.001, 0.999), gains=st.floats(1.0, 1e4))
def test_v_never_grows_from_inside_a_kappa_set(sets: Sets, seed: int, share: float, gains: float) -> None:
    period = 0.3 / sets.slope_horizontal
    low, high = hold_gain_interval(sets.slope_horizontal, period)
    random = np.random.default_rng(seed)
    state = on_boundary(sets, seed, 50) * (share / low)
    for _ in range(10):
        lateral, upright = sets.levels(state)
        v0 = nominal_input(sets, state)
        gamma = np.minimum(1.0 + (gains - 1.0) * random.random(50), high)
        k = np.minimum(gamma, 1.0 / sets.limits.gauge(v0))
        assert (k >= sets.kappa(state) * (1.0 - 1e-9)).all()
        steps = np.array([hold_transition(sets.horizontal, period, float(gain)) for gain in k])
        state = np.einsum("nij,njk->nik", steps, state.reshape(50, 2, 3)).reshape(50, 6)
        after = sets.levels(state)
        assert (after[0] <= lateral * (1.0 + 1e-9)).all()
        assert (after[1] <= upright * (1.0 + 1e-9)).all()


def test_every_place_is_found_and_what_is_not_finite_is_outside() -> None:
    axis = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    reach = 1.0 / float(EXPERIMENT.scale_larger(axis))
    upward = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    height = 1.0 / float(EXPERIMENT.scale_larger(upward))
    near = [0.9 * reach * axis, 0.9 * height * upward, 1.9 * reach * axis, 2.1 * reach * axis]
    states = np.array([*near, np.nan * axis, np.inf * np.ones(6)])
    with np.errstate(invalid="ignore"):
        found, again = EXPERIMENT.classify(states), EXPERIMENT.level_and_kappa(states)
    assert (found.level.tolist(), found.kappa.tolist()) == (again[0].tolist(), again[1].tolist())
    assert list(found.place) == [
        Place.ELLIPSOID, Place.LARGER, Place.KAPPA, Place.OUTSIDE, Place.OUTSIDE, Place.OUTSIDE,
    ]  # fmt: skip
    assert list(found.guaranteed) == [True, True, True, False, False, False]
    assert found.kappa == pytest.approx([1.0, 1.0, 1.0 / 1.9, 1.0 / 2.1, 0.0, 0.0])


def test_a_disturbance_lifts_the_lower_part_first() -> None:
    # V_v at the edge of D and V_h = 0: without disturbance fine; one that lifts V_h pushes the state out of D
    limits = InputSet(2.0 * GRAVITY, math.radians(40.0))
    block = closed_form_block(1.0)
    state = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.95 * GRAVITY]])
    calm = Sets(limits, block, block, 1.0, 1.0, limits.inner_radius**2, 1.0)
    windy = Sets(limits, block, block, 1.0, 1.0, limits.inner_radius**2, 1.0, floor=1.0)
    assert calm.classify(state).place[0] == windy.classify(state).place[0] == Place.LARGER
    assert calm.classify(state).guaranteed[0]
    assert not windy.classify(state).guaranteed[0]


def test_a_longer_state_takes_its_memory_into_account() -> None:
    long = np.kron(np.diag([1.0, 1.0, 0.5]), np.ones((1, 1)))
    sets = Sets(PAPER, long, long, 1.0, 1.0, PAPER.inner_radius**2, 1.0)
    state = np.arange(1.0, 10.0)
    assert sets.levels(state) == (1 + 4 + 16 + 25 + 0.5 * (49 + 64), 9 + 36 + 0.5 * 81)
    assert sets.levels(state[:6]) == (1 + 4 + 16 + 25, 9 + 36)
    with pytest.raises(FlatsatError, match=r"shape of state = .*must be .*6. or .*9."):
        sets.levels(np.zeros(7))
