"""How fast plans are found and how short they are, over drones and way-points, beside a bound and a plain QP.

Missions are drawn by a generator of this file, or read from a folder. The bound is the slowest drone alone in the same
spline space under the same limits: no plan with these knots in proportion is shorter. The QP is what many planners stop
at: the references of least jerk through the way-points, stretched in time until they keep the limits; drones that they
bring nearer than the plan allows are counted. Times are of the CPU, for other load spoils those of the clock.

    .venv/bin/python bench/plans.py [--missions FOLDER] [--seconds S] [--tube M] [--jerk M_S3] [--snap M_S4]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.planning import Asked, Mission, Round, Wishes, plan, read_mission
from flatsat_ros.planning.improvement import _shapes as shapes_of_mission
from flatsat_ros.planning.improvement import bound_of
from flatsat_ros.planning.reference import shapes_of
from flatsat_ros.plans import Bounds, Curve, Tube, closest
from flatsat_ros.plans.curve import UNIT

CERTIFICATE = "paper_experiment"
LOW, HIGH = np.array([-1.5, -1.5, 0.2]), np.array([1.5, 1.5, 2.2])  # m, the room
BODY, PLACES_APART, DOWNWASH = 0.15, 0.5, 2.0  # m, m
DRONES, TOURS = (5, 10, 20, 30), (5, 10, 20)


def drawn(given: argparse.Namespace) -> Iterator[Mission]:
    """Yield missions of several sizes: swarms from random places to others, and tours of one drone."""
    random, limits = np.random.default_rng(0), load_certificate(CERTIFICATE).limits
    bounds = Bounds(limits.inner_radius / 2.0, given.jerk, given.snap, LOW, HIGH)
    tube = Tube(given.tube)
    for count in DRONES:
        ends = [places(random, count), places(random, count)]
        drones = tuple(Asked(f"cf{i}", np.array(way), BODY) for i, way in enumerate(zip(*ends, strict=True), 1))
        yield Mission(f"{count} drones", drones, CERTIFICATE, limits, bounds, tube)
    for count in TOURS:
        way = random.uniform(LOW, HIGH, (count, 3))
        yield Mission(f"tour of {count}", (Asked("cf1", way, BODY),), CERTIFICATE, limits, bounds, tube)


def places(random: np.random.Generator, count: int) -> list[np.ndarray]:
    """Draw places that are apart."""
    found: list[np.ndarray] = []
    while len(found) < count:
        place = random.uniform(LOW, HIGH)
        if all(np.linalg.norm((place - other) / (1.0, 1.0, DOWNWASH)) >= PLACES_APART for other in found):
            found.append(place)
    return found


def read(folder: Path, given: argparse.Namespace) -> Iterator[Mission]:
    """Yield the missions of a folder."""
    certificate = load_certificate(CERTIFICATE)
    wishes = Wishes(tube=given.tube, jerk_max=given.jerk, snap_max=given.snap)
    for path in sorted(path for path in folder.iterdir() if path.suffix in (".json", ".yaml", ".csv")):
        try:
            yield read_mission(path, certificate, wishes, path.stem)
        except FlatsatError as error:
            print(f"{path.name}: {error}")


def plain(mission: Mission) -> tuple[float, float, int]:
    """Return duration, CPU time, s, and too near pairs of the references of least jerk that keep the limits."""
    begin = time.process_time()
    if len(mission.drones) > 1:
        shapes = shapes_of_mission(mission)
    else:
        shapes = shapes_of(np.sqrt(np.linalg.norm(np.diff(mission.drones[0].waypoints, axis=0), axis=1) + 0.1))
    points = [shapes.fixed @ drone.waypoints for drone in mission.drones]

    def curves(duration: float) -> list[Curve]:
        knots = np.rint(shapes.knots * duration * 1e6).astype(int).tolist()
        return [Curve.rounded(knots, each) for each in points]

    def kept(duration: float) -> bool:
        claims = (claim for curve in curves(duration) for claim in mission.bounds.claims(curve, mission.limits))
        return all(claim.slack >= 0.0 or claim.name.startswith("box") for claim in claims)

    low = high = bound_of(mission)  # no reference with these limits is shorter
    while not kept(high):
        low, high = high, 1.3 * high
    while high - low > 1e-3 * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if kept(middle) else (middle, high)
    seconds = time.process_time() - begin
    if len(points) < 2:
        return high, seconds, 0
    found = closest(curves(high), mission.downwash)
    required = mission.distances[found.first, found.second]
    return high, seconds, int(np.count_nonzero(found.distance / UNIT < required))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--missions", type=Path)
    for option, usual in (("seconds", 10.0), ("tube", 0.05), ("jerk", 2.0), ("snap", 20.0)):
        parser.add_argument(f"--{option}", type=float, default=usual)
    given = parser.parse_args()
    missions = drawn(given) if given.missions is None else read(given.missions, given)
    print(
        f"{'mission':<18}{'first plan':>12}{'best':>9}{'/ bound':>9}{'CPU s':>7}   least jerk {'/ bound':>8}  too near"
    )
    for mission in missions:
        rounds: list[tuple[float, Round]] = []
        begin = time.process_time()

        def note(proved: Round, rounds: list[tuple[float, Round]] = rounds, begin: float = begin) -> None:
            rounds.append((time.process_time() - begin, proved))

        try:
            plan(mission, given.seconds, note)
        except FlatsatError as error:
            print(f"{mission.name:<18}{error}")
            continue
        seconds, best = time.process_time() - begin, rounds[-1][1]
        duration, _, near = plain(mission)
        bound = best.bound or best.duration
        ours = f"{best.duration:>7.2f} s{best.duration / bound:>9.4f}{seconds:>7.1f}"
        print(
            f"{mission.name:<18}{rounds[0][0]:>10.2f} s{ours}{duration:>11.2f} s {duration / bound:>8.3f}{near:>10}",
            flush=True,
        )


if __name__ == "__main__":
    main()
