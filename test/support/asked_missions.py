"""Missions that tests plan, and the limits that they are for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.certificate.certificate import load_certificate
from flatsat_ros.planning import Asked, Mission
from flatsat_ros.plans import Bounds, Tube

CERTIFICATE = load_certificate("paper_experiment")
LIMITS = CERTIFICATE.limits
BOUNDS = Bounds(0.85, 2.0, 20.0, np.array([-3.0, -3.0, 0.0]), np.array([3.0, 3.0, 2.0]))
DRAGGED = replace(BOUNDS, drag=(0.9, 0.6), lead=(0.2, 0.3))
WAY = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.2, 0.5, 1.0], [1.0, -0.7, 0.6]])


def mission(*ways: Sequence[Sequence[float]], **others: Any) -> Mission:
    drones = tuple(Asked(f"cf{i + 1}", np.array(way, dtype=float)) for i, way in enumerate(ways))
    asked: dict[str, Any] = {
        "name": "test", "certificate": CERTIFICATE.name, "limits": LIMITS, "bounds": BOUNDS, "tube": Tube(0.05)
    }  # fmt: skip
    return Mission(drones=drones, **asked | others)


def antipodal(count: int, radius: float = 1.5) -> list[list[list[float]]]:
    angles = 2 * np.pi * np.arange(count) / count
    places = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.ones(count)], axis=1)
    return [[place.tolist(), (place * [-1, -1, 1]).tolist()] for place in places]


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path
