"""Flights of many exact drones against the flight section of a certificate, with the controller's own pilot.

A batch is one pilot and `DRONES` drones, each a linear plant inside the certificate's intervals, and `WINDOWS` runs of
`PERIODS` each. All that the certificate leaves open is used against it: noise, disturbance, what a reference may ask
for, ages of poses and gains, with the signs of the loop's own impulse response, so that at the end of a run a signal is
as large as it can become; and starts beside the reference. A run begins with what the one before has left behind.
Tubes are claimed for all applied gains of the interval: half of the batches have limits so wide that none is less than
what the adversary wants. In half of the batches references rest, and what they could ask for at most is pushed in at
the drone's input; in the others they swing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.falsification.exact_drones import ExactDrones, draw_plants
from flatsat_ros.falsification.flight_claims import Breach, Found, Judge
from flatsat_ros.falsification.swinging import swinging
from flatsat_ros.falsification.worst_inputs import SIGNALS, Schedule, WorstInputs
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet

DRONES, WINDOWS, PERIODS = 250, 8, 125

_PLANTS = 12  # number of different plants in a batch, for x and y and for z
_APART, _HEIGHT, _FAR = 30.0, 10.0, 1e5  # m
_SETTLED = 500  # ticks after which the tubes of all drones must be claimed
_OLDEST = 0.99  # age of the oldest pose, in periods: an older one is that of the tick before, which the pilot has seen
_NEAR_ALL = 0.92  # share of the assumed disturbance for the axes that are attacked; the others get the rest
_EDGE = 1.0 - 1e-9
_WIDE = 100.0, math.radians(85.0)  # m/s^2, rad: limits that shorten no command
_QUATERNION = (0.0, 0.0, 0.0, 1.0)

# how the gain of a drone is chosen in a batch, and the share of drones for each way; the first _RESTING gains rest
_COURSES = ("least", "any", "most", "alternating", "random", "greedy")
_RESTING, _OFTEN = 3, (0.25, 0.1, 0.15, 0.15, 0.05, 0.3)
_ATTACKED = (0.65, 0.1, 0.15, 0.1)  # share of the runs in which each of `SIGNALS` is attacked
_STARTS = 0.2  # share of the drones that begin every run beside the reference


@dataclass(frozen=True)
class AttackOutcome:
    """What a batch came to.

    Attributes:
        runs: how many.
        found: the largest of each signal.
        breaches: the first of each drone.
        told: share of the ticks at which the pilot said that its tube is claimed.
    """

    runs: int
    found: tuple[Found, ...]
    breaches: tuple[Breach, ...]
    told: float


def attack(seed: int, certificate: Certificate) -> AttackOutcome:
    """Fly one batch, of which everything follows from the arguments.

    Args:
        seed: even ones attack what is claimed of x and y, odd ones of z; two with the limits of the certificate, then
            two with wide ones; four with references that rest, then four with references that swing.
        certificate: with a flight section, proved or not.

    Raises:
        FlatsatError: there is no flight section, or the drones do not come to rest in their tubes.
    """
    return _Batch(certificate, section_of(certificate), seed).fly()


def section_of(certificate: Certificate) -> FlightSection:
    """Return the flight section of a certificate, refusing one without.

    Raises:
        FlatsatError: there is none.
    """
    if certificate.flight is None:
        raise FlatsatError(f"certificate {certificate.name!r} has no flight section: it claims no tubes to attack")
    return certificate.flight


class _Batch:
    """A pilot, its drones and their adversary."""

    def __init__(self, certificate: Certificate, flight: FlightSection, seed: int) -> None:
        self._flight, self._period, self._focus = flight, certificate.period, seed % 2
        random = self._random = np.random.default_rng(seed)
        self._swinging = bool(seed // 4 % 2) and flight.assumptions.jerk > 0.0 and flight.assumptions.snap > 0.0
        if seed // 2 % 2:
            certificate = replace(certificate, limits=InputSet(*_WIDE, certificate.limits.gravity))
        top = self._top = min(flight.gain_max, certificate.gain_max)
        self._age = min(flight.pose_age, _OLDEST * self._period)
        kinds = [draw_plants(random, axis.box, _PLANTS, lag_varies=axis.lag_varies) for axis in flight.axes]
        self._adversaries = [
            WorstInputs(axis, plants, flight.assumptions, (flight.gain_min, top), self._age)
            for axis, plants in zip(flight.axes, kinds, strict=True)
        ]
        self._gain_of = [np.array([plant.gain for plant in plants]) for plants in kinds]
        row = math.ceil(math.sqrt(DRONES))
        grid = np.array([divmod(number, row) for number in range(DRONES)])
        places = np.column_stack([_APART * grid, np.full(DRONES, _HEIGHT)])
        self._drones = ExactDrones(kinds, self._period, self._age, places)
        self._own = random.integers(_PLANTS, size=(2, DRONES))
        policy = Policy(
            disturbance_max=flight.disturbance, goal_mode=GoalMode.STEP, separation=1e-3, ceiling=_FAR, floor=-_FAR,
            walls=(-_FAR, -_FAR, _FAR, _FAR),
        )  # fmt: skip
        self._limits = certificate.limits
        self._pilot = Pilot(certificate, Tuning(0.0, 1.0, 1.0, top, restart=False), policy, DRONES)
        self._judge = Judge(certificate, flight, seed, kinds, DRONES)
        azimuth = random.uniform(0.0, 2.0 * math.pi, DRONES)
        self._sides = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        self._course = random.choice(len(_COURSES), DRONES, p=_OFTEN)
        self._held = random.uniform(1.0, top, DRONES)
        self._starting = (random.random(DRONES) < _STARTS) & (not self._swinging)
        self._push, self._ticks = np.zeros((DRONES, 3)), 0
        self._gain = np.ones(DRONES)

    def fly(self) -> AttackOutcome:
        """Fly all runs."""
        tick = self._settle()
        if self._swinging:
            self._swing()
        for _ in range(WINDOWS):
            tick = self._run(tick)
        judge = self._judge
        return AttackOutcome(WINDOWS * DRONES, judge.found, judge.breaches, judge.told / (WINDOWS * PERIODS))

    def _tick(self, seen: FloatArray, ages: FloatArray, gains: FloatArray) -> Tick:
        """Let the pilot tick with poses (N, 3), m, of some ages (N,), s, and gains (N,)."""
        now, pilot = self._ticks * self._period, self._pilot
        for index, (age, place) in enumerate(zip(ages.tolist(), seen.tolist(), strict=True)):
            pilot.measure(index, now - age, place, _QUATERNION, now)
        pilot.memory.gain[:] = gains
        self._ticks += 1
        return pilot.tick(now)

    def _settle(self) -> Tick:
        """Take off: until the tubes are claimed the drones are held where they are."""
        still, ones, places = np.zeros(DRONES), np.ones(DRONES), self._drones.position
        for number in range(_SETTLED):
            tick = self._tick(places, still, ones)
            if tick.assessment.guaranteed.all():
                return tick
            if number == 1:
                for index, place in enumerate(places):
                    self._pilot.set_reference(index, Trajectory.hold(place))
        raise FlatsatError("the drones do not come to rest where their tubes are claimed: does the observer settle?")

    def _swing(self) -> None:
        """Give all drones references that swing where they are attacked, each from another time on."""
        lines = self._lines()
        now, duration = self._ticks * self._period, (WINDOWS * PERIODS + 1) * self._period
        for index, (place, wait) in enumerate(zip(self._drones.position, self._random.random(DRONES), strict=True)):
            path = swinging(self._flight, place, lines[index], now + 4.0 * wait, now + duration)
            self._pilot.set_reference(index, path)

    def _lines(self) -> FloatArray:
        """Return along which lines the drones are attacked, (N, 3)."""
        if self._focus == 1:
            return np.tile([0.0, 0.0, 1.0], (DRONES, 1))
        return np.column_stack([self._sides, np.zeros(DRONES)])

    def _run(self, tick: Tick) -> Tick:
        """Fly one run of all drones, from a tick to another."""
        for number, axis in enumerate(self._flight.axes):
            if axis.lag_varies:
                self._own[number] = self._random.integers(_PLANTS, size=DRONES)
        self._drones.choose(self._own)
        schedules = self._plan()
        (noise, rate, drive), (gains, ages, _) = self._inputs(schedules), schedules[0]
        every, judge, h = np.arange(DRONES), self._judge, self._period
        judge.begin(self._course < _RESTING, self._own, self._start(tick.reference))
        for period in range(PERIODS):
            before, push = tick.reference, self._limited(self._push + h * rate[period])
            self._drones.advance(tick.output.acceleration, self._push, (push - self._push) / h, drive[period])
            self._push, age = push, ages[period]
            seen = self._drones.seen[age, every] + noise[period]
            tick = self._tick(seen, self._age * age, gains[min(period + 1, PERIODS - 1)])
            judge.look(tick, before, self._drones, self._push, period)
        judge.end()
        return tick

    def _plan(self) -> tuple[Schedule, Schedule]:
        """Return what is done to x and y, and to z; gains and ages are those for the axes that are attacked."""
        random, course, low, top = self._random, self._course, self._flight.gain_min, self._top
        lengths = random.integers(1, 21, size=(2, DRONES))
        phase = np.arange(PERIODS)[:, np.newaxis] + random.integers(40, size=DRONES)
        first = phase % lengths.sum(axis=0) < lengths[0]
        coin = random.random((PERIODS, DRONES)) < 0.5
        gains = np.select(
            [course == 0, course == 1, course == 2, course == 3],
            [np.full_like(coin, low, float), self._held, top, np.where(first, low, top)],
            np.where(coin, low, top),
        )
        gains[0] = np.where(course < _RESTING, gains[0], self._gain)
        # poses of one age all the time, or of one and the other for some periods each
        aging = random.integers(3, size=DRONES)
        ages = np.where(aging < 2, aging, first.astype(int))
        signals = random.choice(len(SIGNALS), (2, DRONES), p=_ATTACKED)
        schedules = {}
        for axis in (self._focus, 1 - self._focus):
            greedy = (course == len(_COURSES) - 1) & (axis == self._focus)
            plan = self._adversaries[axis].plan(self._own[axis], signals[axis], gains, ages, greedy)
            schedules[axis], gains, ages = plan, plan.gains, plan.ages
        self._gain = gains[-1]
        return schedules[0], schedules[1]

    def _inputs(self, schedules: tuple[Schedule, Schedule]) -> FloatArray:
        """Return noise, m, rate, m/s^3, and drive, m/s^2, (3, T, N, 3).

        Along x and y all act along one line, toward the end of it at which the disturbance has room to grow.
        """
        inputs = np.zeros((3, PERIODS, DRONES, 3))
        for axis, (plan, adversary) in enumerate(zip(schedules, self._adversaries, strict=True)):
            bounds = adversary.bounds[self._own[axis]]
            if self._swinging:  # references act themselves
                bounds = bounds * (1.0, 0.0, 0.0) + (0.0, self._flight.assumptions.disturbance_rate, 0.0)
            sizes = plan.signs * bounds
            moved = sizes[..., 1].sum(axis=0)
            now = (self._push[:, :2] * self._sides).sum(axis=1) if axis == 0 else self._push[:, 2]
            sizes *= np.where(moved * now > 0.0, -1.0, 1.0)[:, np.newaxis]
            parts = sizes.transpose(2, 0, 1)[..., np.newaxis]
            if axis == 0:
                inputs[..., :2] = parts * self._sides
            else:
                inputs[..., 2:] = parts
        return inputs

    def _limited(self, push: FloatArray) -> FloatArray:
        """Return disturbances (N, 3), m/s^2, shortened to what is assumed: no further from those within it."""
        shares = (_NEAR_ALL, math.sqrt(1.0 - _NEAR_ALL**2))
        gains = [gain[own] for gain, own in zip(self._gain_of, self._own, strict=True)]
        most = [shares[axis != self._focus] * self._flight.disturbance * gains[axis] for axis in range(2)]
        if self._swinging:
            most[self._focus] = most[self._focus] - self._judge.asked_at_most(self._own)[self._focus]
        sides = np.hypot(push[:, 0], push[:, 1])
        shorter = np.minimum(1.0, most[0] / np.maximum(sides, 1e-12))
        upright = np.clip(push[:, 2], -most[1], most[1])
        return np.column_stack([push[:, :2] * shorter[:, np.newaxis], upright])

    def _start(self, reference: FloatArray) -> FloatArray:
        """Move references (N, 9) to another place; return how far, (2, N) m, from which drones return."""
        random, focus, away = self._random, self._focus, np.zeros((2, DRONES))
        certified = self._flight.certified_start(self._limits)[focus] - self._judge.started[focus]
        large = self._flight.axes[focus].tube.position * random.random(DRONES)
        small = random.random(DRONES) < 0.5
        away[focus] = np.where(self._starting, np.where(small, np.maximum(_EDGE * certified, 0.0), large), 0.0)
        lines = self._lines() * random.choice([-1.0, 1.0], DRONES)[:, np.newaxis]
        for index in map(int, np.flatnonzero(away[focus])):
            place = reference[index, :3] + away[focus, index] * lines[index]
            self._pilot.set_reference(index, Trajectory.hold(place))
        return away
