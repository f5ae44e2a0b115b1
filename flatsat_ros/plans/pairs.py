"""What a plan states of two drones, or of a drone and an obstacle: how far apart they always are, and its proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import IntArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.plans import tables
from flatsat_ros.plans.curve import NANOMETRE, UNIT
from flatsat_ros.plans.separation import Closest

DRONES_MAX = 150  # of a plan

_COLUMNS = (None, None, 4, 6, 6)
_ROWS_MAX = DRONES_MAX * DRONES_MAX
_STEP = 10**5  # nm: distances are stated in tenths of a millimetre, rounded down


class Pair(NamedTuple):
    """Two drones, or a drone and an obstacle.

    Attributes:
        first, second: their names.
        distance: 1e-4 m; references keep it always, in the downwash metric.
        start, end: us, an interval in which they are nearest.
    """

    first: str
    second: str
    distance: int
    start: int
    end: int


def stated(found: Closest, first: Sequence[str], second: Sequence[str]) -> tuple[Pair, ...]:
    """Return what a plan states of certified distances: they are rounded down.

    Args:
        found: the distances.
        first: names of those that come first in a pair.
        second: names of those that come second.
    """
    return tuple(
        Pair(first[i], second[j], distance * 10**9 // (_STEP * UNIT), math.floor(start * 1e6), math.ceil(end * 1e6))
        for i, j, distance, start, end in zip(
            *(values.tolist() for values in (found.first, found.second, found.distance, found.start, found.end)),
            strict=True,
        )
    )


def slacks(
    pairs: Sequence[Pair],
    required: Sequence[Fraction],
    why: str,
    proved: Callable[[IntArray | None], Closest],
) -> dict[str, float]:
    """Prove the stated distances, and that they are enough.

    Args:
        pairs: with what is stated.
        required: what each must keep, m.
        why: what that is made of.
        proved: proves distances, the goals, in units of `curve.UNIT`, or as much as it can without goals.

    Returns:
        By how much each stated distance is above what the pair must keep, m.

    Raises:
        FlatsatError: one does not hold or is not enough; the text names the pair, the time and by how much.
    """
    unit = _STEP * NANOMETRE
    goals = np.array([math.ceil(pair.distance * unit * UNIT) for pair in pairs], dtype=np.int64)
    found, left = proved(goals), {}
    for number, (pair, least) in enumerate(zip(pairs, required, strict=True)):
        distance, what = pair.distance * unit, f"'{pair.first}, {pair.second}: distance'"
        if found.distance[number] < goals[number]:
            exact = proved(None)
            raise FlatsatError(
                f"{what} is {exact.distance[number] / UNIT:.6g} m at t = {exact.start[number]:.4f} s: must be "
                f"{float(distance):.4f} m as stated"
            )
        if distance < least:
            valid = f"must be {float(least):.6g} m, {why}"
            raise FlatsatError(f"{what} is {float(distance):.4f} m at t = {pair.start / 1e6:.4f} s: {valid}")
        left[f"{pair.first}, {pair.second}: distance (m)"] = float(distance - least)
    return left


def written(pairs: Sequence[Pair]) -> str:
    """Return a table of pairs."""
    return tables.written(pairs, _COLUMNS)


def read(name: str, text: object) -> tuple[Pair, ...]:
    """Return the pairs of a table called `name`.

    Raises:
        FlatsatError: it is none.
    """
    rows = tables.read(name, text, _COLUMNS, _ROWS_MAX)
    return tuple(Pair(str(first), str(second), *map(int, figures)) for first, second, *figures in rows)
