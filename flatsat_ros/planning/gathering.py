"""The way of a plan's drones to their places, planned in a process of its own: no solver delays a tick.

`python -m flatsat_ros.planning.gathering` reads a `Move` from its standard input and writes to its standard output what
`prepared.received` reads; whoever starts it knows only how to call it (`plans.gathering`).
"""

from __future__ import annotations

import itertools
import pickle
import sys
import time
from dataclasses import replace

import numpy as np

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.planning.mission import Asked, Mission
from flatsat_ros.planning.planner import finished
from flatsat_ros.plans.gathering import Move
from flatsat_ros.plans.prepared import PreparedPlan

_PATIENCE = 20.0  # s, for the first plan
_BODY_MIN = 0.08  # m: nearer to each other than this and their tubes drones do not pass, even if they stand so
_ROUNDING = 2e-3  # m


def first_proved(move: Move) -> PreparedPlan:
    """Return the first proved plan of a move.

    Bodies count as those of the plan, or as less where drones stand nearer to each other than these.

    Raises:
        FlatsatError: nothing can be planned; the text says why.
    """
    from flatsat_ros.planning.improvement import rounds  # scipy and the solver take a while to import

    plan, bounds = move.plan, move.plan.bounds
    ways = {drone.name: np.array([move.starts[drone.name], move.goals[drone.name]]) for drone in plan.drones}
    places = np.array(list(ways.values()))  # (N, 2, 3)
    lower = np.minimum(bounds.lower, places.min(axis=(0, 1)) - _ROUNDING)
    upper = np.maximum(bounds.upper, places.max(axis=(0, 1)) + _ROUNDING)
    stretch, tube = np.array([1.0, 1.0, plan.downwash]), max(drone.tube.radius for drone in plan.drones)
    room = min(
        (float((np.linalg.norm((a - b) / stretch, axis=1)).min()) for a, b in itertools.combinations(places, 2)),
        default=np.inf,
    )
    most = (room - plan.clearance) / 2.0 - tube - _ROUNDING
    if most < _BODY_MIN:
        valid = f"{2.0 * (_BODY_MIN + tube) + plan.clearance:.3g} m, to plan how they go to their places"
        raise refusal("distance of two drones", round(room, 3), "m", f"at least {valid}")
    drones = [Asked(drone.name, ways[drone.name], min(drone.body, most), drone.yaw) for drone in plan.drones]
    mission = Mission(
        f"to {plan.name}", tuple(drones), plan.certificate, plan.limits, replace(bounds, lower=lower, upper=upper),
        replace(plan.drones[0].tube, radius=tube), downwash=plan.downwash, clearance=plan.clearance,
        obstacles=plan.obstacles,
    )  # fmt: skip
    until = time.monotonic() + _PATIENCE
    return PreparedPlan.of(finished(mission, next(iter(rounds(mission, lambda: time.monotonic() > until)))))


def main() -> None:
    """Plan the move on the standard input."""
    try:
        found: PreparedPlan | str = first_proved(pickle.load(sys.stdin.buffer))
    except FlatsatError as error:
        found = str(error)
    pickle.dump(found, sys.stdout.buffer)


if __name__ == "__main__":
    main()
