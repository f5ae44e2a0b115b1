"""From a mission to a proved plan: the best references of the rounds that fit the time, and their distances."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version

from flatsat_ros._version import __version__
from flatsat_ros.base.errors import require_positive
from flatsat_ros.planning.mission import Asked, Mission
from flatsat_ros.plans import Curve, Plan, PlannedDrone, Waypoint
from flatsat_ros.plans.laps import with_ramp
from flatsat_ros.plans.tubes import Promise, narrowed

SECONDS = 20.0  # how long a plan is improved, unless it is said otherwise


@dataclass(frozen=True, eq=False)
class Round:
    """References that are proved to keep what a mission asks.

    Attributes:
        curves: one for each drone.
        duration: s; of a lap, if there are laps.
        bound: s; no references with these knots in proportion are shorter. None where the times are given, or the
            solver stops short of it.
        note: what became of polynomials; empty for way-points.
    """

    curves: tuple[Curve, ...]
    duration: float
    bound: float | None = None
    note: str = ""


def plan(mission: Mission, seconds: float = SECONDS, progress: Callable[[Round], None] | None = None) -> Plan:
    """Return the best plan that is found in the given time, proved.

    Ctrl-C ends the search early. Rounds follow each other in the same way always; how far they get depends on the time.

    Args:
        mission: what is asked.
        seconds: for the search; without a proved round by then the mission is refused.
        progress: is told each round.

    Raises:
        FlatsatError: what is asked cannot be planned; the text names drones, time and limit.
    """
    from flatsat_ros.planning.improvement import rounds  # scipy and the solver take a while to import

    require_positive("seconds", seconds, "s")
    until = time.monotonic() + seconds
    found: list[Round] = []
    try:
        for proved in rounds(mission, lambda: time.monotonic() > until):
            found.append(proved)
            if progress is not None:
                progress(proved)
    except KeyboardInterrupt:
        if not found:
            raise
    return finished(mission, found[-1])


def finished(mission: Mission, found: Round) -> Plan:
    """Return the plan of a round, with the distances that can be certified."""
    promised = Promise(mission.bounds, mission.tube)
    if mission.proves is not None and not mission.is_closed:
        promised = narrowed(promised, found.curves, mission.proves, mission.limits, mission.downwash)
    bounds, tube = promised
    drones = [
        PlannedDrone(
            drone.name, curve, drone.body, tube, drone.yaw,
            tuple(
                Waypoint(knot, *(round(1e9 * value) for value in (*place, radius)))
                for knot, place, radius in zip(
                    _passed(drone, curve), drone.waypoints.tolist(), drone.allowed.tolist(), strict=True
                )
            ),
        )
        for drone, curve in zip(mission.drones, found.curves, strict=True)
    ]  # fmt: skip
    provenance = {"package": f"flatsat_ros {__version__}", "solver": f"Clarabel {version('clarabel')}"}
    if found.bound is not None:
        provenance["bound"] = f"{found.bound:.6f} s: the slowest drone alone, same limits, same knots in proportion"
    if found.note:
        provenance["polynomials"] = found.note
    laps = None
    if mission.laps is not None:
        ways = [curve.trajectory() for curve in found.curves]
        laps = with_ramp(mission.laps, ways, bounds, mission.limits)
    made = Plan.of(
        drones, name=mission.name, certificate=mission.certificate, limits=mission.limits, bounds=bounds,
        downwash=mission.downwash, clearance=mission.clearance, obstacles=mission.obstacles, provenance=provenance,
        laps=laps,
    )  # fmt: skip
    made.verify()
    return made


def _passed(drone: Asked, curve: Curve) -> list[int]:
    """Return the knots, us, at which the way-points are passed: legs have equally many spans."""
    return list(curve.knots[:: (len(curve.knots) - 1) // (len(drone.waypoints) - 1)])
