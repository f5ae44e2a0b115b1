"""The demo without ROS: one process on simulated time."""

from __future__ import annotations

import numpy as np
from tqdm import tqdm

from flatsat_ros._resources import config_path
from flatsat_ros.cli.demo_record import FlightRecord, RobotRecord
from flatsat_ros.cli.demo_scenario import (
    BAR,
    CLIMB_TIME,
    GAMMA_0,
    MU,
    POSE_NOISE,
    V_INF,
    VEHICLE,
    Scenario,
    record_of,
)  # fmt: skip
from flatsat_ros.core import telemetry
from flatsat_ros.core.flatness import FloatArray
from flatsat_ros.core.gain import Tuning
from flatsat_ros.core.pilot import Pilot, Tick
from flatsat_ros.core.reference import Trajectory
from flatsat_ros.core.supervisor import Policy
from flatsat_ros.core.vehicle import VehicleProfile
from flatsat_ros.core.wire import WireSetpoint, input_from_setpoint
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.flight import fly as fly_simulated
from flatsat_ros.sim.sensor import MotionCapture, Sample


def fly(scenario: Scenario) -> FlightRecord:
    """Fly on simulated time in this process."""
    count = len(scenario.robots)
    vehicle = VehicleProfile.load(config_path(VEHICLE, "vehicles"))
    certificate = scenario.certificate
    policy = Policy(disturbance_max=scenario.disturbance_max)
    pilot = Pilot(certificate, Tuning(MU, V_INF, GAMMA_0, certificate.gain_max, restart=np.zeros(1)), policy, count)
    fleet = SimulatedFleet(
        vehicle, count, dynamics=scenario.dynamics, start=scenario.start, capture=MotionCapture(noise=POSE_NOISE)
    )
    poses: list[list[list[float]]] = [[] for _ in range(count)]
    ticks: list[list[FloatArray]] = [[] for _ in range(count)]
    commands: list[list[list[float]]] = [[] for _ in range(count)]
    end = CLIMB_TIME + scenario.duration

    with tqdm(total=round(end, 1), unit="s", desc="simulated", bar_format=BAR) as bar:

        def observe(now: float, samples: list[Sample], tick: Tick, sent: dict[int, WireSetpoint]) -> None:
            for sample in samples:
                poses[sample.drone].append([sample.stamp, *sample.position])
            for i, row in enumerate(telemetry.rows(tick)):
                ticks[i].append(np.array([now, *row]))
            for i, setpoint in sent.items():
                commands[i].append([now, *input_from_setpoint(setpoint, vehicle)])
            bar.update(min(now, end) - bar.n)

        for i, position in enumerate(scenario.gathering):
            pilot.refer(i, Trajectory.hold(position))
        fly_simulated(pilot, fleet, vehicle, CLIMB_TIME - certificate.period, observe)
        for i, swap in enumerate(scenario.swaps):
            pilot.refer(i, swap.shifted(CLIMB_TIME))
        fly_simulated(pilot, fleet, vehicle, end, observe, start=CLIMB_TIME)

    robots = {
        name: RobotRecord(*(np.array(x[i]) for x in (poses, ticks, commands)), scenario.swaps[i].shifted(CLIMB_TIME))
        for i, name in enumerate(scenario.robots)
    }
    return record_of(scenario, robots, CLIMB_TIME)
