"""The demo: three simulated Crazyflies swap places (Test 2 of the paper), every node its own process."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from flatsat_ros._resources import config_path
from flatsat_ros.cli import demo_record
from flatsat_ros.cli.demo_record import FlightRecord, RobotRecord
from flatsat_ros.core import telemetry
from flatsat_ros.core.certificate import Certificate
from flatsat_ros.core.errors import FlatsatError
from flatsat_ros.core.flatness import FloatArray
from flatsat_ros.core.gain import Tuning
from flatsat_ros.core.pilot import Pilot, Tick
from flatsat_ros.core.reference import Trajectory
from flatsat_ros.core.supervisor import Policy
from flatsat_ros.core.vehicle import VehicleProfile
from flatsat_ros.core.wire import WireSetpoint, input_from_setpoint

# the paper's way-points, {[0,-6,1],[6,6,1],[-6,6,1]} x 10 cm in x and y, m
_PAPER_WAYPOINTS = np.array([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0]])
_NEIGHBOUR_DISTANCE = 1.25  # m, between neighbours on the ring that replaces the triangle for more drones
LEG_TIME = 4.0  # s from one way-point to the next; the paper prints none
CLIMB_TIME = 6.0  # s from the floor to the start of the swap
MU, V_INF, GAMMA_0 = 2.0, 0.05, 1.0  # Table III
VEHICLE = "cf21"
POSE_NOISE = 5e-4  # m, of the simulated motion capture
DISTURBANCE_MAX = 0.8  # m/s^2, of an offset-free flight


@dataclass(frozen=True, eq=False)
class Scenario:
    """What is flown.

    Attributes:
        robots: names.
        start: (N, 3) places on the floor, m.
        gathering: (N, 3) first way-points, m.
        swaps: the reference of each robot, times from 0.
        certificate: flown by all.
        certificate_path: its file.
        dynamics: ideal or identified.
        disturbance_max: m/s^2, what the controller may compensate.
    """

    robots: list[str]
    start: FloatArray
    gathering: FloatArray
    swaps: list[Trajectory]
    certificate: Certificate
    certificate_path: Path
    dynamics: str
    disturbance_max: float

    @property
    def duration(self) -> float:
        """Length of the swap, s."""
        return float(self.swaps[0].times[-1])


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the demo; 0 if it kept its promises, 1 if not, 2 if it could not be flown as asked."""
    arguments = _parser().parse_args(argv)
    try:
        return _run(arguments)
    except FlatsatError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument("--dynamics", choices=("identified", "ideal"), default="identified", help="of the drones")
    parser.add_argument(
        "--seconds",
        type=float,
        default=3 * LEG_TIME,
        help=f"of swapping, rounded up to whole legs of {LEG_TIME:g} s (default: %(default)g)",
    )
    parser.add_argument("--robots", type=int, default=3, help="number of drones (default: %(default)s)")
    parser.add_argument("--rate", type=float, help="of the controller, Hz (default: the certificate's)")
    parser.add_argument("--headless", action="store_true", help="one process on simulated time, no ROS: fast, no bag")
    parser.add_argument(
        "--offset-free", action="store_true", help="compensate the estimated disturbance, beyond the paper's law"
    )
    parser.add_argument("--output", type=Path, default=Path("out/demo"), help="for the results (default: %(default)s)")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    arguments.output.mkdir(parents=True, exist_ok=True)
    scenario = plan(
        arguments.output,
        arguments.robots,
        arguments.seconds,
        arguments.rate,
        arguments.dynamics,
        DISTURBANCE_MAX if arguments.offset_free else 0.0,
    )
    if arguments.headless:
        record = fly_headless(scenario)
    else:
        from flatsat_ros.cli import demo_live

        record = demo_live.fly(scenario, arguments.output)
    summary = record.summary()
    _write_json(arguments.output / "summary.json", summary)
    print(demo_record.table(summary, record.limits))
    from flatsat_ros.cli import demo_pictures

    written = [arguments.output / "summary.json", *demo_pictures.draw(record, arguments.output)]
    if not arguments.headless:
        written.append(arguments.output / "bag")
    print("wrote " + ", ".join(os.fspath(path) for path in written))
    broken = demo_record.failures(summary)
    for sentence in broken:
        print(f"FAILED: {sentence}", file=sys.stderr)
    return 1 if broken else 0


def plan(
    folder: Path,
    count: int = 3,
    seconds: float = 3 * LEG_TIME,
    rate: float | None = None,
    dynamics: str = "identified",
    disturbance_max: float = 0.0,
) -> Scenario:
    """Return what is to be flown: by default Test 2 of the paper.

    Args:
        folder: where a certificate for another rate is written.
        count: number of drones.
        seconds: of swapping, rounded up to whole legs.
        rate: of the controller, Hz; None for the rate of the paper's certificate.
        dynamics: ideal or identified.
        disturbance_max: m/s^2, what the controller may compensate.

    Raises:
        FlatsatError: the number of drones, the time or the rate cannot be flown.
    """
    if not 1 <= count <= 64:
        raise FlatsatError(f"--robots {count}: must be from 1 to 64")
    if not 0.0 < seconds <= 3600.0:
        raise FlatsatError(f"--seconds {seconds}: must lie in (0, 3600]")
    path = config_path("paper_experiment")
    certificate = Certificate.load(path)
    if rate is not None:
        if not 1.0 <= rate <= 500.0:
            raise FlatsatError(f"--rate {rate} Hz: must be from 1 to 500")
        from flatsat_ros.synthesis.nominal import synthesize

        certificate = synthesize(certificate.limits, certificate.rate, 1.0 / rate, f"demo_{rate:g}_hz")
        path = folder / "certificate.yaml"
        certificate.save(path)
    from flatsat_ros.synthesis.planner import spline_through

    ring = _ring(count)
    legs = math.ceil(seconds / LEG_TIME - 1e-9)
    swaps = []
    for i in range(count):
        swap = spline_through([ring[(i + leg) % len(ring)] for leg in range(legs + 1)], LEG_TIME)
        swap.require_margin(certificate.limits)
        swaps.append(swap)
    gathering = ring[:count]
    return Scenario(
        robots=[f"cf{i + 1}" for i in range(count)],
        start=gathering * (1.0, 1.0, 0.0),
        gathering=gathering,
        swaps=swaps,
        certificate=certificate,
        certificate_path=path,
        dynamics=dynamics,
        disturbance_max=disturbance_max,
    )


def _ring(count: int) -> FloatArray:
    """Return the way-points: the paper's triangle for up to three drones, a ring with room for all otherwise."""
    if count <= len(_PAPER_WAYPOINTS):
        return _PAPER_WAYPOINTS
    angle = 2.0 * np.pi * np.arange(count) / count
    radius = _NEIGHBOUR_DISTANCE / (2.0 * math.sin(math.pi / count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(count)], axis=1)


def fly_headless(scenario: Scenario) -> FlightRecord:
    """Fly on simulated time in this process."""
    from flatsat_ros.sim.fleet import SimulatedFleet
    from flatsat_ros.sim.flight import fly
    from flatsat_ros.sim.sensor import MotionCapture, Sample

    count = len(scenario.robots)
    vehicle = VehicleProfile.load(config_path(VEHICLE, "vehicles"))
    certificate = scenario.certificate
    policy = Policy(disturbance_max=scenario.disturbance_max)
    pilot = Pilot(certificate, Tuning(MU, V_INF, GAMMA_0, certificate.gain_max), policy, count)
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
        fly(pilot, fleet, vehicle, CLIMB_TIME - certificate.period, observe)
        for i, swap in enumerate(scenario.swaps):
            pilot.refer(i, swap.shifted(CLIMB_TIME))
        fly(pilot, fleet, vehicle, end, observe, start=CLIMB_TIME)

    robots = {
        name: RobotRecord(*(np.array(x[i]) for x in (poses, ticks, commands)), scenario.swaps[i].shifted(CLIMB_TIME))
        for i, name in enumerate(scenario.robots)
    }
    return record_of(scenario, robots, CLIMB_TIME)


# time flown, time left
BAR = "{desc} {bar} {n:.1f}/{total:.1f} {unit}"


def record_of(scenario: Scenario, robots: dict[str, RobotRecord], swap_start: float) -> FlightRecord:
    """Return the record of a scenario flown."""
    certificate = scenario.certificate
    return FlightRecord(
        robots,
        certificate.limits,
        certificate.level,
        V_INF,
        certificate.gain_max,
        1.0 / certificate.period,
        scenario.dynamics,
        (swap_start, swap_start + scenario.duration),
    )


def _write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
