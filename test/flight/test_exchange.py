"""Drones whose poses have been another's, or upside down, since before their take-off come down without harm."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.falsification.faults.record import Record
from flatsat_ros.flight.exchange import ExchangeDetector
from flatsat_ros.flight.modes import AIRBORNE, Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.faults import FaultyLink, commands_delayed, exchanged, mirrored
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

VEHICLE = load_vehicle("cf21")
PERIOD = 0.05  # s, between two looks
SOFTLY = 1.05  # m/s, of a drone that nobody sees but as another one
HOPPING = 1.5  # m/s, before the thrust has been learnt
TOLD = "moves as another drone is commanded"


class Flight:
    """Drones a metre apart take off one after another; what was told and how they met the floor."""

    def __init__(
        self,
        name: str,
        starts: tuple[float, ...],
        seed: int = 1,
        *,
        prepare: Callable[[FaultyLink], None] = lambda _: None,
        thrust: float | tuple[float, ...] = 1.0,
        wind: Wind | None = None,
    ) -> None:
        certificate, count = load_certificate(name), len(starts)
        places = np.array([[1.0 * number, 0.0, 0.0] for number in range(count)])
        self.fleet = SimulatedFleet(
            VEHICLE, count, start=places, seed=seed, thrust_scale=thrust, wind=wind,
            capture=MotionCapture(noise=5e-4), command_delay=LINK_DELAY,
        )  # fmt: skip
        policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=VEHICLE.dynamics.drag_z)
        self.pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), policy, count)
        self.record = Record(places, 0.0)
        self.told: set[int] = set()
        self.cut: list[float] = []  # m, heights at which motors were stopped
        self.link = FaultyLink(self.fleet, self._feel)
        prepare(self.link)
        self.time = 0.0
        self.pass_to(1.0)
        for index, start in enumerate(starts):
            self.pass_to(1.0 + start)
            self.pilot.take_off(index, 1.0)

    def pass_to(self, end: float) -> None:
        self.time = fly(self.pilot, self.link, VEHICLE, end, self._look, start=self.time)

    def _feel(self) -> None:
        bodies = self.fleet.bodies
        self.record.feel(bodies.velocity, bodies.grounded)
        self.record.look(self.fleet.time, bodies.position)

    def _look(self, _now: float, _samples: object, tick: Tick, _sent: object) -> None:
        self.told |= {index for index, text in tick.reports if TOLD in text}
        for index, before, after, _ in tick.transitions:
            if before in AIRBORNE and after not in AIRBORNE:
                self.cut.append(float(self.fleet.bodies.position[index, 2]))


@pytest.mark.parametrize("name", ["cf21_adaptive_50hz", "cf21_50hz", "cf21_tight_50hz"])
@pytest.mark.parametrize(
    ("starts", "thrust"),
    [((0.0, 0.0, 0.0), 1.0), ((0.0, 0.1, 0.2), 1.0), ((0.0, 0.5, 1.0), 1.0), ((0.0, 0.0, 0.0), (0.92, 1.08, 1.0))],
    ids=["at once", "one after another", "the other waits", "the other is weaker"],
)
def test_whoever_takes_off_with_another_ones_poses_is_told_so_and_sinks(
    name: str, starts: tuple[float, ...], thrust: float | tuple[float, ...]
) -> None:
    flight = Flight(name, starts, thrust=thrust, prepare=lambda link: link.poses.append(exchanged(0, 1)))
    flight.pass_to(12.0)
    impact, grounded = flight.record.impact, flight.fleet.bodies.grounded
    assert impact[:2].max() <= SOFTLY
    assert flight.told >= {0, 1}
    assert max(flight.cut) < 0.05
    assert (flight.record.height < 2.0).all()
    assert grounded[:2].all()
    assert (flight.pilot.mode[:2] == Mode.FALLEN).all()
    with pytest.raises(FlatsatError, match="arm it again"):  # the next goal does not let it do that again
        flight.pilot.set_goal(0, np.array([0.0, 0.0, 1.0]))
    # who stands as the second does, told to climb as it is, may be the one that is seen as the first
    assert impact[2] <= HOPPING if 2 in flight.told else flight.pilot.mode[2] == Mode.FLY


def cycle(_time: float, samples: list[Sample]) -> list[Sample]:
    """Poses of three drones, each of which is seen as the next one."""
    return [sample._replace(drone=(sample.drone + 1) % 3) for sample in samples]


@pytest.mark.parametrize(("name", "seed"), [("cf21_50hz", 2), ("cf21_50hz", 3), ("cf21_tight_50hz", 2)])
def test_three_that_are_seen_as_one_another_sink_slowly(name: str, seed: int) -> None:
    flight = Flight(name, (0.0, 0.0, 0.0), seed, prepare=lambda link: link.poses.append(cycle))
    flight.pass_to(12.0)
    assert flight.record.impact.max() <= SOFTLY
    assert flight.told == {0, 1, 2}
    assert max(flight.cut) < 0.05
    assert (flight.pilot.mode == Mode.FALLEN).all()


@pytest.mark.parametrize(
    ("prepare", "thrust", "wind"),
    [
        (lambda _: None, (0.9, 1.1, 1.0), None),
        (lambda _: None, (0.8, 1.2, 1.2), Wind(gust=1.0)),
        (lambda link: link.commands.append(commands_delayed(0.15, 0, 1, 2)), (1.0, 1.0, 1.0), None),
    ],
    ids=["thrusts", "gusts", "late commands"],
)
@pytest.mark.parametrize("starts", [(0.0, 0.0, 0.0), (0.0, 0.3, 2.0)])
def test_nothing_else_that_moves_drones_up_and_down_is_taken_for_it(
    prepare: Callable[[FaultyLink], None], thrust: tuple[float, ...], wind: Wind | None, starts: tuple[float, ...]
) -> None:
    flight = Flight("cf21_adaptive_50hz", starts, prepare=prepare, thrust=thrust, wind=wind)
    flight.pass_to(10.0)
    for index in range(3):
        flight.pilot.set_goal(index, flight.fleet.bodies.position[index] + (0.0, 0.0, 0.5 * (index - 1)))
    flight.pass_to(13.0)
    assert not flight.told


@pytest.mark.parametrize("name", ["cf21_adaptive_50hz", "cf21_50hz"])
@pytest.mark.parametrize("thrust", [0.95, 1.05, 1.1, 1.2])
def test_whoever_is_seen_to_sink_as_it_takes_off_comes_down_slowly(name: str, thrust: float) -> None:
    flight = Flight(name, (0.0,), thrust=thrust, prepare=lambda link: link.poses.append(mirrored(2)))
    flight.pass_to(10.0)
    assert flight.pilot.mode[0] == Mode.FALLEN
    assert flight.record.impact[0] <= SOFTLY
    assert max(flight.cut) < 0.05
    assert flight.record.height[0] < 0.5


def looks(follows: list[int], pushes: np.ndarray) -> set[int]:
    """Return who is found of drones that move as those of the numbers are commanded, by pushes (M, N), m/s."""
    count = pushes.shape[1]
    detector, everybody, nobody = ExchangeDetector(count, PERIOD, PERIOD), np.ones(count, bool), np.zeros(count, bool)
    places, speed, found = np.zeros((count, 3)), np.zeros(count), set[int]()
    for look, push in enumerate(pushes):
        newest = np.full(count, PERIOD * look)
        found.update(detector.look(push, newest, places[:, 2].copy(), np.ones(count), everybody, nobody))
        places[:, 2] += PERIOD * (speed[follows] + push[follows] / 2.0)
        speed = speed + push
    return found


@pytest.mark.parametrize("follows", [[0, 1, 2, 3], [1, 0, 2, 3], [1, 2, 0, 3], [1, 0, 3, 2]])
def test_who_moves_as_another_is_commanded_is_found_and_nobody_else(follows: list[int]) -> None:
    times = PERIOD * np.arange(60)
    pushes = PERIOD * np.stack([np.cos(2.0 * math.pi * (0.5 + 0.2 * n) * times + n) for n in range(4)], axis=1)
    assert looks(follows, pushes) == {index for index in range(4) if follows[index] != index}
