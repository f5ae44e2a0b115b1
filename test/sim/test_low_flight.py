"""Goals near the ground, and drones that have left what they stood on: both are flown, and nobody stays on the way."""

from __future__ import annotations

import numpy as np
import pytest

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.faults import FaultyLink, lost
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

CERTIFICATE = load_certificate("cf21_adaptive_50hz")
VEHICLE = load_vehicle("cf21")


class LowFlight:
    """One drone, and what it stands on.

    Attributes:
        sank: the largest speed at which it has sunk so far, m/s.
    """

    def __init__(self, floor: float = 0.0, noise: float = 1e-4) -> None:
        policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
        self.pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), policy, 1)
        start, capture = [[0.0, 0.0, floor]], MotionCapture(noise=noise)
        self.fleet = SimulatedFleet(VEHICLE, 1, start=start, floor=floor, command_delay=0.028, capture=capture)
        self.link = FaultyLink(self.fleet, self._look)
        self.now = self.sank = 0.0
        self.let_pass(1.0)

    def let_pass(self, seconds: float) -> None:
        self.now = fly(self.pilot, self.link, VEHICLE, self.now + seconds, start=self.now)

    def go(self, x: float, y: float, z: float) -> float:
        """Send it to a goal, m, give it the time, and return how far it is from there, m."""
        self.pilot.set_goal(0, [x, y, z])
        self.let_pass(10.0)
        return float(np.linalg.norm(self.fleet.bodies.position[0] - [x, y, z]))

    def _look(self) -> None:
        self.sank = max(self.sank, -float(self.fleet.bodies.velocity[0, 2]))


@pytest.mark.parametrize("height", [0.08, 0.12, 0.19])
def test_a_goal_near_the_ground_is_reached_from_the_ground_and_from_the_air(height: float) -> None:
    flight = LowFlight()
    assert flight.go(0.6, 0.0, height) < 0.02
    assert flight.go(0.0, 0.4, height) < 0.02
    assert flight.go(0.0, 0.0, 0.6) < 0.02
    assert flight.go(1.0, 0.0, height) < 0.02


@pytest.mark.parametrize("after", [0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2])
def test_a_drone_that_lands_as_soon_as_it_has_left_the_ground_rests_where_poses_have_no_noise(after: float) -> None:
    """As those of simulated drones: on the ground they are the same again and again."""
    flight, modes = LowFlight(noise=0.0), set()
    flight.pilot.set_goal(0, [0.0, 0.0, 0.6])
    flight.let_pass(after)
    flight.pilot.land(0)
    for _ in range(500):
        flight.let_pass(0.02)
        modes.add(Mode(flight.pilot.mode[0]))
    assert modes == {Mode.FLY, Mode.REST, Mode.IDLE}


@pytest.mark.parametrize("after", [0.0, 0.1, 0.3, 0.7])
@pytest.mark.parametrize(("floor", "noise"), [(0.0, 0.0), (0.0, 1e-4), (0.7, 1e-4)])
def test_a_goal_for_a_drone_that_is_touching_down_is_flown_to(floor: float, noise: float, after: float) -> None:
    """Nobody falls from there, but it lay on the floor, pressed down by the end of its landing, until it had FALLEN."""
    flight = LowFlight(floor, noise)
    assert flight.go(0.0, 0.0, floor + 0.5) < 0.02
    flight.pilot.land(0)
    while not flight.fleet.bodies.grounded[0]:
        flight.let_pass(0.02)
    flight.let_pass(after)
    assert flight.pilot.mode[0] == Mode.FLY
    assert flight.go(0.3, 0.0, floor + 0.6) < 0.02
    assert flight.pilot.mode[0] == Mode.FLY


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("height", [0.12, 0.0])
def test_a_drone_that_is_told_to_hold_as_it_touches_down_lands(height: float, noise: float) -> None:
    """It stayed in FLY on the floor, its motors on."""
    flight = LowFlight(noise=noise)
    assert flight.go(0.0, 0.0, 0.5) < 0.02
    flight.pilot.land(0)
    while flight.fleet.bodies.position[0, 2] > height:
        flight.let_pass(0.02)
    flight.pilot.hold(0)
    flight.let_pass(8.0)
    assert flight.pilot.mode[0] == Mode.IDLE


@pytest.mark.parametrize("height", [0.12, 0.25])
def test_a_goal_for_a_drone_that_is_about_to_land_is_flown_to_without_noise_too(height: float) -> None:
    """Its reference sank on to 0.2 m below the floor: the drone lay there, its poses repeated, and it was cut."""
    flight = LowFlight(noise=0.0)
    assert flight.go(0.0, 0.0, 0.5) < 0.02
    flight.pilot.land(0)
    while flight.fleet.bodies.position[0, 2] > height:
        flight.let_pass(0.02)
    assert flight.go(0.3, 0.0, 0.6) < 0.02


def test_before_it_goes_sideways_a_drone_has_left_the_ground() -> None:
    flight, went = LowFlight(), []
    flight.pilot.set_goal(0, [1.0, 0.0, 0.12])
    for _ in range(500):
        flight.let_pass(0.02)
        x, _, z = flight.fleet.bodies.position[0]
        went.append((x, z))
    assert min(z for x, z in went if x > 0.01) > 0.05
    assert went[-1][0] == pytest.approx(1.0, abs=0.02)


def test_a_drone_that_has_left_its_table_flies_as_low_as_it_is_told_beside_it() -> None:
    flight = LowFlight(floor=0.75)
    assert flight.go(0.0, 0.0, 1.2) < 0.02
    flight.go(1.0, 0.0, 1.0)
    flight.fleet.bodies.floor = 0.0
    assert flight.go(1.0, 0.8, 0.5) < 0.02
    assert flight.go(0.4, 0.8, 0.6) < 0.02


def test_a_drone_that_flies_beside_its_table_as_low_as_that_is_not_taken_for_one_that_stands() -> None:
    """Its motors would be stopped as soon as its poses are lost."""
    flight = LowFlight(floor=0.75)
    assert flight.go(0.0, 0.0, 1.2) < 0.02
    flight.go(1.0, 0.0, 1.0)
    flight.fleet.bodies.floor = 0.0
    assert flight.go(1.0, 0.8, 1.0) < 0.02
    assert flight.go(1.0, 0.8, 0.78) < 0.02
    flight.pilot.set_goal(0, [0.4, 0.8, 0.78])
    flight.link.poses.append(lost)
    flight.let_pass(0.7)
    assert flight.pilot.mode[0] == Mode.LEVEL


def test_a_drone_that_has_left_its_table_sinks_without_poses_to_the_floor() -> None:
    flight = LowFlight(floor=1.5)
    assert flight.go(0.0, 0.0, 1.8) < 0.02
    assert flight.go(1.0, 0.0, 1.9) < 0.02
    flight.fleet.bodies.floor, flight.sank = 0.0, 0.0
    flight.link.poses.append(lost)
    flight.let_pass(15.0)
    assert flight.pilot.mode[0] == Mode.CUT
    assert flight.fleet.bodies.grounded[0]
    assert flight.sank < 1.0
