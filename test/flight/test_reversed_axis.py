"""A drone on which roll or pitch has the other sign is noticed in a hover before it has moved by 0.3 m, and lands.

So is one that is taken over in the air with such a sign, or with a wrong yaw.
"""

from __future__ import annotations

import numpy as np
import pytest

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.faults import FaultyLink, of_drones, pitch_negated, turned
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

VEHICLE = load_vehicle("cf21")
# reversed roll, reversed pitch and none, each seen from four sides, so that the air pushes along each axis either way
YAWS = np.tile([0.0, np.pi / 2, np.pi, -np.pi / 2], 3)
ROLL, PITCH, RIGHT = slice(0, 4), slice(4, 8), slice(8, 12)
STARTS = np.array([[4.0 * (n % 4), 4.0 * (n // 4), 0.0] for n in range(len(YAWS))])
MOST = 0.3  # m


def reversed_axes(_time: float, index: int, setpoint: WireSetpoint) -> list[tuple[float, WireSetpoint]]:
    if index < ROLL.stop:
        setpoint = setpoint._replace(roll=-setpoint.roll)
    elif index < PITCH.stop:
        setpoint = setpoint._replace(pitch=-setpoint.pitch)
    return [(0.0, setpoint)]


def test_a_reversed_axis_is_noticed_in_a_hover_before_the_drone_has_gone_far() -> None:
    certificate, count = load_certificate(DEFAULT_CERTIFICATE), len(YAWS)
    wind, capture = Wind(gust=0.05), MotionCapture(noise=5e-4)
    fleet = SimulatedFleet(
        VEHICLE, count, start=STARTS, yaw=YAWS, seed=1, wind=wind, capture=capture, command_delay=LINK_DELAY
    )
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, count)
    noticed = np.full(count, np.nan)  # m, how far away

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        away = np.hypot(*(fleet.bodies.position - STARTS)[:, :2].T)
        for change in tick.transitions:
            if change.after is Mode.DESCEND:
                noticed[change.drone] = away[change.drone]

    link = FaultyLink(fleet)
    link.commands.append(reversed_axes)
    time = fly(pilot, link, VEHICLE, 1.0, look)
    for index in range(count):
        pilot.take_off(index, 1.0)
    fly(pilot, link, VEHICLE, 9.0, look, start=time)
    wrong = np.r_[noticed[ROLL], noticed[PITCH]]
    assert (wrong < MOST).all(), wrong
    assert fleet.bodies.grounded[: PITCH.stop].all()
    assert np.isnan(noticed[RIGHT]).all()
    assert (pilot.mode[RIGHT] == Mode.FLY).all()


# with ten ticks a second a drone is seen half as often, and goes twice as far
@pytest.mark.parametrize(
    ("name", "most"),
    [("cf21_adaptive_50hz", MOST), ("cf21_tight_100hz", MOST), ("cf21_50hz", MOST), ("cf21_tight_10hz", 2.0 * MOST)],
)
@pytest.mark.parametrize("away", [0.0, 1.0])
def test_who_is_taken_over_with_a_wrong_yaw_or_sign_is_noticed_though_its_goal_is_as_high_as_it_is(
    name: str, most: float, away: float
) -> None:
    certificate, starts = load_certificate(name), np.array([[0.0, 4.0 * n, 1.0] for n in range(4)])
    wind, capture = Wind(gust=0.05), MotionCapture(noise=5e-4)
    fleet = SimulatedFleet(
        VEHICLE, 4, start=starts, flying=True, seed=1, wind=wind, capture=capture, command_delay=LINK_DELAY
    )
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 4)
    noticed, farthest, ends = np.full(4, np.nan), np.zeros(4), starts + (away, 0.0, 0.0)

    def look(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        place = fleet.bodies.position
        off = np.hypot(place[:, 0] - np.clip(place[:, 0], starts[:, 0], ends[:, 0]), place[:, 1] - starts[:, 1])
        np.maximum(farthest, off, out=farthest)
        for change in tick.transitions:
            if change.after is Mode.DESCEND:
                noticed[change.drone] = off[change.drone]

    link = FaultyLink(fleet)
    link.poses += [of_drones(turned(np.pi), 0), of_drones(turned(np.pi / 2.0), 1)]
    link.commands.append(pitch_negated(2))
    time = fly(pilot, link, VEHICLE, 0.3)
    for index, end in enumerate(ends):
        pilot.set_goal(index, end)
    fly(pilot, link, VEHICLE, time + 8.0, look, start=time)
    assert (noticed[:3] < most).all(), noticed
    assert (farthest[:3] < 1.2).all(), farthest
    assert fleet.bodies.grounded[:3].all()
    assert np.isnan(noticed[3])
    assert pilot.mode[3] == Mode.FLY
    assert farthest[3] < 0.05


def test_gusts_are_taken_for_no_reversed_axis_with_ten_ticks_a_second() -> None:
    certificate, starts = (
        load_certificate("cf21_tight_10hz"),
        np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [4.0, 0.0, 1.0]]),
    )
    fleet = SimulatedFleet(
        VEHICLE, 3, start=starts, flying=True, seed=1, wind=Wind(gust=0.5), capture=MotionCapture(noise=2e-4),
        command_delay=LINK_DELAY,
    )  # fmt: skip
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 3)
    time = fly(pilot, fleet, VEHICLE, 0.3)
    for index, start in enumerate(starts):
        pilot.set_goal(index, start + (0.0, 0.0, 0.3))
    fly(pilot, fleet, VEHICLE, 12.0, start=time)
    assert (pilot.mode == Mode.FLY).all()
