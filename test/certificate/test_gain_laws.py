"""The gain laws beyond the paper's: leak, restart, cap."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning, adapt
from flatsat_ros.law.input_set import InputSet

PERIOD = 0.1
RATE = 1.25


def certificate() -> Certificate:
    return closed_form_certificate(InputSet(1.45 * GRAVITY, np.radians(10.0)), RATE, PERIOD, "test")


@given(
    gain=st.floats(1.0, 15.0),
    lyapunov=st.floats(0.0, 100.0),
    mu=st.floats(0.0, 10.0),
    nu=st.floats(0.0, 1.0 / PERIOD),
)
def test_any_law_keeps_the_gain_between_one_and_its_cap(gain: float, lyapunov: float, mu: float, nu: float) -> None:
    following = adapt(np.array([gain]), np.array([lyapunov]), Tuning(mu, 0.05, 1.0, 15.0, nu), PERIOD)
    assert 1.0 <= following[0] <= 15.0


@given(gain=st.floats(1.0, 15.0), lyapunov=st.floats(0.0, 100.0), mu=st.floats(0.0, 10.0))
def test_without_leak_the_gain_never_falls(gain: float, lyapunov: float, mu: float) -> None:
    assert adapt(np.array([gain]), np.array([lyapunov]), Tuning(mu, 0.05, 1.0, 15.0), PERIOD)[0] >= gain


def test_at_rest_the_leak_brings_the_gain_back_to_one_exponentially() -> None:
    tuning, gain = Tuning(2.0, 0.05, 1.0, 15.0, 0.2), np.array([11.0])
    for _ in range(50):
        gain = adapt(gain, np.array([0.01]), tuning, PERIOD)
    assert gain[0] == pytest.approx(1.0 + 10.0 * (1.0 - 0.2 * PERIOD) ** 50, rel=1e-12)


def test_a_leak_of_more_than_everything_in_one_period_is_refused() -> None:
    with pytest.raises(FlatsatError, match=r"leak \(nu\) = 10.5 1/s: must be at most 1/period = 10 1/s"):
        Controller(certificate(), Tuning(2.0, 0.05, 1.0, 15.0, 10.5))


@pytest.mark.parametrize("nu", [-0.1, np.nan, np.inf])
def test_a_leak_that_is_no_rate_is_refused(nu: float) -> None:
    with pytest.raises(FlatsatError, match="leak"):
        Tuning(2.0, 0.05, 1.0, 15.0, nu)


def disturbed_gain(nu: float, seconds: float) -> float:
    """Gamma after some time under a constant error of the position rate, w with w^2 = 4 V_inf/alpha, ideal dynamics."""
    proof = certificate()
    controller = Controller(proof, Tuning(2.0, 0.05, 1.0, proof.gain_max, nu))
    memory, state, rate = controller.start(), np.zeros((1, 6)), np.array([2.0 * np.sqrt(0.05 / RATE), 0.0, 0.0])
    steps = 10
    for _ in range(round(seconds / PERIOD)):
        memory, output = controller.step(memory, state, np.zeros(1), np.zeros((1, 9)))
        for _ in range(steps):
            h = PERIOD / steps
            state[:, :3] += h * (state[:, 3:] + rate) + h * h / 2.0 * output.acceleration
            state[:, 3:] += h * output.acceleration
    return float(memory.gain[0])


def test_under_a_constant_disturbance_the_papers_gain_runs_to_its_cap_and_a_leaky_one_settles() -> None:
    assert disturbed_gain(0.0, 600.0) == certificate().gain_max
    settled = disturbed_gain(0.2, 600.0)
    assert settled == pytest.approx(disturbed_gain(0.2, 700.0), rel=1e-3)
    assert settled < certificate().gain_max / 2.0


def repeated_set_points(tuning: Tuning) -> list[float]:
    """Gamma at the end of each of four legs to and fro between two far set-points, ideal dynamics."""
    proof = certificate()
    pilot = Pilot(proof, tuning, Policy(unlock_time=1e-3, goal_mode=GoalMode.STEP), 1)
    state, at_ends = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), []
    for tick in range(4 * 80):
        now = tick * PERIOD
        if tick % 80 == 0:
            pilot.set_reference(0, Trajectory.hold([1.0 if tick % 160 == 0 else 0.0, 0.0, 1.0]))
        pilot.measure(0, now, state[:3].tolist(), (0.0, 0.0, 0.0, 1.0), now)
        v = pilot.tick(now).output.acceleration[0] if tick > 2 else np.zeros(3)
        state[:3] += PERIOD * state[3:] + PERIOD**2 / 2.0 * v
        state[3:] += PERIOD * v
        if tick % 80 == 79:
            at_ends.append(float(pilot.memory.gain[0]))
    return at_ends


def test_the_papers_gain_ratchets_over_repeated_set_points_and_a_restarted_one_does_not() -> None:
    cap = certificate().gain_max
    ratchet = repeated_set_points(Tuning(2.0, 0.05, 1.0, cap, 0.0, False))
    assert all(b > a + 0.2 for a, b in itertools.pairwise(ratchet))
    restarted = repeated_set_points(Tuning(2.0, 0.05, 1.0, cap, 0.0, True))
    assert max(restarted) - min(restarted[1:]) < 0.5
    assert max(restarted) < ratchet[-1]
