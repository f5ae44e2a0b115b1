"""How short a mission is with a limit of the speed along each axis by itself, as lsc_planner has it.

`plan --speed-max` bounds the norm of the velocity. Here the penalty of the search, and what is proved beside all else,
are limits of the axes: control points of the velocity, which hold it between them, keep them along x, y and z.

    .venv/bin/python bench/axis_speed.py square16.json [--speed M_S] [--seconds S]
"""

from __future__ import annotations

import argparse
import math
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
from flatsat_ros.planning import Mission, Wishes, improvement, read_mission, rounds, search
from flatsat_ros.planning.penalties import Penalty
from flatsat_ros.plans import Curve
from flatsat_ros.plans.curve import DEGREE, UNIT

_DIAGONAL = math.sqrt(2.0)  # of the norm that both axes of a level way have together


def axis_speed(curves: tuple[Curve, ...]) -> float:
    """Return the largest control point of a velocity along one axis, m/s; rounded by 1e-9."""
    return max(float(np.abs(curve.fixed(1).astype(np.float64)).max()) / UNIT for curve in curves)


def bound_axes(speed: float) -> None:
    """Let searches and proofs of this process bound the speed along each axis, m/s, instead of by the norm."""
    shorten, broken_limit = search.shorten, improvement.broken_limit

    def shorten_axes(vectors: FloatArray, room: float, slopes: FloatArray, spans: list[int]) -> Penalty:
        if len(vectors) != DEGREE * spans[0]:  # no velocities
            return shorten(vectors, room, slopes)
        sizes = np.abs(vectors) * _DIAGONAL
        beyond = np.maximum(sizes - (1.0 - room), 0.0)
        slopes[:] = 2.0 * _DIAGONAL * beyond * np.sign(vectors)
        return Penalty(float((beyond * beyond).sum()), float(beyond.max()) / room)

    def broken(mission: Mission, curves: tuple[Curve, ...]) -> str | None:
        most = axis_speed(curves)
        return f"{most:.4f} m/s along an axis" if most > speed else broken_limit(mission, curves)

    def settle(own: search.Search, *arguments: object) -> tuple[FloatArray, bool]:
        spans = [len(own.swarm.shapes.lengths)]
        search.shorten = lambda vectors, room, slopes: shorten_axes(vectors, room, slopes, spans)
        return plain(own, *arguments)

    plain = search.Search.settle
    search.Search.settle = settle
    improvement.broken_limit = broken


def main() -> None:
    """Print a line for each plan that is proved."""
    parser = argparse.ArgumentParser()
    parser.add_argument("mission", type=Path)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=15.0)
    given = parser.parse_args()
    certificate = load_certificate(DEFAULT_CERTIFICATE)
    mission = read_mission(given.mission, certificate, Wishes(speed_max=_DIAGONAL * given.speed), given.mission.stem)
    bound_axes(given.speed)
    begin = time.process_time()
    for proved in rounds(mission, lambda: time.process_time() - begin > given.seconds):
        took, most = time.process_time() - begin, axis_speed(proved.curves)
        print(f"{proved.duration:.3f} s, bound {proved.bound:.3f} s, {most:.4f} m/s, after {took:.1f} s", flush=True)


if __name__ == "__main__":
    main()
