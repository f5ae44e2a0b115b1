"""The thrust scale: what is learnt of it disturbs no more."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.thrust import ThrustScale
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture


@given(true=st.floats(0.8, 1.2), upward=st.floats(5.0, 14.0), period=st.floats(0.01, 0.1))
def test_what_the_scale_gains_is_what_disturbs_less(true: float, upward: float, period: float) -> None:
    thrust, asked, air, floor = (
        ThrustScale(1, 0.25, quick=True),
        np.array([upward]),
        np.ones(1, bool),
        np.zeros(1, bool),
    )
    disturbance = (true / thrust.scale - 1.0) * asked
    for _ in range(5):
        thrust.learn(asked, disturbance, air, floor, period)
        gained = thrust.take_gained()
        assert gained is not None
        disturbance = disturbance + gained
        assert disturbance == pytest.approx((true / thrust.scale - 1.0) * asked, abs=1e-12)
    assert abs(disturbance[0]) < abs(true / 1.125 - 1.0) * upward + 1e-12


@given(upward=st.floats(0.0, 5.0), disturbance=st.floats(-9.0, 9.0), quick=st.booleans())
def test_little_thrust_shows_little_of_its_scale(upward: float, disturbance: float, quick: bool) -> None:
    thrust, air = ThrustScale(1, 0.25, quick=quick), np.ones(1, bool)
    before = float(thrust.scale[0])
    thrust.learn(np.full(1, upward), np.full(1, disturbance), air, ~air, 0.01)
    assert abs(float(thrust.scale[0]) - before) <= 0.045


def test_what_a_drone_gains_once_it_rises_is_no_lack_of_thrust() -> None:
    certificate, vehicle = load_certificate("cf2x_2025_adaptive_50hz"), load_vehicle("cf2x_2025")
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1)
    fleet = SimulatedFleet(vehicle, 1, capture=MotionCapture(noise=1e-4), command_delay=LINK_DELAY, seed=1)
    away: list[float] = []

    def observe(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        away.append(abs(float(fleet.bodies.position[0, 2] - tick.reference[0, 2])))

    fly(pilot, fleet, vehicle, 1.0)
    fleet.firmware.request_arming(0, True)
    pilot.take_off(0, 1.0)
    fly(pilot, fleet, vehicle, 10.0, observe, start=1.0)
    assert max(away[round(3.0 / certificate.period) :]) < 0.007  # judged by its height of some ticks ago it is 0.010 m


def test_a_take_off_whose_thrust_is_still_learnt_does_not_make_up_for_it_twice() -> None:
    certificate, vehicle = load_certificate("cf21_adaptive_50hz"), load_vehicle("cf21")
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    fleet = SimulatedFleet(vehicle, 1, start=[[0.0, 0.0, 0.0]], command_delay=0.028)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1)
    ahead: list[float] = []
    fly(pilot, fleet, vehicle, 1.0)
    pilot.take_off(0, 1.0)
    fly(
        pilot, fleet, vehicle, 8.0, start=1.0,
        observe=lambda _now, _samples, tick, _sent: ahead.append(fleet.bodies.position[0, 2] - tick.reference[0, 2]),
    )  # fmt: skip
    assert pilot.mode[0] == 2
    assert max(ahead) < 0.03
