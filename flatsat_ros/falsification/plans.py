"""Plans flown by simulated drones in wind, by the hundred: is a drone ever outside its tube, or a pair too near?

Several copies of a plan are flown side by side. Each drone has a thrust of its own, the wind turns as fast as the
certificate's assumptions allow, and there is one pose for each tick, new or as late as they allow. Drones begin in the
air at their first points and have 1.5 s to settle. The true places are compared, at every tick.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.crazyflie.fit import LINK_DELAY, require_fit
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.defaults import default_tuning
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.plans.plan import Plan
from flatsat_ros.plans.tubes import require_tubes
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture

_VEHICLE = "cf21"  # as in the demo
_DRONES = 720  # about the number of drones flown at once: each costs less among many
_BESIDE = 30.0  # m, between copies of a plan
_GIVEN, _SETTLED = 0.5, 1.5  # s, when the references are given, and begin: drones are in their tubes, not yet at rest
_FAR = 1e5  # m, walls and ceiling
_OF_NOISE = 1.0 / 4.0  # standard deviation over the bound that the certificate assumes
# shares of the assumed disturbance and of its rate that the wind makes; the rest is for the drones' own motion in it
_OF_DISTURBANCE, _OF_RATE = 0.4, 0.4


@dataclass(frozen=True)
class Attack:
    """What flights of one plan came to.

    Attributes:
        flights: of single drones.
        outside: the largest distance of a drone from its reference, over its tube.
        nearest: m, the least of what pairs are apart, less bodies and clearance; None for one drone.
        breaches: flights in which a drone was outside its tube, or nearer to another than the bodies and the clearance.
    """

    flights: int
    outside: float
    nearest: float | None
    breaches: int


def attack(plan: Plan, certificate: Certificate, seed: int) -> Attack:
    """Fly copies of a plan once; everything follows from the arguments.

    Args:
        plan: whose tubes the certificate proves.
        certificate: with a flight section.
        seed: of wind, noise and thrust.

    Raises:
        FlatsatError: the plan is not for the certificate, or that has no flight section.
    """
    flight = certificate.flight
    if flight is None:
        raise FlatsatError(f"certificate {certificate.name!r} has no flight section: it claims no tubes to attack")
    require_tubes(plan, certificate)
    vehicle = load_vehicle(_VEHICLE)
    require_fit(certificate, vehicle, LINK_DELAY, "the simulated drones")
    random = np.random.default_rng(seed)
    copies = max(1, _DRONES // len(plan.drones))
    own = [plan.trajectory(drone.name) for drone in plan.drones]
    paths = [_moved(path, place) for place in _places(copies) for path in own]
    gains = flight.vertical.box.low.gain, flight.vertical.box.high.gain
    fleet = SimulatedFleet(
        vehicle,
        len(paths),
        start=[path.sample(0.0)[:3] for path in paths],
        flying=True,
        seed=seed,
        capture=_capture(random, flight.assumptions, certificate.period),
        thrust_scale=random.uniform(*gains, len(paths)),
        command_delay=LINK_DELAY,
        floor=-_FAR,  # the origin of a plan need not be on the floor, and drones begin in the air
    )
    # copies are far apart, and the drones of one are kept apart by the plan, not by the rules of separation
    policy = Policy(
        disturbance_max=flight.disturbance, drag=vehicle.dynamics.drag_z, separation=1e-3, ceiling=_FAR, floor=-_FAR,
        walls=(-_FAR, -_FAR, _FAR, _FAR),
    )  # fmt: skip
    pilot = Pilot(certificate, default_tuning(certificate), policy, len(paths))
    watch = _Watch(plan, copies)
    blow = _wind(random, flight.disturbance, flight.assumptions.disturbance_rate, vehicle.dynamics.drag_xy)

    def observe(now: float, _: object, tick: Tick, __: object) -> None:
        fleet.wind = Wind(mean=blow(now))
        if now >= _SETTLED:
            watch.look(fleet.bodies.position, tick.reference[:, :3])

    now = fly(pilot, fleet, vehicle, _GIVEN, observe)
    for index, path in enumerate(paths):
        pilot.set_reference(index, path.shifted(_SETTLED))
    fly(pilot, fleet, vehicle, _SETTLED + plan.duration, observe, now)
    return watch.result()


class Task(NamedTuple):
    """One attack to be made: the plan's number, and the seed."""

    plan: int
    seed: int


def made(task: Task, plans: Sequence[Plan], certificate: Certificate) -> Attack:
    """Make one attack, in whatever process."""
    return attack(plans[task.plan], certificate, task.seed)


def tasks(plans: int, seed: int) -> Iterator[Task]:
    """Yield attacks on each plan in turn, for ever."""
    for turn in itertools.count(seed):
        yield from (Task(number, turn) for number in range(plans))


class _Watch:
    """Compares true places with what is claimed."""

    def __init__(self, plan: Plan, copies: int) -> None:
        count = len(plan.drones)
        self._shape = copies, count
        self._stretch = np.array([1.0, 1.0, plan.downwash])
        self._tubes = np.array([drone.tube.radius for drone in plan.drones])
        bodies = np.array([drone.body for drone in plan.drones])
        self._touching = bodies + bodies[:, np.newaxis] + plan.clearance
        np.fill_diagonal(self._touching, -math.inf)
        self._outside = np.zeros(self._shape)
        self._room = np.full(self._shape, math.inf)

    def look(self, places: FloatArray, references: FloatArray) -> None:
        """Look at places (copies x drones, 3) and references, m."""
        shape = (*self._shape, 3)
        there, planned = (values.reshape(shape) / self._stretch for values in (places, references))
        self._outside = np.maximum(self._outside, np.linalg.norm(there - planned, axis=2) / self._tubes)
        apart = np.linalg.norm(there[:, :, np.newaxis] - there[:, np.newaxis], axis=3)
        self._room = np.minimum(self._room, (apart - self._touching).min(axis=2))

    def result(self) -> Attack:
        """Return what was seen."""
        nearest = float(self._room.min())
        breaches = int(np.count_nonzero((self._outside > 1.0) | (self._room < 0.0)))
        flights = self._outside.size
        return Attack(flights, float(self._outside.max()), nearest if math.isfinite(nearest) else None, breaches)


def _places(copies: int) -> list[tuple[float, float]]:
    """Return the offsets of the copies from the plan along x and y, m: rows that form a square or nearly so."""
    side = math.ceil(math.sqrt(copies))
    return [(_BESIDE * (number % side), _BESIDE * (number // side)) for number in range(copies)]


def _moved(path: Trajectory, aside: tuple[float, float]) -> Trajectory:
    """Return a path moved along x and y, m."""
    coefficients = path.coefficients.copy()
    coefficients[:, 0, :2] += aside
    return Trajectory(path.times, coefficients, path.yaw)


def _capture(random: np.random.Generator, assumed: Assumptions, period: float) -> MotionCapture:
    """Return a motion capture with one new pose for each tick, of that moment or as old as the assumptions allow."""
    late = float(random.choice([0.0, assumed.pose_age]))
    return MotionCapture(rate=1.0 / period, noise=_OF_NOISE * assumed.noise, latency=late)


def _wind(
    random: np.random.Generator, disturbance: float, rate: float, drag: float
) -> Callable[[float], tuple[float, float, float]]:
    """Return a wind of constant speed that turns: its velocity, m/s, at a time, s."""
    speed = _OF_DISTURBANCE * disturbance / drag
    turn = float(random.choice([-1.0, 1.0]) * random.uniform(0.2, 1.0)) * _OF_RATE * rate / (speed * drag)
    begin = float(random.uniform(-math.pi, math.pi))

    def velocity(now: float) -> tuple[float, float, float]:
        angle = begin + turn * now
        return speed * math.cos(angle), speed * math.sin(angle), 0.0

    return velocity


def report(attacks: Sequence[tuple[str, Attack]], seconds: float) -> str:
    """Return what attacks on plans, by the names of their files, came to."""
    flights, breaches = (sum(getattr(one, name) for _, one in attacks) for name in ("flights", "breaches"))
    lines = [f"{flights} flights of {len({name for name, _ in attacks})} plans in {seconds:.0f} s: {breaches} breaches"]
    for name in dict.fromkeys(name for name, _ in attacks):
        own = [one for other, one in attacks if other == name]
        rooms = [one.nearest for one in own if one.nearest is not None]
        beside = f", bodies at least {min(rooms):.3f} m apart" if rooms else ""
        flown, most = sum(one.flights for one in own), max(one.outside for one in own)
        lines.append(f"  {name}: {flown} flights, at most {most:.3f} of the tube{beside}")
    return "\n".join(lines)
