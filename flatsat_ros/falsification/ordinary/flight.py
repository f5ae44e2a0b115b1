"""An ordinary flight: drones are given one thing to do after another, and what is said of them is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.falsification.ordinary.drawn import Drawn, Start
from flatsat_ros.flight.defaults import default_policy, default_tuning
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.preview import needed_margin
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.planning.spline import gentle_spline_through
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import BATTERY_PERIOD
from flatsat_ros.sim.sensor import Sample

_STANDING, _TAKEN = 1.0, 0.3  # s before the first take-off, and before a drone is taken over in the air
_DISARMS = 3.0  # s after a landing, in which the firmware disarms a drone that a person must arm
_PATIENCE, _LANDING = 40.0, 30.0  # s until drones are where they were sent, or stand
_SLICE = 0.2  # s
_HEIGHTS = 0.4, 1.8  # m, of what drones fly at
_NEAR, _FAR = 0.25, 4.0  # m, of goals
_LEG, _LONGER = 1.0, 1.15  # s, between points of a figure at first, and by how much slower it is tried next
_EIGHT = np.linspace(0.0, 2.0 * np.pi, 9)
_REST = 2.0, 4.0  # s at rest between two things
_TABLE_ROOM = 0.2  # m, that drones are above a table which is put below them
_RISEN = 0.1  # m: a drone so high has left the ground
_ROUNDING = 1e-6  # s


class Said(NamedTuple):
    """Something that was said, or is wrong though nobody says so.

    Attributes:
        time: s.
        drone: whom it is about.
        text: what.
        doing: what the drones had been told to do last.
    """

    time: float
    drone: int
    text: str
    doing: str


class Flown(NamedTuple):
    """What came of a flight.

    Attributes:
        seconds: that it lasted.
        worst: largest distance to its reference of a drone that has risen, m; sideways alone of one that lands.
        said: everything.
        wrong: what is no saying: drones that came down, or not where they were sent, refusals.
        done: what the drones did, in order.
    """

    seconds: float
    worst: float
    said: list[Said]
    wrong: list[Said]
    done: list[str]


class OrdinaryFlight:
    """One flight in progress."""

    def __init__(self, drawn: Drawn) -> None:
        """Put the drones where they start.

        Args:
            drawn: what the flight is made of.
        """
        certificate, vehicle, count = drawn.certificate, drawn.vehicle, len(drawn.places)
        self._drawn, self._count, self._random = drawn, count, np.random.default_rng([drawn.seed, 1])
        policy = default_policy(vehicle.dynamics.drag_z)
        self._pilot = Pilot(certificate, default_tuning(certificate), policy, count)
        self._fleet = SimulatedFleet(
            vehicle, count, start=drawn.places, yaw=drawn.yaw, flying=drawn.start is Start.AIR, seed=drawn.seed,
            floor=drawn.floor, wind=drawn.wind, capture=drawn.capture, battery=drawn.battery,
            thrust_scale=drawn.thrust_scale, command_delay=drawn.delay,
        )  # fmt: skip
        self._goals = drawn.places.copy()  # where each was sent last, m
        self._home = drawn.places.copy()  # places of each among the others when they are as far apart as at first, m
        self._now = self._battery_due = self._worst = 0.0
        self._doing, self._done = "nothing", list[str]()
        self._said, self._wrong = list[Said](), list[Said]()
        self._landing = np.zeros(count, dtype=bool)
        self._lifted = np.full(count, drawn.start is Start.AIR)

    def fly(self) -> Flown:
        """Fly it to its end."""
        if self._drawn.start is Start.AIR:
            self._pass(_TAKEN)
            self._take_over()
        else:
            self._pass(_STANDING)
            self._take_off()
        acts: tuple[Callable[[], None], ...] = (
            self._near, self._far, self._eight, self._swap, self._hold, self._turn, self._again, self._in_a_climb,
            self._hand_over,
        )  # fmt: skip
        while self._now < self._drawn.seconds:
            acts[int(self._random.integers(len(acts)))]()
            self._pass(float(self._random.uniform(*_REST)))
            self._require(Mode.FLY)
        self._land("land")
        return Flown(self._now, self._worst, self._said, self._wrong, self._done)

    def _begin(self, doing: str) -> None:
        self._doing = doing
        self._done.append(doing)

    def _each(self, ask: Callable[[int], object]) -> None:
        """Ask something for every drone; a refusal is kept, if it stays one when all have been asked."""
        if refused := self._refused(ask, range(self._count)):
            for index, error in self._refused(ask, refused).items():
                self._wrong.append(Said(self._now, index, f"refused: {error}", self._doing))

    @staticmethod
    def _refused(ask: Callable[[int], object], drones: Iterable[int]) -> dict[int, FlatsatError]:
        refused = {}
        for index in drones:
            try:
                ask(index)
            except FlatsatError as error:
                refused[index] = error
        return refused

    def _go(self, goals: FloatArray, yaw: FloatArray | None = None) -> None:
        """Send the drones to goals (N, 3), m."""
        self._goals = goals
        turned = np.zeros(self._count) if yaw is None else yaw
        self._each(lambda index: self._pilot.set_goal(index, goals[index], float(turned[index])))

    def _arrive(self) -> None:
        """Let the drones reach what they follow."""
        latest = self._now + _PATIENCE
        while self._now < latest and not all(self._pilot.is_at_rest(index) for index in range(self._count)):
            self._pass(_SLICE)
        if self._now >= latest:
            self._require_each("does not get to where it was sent", self._pilot.is_at_rest)

    def _take_off(self) -> None:
        self._begin("take off")
        if self._drawn.vehicle.motors.arming_required:
            self._pass(_DISARMS)
        for index in range(self._count):
            self._fleet.firmware.request_arming(index, True)
        height = float(self._random.uniform(*_HEIGHTS))
        self._goals = self._fleet.bodies.position + (0.0, 0.0, height)
        self._each(lambda index: self._pilot.take_off(index, height))
        self._pass(2.0)
        self._arrive()
        self._find_goals()
        self._pass(float(self._random.uniform(*_REST)))
        self._require(Mode.FLY)

    def _find_goals(self) -> None:
        """Take note of where the drones are led."""
        found = [self._pilot.destination(index) for index in range(self._count)]
        self._goals = np.array([goal if end is None else end for end, goal in zip(found, self._goals, strict=True)])

    def _take_over(self) -> None:
        self._begin("take over")
        self._go(self._fleet.bodies.position + self._random.uniform(0.0, _NEAR, (self._count, 3)))
        self._arrive()

    def _near(self) -> None:
        self._begin("near goals")
        self._go(self._at_heights(self._goals + self._random.uniform(-_NEAR, _NEAR, (self._count, 3))))
        if self._random.random() < 0.3:  # new ones on the way
            self._pass(float(self._random.uniform(0.2, 1.5)))
            self._go(self._at_heights(self._goals + self._random.uniform(-_NEAR, _NEAR, (self._count, 3))))
        self._arrive()
        self._regroup()

    def _at_heights(self, goals: FloatArray) -> FloatArray:
        low = float(self._fleet.bodies.floor) + _HEIGHTS[0]
        return np.column_stack([goals[:, :2], np.clip(goals[:, 2], low, low + _HEIGHTS[1])])

    def _regroup(self) -> None:
        """Send the drones back to as far apart as they started."""
        self._go(self._at_heights(self._home + self._goals.mean(axis=0) - self._home.mean(axis=0)))
        self._arrive()

    def _far(self) -> None:
        self._begin("far goals")
        angle, way = self._random.uniform(-np.pi, np.pi), self._random.uniform(1.0, _FAR)
        heading = way * np.array([np.cos(angle), np.sin(angle), 0.0])
        if np.abs(self._goals.mean(axis=0) + heading)[:2].max() > 2.0 * _FAR:
            heading = -heading
        height = (0.0, 0.0, self._random.uniform(-1.0, 1.0))
        self._go(self._at_heights(self._goals + heading + height))
        self._arrive()

    def _eight(self) -> None:
        self._begin("figure eight")
        size = self._random.uniform(0.2, 0.8, 2)
        eight = np.column_stack([size[0] * np.sin(_EIGHT), size[1] / 2.0 * np.sin(2.0 * _EIGHT), 0.0 * _EIGHT])
        self._follow([eight + goal for goal in self._goals])

    def _swap(self) -> None:
        self._begin("swap")
        alone = self._count == 1
        middle = self._goals.mean(axis=0) + ((0.6, 0.0, 0.0) if alone else 0.0)
        turn = 2.0 * np.pi / (1 if alone else self._count)
        arms, steps = self._goals - middle, np.linspace(0.0, turn, max(3, round(4.0 * turn)))
        self._follow([_turned(arm, steps) + middle for arm in arms])
        self._home = np.roll(self._home, -1, axis=0)

    def _follow(self, points: list[FloatArray]) -> None:
        """Let each drone fly through points (M, 3), m, all in the same time, as slowly as the certificate wants."""
        certificate, flight = self._drawn.certificate, self._drawn.certificate.flight
        assert flight is not None
        leg = _LEG
        while True:
            paths = [gentle_spline_through(each, leg) for each in points]
            asked = [flight.demanded(p.demand(), needed_margin(p, certificate.limits, flight)) for p in paths]
            if max(asked) <= 1.0:
                break
            leg *= _LONGER
        begin = self._now + 0.1
        self._each(lambda index: self._set(index, paths[index].shifted(begin)))
        self._pass(float(paths[0].times[-1]) + 0.2)
        self._arrive()

    def _set(self, index: int, path: Trajectory) -> None:
        self._pilot.set_reference(index, path)
        self._goals[index] = path.end

    def _hold(self) -> None:
        self._begin("hold on the way")
        angle = self._random.uniform(-np.pi, np.pi)
        self._go(self._goals + 2.0 * np.array([np.cos(angle), np.sin(angle), 0.0]))
        self._pass(float(self._random.uniform(0.5, 2.5)))
        self._each(self._pilot.hold)
        self._arrive()
        self._find_goals()
        self._regroup()

    def _turn(self) -> None:
        self._begin("turn")
        self._go(self._goals.copy(), self._random.uniform(-np.pi, np.pi, self._count))
        self._arrive()
        self._pass(2.0)

    def _again(self) -> None:
        self._land("land", on_table=self._random.random() < 0.4)
        self._pass(float(self._random.uniform(*_REST)))
        self._take_off()

    def _in_a_climb(self) -> None:
        self._begin("climb")
        self._go(self._goals + (0.0, 0.0, 1.0))
        self._pass(float(self._random.uniform(0.3, 1.5)))
        self._land("land in a climb")
        self._pass(float(self._random.uniform(*_REST)))
        self._take_off()

    def _hand_over(self) -> None:
        self._begin("hand over")
        bodies = self._fleet.bodies

        def leave(index: int) -> None:
            self._pilot.hand_over(index)
            self._fleet.notify_setpoints_stop(index)
            self._fleet.go_to(index, (0.0, 0.0, 0.0), 0.0, 1.0, relative=True)

        self._each(leave)
        self._pass(float(self._random.uniform(1.0, 3.0)))
        self._begin("take over")
        self._go(self._at_heights(bodies.position + (0.1, 0.1, 0.0)))
        self._arrive()
        self._regroup()

    def _land(self, doing: str, *, on_table: bool = False) -> None:
        bodies = self._fleet.bodies
        self._begin(doing if not (on_table or bodies.floor > 0.0) else f"{doing} on a table")
        if on_table:
            lowest = float(bodies.position[:, 2].min())
            bodies.floor = max(bodies.floor, float(self._random.uniform(0.0, 1.0)) * (lowest - _TABLE_ROOM))
        self._landing[:] = True
        self._each(self._pilot.land)
        latest = self._now + _LANDING
        while self._now < latest and not (self._pilot.mode == Mode.IDLE).all():
            self._pass(_SLICE)
        self._require(Mode.IDLE)
        self._require_each("is not on the ground", lambda index: bool(bodies.grounded[index]))
        self._landing[:] = self._lifted[:] = False

    def _require(self, mode: Mode) -> None:
        self._require_each(f"is not in {mode.name}", lambda index: bool(self._pilot.mode[index] == mode))

    def _require_each(self, text: str, holds: Callable[[int], bool]) -> None:
        self._wrong += [Said(self._now, i, text, self._doing) for i in range(self._count) if not holds(i)]

    def _pass(self, seconds: float) -> None:
        self._now = fly(
            self._pilot, self._fleet, self._drawn.vehicle, self._now + seconds, self._observe, start=self._now
        )

    def _observe(self, now: float, _samples: list[Sample], tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        bodies = self._fleet.bodies
        if now >= self._battery_due - _ROUNDING:
            self._battery_due = now + BATTERY_PERIOD
            for index, voltage in enumerate(self._fleet.power.voltage.tolist()):
                self._pilot.note_battery(index, voltage, self._drawn.vehicle.battery, now)
        for index, before, after, reason in tick.transitions:
            self._said.append(Said(now, index, f"{before.name} to {after.name}: {reason}", self._doing))
            if after is Mode.REST and not bodies.grounded[index]:
                self._wrong.append(Said(now, index, "takes the air for the ground", self._doing))
        self._said += [Said(now, index, text, self._doing) for index, text in tick.reports]
        down = bodies.grounded & self._lifted & ~self._landing
        for index in map(int, np.flatnonzero(down)):
            self._wrong.append(Said(now, index, "comes down unasked", self._doing))
        self._lifted = (self._lifted | (bodies.position[:, 2] > bodies.floor + _RISEN)) & ~down
        away = bodies.position - tick.reference[:, :3]
        away[self._landing, 2] = 0.0
        size = np.linalg.norm(away, axis=1)[(tick.mode == Mode.FLY) & self._lifted]
        self._worst = max(self._worst, float(size.max(initial=0.0)))


def _turned(arm: FloatArray, angles: FloatArray) -> FloatArray:
    """Return an arm (3,), m, turned about the vertical by angles (M,), rad: (M, 3)."""
    (x, y, z), cos, sin = arm, np.cos(angles), np.sin(angles)
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, np.full_like(angles, z)])
