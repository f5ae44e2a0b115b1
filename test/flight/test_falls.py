"""A fall is told from whatever commands that come late do, and links late from before the take-off cut no motors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.falls import FallDetector
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

LOOK, STEPS = 0.05, 10  # s between two looks, and steps of integration in one
JUDGED = np.ones(1, dtype=bool)
GRAVITY = 9.81
# upward accelerations that are commanded in turn, m/s^2, and for how long each, s
COMMANDS = st.lists(st.tuples(st.floats(-5.5, 4.5), st.floats(0.1, 0.8)), min_size=2, max_size=6)


def found_falling(
    pushes: np.ndarray, *, delay: float, ratio: float, gust: float, noise: float, falls_after: float = np.inf
) -> float:
    """When, s, a drone is taken for one that falls; infinite for never.

    Its estimate takes it for falling all the time.

    Args:
        pushes: (M,) upward acceleration commanded at each look, m/s^2.
        delay: after which it obeys, s.
        ratio: its thrust over the thrust asked for.
        gust: what is added, m/s^2.
        noise: standard deviation of its poses, m.
        falls_after: s, from when on it has no thrust.
    """
    detector, random = FallDetector(1, LOOK), np.random.default_rng(1)
    state = np.array([[0.0, 0.0, 50.0, 0.0, 0.0, 0.0]])
    for n, push in enumerate(pushes):
        detector.note(np.array([push]), np.array([n * LOOK]), state[:, 2] + random.normal(0.0, noise, 1))
        for step in range(STEPS):
            time = n * LOOK + step * LOOK / STEPS
            thrust = ratio * (pushes[max(0, int((time - delay) / LOOK))] + GRAVITY) + gust
            state[0, 2] += LOOK / STEPS * state[0, 5]
            state[0, 5] += LOOK / STEPS * ((thrust if time < falls_after else 0.0) - GRAVITY)
        if detector.fell((n + 1) * LOOK, state, np.array([-9.0]), np.array([push]), state[:, 2], JUDGED)[0]:
            return (n + 1) * LOOK
    return np.inf


def listed(commands: list[tuple[float, float]]) -> np.ndarray:
    return np.array([push for push, lasts in commands for _ in range(round(lasts / LOOK))])


@given(
    commands=COMMANDS,
    delay=st.floats(0.0, 0.5),
    ratio=st.floats(0.8, 1.2),
    gust=st.floats(-1.0, 1.0),
    noise=st.floats(0.0, 0.002),
)
@settings(max_examples=60)
def test_a_drone_that_obeys_late_does_not_fall_whatever_its_estimate_says(
    commands: list[tuple[float, float]], delay: float, ratio: float, gust: float, noise: float
) -> None:
    assert found_falling(listed(commands), delay=delay, ratio=ratio, gust=gust, noise=noise) == np.inf


@given(
    pushes=st.lists(st.floats(-1.5, 4.5), min_size=40, max_size=40),
    delay=st.floats(0.0, 0.3),
    noise=st.floats(0.0, 0.002),
)
@settings(max_examples=30)
def test_a_drone_without_thrust_is_noticed_within_four_tenths_of_a_second(
    pushes: list[float], delay: float, noise: float
) -> None:
    level = [0.0] * 20  # it hovers at first
    found = found_falling(np.array(level + pushes), delay=delay, ratio=1.0, gust=0.0, noise=noise, falls_after=1.0)
    assert 1.0 < found <= 1.41


def test_who_is_not_seen_is_not_told_to_fall_and_neither_is_who_was_seen_before_the_clock_was_set() -> None:
    state, push = np.array([[0.0, 0.0, 9.0, 0.0, 0.0, -3.0]]), np.array([-9.0])
    for stamps, falls in (([0.0, 0.1, 0.2], True), ([0.2, 0.2, 0.2], False), ([-np.inf, 0.1, 0.2], False)):
        detector = FallDetector(1, LOOK)
        for stamp, z in zip(stamps, (9.1, 9.05, 8.9), strict=True):
            detector.note(np.zeros(1), np.array([stamp]), np.array([z]))
        assert detector.fell(0.2, state, push, np.zeros(1), np.full(1, 9.0), JUDGED)[0] == falls
        detector.set_clock_back(0.0)
        assert not detector.fell(0.2, state, push, np.zeros(1), np.full(1, 9.0), JUDGED)[0]


@pytest.mark.parametrize(
    ("name", "late", "thrust", "gust"),
    [
        ("cf21_adaptive_50hz", 0.2, 1.0, 0.0),
        ("cf21_adaptive_50hz", 0.2, 0.85, 1.0),
        ("cf21_adaptive_50hz", 0.3, 1.15, 0.0),
        ("cf21_50hz", 0.2, 0.85, 0.5),
        ("cf21_50hz", 0.3, 1.0, 0.0),
        ("paper_experiment", 0.3, 1.15, 0.0),
        ("paper_robust", 0.2, 1.0, 0.0),
    ],
)
def test_commands_that_are_late_from_before_the_take_off_on_cut_no_motors_and_drop_no_drone(
    name: str, late: float, thrust: float, gust: float
) -> None:
    vehicle, certificate = load_vehicle("cf21"), load_certificate(name)
    fleet = SimulatedFleet(
        vehicle,
        2,
        start=[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        seed=3,
        capture=MotionCapture(noise=1e-4),
        command_delay=LINK_DELAY + late,
        thrust_scale=thrust,
        wind=Wind(gust=gust),
    )
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 2)
    told, fastest = [], 0.0

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        nonlocal fastest
        told.extend(report.text for report in tick.reports)
        assert not np.isin(tick.mode, (Mode.FALLEN, Mode.CUT)).any()
        low = fleet.bodies.position[:, 2] < 0.1
        fastest = max(fastest, float(np.where(low, -fleet.bodies.velocity[:, 2], 0.0).max()))

    time = fly(pilot, fleet, vehicle, 1.0)
    for index in range(2):
        pilot.take_off(index, 1.0)
    time = fly(pilot, fleet, vehicle, time + 9.0, look, start=time)
    for index in range(2):
        pilot.land(index)
    fly(pilot, fleet, vehicle, time + 10.0, look, start=time)
    assert fleet.bodies.grounded.all()
    assert fastest < 1.0
    assert any("come too late" in text for text in told)
