"""The demo without ROS: one process on simulated time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.fit import LINK_DELAY
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint, input_from_setpoint
from flatsat_ros.demo.choreography import Stage, perform
from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.demo.scenario import POSE_NOISE, VEHICLE, Scenario, record_of
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.defaults import default_tuning
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.planning.gathering import first_proved
from flatsat_ros.plans.gathering import Move
from flatsat_ros.plans.performance import PATIENCE, Performance, PlanPhase
from flatsat_ros.plans.prepared import PreparedPlan
from flatsat_ros.sim.closed_loop import Observer
from flatsat_ros.sim.closed_loop import fly as fly_simulated
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample


def fly(scenario: Scenario, observe: Observer | None = None) -> FlightRecord:
    """Fly on simulated time in this process.

    Args:
        scenario: what is flown.
        observe: if given, is called at every tick as `flatsat_ros.fly` does.

    Raises:
        FlatsatError: a drone did not take off, or did not arrive at its first way-point.
    """
    stage = _Simulation(scenario, observe)
    start = perform(scenario, stage)
    robots = {
        name: RobotRecord(
            np.array(stage.poses[i]),
            np.array(stage.ticks[i]),
            np.array(stage.commands[i]),
            scenario.swaps[i].shifted(start),
        )
        for i, name in enumerate(scenario.robots)
    }
    return record_of(scenario, robots, start)


def _planned_at_once(move: Move) -> Callable[[], PreparedPlan]:
    """Plan how drones gather, while simulated time stands still."""
    found = first_proved(move)
    return lambda: found


class _Simulation(Stage):
    """Pilot and simulated fleet; a step is a tick.

    Attributes:
        poses: of each drone so far: stamp s, x, y, z m.
        ticks: of each drone so far: time s, telemetry.
        commands: for each drone so far: time s, T m/s^2, phi, theta rad, yaw rate rad/s.
    """

    def __init__(self, scenario: Scenario, observe: Observer | None) -> None:
        super().__init__()
        count, certificate = len(scenario.robots), scenario.certificate
        self._scenario, self._observer = scenario, observe
        self._vehicle = load_vehicle(VEHICLE)
        tuning = default_tuning(certificate, restart=not scenario.paper)
        self._pilot = Pilot(certificate, tuning, scenario.policy, count)
        self._fleet = SimulatedFleet(
            self._vehicle,
            count,
            dynamics=scenario.dynamics,
            start=scenario.start,
            wind=Wind(mean=(scenario.wind, 0.0, 0.0)),
            capture=MotionCapture(noise=POSE_NOISE),
            command_delay=0.0 if scenario.paper else LINK_DELAY,
            floor=scenario.floor,
        )
        self._performance = None
        if scenario.plan is not None:
            self._performance = Performance(scenario.plan, self._pilot, scenario.robots, _planned_at_once)
        self._next = 0  # number of the next tick
        self.poses: list[list[list[float]]] = [[] for _ in range(count)]
        self.ticks: list[list[FloatArray]] = [[] for _ in range(count)]
        self.commands: list[list[list[float]]] = [[] for _ in range(count)]

    def now(self) -> float:
        """Return the time of the next tick, s."""
        return self._next * self._scenario.certificate.period

    def step(self) -> None:
        """Fly one tick."""
        now = self.now()
        self._next += 1
        if self._performance is not None:
            self._performance.look(now)
        fly_simulated(self._pilot, self._fleet, self._vehicle, self.now(), self._observe, start=now)

    def _observe(self, now: float, samples: list[Sample], tick: Tick, sent: dict[int, WireSetpoint]) -> None:
        if self._observer is not None:
            self._observer(now, samples, tick, sent)
        for sample in samples:
            self.poses[sample.drone].append([sample.stamp, *sample.position])
        for i, row in enumerate(telemetry.rows(tick)):
            self.ticks[i].append(np.array([now, *row]))
        for i, setpoint in sent.items():
            self.commands[i].append([now, *input_from_setpoint(setpoint, self._vehicle)])

    def arm(self) -> None:
        """Arm all drones."""
        for i in range(self._fleet.count):
            self._pilot.arm(i, True)

    def take_off(self) -> None:
        """Let all drones take off."""
        for i in range(self._fleet.count):
            self._pilot.take_off(i, self._scenario.height)

    def send_goals(self, places: FloatArray) -> None:
        """Send all drones to places (N, 3), m."""
        for i, place in enumerate(places):
            self._pilot.set_reference(i, Trajectory.hold(place))

    def send_trajectories(self, trajectories: Sequence[Trajectory], lead: float) -> float:
        """Send each drone a trajectory that begins in `lead` seconds; return when that is, s.

        Those of a plan begin when all drones are within their tubes.

        Raises:
            FlatsatError: they are not in time.
        """
        plan = self._performance
        if plan is not None:
            plan.start(self.now())
            if not self.wait_until(lambda: plan.phase is PlanPhase.FLYING, PATIENCE):
                raise FlatsatError(f"the plan does not begin within {PATIENCE:g} s: drones are not within their tubes")
            return plan.origin
        start = self.now() + lead
        for i, trajectory in enumerate(trajectories):
            self._pilot.set_reference(i, trajectory.shifted(start))
        return start

    def land(self) -> None:
        """Let all drones land."""
        for i in range(self._fleet.count):
            self._pilot.land(i)

    def away(self, places: FloatArray, distance: float) -> list[str]:
        """Return the names of the drones that are farther than a distance, m, from their places (N, 3), m."""
        positions = np.array([poses[-1][1:] for poses in self.poses])
        return self._names(np.linalg.norm(positions - places, axis=1) > distance)

    def in_use(self) -> list[str]:
        """Return the names of the drones that the pilot still commands."""
        return self._names(self._pilot.mode != Mode.IDLE)

    def _names(self, chosen: np.ndarray) -> list[str]:
        return [name for name, is_one in zip(self._scenario.robots, chosen, strict=True) if is_one]
