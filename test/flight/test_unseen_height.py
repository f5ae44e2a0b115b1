"""Drones whose height stands still but for noise, as another body's does, come down without harm, whoever sees them."""

from __future__ import annotations

import numpy as np
import pytest

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.falsification.faults.record import Record
from flatsat_ros.flight.modes import AIRBORNE, STANDING_HEIGHT, Event, Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.faults import FaultyLink, frozen, repeated, rounded
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

VEHICLE = load_vehicle("cf21")
SEED, NOISE = 1, 5e-4  # m
HEIGHT = 1.2  # m, of who is taken over
HOP = 3.0  # m, about as high as rooms are
HOPPING = 2.0  # m/s, of who has climbed unseen, by a thrust that nobody knows
SINKING = 1.1  # m/s, of who was told to sink; with too little thrust it sinks the faster


class Flight:
    """A drone on the floor, or in the air; what was told, and how it met the floor."""

    def __init__(self, name: str, thrust: float, height: float, floor: float = 0.0, noise: float = NOISE) -> None:
        certificate = load_certificate(name)
        place = np.array([[0.0, 0.0, height]])
        self.fleet = SimulatedFleet(
            VEHICLE, 1, start=place, seed=SEED, thrust_scale=thrust, capture=MotionCapture(noise=noise),
            command_delay=LINK_DELAY, flying=height > floor, floor=floor,
        )  # fmt: skip
        policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
        self.pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, 1)
        self.record = Record(place, floor)
        self.told: list[str] = []
        self.stopped: list[float] = []  # m, heights at which its motors were
        self.highest = height  # m
        self.link = FaultyLink(self.fleet, self._feel)
        self.time = 0.0

    def pass_by(self, seconds: float) -> None:
        self.time = fly(self.pilot, self.link, VEHICLE, self.time + seconds, self._look, start=self.time)

    def pass_until_fallen(self) -> None:
        while self.pilot.mode[0] != Mode.FALLEN and self.time < 40.0:
            self.pass_by(1.0)
        assert self.pilot.mode[0] == Mode.FALLEN

    def _feel(self) -> None:
        bodies = self.fleet.bodies
        self.record.feel(bodies.velocity, bodies.grounded)
        self.record.look(self.fleet.time, bodies.position)
        self.highest = max(self.highest, float(bodies.position[0, 2]))

    def _look(self, _now: float, _samples: object, tick: Tick, _sent: object) -> None:
        self.told += [text for _, text in tick.reports]
        for _, before, after, reason in tick.transitions:
            self.told.append(reason)
            if before in AIRBORNE and after not in AIRBORNE:
                self.stopped.append(float(self.fleet.bodies.position[0, 2]))


@pytest.mark.parametrize(
    ("name", "thrust", "taken_over"),
    [
        ("cf21_adaptive_50hz", 1.1, False),
        ("cf21_adaptive_50hz", 1.0, True),
        ("cf21_adaptive_50hz", 1.1, True),
        ("cf21_50hz", 0.9, True),
    ],
)
def test_whoever_climbs_unseen_is_not_stopped_in_the_air(name: str, thrust: float, taken_over: bool) -> None:
    flight = Flight(name, thrust, HEIGHT if taken_over else 0.0)
    flight.pass_by(0.3 if taken_over else 1.0)
    flight.link.poses.append(frozen(2, SEED, NOISE))
    flight.pilot.set_goal(0, flight.fleet.bodies.position[0] + (0.0, 0.0, 1.0))
    flight.pass_until_fallen()
    assert flight.fleet.bodies.grounded.all()
    assert max(flight.stopped) < 0.01
    assert flight.record.impact[0] <= HOPPING
    assert any("not seen to leave the ground" in text for text in flight.told)


@pytest.mark.parametrize(
    ("name", "thrust", "way"),
    [("cf21_adaptive_50hz", 1.0, -0.3), ("cf21_adaptive_50hz", 1.1, -0.8), ("cf21_50hz", 1.0, -0.8)],
)
def test_whoever_was_taken_over_and_is_not_seen_to_sink_sinks_slowly(name: str, thrust: float, way: float) -> None:
    flight = Flight(name, thrust, HEIGHT)
    flight.pass_by(0.3)
    flight.link.poses.append(frozen(2, SEED, NOISE))
    flight.pilot.set_goal(0, np.array([0.0, 0.0, HEIGHT + way]))
    flight.pass_until_fallen()
    assert flight.fleet.bodies.grounded.all()
    assert max(flight.stopped) < 0.01
    assert flight.record.impact[0] <= SINKING
    assert any("z stays within" in text for text in flight.told)


@pytest.mark.parametrize(("name", "thrust"), [("cf21_adaptive_50hz", 0.85), ("cf21_50hz", 1.15)])
def test_whoever_is_locked_on_a_table_is_unlocked_when_it_has_not_moved(name: str, thrust: float) -> None:
    flight = Flight(name, thrust, 0.7, floor=0.7)
    flight.pass_by(1.0)
    flight.pilot.set_goal(0, np.array([0.0, 0.0, 1.2]))
    flight.pass_by(12.0)
    assert any("on something: unlocked" in text for text in flight.told)
    assert flight.fleet.bodies.position[0, 2] == pytest.approx(1.2, abs=0.05)


@pytest.mark.parametrize("goal", [(0.1, 0.0, HEIGHT), (0.0, 0.0, HEIGHT - 0.1)])
def test_whoever_is_taken_over_with_poses_that_repeat_is_led_down_without_them(goal: tuple[float, ...]) -> None:
    flight = Flight("cf21_adaptive_50hz", 1.0, HEIGHT)
    flight.pass_by(0.3)
    flight.link.poses.append(repeated())
    flight.pass_by(0.3)
    flight.pilot.set_goal(0, np.array(goal))
    flight.pass_by(12.0)
    assert flight.fleet.bodies.grounded.all()
    assert np.linalg.norm(flight.fleet.bodies.position[0, :2]) < 1.0
    assert flight.record.impact[0] <= SINKING
    assert any("the same pose again and again" in text for text in flight.told)


@pytest.mark.parametrize(("noise", "step"), [(0.0, 1e-9), (1e-4, 1e-3)])
def test_on_a_table_poses_may_repeat(noise: float, step: float) -> None:
    """So those of an ideal motion capture do, and those of whole millimetres."""
    flight = Flight("cf21_adaptive_50hz", 1.0, 0.75, floor=0.75, noise=noise)
    flight.link.poses.append(rounded(step))
    flight.pass_by(1.0)
    flight.pilot.take_off(0, 0.5)
    flight.pass_by(8.0)
    assert flight.pilot.mode[0] == Mode.FLY
    assert flight.fleet.bodies.position[0, 2] == pytest.approx(1.25, abs=0.03)


@pytest.mark.parametrize("name", ["cf21_adaptive_50hz", "cf21_50hz"])
@pytest.mark.parametrize(
    ("thrust", "told_since"),
    [(1.2, 0.7), (1.2, 0.9), (1.2, 1.2), (1.2, 1.4), (1.1, 0.3), (1.1, 1.55), (1.0, 1.5), (0.9, 1.8), (0.8, 2.0)],
)
def test_whoever_leaves_the_ground_as_its_poses_begin_to_repeat_comes_down_without_harm(
    name: str, thrust: float, told_since: float
) -> None:
    """Before, or when it is a few centimetres high, where nothing else shows that it goes on climbing."""
    flight = Flight(name, thrust, 0.0)
    flight.pass_by(1.0)
    flight.pilot.take_off(0, 1.0)
    flight.pass_by(told_since)
    flight.link.poses.append(repeated())
    flight.pass_by(33.0)
    assert flight.fleet.bodies.grounded.all()
    assert max([0.0, *flight.stopped]) < STANDING_HEIGHT  # as if it had not left the ground
    assert flight.record.impact[0] <= HOPPING
    assert flight.highest <= HOP
    assert any("the same pose again" in text for text in flight.told)


@pytest.mark.parametrize("name", ["cf21_adaptive_50hz", "cf21_50hz"])
def test_nobody_takes_off_whose_poses_repeat_that_were_noisy_before(name: str) -> None:
    """With 10 % more thrust it rose to 5 m, as it was not seen to."""
    flight = Flight(name, 1.1, 0.0)
    flight.pass_by(1.0)
    flight.link.poses.append(repeated())
    flight.pass_by(2.0)
    flight.pilot.take_off(0, 1.0)
    flight.pass_by(8.0)
    assert flight.highest < 1e-3
    assert flight.told[-1] == Event.TAKE_OFF_LOST.value
    assert any("the same pose again" in text for text in flight.told)
    flight.link.poses.clear()
    flight.pass_by(0.5)
    flight.pilot.take_off(0, 1.0)
    flight.pass_by(8.0)
    assert flight.fleet.bodies.position[0, 2] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("thrust", "seconds"), [(1.0, 2.0), (1.1, 2.0)])
def test_whoever_was_taken_over_where_it_hovers_is_not_flown_on_poses_that_begin_to_repeat(
    thrust: float, seconds: float
) -> None:
    flight = Flight("cf21_adaptive_50hz", thrust, HEIGHT)
    flight.pass_by(0.3)
    flight.pilot.set_goal(0, np.array([0.0, 0.0, HEIGHT]))
    flight.pass_by(seconds)
    flight.link.poses.append(repeated())
    flight.pass_by(12.0)
    assert any("the same pose again" in text for text in flight.told)
    assert flight.fleet.bodies.grounded.all()
    assert flight.record.impact[0] <= SINKING
