"""Where the monitor says a drone is, and when it claims a guarantee."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.certificate.sets import Place
from flatsat_ros.flight.guarantee import GuaranteeMonitor
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(1.45 * GRAVITY, np.radians(10.0))
PERIOD, RATE = 0.1, 1.25
PROOF = closed_form_certificate(LIMITS, RATE, PERIOD, "test")
FIXED, MOVING = np.ones(1, dtype=bool), np.zeros(1, dtype=bool)
FULL = np.array([LIMITS.inner_radius])

errors = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(lambda row: np.array([row]))


@given(error=errors)
def test_the_ellipsoid_is_where_v_is_at_most_its_level(error: np.ndarray) -> None:
    seen = GuaranteeMonitor(PROOF, 1).assess(error, FULL, FIXED)
    level = float(error[0] @ PROOF.matrix @ error[0]) / PROOF.level
    assert seen.relative_level[0] == pytest.approx(level, rel=1e-9)
    assert (seen.place[0] == Place.ELLIPSOID) == (seen.relative_level[0] <= 1.0)


@given(error=errors)
def test_nothing_is_guaranteed_outside_or_on_the_move(error: np.ndarray) -> None:
    monitor = GuaranteeMonitor(PROOF, 1)
    seen = monitor.assess(error, FULL, FIXED)
    assert seen.guaranteed[0] == (seen.place[0] != Place.OUTSIDE)
    assert not monitor.assess(error, FULL, MOVING).guaranteed[0]


@given(error=errors, share=st.floats(0.05, 1.0))
def test_half_the_margin_leaves_a_quarter_of_the_level(error: np.ndarray, share: float) -> None:
    monitor = GuaranteeMonitor(PROOF, 1)
    whole = monitor.assess(error, FULL, MOVING).relative_level
    assert monitor.assess(error, share * FULL, MOVING).relative_level == pytest.approx(whole / share**2, rel=1e-9)


def fly(policy: Policy, push: float) -> tuple[float, bool]:
    """Height error after 20 s under a constant vertical push, ideal dynamics, and whether all limits were kept."""
    pilot = Pilot(PROOF, Tuning(2.0, 0.05, 1.0, PROOF.gain_max), policy, 1)
    pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
    state, within = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]), True
    for number in range(200):
        now = number * PERIOD
        for part in range(5):
            at = now + (part - 4) * PERIOD / 5
            pilot.measure(0, at, (state[:3] + (part - 4) * PERIOD / 5 * state[3:]).tolist(), (0.0, 0.0, 0.0, 1.0), now)
        tick = pilot.tick(now)
        flying = tick.mode[0] == Mode.FLY
        within &= bool(LIMITS.contains(tick.output.acceleration[0]))
        v = (tick.output.acceleration[0] + [0.0, 0.0, push]) if flying else np.zeros(3)
        state[:3] += PERIOD * state[3:] + PERIOD**2 / 2.0 * v
        state[3:] += PERIOD * v
    return float(abs(state[2] - 1.0)), within


def test_a_compensated_disturbance_leaves_no_offset_and_no_limit_is_broken() -> None:
    offset, within = fly(Policy(disturbance_max=0.8), -0.5)
    assert (offset < 0.01, within) == (True, True)
    paper, within = fly(Policy(), -0.5)
    assert (paper > 0.05, within) == (True, True)


def test_at_most_the_stated_disturbance_is_compensated() -> None:
    full, within = fly(Policy(disturbance_max=0.8), -0.8)
    none, _ = fly(Policy(disturbance_max=0.01), -0.8)
    assert within
    assert full < 0.02 < none


def test_a_compensating_flight_claims_no_guarantee() -> None:
    pilot = Pilot(PROOF, Tuning(2.0, 0.05, 1.0, PROOF.gain_max), Policy(disturbance_max=0.8), 1)
    pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
    for number in range(30):
        z = 0.9 + 1e-4 * (number % 2)  # poses that repeat are old ones
        pilot.measure(0, number * PERIOD, (0.0, 0.0, z), (0.0, 0.0, 0.0, 1.0), number * PERIOD)
        tick = pilot.tick(number * PERIOD)
    assert tick.mode[0] == Mode.FLY
    assert np.linalg.norm(tick.disturbance[0]) > 0.0
    assert not tick.assessment.guaranteed[0]


ROUND_TRIP = Trajectory.through(
    [2.0, 4.0, 6.0], [[0.0, 0.0, 1.0], [0.4, 0.0, 1.0], [0.0, 0.0, 1.0]], np.zeros((3, 3)), np.zeros((3, 3))
)


def on_the_reference(certificate: Certificate, trajectory: Trajectory, seconds: float) -> list[Tick]:
    """The ticks of a drone that is exactly where its reference is."""
    pilot = Pilot(certificate, Tuning(0.0, 0.05, 1.0, 1.0), Policy(), 1)
    pilot.set_reference(0, trajectory)
    ticks = []
    for number in range(round(seconds / certificate.period)):
        now = number * certificate.period
        pilot.measure(0, now, trajectory.sample(now)[:3].tolist(), (0.0, 0.0, 0.0, 1.0), now)
        ticks.append(pilot.tick(now))
    return ticks


def test_a_trajectory_is_guaranteed_neither_before_it_begins_nor_on_its_way_but_after_its_end() -> None:
    ticks = on_the_reference(PROOF, ROUND_TRIP, 9.0)
    flying = [(i * PERIOD, bool(t.assessment.guaranteed[0])) for i, t in enumerate(ticks) if t.mode[0] == Mode.FLY]
    assert {held for time, held in flying if time < 5.95} == {False}
    assert {held for time, held in flying if time > 7.0} == {True}


def test_with_a_lag_a_moving_reference_that_is_met_is_not_outside() -> None:
    certificate = Certificate.load(Path(__file__).parents[2] / "config" / "cf21_50hz.yaml")
    ticks = [tick for tick in on_the_reference(certificate, ROUND_TRIP, 8.0) if tick.mode[0] == Mode.FLY]
    assert len(ticks) > 300
    # the estimator's errors alone are left
    assert max(float(tick.assessment.relative_level[0]) for tick in ticks[20:]) < 0.1
    assert {int(tick.assessment.place[0]) for tick in ticks[20:]} == {Place.ELLIPSOID}
