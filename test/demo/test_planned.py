"""The demo flies plan files: from the floor below their first points, by the certificate that proves their tubes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path
from flatsat_ros.certificate.certificate import FLIGHT_CERTIFICATE, load_certificate
from flatsat_ros.demo import headless
from flatsat_ros.demo.scenario import planned
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube
from flatsat_ros.plans.tubes import certified_tube, default_bounds

CERTIFICATE = load_certificate(FLIGHT_CERTIFICATE)


@pytest.fixture(autouse=True)
def loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its proof takes seconds: once is enough."""
    found = CERTIFICATE, config_path(FLIGHT_CERTIFICATE)
    monkeypatch.setattr("flatsat_ros.demo.scenario._default_certificate", lambda: found)


def save(path: Path, *places: tuple[float, float, float]) -> Path:
    """A plan in which drones move by 0.3 m along y in 6 s."""
    margin, jerk, snap, _ = default_bounds(CERTIFICATE)
    share = np.clip((np.arange(13) - 3) / 6, 0.0, 1.0)[:, np.newaxis]
    moved = share * share * (3 - 2 * share) * np.array([0.0, 0.3, 0.0])
    assert CERTIFICATE.flight is not None
    tube: Tube = certified_tube(CERTIFICATE.flight, jerk, snap, 2.0)
    curves = [Curve.rounded([750_000 * i for i in range(9)], np.array(place) + moved) for place in places]
    drones = [PlannedDrone(f"cf{i}", curve, 0.1, tube) for i, curve in enumerate(curves, 1)]
    bounds = Bounds(margin, jerk, snap, np.array([-1.0, -1.0, 0.0]), np.array([3.0, 1.0, 3.0]))
    Plan.of(drones, name="b", certificate=CERTIFICATE.name, limits=CERTIFICATE.limits, bounds=bounds).save(path)
    return path


def test_a_plan_is_flown_within_its_tubes(tmp_path: Path) -> None:
    scenario = planned(save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6)))
    flown = headless.fly(scenario)
    (record,) = flown.robots.values()
    begin, end = flown.swap
    during = (record.poses[:, 0] > begin) & (record.poses[:, 0] < end)
    errors = [np.linalg.norm(pose[1:] - record.reference.sample(pose[0])[:3]) for pose in record.poses[during]]
    assert len(errors) > 500
    assert max(errors) < CERTIFICATE.flight.vertical.tube.position  # type: ignore[union-attr]


def test_drones_that_would_stand_too_near_to_each_other_are_named(tmp_path: Path) -> None:
    path = save(tmp_path / "plan.yaml", (0.0, 0.0, 0.6), (0.1, 0.0, 2.0))
    with pytest.raises(FlatsatError, match=r"distance of cf1 and cf2 on the floor below .* = 0.1 m: must be"):
        planned(path)
