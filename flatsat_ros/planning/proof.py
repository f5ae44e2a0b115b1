"""Limits of references, proved with integers while a plan is made; and given references, slowed down to keep them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np

from flatsat_ros.base.arrays import IntArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.planning.mission import Mission
from flatsat_ros.planning.planner import Round
from flatsat_ros.plans import Closest, Curve, closest
from flatsat_ros.plans.curve import UNIT
from flatsat_ros.plans.separation import closest_to_boxes

_STEP = 1e-3  # of the factor by which references from elsewhere are slowed down
_SLOWEST = 100.0


def broken_limit(mission: Mission, curves: tuple[Curve, ...]) -> str | None:
    """Prove with integers what is asked of the references; return what cannot be proved, or None."""
    for drone, curve in zip(mission.drones, curves, strict=False):
        for claim in mission.bounds.claims(curve, mission.limits):
            if claim.slack < 0.0:
                return f"{drone.name}: {claim.name} by {-claim.slack:.4g} {claim.unit} at about t = {claim.time:.4g} s"
    names = [drone.name for drone in mission.drones]
    return _too_near(
        [(names[i], names[j], _asked(mission, i, j)) for i, j in itertools.combinations(range(len(curves)), 2)],
        lambda goals: closest(curves, mission.downwash, goals),
    ) or _too_near(
        [(name, box.name, _asked(mission, i)) for i, name in enumerate(names) for box in mission.obstacles],
        lambda goals: closest_to_boxes(curves, mission.obstacles, mission.downwash, goals),
    )  # fmt: skip


def _too_near(pairs: Sequence[tuple[str, str, Fraction]], proved: Callable[[IntArray | None], Closest]) -> str | None:
    """Prove distances that are asked for, of two names each, m; return the first that cannot be proved, or None."""
    asked = np.array([math.ceil(distance * UNIT) for *_, distance in pairs], dtype=np.int64)
    missed = np.flatnonzero(proved(asked).distance < asked)
    if not missed.size:
        return None
    exact, number = proved(None), int(missed[0])
    return (
        f"{pairs[number][0]}, {pairs[number][1]}: distance {exact.distance[number] / UNIT:.4g} m at about t = "
        f"{exact.start[number]:.4g} s, {asked[number] / UNIT:.4g} m are asked for"
    )


def _asked(mission: Mission, *drones: int) -> Fraction:
    """Return the distance that drones must keep, m, enlarged by what the rounding of stated distances may take off."""
    radii = sum(Fraction(mission.drones[i].body) + Fraction(mission.tube.radius) for i in drones)
    return radii + Fraction(mission.clearance) + Fraction(3, 10**4)


def retimed(mission: Mission) -> Round:
    """Return the references that are given, slowed down together as little as their limits ask for.

    Raises:
        FlatsatError: a limit fails at every pace, or a distance does.
    """
    given = [drone.given for drone in mission.drones if drone.given is not None]

    def slowed(factor: float) -> tuple[Curve, ...]:
        knots = [[round(factor * knot) for knot in curve.knots] for curve in given]
        return tuple(Curve(tuple(own), curve.points, curve.degree) for own, curve in zip(knots, given, strict=True))

    def limited(factor: float) -> str:
        """The first limit that more time would help."""
        for drone, curve in zip(mission.drones, slowed(factor), strict=True):
            for claim in mission.bounds.claims(curve, mission.limits):
                if claim.slack < 0.0 and not claim.name.startswith("box"):
                    return f"{drone.name}: {claim.name}"
        return ""

    low, high, why = 1.0, 1.0, limited(1.0)
    while limited(high) and high < _SLOWEST:
        low, high = high, 2.0 * high
    while high - low > _STEP:
        middle = (low + high) / 2.0
        if limit := limited(middle):
            low, why = middle, limit
        else:
            high = middle
    curves = slowed(high)
    note = f"slowed down {high:.3f} times because of {why}" if high > 1.0 else "as given"
    if broken := broken_limit(mission, curves):
        raise FlatsatError(f"polynomials, {note}: {broken}")
    return Round(curves, max(curve.duration for curve in curves), note=note)
