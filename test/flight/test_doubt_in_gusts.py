"""What gusts make of innovations is no reason to doubt a loop, what lateness makes of them is."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.doubt import Doubt
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

CERTIFICATE = load_certificate("cf21_adaptive_50hz")
assert CERTIFICATE.flight is not None
FLIGHT = CERTIFICATE.flight
BOUNDS = np.array([0.003, 0.003])  # m
FLYING, CALM = np.ones(1, dtype=bool), np.zeros((1, 2))


@given(
    size=st.floats(0.0, 0.0105),
    lasts=st.floats(0.02, 0.1),
    apart=st.floats(2.0, 6.0),
    period=st.sampled_from([0.5, 1.2]),
)
@settings(max_examples=15)
def test_a_gust_that_pushes_up_or_down_for_a_moment_is_no_reason_to_doubt_but_a_swing_is(
    size: float, lasts: float, apart: float, period: float
) -> None:
    def doubted(shape: Callable[[float], float], seconds: float) -> bool:
        doubt, found = Doubt.of_flight(FLIGHT, BOUNDS, 1), False
        for now in np.arange(0.0, seconds, 0.02):
            doubt.look(now, FLYING, np.zeros(1), np.array([[0.0, abs(shape(now))]]))
            found |= bool(doubt.of(now).any())
        return found

    assert not doubted(lambda now: size if now % apart < lasts else 0.0, 7.0)
    assert doubted(lambda now: 0.012 * math.sin(2.0 * math.pi * now / period), 1.0)
    assert not doubted(lambda now: 0.005 * math.sin(2.0 * math.pi * now / period), 4.0)


def test_who_is_doubted_again_by_chance_is_so_for_no_longer_than_before() -> None:
    doubt = Doubt.of_flight(FLIGHT, BOUNDS, 1)
    for now in (0.0, 8.5, 17.0):
        doubt.look(now, FLYING, np.full(1, 0.2), CALM)
        assert doubt.of(now + 1.9).all()
        assert not doubt.of(now + 2.1).any()


def test_gusts_of_a_metre_a_second_are_no_reason_to_fly_a_drone_softly() -> None:
    vehicle, certificate = load_vehicle("cf21"), load_certificate("cf21_tight_50hz")
    fleet = SimulatedFleet(vehicle, 1, seed=23, capture=MotionCapture(noise=5e-4), command_delay=LINK_DELAY)
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot, told, farthest = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1), [], 0.0

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        nonlocal farthest
        farthest = max(farthest, float(np.abs(fleet.bodies.position[0] - (0.0, 0.0, 1.0)).max()))
        told.extend(report.text for report in tick.reports)

    time = fly(pilot, fleet, vehicle, 1.0)
    pilot.take_off(0, 1.0)
    time = fly(pilot, fleet, vehicle, time + 10.0, start=time)
    fleet.wind = Wind(gust=1.0)
    fly(pilot, fleet, vehicle, time + 47.0, look, start=time)
    assert not any("flown softly" in text for text in told)
    assert farthest < 0.15
