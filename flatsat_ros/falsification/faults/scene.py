"""One flight of the matrix: fleet, faults and pilot on simulated time, and a record of all that the bounds speak of."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, one_line
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint, setpoint_from_command
from flatsat_ros.falsification.faults.criteria import Outcome, Remark
from flatsat_ros.falsification.faults.record import Record
from flatsat_ros.flight.pilot import Pilot, Tick
from flatsat_ros.flight.supervisor import Mode, Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.faults import FaultyLink
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

CERTIFICATE = "cf21_50hz"
VEHICLE = "cf21"
NOISE = 5e-4  # m, standard deviation of the motion capture
# the tuning and the policy that the controller has by default
_TUNING = (2.0, 0.05, 1.0)
_DISTURBANCE_MAX = 0.8  # m/s^2
_ROUNDING = 1e-6  # s
TEXT = 160  # letters of a remark
_LOOK_EVERY = 10  # steps of integration between two looks at distances


class Moment(NamedTuple):
    """The state of all drones at one tick, for a replay.

    Attributes:
        time: s since the beginning of the flight.
        mode: (N,) values of Mode.
        position: (N, 3) m, true.
        velocity: (N, 3) m/s, true.
        command: of each drone, as sent; None for one that was sent nothing.
    """

    time: float
    mode: np.ndarray
    position: FloatArray
    velocity: FloatArray
    command: list[WireSetpoint | None]


def told(tick: Tick) -> Iterator[tuple[int, str]]:
    """Yield what a tick tells, as pairs of drone and text."""
    for index, before, after, reason in tick.transitions:
        yield index, f"{before.name} to {after.name}: {reason}"


class Scene:
    """A flight in progress.

    Attributes:
        fleet: the drones.
        link: the fleet behind its faults.
        pilot: flies; None when its process has ended.
        record: what happened.
        remarks: what was told.
        moments: the ticks so far, if they are kept.
        failure: what the pilot raised that is no refusal: then its process ended; empty if it did not.
        seed: of everything random.
        now: s, the pilot's clock at the next tick.
    """

    def __init__(
        self,
        starts: FloatArray,
        seed: int,
        *,
        floor: float = 0.0,
        stopped: Sequence[int] = (),
        keep: bool = False,
        **fleet: Any,
    ) -> None:
        """Put drones on the floor at (N, 2), m, and start the pilot.

        Args:
            starts: x and y.
            seed: of everything random.
            floor: its height, m.
            stopped: drones with an emergency stop.
            keep: keep the moments.
            fleet: further arguments of the SimulatedFleet.
        """
        self.certificate, self.vehicle = load_certificate(CERTIFICATE), load_vehicle(VEHICLE)
        places = np.column_stack([starts, np.full(len(starts), floor)])
        self.fleet = SimulatedFleet(
            self.vehicle,
            len(starts),
            **{"start": places, "seed": seed, "floor": floor, "capture": MotionCapture(noise=NOISE), **fleet},
        )
        for drone in stopped:
            self.fleet.firmware.request_emergency(drone)
        self.record = Record(self.fleet.bodies.position, floor)
        self.link = FaultyLink(self.fleet, self._look)
        self._looks = 0
        self._sent: dict[int, WireSetpoint] = {}  # at the last tick
        self.pilot: Pilot | None = self.new_pilot()
        self.remarks: list[Remark] = []
        self.moments: list[Moment] | None = [] if keep else None
        self.failure = ""
        self.seed = seed
        self.now = 0.0
        self._agenda: list[tuple[float, int, Callable[[Scene], None]]] = []

    def new_pilot(self) -> Pilot:
        """Return a pilot as the controller starts it."""
        tuning = Tuning(*_TUNING, self.certificate.gain_max)
        return Pilot(self.certificate, tuning, Policy(disturbance_max=_DISTURBANCE_MAX), self.fleet.count)

    @property
    def time(self) -> float:
        """Time since the beginning of the flight, s."""
        return self.now + self.link.behind

    @property
    def place(self) -> FloatArray:
        """(N, 3) true positions, m."""
        return self.fleet.bodies.position

    def plan(self, time: float, action: Callable[[Scene], None]) -> None:
        """Do something at a time, s since the beginning of the flight."""
        heapq.heappush(self._agenda, (time, len(self._agenda), action))

    def let_pass(self, seconds: float) -> None:
        """Fly on for a while, and do what is planned meanwhile."""
        end = self.time + seconds
        while self._agenda and self._agenda[0][0] < end - _ROUNDING:
            time, _, action = heapq.heappop(self._agenda)
            self._fly_until(time)
            action(self)
        self._fly_until(end)

    def _fly_until(self, end: float) -> None:
        """Fly to the first tick at or after a time, s since the beginning of the flight."""
        if self.pilot is not None:
            until = end - self.link.behind
            try:
                self.now = fly(self.pilot, self.link, self.vehicle, until, self._observe, start=self.now)
            except Exception as error:  # what escapes the pilot ends the controller: a finding, not an error of ours
                self._fail(error)
        if self.pilot is None:
            self.pass_by(end - self.time)

    def _fail(self, error: Exception) -> None:
        self.failure = one_line(f"{type(error).__name__}: {error}", TEXT)
        self.pilot = None

    def pass_by(self, seconds: float) -> None:
        """Let time pass without any tick: the controller is stopped, or is no more."""
        self.now += max(seconds, 0.0)
        self.link.advance_to(self.now)

    def tell(self, drone: int, text: str) -> None:
        """Note a remark."""
        self.remarks.append(Remark(self.time, drone, one_line(text, TEXT)))

    def ask(self, drone: int, request: Callable[[Pilot], object]) -> bool:
        """Ask something of the pilot for a drone, and return whether it was granted; a refusal is noted."""
        if self.pilot is None:
            return False
        try:
            request(self.pilot)
        except FlatsatError as error:
            self.tell(drone, f"refused: {error}")
            return False
        except Exception as error:  # see _fly_until
            self._fail(error)
            return False
        return True

    def take_off(self, drone: int, height: float) -> None:
        """Ask for a take-off by a height, m."""
        self.ask(drone, lambda pilot: pilot.take_off(drone, height))

    def go_to(self, drone: int, goal: FloatArray) -> None:
        """Give a drone a goal (3,), m, as the goal topic does."""
        self.ask(drone, lambda pilot: pilot.set_reference(drone, Trajectory.hold(goal)))

    def land(self, drone: int) -> None:
        """Ask for a landing."""
        self.ask(drone, lambda pilot: pilot.land(drone))

    def end_controller(self) -> None:
        """End the controller's process as Ctrl-C does."""
        if self.pilot is None:
            return
        for index in range(self.fleet.count):
            command = self.pilot.last_command(index)
            if command is not None:
                self.link.command(index, *setpoint_from_command(*command, self.vehicle))
        self.pilot = None

    def _look(self) -> None:
        """Note one step of the bodies."""
        bodies = self.fleet.bodies
        self.record.feel(bodies.velocity, bodies.grounded)
        self._looks += 1
        if self._looks % _LOOK_EVERY == 0:
            self.record.look(self.fleet.time, bodies.position)

    def _observe(self, _now: float, _samples: list[Sample], tick: Tick, sent: dict[int, WireSetpoint]) -> None:
        time, self._sent = self.fleet.time, sent
        self.remarks += [Remark(time, drone, one_line(text, TEXT)) for drone, text in told(tick)]
        if self.moments is not None:
            bodies = self.fleet.bodies
            commands = [sent.get(index) for index in range(self.fleet.count)]
            self.moments.append(Moment(time, tick.mode, bodies.position.copy(), bodies.velocity.copy(), commands))

    def _is_driven(self, drone: int) -> bool:
        """Tell whether the pilot asks a drone for thrust, be it that its firmware does not give it."""
        return self.pilot is not None and drone in self._sent and self._sent[drone].thrust > 0.0

    def outcomes(self) -> list[Outcome]:
        """Return what came of each drone's flight so far."""
        bodies, power = self.fleet.bodies, self.fleet.power
        return [
            self.record.outcome(
                drone,
                grounded=bool(bodies.grounded[drone]),
                motors=bool(power.ratio[drone] > 0.0 or self._is_driven(drone)),
                speed=float(np.linalg.norm(bodies.velocity[drone])),
                off=float(np.linalg.norm(bodies.position[drone] - self.record.paths[drone][-1])),
                mode=None if self.pilot is None else Mode(int(self.pilot.mode[drone])),
            )
            for drone in range(self.fleet.count)
        ]
