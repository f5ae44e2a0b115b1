"""One flight of the matrix: fleet, faults and pilot on simulated time, and a record of all that the bounds speak of."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import NANOSECONDS
from flatsat_ros.base.errors import FlatsatError, one_line
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint, setpoint_from_command
from flatsat_ros.falsification.faults.criteria import DroneOutcome, Remark
from flatsat_ros.falsification.faults.record import Record
from flatsat_ros.flight.defaults import default_policy, default_tuning
from flatsat_ros.flight.modes import AIRBORNE, Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy, YawSource
from flatsat_ros.flight.stamps import StampClock
from flatsat_ros.flight.tick import Tick
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.faults import FaultyLink, PoseFault
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import BATTERY_PERIOD
from flatsat_ros.sim.sensor import MotionCapture, Sample

VEHICLE = "cf21"
NOISE = 5e-4  # m, standard deviation of the motion capture
EPOCH = 1_700_000_000  # s, what the clocks show at the beginning
# s, that the landings may take when the controller is ended
_SHUTDOWN_TIME_MAX = 60.0
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
    yield from tick.reports


def policy_of(vehicle: VehicleProfile, yaw_source: YawSource = YawSource.MEASURED) -> Policy:
    """Return the policy that the controller has by default for drones of this kind, with another source of yaws."""
    return replace(default_policy(vehicle.dynamics.drag_z), yaw_source=yaw_source)


class Scene:
    """A flight in progress.

    Attributes:
        fleet: the drones.
        link: the fleet behind its faults.
        pilot: flies; None when its process has ended.
        record: what happened.
        remarks: what was told.
        readings: battery voltages that drones report instead of theirs, V.
        moments: the ticks so far, if they are kept.
        failure: what the pilot raised that is no refusal: then its process ended; empty if it did not.
        seed: of everything random.
        time: s, of the next tick.
        acted: s, when the last thing that was planned had been done.
    """

    def __init__(
        self,
        starts: FloatArray,
        seed: int,
        *,
        floor: float = 0.0,
        stopped: Sequence[int] = (),
        keep: bool = False,
        certificate: str = DEFAULT_CERTIFICATE,
        yaw_source: YawSource = YawSource.MEASURED,
        poses: Sequence[PoseFault] = (),
        **fleet: Any,
    ) -> None:
        """Put drones on the floor at (N, 2), m, and start the pilot.

        Args:
            starts: x and y.
            seed: of everything random.
            floor: its height, m.
            stopped: drones with an emergency stop.
            keep: keep the moments.
            certificate: that is flown: packaged name or path.
            yaw_source: where yaws come from.
            poses: what is wrong with them from the first moment on; faults without a memory, which flights share.
            fleet: further arguments of the SimulatedFleet.
        """
        self.certificate, self.vehicle = load_certificate(certificate), load_vehicle(VEHICLE)
        places = np.column_stack([starts, np.full(len(starts), floor)])
        self.fleet = SimulatedFleet(
            self.vehicle,
            len(starts),
            **{
                "start": places,
                "seed": seed,
                "floor": floor,
                "capture": MotionCapture(noise=NOISE),
                "command_delay": LINK_DELAY,
                **fleet,
            },
        )
        for drone in stopped:
            self.fleet.firmware.request_emergency(drone)
        self.record = Record(self.fleet.bodies.position, floor)
        self.link = FaultyLink(self.fleet, self._look, self._read)
        self.link.poses += poses
        self._policy = policy_of(self.vehicle, yaw_source)
        self._looks = 0
        self._sent: dict[int, WireSetpoint] = {}  # at the last tick
        self._set = {"here": 0.0, "there": 0.0}  # by how much the clocks of controller and motion capture were set, s
        self.pilot: Pilot | None = None
        self.start_controller()
        self.remarks: list[Remark] = []
        self.moments: list[Moment] | None = [] if keep else None
        self.readings: dict[int, float] = {}
        self.failure = ""
        self.seed = seed
        self.time = self.acted = 0.0
        self._battery_due = 0.0  # s, when the drones report their batteries next
        self._agenda: list[tuple[float, int, Callable[[Scene], None]]] = []

    def start_controller(self) -> None:
        """Start the controller, with a pilot that knows of nothing."""
        tuning = default_tuning(self.certificate)
        self.pilot = Pilot(self.certificate, tuning, self._policy, self.fleet.count)
        self._started = self.fleet.time
        # methods, which a copy of this flight takes along; a lambda would read the clocks of the original
        self._stamps = StampClock(self.fleet.count, self._system_clock, self._steady_clock)

    def _system_clock(self) -> int:
        """Return what the clock of the controller's machine shows, ns."""
        return self._steady_clock() + self._nanoseconds(self._set["here"]) + EPOCH * NANOSECONDS

    def _steady_clock(self) -> int:
        """Return the time that nobody sets, ns."""
        return self._nanoseconds(self.fleet.time)

    def set_clock(self, change: float, *clocks: str) -> None:
        """Set clocks, "here" or "there", by a change, s."""
        for clock in clocks:
            self._set[clock] += change

    def _read(self, samples: list[Sample]) -> list[Sample]:
        """Read stamps as the controller does."""
        self._stamps.look()
        shown = [self._nanoseconds(sample.stamp + self._set["there"]) + EPOCH * NANOSECONDS for sample in samples]
        measured = [self._stamps.measured(s.drone, stamp) for s, stamp in zip(samples, shown, strict=True)]
        return [s._replace(stamp=self._started + stamp) for s, stamp in zip(samples, measured, strict=True)]

    @staticmethod
    def _nanoseconds(seconds: float) -> int:
        return round(seconds * NANOSECONDS)

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
            self.acted = self.time
        self._fly_until(end)

    def _fly_until(self, end: float) -> None:
        """Fly to the first tick at or after a time, s since the beginning of the flight."""
        if self.pilot is not None:
            try:
                self.time = fly(self.pilot, self.link, self.vehicle, end, self._observe, start=self.time)
            except Exception as error:  # what escapes the pilot ends the controller: a finding, not an error of ours
                self._fail(error)
        if self.pilot is None:
            self.pass_by(end - self.time)

    def _fail(self, error: Exception) -> None:
        self.failure = one_line(f"{type(error).__name__}: {error}", TEXT)
        self.pilot = None

    def pass_by(self, seconds: float) -> None:
        """Let time pass without any tick: the controller is stopped, or is no more."""
        self.time += max(seconds, 0.0)
        self.link.advance_to(self.time)

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
        self.ask(drone, lambda pilot: pilot.set_goal(drone, goal))

    def land(self, drone: int) -> None:
        """Ask for a landing."""
        self.ask(drone, lambda pilot: pilot.land(drone))

    def end_controller(self) -> None:
        """End the controller's process as Ctrl-C does: it lands the drones, leaves a last command behind, and ends."""
        latest = self.time + _SHUTDOWN_TIME_MAX
        self.ask(0, lambda pilot: pilot.retire())
        while self.pilot is not None and self.time < latest and np.isin(self.pilot.mode, (*AIRBORNE, Mode.REST)).any():
            self._fly_until(self.time + self.certificate.period)
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

    def _report_batteries(self, now: float) -> None:
        """Let the drones that are on report their batteries when that is due."""
        if self.pilot is None or now < self._battery_due - _ROUNDING:
            return
        self._battery_due = now + BATTERY_PERIOD
        for drone in map(int, np.flatnonzero(self.fleet.firmware.powered)):
            voltage = self.readings.get(drone, float(self.fleet.power.voltage[drone]))
            self.pilot.note_battery(drone, voltage, self.vehicle.battery, now)

    def _observe(self, now: float, _samples: list[Sample], tick: Tick, sent: dict[int, WireSetpoint]) -> None:
        time, self._sent = self.fleet.time, sent
        self._report_batteries(now)
        self.remarks += [Remark(time, drone, one_line(text, TEXT)) for drone, text in told(tick)]
        if self.moments is not None:
            bodies = self.fleet.bodies
            commands = [sent.get(index) for index in range(self.fleet.count)]
            self.moments.append(Moment(time, tick.mode, bodies.position.copy(), bodies.velocity.copy(), commands))

    def _is_driven(self, drone: int) -> bool:
        """Tell whether the pilot asks a drone for thrust, also where its firmware does not give it."""
        return self.pilot is not None and drone in self._sent and self._sent[drone].thrust > 0.0

    def outcomes(self) -> list[DroneOutcome]:
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
