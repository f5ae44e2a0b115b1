"""The demo without ROS: one process on simulated time."""

from __future__ import annotations

import numpy as np
from tqdm import tqdm

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint, input_from_setpoint
from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.demo.scenario import (
    BAR,
    CLIMB_TIME,
    GAMMA_0,
    GATHER_TIME,
    LANDING_LATEST,
    LANDING_TIME,
    MU,
    POSE_NOISE,
    STANDING_TIME,
    V_INF,
    VEHICLE,
    Scenario,
    record_of,
)  # fmt: skip
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.pilot import Pilot, Tick
from flatsat_ros.flight.supervisor import Mode, Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.sim.closed_loop import fly as fly_simulated
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample


def fly(scenario: Scenario) -> FlightRecord:
    """Fly on simulated time in this process: take off, gather, swap, land."""
    count = len(scenario.robots)
    vehicle = load_vehicle(VEHICLE)
    certificate = scenario.certificate
    policy = Policy(disturbance_max=scenario.disturbance_max)
    pilot = Pilot(certificate, Tuning(MU, V_INF, GAMMA_0, certificate.gain_max, restart=False), policy, count)
    fleet = SimulatedFleet(
        vehicle, count, dynamics=scenario.dynamics, start=scenario.start, capture=MotionCapture(noise=POSE_NOISE)
    )
    poses: list[list[list[float]]] = [[] for _ in range(count)]
    ticks: list[list[FloatArray]] = [[] for _ in range(count)]
    commands: list[list[list[float]]] = [[] for _ in range(count)]
    start = STANDING_TIME + CLIMB_TIME
    end = start + scenario.duration
    total = end + LANDING_TIME

    with tqdm(total=round(total, 1), unit="s", desc="simulated", bar_format=BAR) as bar:

        def observe(now: float, samples: list[Sample], tick: Tick, sent: dict[int, WireSetpoint]) -> None:
            for sample in samples:
                poses[sample.drone].append([sample.stamp, *sample.position])
            for i, row in enumerate(telemetry.rows(tick)):
                ticks[i].append(np.array([now, *row]))
            for i, setpoint in sent.items():
                commands[i].append([now, *input_from_setpoint(setpoint, vehicle)])
            bar.update(min(now, total) - bar.n)

        def let_pass(begin: float, until: float) -> None:
            fly_simulated(pilot, fleet, vehicle, until, observe, start=begin)

        let_pass(0.0, STANDING_TIME)
        for i in range(count):
            pilot.take_off(i, scenario.height)
        let_pass(STANDING_TIME, STANDING_TIME + GATHER_TIME)
        for i, position in enumerate(scenario.gathering):
            pilot.set_reference(i, Trajectory.hold(position))
        let_pass(STANDING_TIME + GATHER_TIME, start)
        for i, swap in enumerate(scenario.swaps):
            pilot.set_reference(i, swap.shifted(start))
        now = end + certificate.period
        let_pass(start, now)
        for i in range(count):
            pilot.land(i)
        while (pilot.mode != Mode.IDLE).any() and now < end + LANDING_LATEST:
            let_pass(now, now + certificate.period)
            now += certificate.period
        bar.update(total - bar.n)

    robots = {
        name: RobotRecord(
            np.array(poses[i]), np.array(ticks[i]), np.array(commands[i]), scenario.swaps[i].shifted(start)
        )
        for i, name in enumerate(scenario.robots)
    }
    return record_of(scenario, robots, start)
