"""Plans: whatever is loaded is proved, and its references are finite; the hash is made to fit, as a forger would."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube
from flatsat_ros.plans.plan import BYTES_MAX, _digest
from fuzzing.damage import damaged
from fuzzing.kind import Attempt, Kind, require_one_line, rewrite


def _curve(y: float) -> Curve:
    """One metre from rest to rest in 6 s."""
    share = np.clip((np.arange(9) - 3) / 2, 0, 1)
    way = share**3 * (10 - 15 * share + 6 * share**2)
    return Curve.rounded([1_500_000 * i for i in range(5)], np.outer(way, [1.0, 0.0, 0.0]) + [0.0, y, 1.0])


def _example() -> str:
    """The file of two drones that fly side by side."""
    certificate = load_certificate("paper_experiment")
    bounds = Bounds(margin=0.85, jerk_max=8.0, snap_max=80.0, lower=np.array([-3.0, -3.0, 0.0]), upper=np.full(3, 3.0))
    drones = [PlannedDrone(f"cf{i}", _curve(2.0 * i), 0.15, Tube(0.05)) for i in range(2)]
    made = Plan.of(drones, name="side", certificate=certificate.name, limits=certificate.limits, bounds=bounds)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "plan.yaml")
        made.save(file)
        return file.read_text(encoding="utf-8")


def _law(plan: Plan) -> None:
    plan.verify()
    for drone in plan.drones:
        for points in (drone.curve.points, drone.curve.knots):
            assert np.isfinite(np.array(points, dtype=float)).all()


@contextmanager
def _open(folder: Path) -> Iterator[Attempt]:
    path = folder / "plan.yaml"

    def attempt(data: bytes) -> bool:
        rewrite(path, data)
        with suppress(FlatsatError):
            document = read_yaml(path, BYTES_MAX)
            if isinstance(document, dict):
                rewrite(path, re.sub(rb"(?m)^hash: .*$", f"hash: {_digest(document)}".encode(), data))
        try:
            plan = Plan.load(path)
        except FlatsatError as refused:
            require_one_line(refused, path)
            return False
        _law(plan)
        return True

    yield attempt


PLAN = Kind(damaged(_example()), _open)
