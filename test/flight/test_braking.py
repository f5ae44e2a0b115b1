"""Braking by what was seen of the answer: it ends the motion, at every yaw, or ends itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.flight.braking import Braking
from flatsat_ros.law.input_set import InputSet

LIMITS = InputSet(thrust_max=14.0, tilt_max=math.radians(10.0))
MOST = LIMITS.gravity * math.tan(LIMITS.tilt_max)
PERIOD, LAG = 0.02, 0.15  # s


def turned(angle: float) -> np.ndarray:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def speeds(seen: np.ndarray | None, answer: np.ndarray, velocity: np.ndarray, yaw: float) -> list[float]:
    """Speed, m/s, over 4 s of a drone that answers, in its body's axes, with a lag; what was seen is used to brake."""
    braking, acceleration, found = Braking(LIMITS, 2), np.zeros(2), []
    braking.begin(1, seen, velocity)
    for _ in range(round(4.0 / PERIOD)):
        both = np.array([[9.0, 9.0], velocity])
        who, wanted, asked = braking.accelerations(both, np.array([0.0, yaw]), np.ones(2, dtype=bool))
        assert who.tolist() in ([], [1])
        assert (np.hypot(*wanted.T) <= MOST).all()
        assert np.hypot(*asked.T) == pytest.approx(np.hypot(*wanted.T))
        came = turned(yaw) @ answer @ turned(-yaw) @ asked[0] if who.size else np.zeros(2)
        acceleration = acceleration + PERIOD / LAG * (came - acceleration)
        velocity = velocity + PERIOD * acceleration
        found.append(float(np.hypot(*velocity)))
    return found


ANSWERS = st.one_of(
    st.floats(-math.pi, math.pi).map(turned), st.sampled_from([np.diag([-1.0, 1.0]), np.diag([1.0, -1.0])])
)
VELOCITIES = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)).map(np.array)
YAWS = st.floats(-math.pi, math.pi)


@given(answer=ANSWERS, off=st.floats(-0.7, 0.7), velocity=VELOCITIES, yaw=YAWS)
@settings(max_examples=40)
def test_it_ends_the_motion_even_if_what_was_seen_is_off_by_40_degrees(
    answer: np.ndarray, off: float, velocity: np.ndarray, yaw: float
) -> None:
    found = speeds(turned(off) @ answer, answer, velocity, yaw)
    assert max(found) <= np.hypot(*velocity) + 1e-9
    assert found[-1] < 0.02


@given(answer=ANSWERS, velocity=VELOCITIES, yaw=YAWS)
@settings(max_examples=20)
def test_what_was_seen_wrongly_is_given_up_before_it_does_harm(
    answer: np.ndarray, velocity: np.ndarray, yaw: float
) -> None:
    assert max(speeds(-answer, answer, velocity, yaw)) < np.hypot(*velocity) + 0.6


def test_what_commands_on_their_way_still_add_does_not_end_the_braking() -> None:
    for under_way, ends in ((0.0, True), (0.5, False)):
        braking = Braking(LIMITS, 1)
        braking.begin(0, np.eye(2), np.array([1.0, 0.0]), under_way)
        who, *_ = braking.accelerations(np.array([[1.7, 0.0]]), np.zeros(1), np.ones(1, dtype=bool))
        assert (who.size == 0) == ends


def test_without_anything_seen_or_a_known_velocity_nobody_brakes() -> None:
    braking = Braking(LIMITS, 1)
    moving, still = np.array([[0.5, 0.0]]), np.zeros(1)
    braking.begin(0, None, moving[0])
    assert braking.accelerations(moving, still, np.ones(1, dtype=bool))[0].size == 0
    braking.begin(0, np.eye(2), moving[0])
    assert braking.accelerations(moving, still, np.zeros(1, dtype=bool))[0].size == 0
    assert braking.accelerations(moving, still, np.ones(1, dtype=bool))[0].tolist() == [0]
