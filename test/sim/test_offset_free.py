"""Offset-free flight on the identified Crazyflie: 5 % of thrust missing, 50 Hz, mu = 2, the swap with legs of 4 s."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from flatsat_ros.core.certificate import Certificate
from flatsat_ros.core.flatness import FloatArray
from flatsat_ros.core.gain import Tuning
from flatsat_ros.core.input_set import InputSet
from flatsat_ros.core.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.core.pilot import Pilot, Tick
from flatsat_ros.core.reference import Trajectory
from flatsat_ros.core.supervisor import Policy
from flatsat_ros.core.vehicle import VehicleProfile
from flatsat_ros.core.wire import WireSetpoint
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.flight import fly
from flatsat_ros.sim.sensor import MotionCapture, Sample
from flatsat_ros.synthesis.planner import spline_through

VEHICLE = VehicleProfile.load(Path(__file__).parents[2] / "config" / "vehicles" / "cf21.yaml")
LIMITS = InputSet(1.45 * 9.81, math.radians(10.0))
RATE, PERIOD, LEG, CLIMB = 1.25, 0.02, 4.0, 8.0
PLACES = np.array([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0]])


def swap(compensated: float) -> tuple[FloatArray, FloatArray, bool]:
    """Fly the three drones.

    Returns:
        The errors at the end of the hover and the RMS errors of the swap, m, and whether all commands kept the limits.
    """
    low, high = hold_gain_interval(RATE, PERIOD)
    ball = LIMITS.inner_radius**2
    proof = Certificate("50 Hz", LIMITS, RATE, closed_form_block(RATE), ball, ball / RATE, PERIOD, low, high)
    pilot = Pilot(proof, Tuning(2.0, 0.05, 1.0, high), Policy(disturbance_max=compensated), 3)
    fleet = SimulatedFleet(
        VEHICLE, 3, start=PLACES * (1.0, 1.0, 0.0), thrust_scale=0.95, capture=MotionCapture(noise=5e-4), seed=1
    )
    errors: list[FloatArray] = []
    within = True

    def observe(_now: float, _samples: list[Sample], tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        nonlocal within
        errors.append(np.linalg.norm(fleet.bodies.position - tick.reference[:, :3], axis=1))
        within &= bool((tick.input[:, 0] <= LIMITS.thrust_max * (1.0 + 1e-12)).all())
        within &= bool((np.abs(tick.input[:, 1:]) <= LIMITS.tilt_max * (1.0 + 1e-9)).all())

    for i, place in enumerate(PLACES):
        pilot.refer(i, Trajectory.hold(place))
    fly(pilot, fleet, VEHICLE, CLIMB - PERIOD, observe)
    hovered = np.array(errors[-25:]).mean(axis=0)
    errors.clear()
    for i in range(3):
        pilot.refer(i, spline_through([PLACES[(i + leg) % 3] for leg in range(4)], LEG).shifted(CLIMB))
    fly(pilot, fleet, VEHICLE, CLIMB + 3.0 * LEG, observe, start=CLIMB)
    return hovered, np.sqrt(np.mean(np.square(errors), axis=0)), within


def test_a_steady_error_below_one_centimetre_and_a_swap_below_four() -> None:
    hovered, swapped, within = swap(compensated=0.8)
    assert hovered.max() < 0.01
    assert swapped.max() < 0.04
    assert within


def test_without_it_the_papers_law_hangs_low_and_lags_behind() -> None:
    hovered, swapped, within = swap(compensated=0.0)
    assert hovered.min() > 0.10
    assert swapped.min() == pytest.approx(0.2, abs=0.1)
    assert within
