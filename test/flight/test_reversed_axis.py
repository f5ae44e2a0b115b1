"""A drone on which roll or pitch has the other sign is noticed in a hover before it has moved by 0.3 m, and lands."""

from __future__ import annotations

import numpy as np

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
from flatsat_ros.sim.faults import FaultyLink
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
