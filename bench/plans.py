"""How fast plans are found and how short they are, over drones and way-points, beside what else is there.

Missions are drawn by a generator of this file, or read from a folder, and planned without options. Beside each stand:

- the bound: the slowest drone alone in the same spline space under the same limits; for one drone the optimum for the
  legs that were found;
- a plain quadratic program: the references of least snap through the way-points, stretched in time until they keep the
  limits, which is what many planners stop at;
- CasADi and ipopt with the same limits, where casadi is installed and there are few drones.

What each one's references violate is found by the same proof. Times are of the CPU, for other load spoils those of the
clock.

    .venv/bin/python bench/plans.py [--missions FOLDER] [--seconds S] [--certificate NAME] [--tube M]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from report import table

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.planning import Asked, Mission, Wishes, read_mission, rounds
from flatsat_ros.planning.improvement import _shapes as shapes_of_mission
from flatsat_ros.planning.program import raising
from flatsat_ros.planning.reference import shapes_of
from flatsat_ros.plans import Curve, closest
from flatsat_ros.plans.curve import UNIT
from flatsat_ros.plans.tubes import promise

LOW, HIGH = np.array([-1.5, -1.5, 0.2]), np.array([1.5, 1.5, 2.2])  # m, the room
BODY, PLACES_APART, DOWNWASH = 0.15, 0.5, 2.0  # m, m
DRONES, TOURS = (5, 10, 20, 30), (5, 10, 20)
SECONDS = 10.0  # of each search
IPOPT_DRONES, IPOPT_SECONDS = 5, 30.0  # at most
_SQUARES = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0  # integrals of products of the Bernstein polynomials of degree 1


class Result(NamedTuple):
    """What became of one mission.

    Attributes:
        name: of the mission.
        refused: why nothing was planned; empty where something was.
        drones, waypoints: how many.
        first: CPU time to the first proved plan, s.
        seconds: of the whole search, s.
        duration: of the best plan, s.
        bound: s.
        plain: duration, CPU time, s, and violations of the quadratic program.
        ipopt: the same of CasADi and ipopt; None where it was not asked. Where it has not ended, its duration is None,
            and how it was stopped stands in place of the violations.
        solving: CPU time of ipopt alone, s.
    """

    name: str
    refused: str = ""
    drones: int = 0
    waypoints: int = 0
    first: float = 0.0
    seconds: float = 0.0
    duration: float = 0.0
    bound: float = 0.0
    plain: tuple[float, float, str] | None = None
    ipopt: tuple[float | None, float, str] | None = None
    solving: float = 0.0


def drawn(certificate: Certificate, wishes: Wishes) -> Iterator[Mission]:
    """Yield missions of several sizes: swarms from random places to others, and tours of one drone."""
    random = np.random.default_rng(0)
    bounds, tube = promise(certificate, LOW, HIGH, downwash=DOWNWASH, tube=wishes.tube)

    def mission(name: str, drones: Iterable[Asked]) -> Mission:
        return Mission(name, tuple(drones), certificate.name, certificate.limits, bounds, tube)

    for count in DRONES:
        ways = zip(places(random, count), places(random, count), strict=True)
        yield mission(f"{count} drones", [Asked(f"cf{i}", np.array(way), BODY) for i, way in enumerate(ways, 1)])
    for count in TOURS:
        yield mission(f"tour of {count}", [Asked("cf1", random.uniform(LOW, HIGH, (count, 3)), BODY)])


def places(random: np.random.Generator, count: int) -> list[FloatArray]:
    """Draw places that are apart."""
    found: list[FloatArray] = []
    while len(found) < count:
        place = random.uniform(LOW, HIGH)
        if all(np.linalg.norm((place - other) / (1.0, 1.0, DOWNWASH)) >= PLACES_APART for other in found):
            found.append(place)
    return found


def read(folder: Path, certificate: Certificate, wishes: Wishes) -> Iterator[Mission | Result]:
    """Yield the missions of a folder, and what is refused of it."""
    for path in sorted(path for path in folder.iterdir() if path.suffix in (".json", ".yaml", ".csv")):
        try:
            yield read_mission(path, certificate, wishes, path.stem)
        except FlatsatError as error:
            yield Result(path.stem, str(error))


def compared(missions: Iterable[Mission | Result], seconds: float) -> Iterator[Result]:
    """Plan missions, each for so many seconds, in all ways."""
    for mission in missions:
        if isinstance(mission, Result):
            yield mission
            continue
        begin, first, best = time.process_time(), 0.0, None
        try:
            for proved in rounds(mission, lambda begin=begin: time.process_time() - begin > seconds):
                best, first = proved, first or time.process_time() - begin
        except FlatsatError as error:
            yield Result(mission.name, str(error), len(mission.drones))
            continue
        assert best is not None
        found = Result(
            mission.name, "", len(mission.drones), len(mission.drones[0].waypoints), first,
            time.process_time() - begin, best.duration, best.bound or best.duration,
        )  # fmt: skip
        if not mission.is_given and mission.times is None and not mission.obstacles:
            found = found._replace(plain=plain(mission))
            if find_spec("casadi") is not None and len(mission.drones) <= IPOPT_DRONES:
                import ipopt

                answer = ipopt.shortest(mission, IPOPT_SECONDS)
                found = found._replace(ipopt=(None, answer.seconds, answer.status), solving=answer.solving)
                if answer.curves:
                    theirs = answer.curves[0].duration, answer.seconds, violations(mission, answer.curves)
                    found = found._replace(ipopt=theirs)
        yield found


def plain(mission: Mission) -> tuple[float, float, str]:
    """Return duration, CPU time, s, and violations of the references of least snap that keep all but box and others."""
    begin = time.process_time()
    ways = np.linalg.norm(np.diff(mission.waypoints, axis=1), axis=2).max(axis=0)
    shapes = shapes_of(np.sqrt(ways + 0.1)) if len(mission.drones) == 1 else shapes_of_mission(mission)
    snaps = shapes.bezier[4].reshape(len(shapes.lengths), 2, shapes.count)
    widths = np.diff(shapes.knots)[:, np.newaxis, np.newaxis]
    form = (widths * (snaps.transpose(0, 2, 1) @ _SQUARES @ snaps)).sum(axis=0)
    form /= np.abs(form).max()
    count = len(shapes.pinned)
    system = np.block([[form, shapes.pinned.T], [shapes.pinned, np.zeros((count, count))]])
    targets = [np.concatenate([np.zeros((shapes.count, 3)), shapes.targets(way)]) for way in mission.waypoints]
    points = [np.linalg.solve(system, target)[: shapes.count] for target in targets]
    bounds = mission.bounds
    values = [np.concatenate([matrix @ each for each in points]) for matrix in shapes.bezier]
    most = [np.linalg.norm(value, axis=1).max() for value in values]
    low = max(
        (size / bound) ** (1.0 / order)
        for order, size, bound in zip(
            range(1, 5), most[1:], (bounds.speed_max, bounds.acceleration_max, bounds.jerk_max, bounds.snap_max),
            strict=True,
        )
        if bound is not None
    )  # fmt: skip
    high = low

    raised = {order: np.kron(np.eye(len(shapes.lengths)), raising(order, min(bounds.asked))) for order in bounds.asked}
    parts = [
        np.concatenate([raised[order] @ matrix @ each for each in points]) * np.array(factors, dtype=np.float64)
        for order, factors in bounds.asked.items()
        for matrix in [shapes.bezier[order]]
    ]

    def kept(duration: float) -> bool:
        f = sum(part / duration**order for order, part in zip(bounds.asked, parts, strict=True))
        return float(bounds.room(mission.limits).margin(f).min()) >= bounds.margin

    while not kept(high):
        low, high = high, 1.3 * high
    while high - low > 1e-4 * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if kept(middle) else (middle, high)
    seconds = time.process_time() - begin
    knots = np.rint(shapes.knots * (1.0 + 1e-4) * high * 1e6).astype(int).tolist()
    curves = [Curve.rounded(knots, each) for each in points]
    return curves[0].duration, seconds, violations(mission, curves)


def violations(mission: Mission, curves: Sequence[Curve]) -> str:
    """Return what references violate, as found by the proof of plans: how many limits and pairs, and the worst box."""
    claims = [claim for curve in curves for claim in mission.bounds.claims(curve, mission.limits)]
    broken = [claim for claim in claims if claim.slack < 0.0]
    inside = [claim.slack for claim in broken if claim.name.startswith("box")]
    parts = [f"{len(broken) - len(inside)} limits"] if len(broken) > len(inside) else []
    if inside:
        parts.append(f"box by {-min(inside):.2g} m")
    if len(curves) > 1:
        found = closest(curves, mission.downwash)
        short = mission.distances[found.first, found.second] - found.distance / UNIT
        if (short > 0.0).any():
            parts.append(f"{np.count_nonzero(short > 0.0)} pairs too near, by up to {short.max():.2g} m")
    return ", ".join(parts) or "none"


def shown(results: Iterable[Result]) -> str:
    """Return the table."""
    rows = []
    for found in results:
        if found.refused:
            rows.append([found.name, *[""] * 9, found.refused])
            continue
        row = [found.name, f"{found.first:.2f}", f"{found.seconds:.2f}", f"{found.duration:.2f}"]
        row.append(f"{found.duration / found.bound:.4f}")
        for other in (found.plain, found.ipopt):
            duration = "" if other is None or other[0] is None else f"{other[0] / found.duration:.3f}"
            row += ["", "", ""] if other is None else [f"{other[1]:.2f}", duration, other[2]]
        rows.append(row)
    header = ["", "first, CPU s", "all, CPU s", "duration s", "/ bound"]
    for name in ("least snap", "ipopt"):
        header += [f"{name}, CPU s", "/ ours", "violates"]
    return table(header, rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--missions", type=Path, metavar="FOLDER")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--certificate", default=DEFAULT_CERTIFICATE)
    parser.add_argument("--tube", type=float)
    given = parser.parse_args()
    certificate, wishes = load_certificate(given.certificate), Wishes(tube=given.tube)
    missions = drawn(certificate, wishes) if given.missions is None else read(given.missions, certificate, wishes)
    results = []
    for found in compared(missions, given.seconds):
        print(found.name, found.refused, file=sys.stderr, flush=True)
        results.append(found)
    print(shown(results))


if __name__ == "__main__":
    main()
