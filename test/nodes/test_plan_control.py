"""The plan of a controller node: its parameter, its services, and what they refuse."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from rclpy.parameter import Parameter
from room import Room, rooms

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.plans import Bounds, Curve, Plan, PlannedDrone, Tube

pytestmark = pytest.mark.in_process

PLACES = ((0.0, 0.0, 0.8), (1.0, 0.0, 0.8))


def save(room: Room, path: Path, *names: str) -> str:
    """A plan in which drones move along y, 1 m apart."""
    certificate = room.node._certificate
    share = np.clip((np.arange(13) - 3) / 6, 0.0, 1.0)[:, np.newaxis]
    moved = share * share * (3 - 2 * share) * np.array([0.0, 0.4, 0.0])
    ways = [Curve.rounded([500_000 * i for i in range(9)], np.array(place) + moved) for place in PLACES[: len(names)]]
    drones = [PlannedDrone(name, way, 0.1, Tube(0.1)) for name, way in zip(names, ways, strict=True)]
    bounds = Bounds(0.3, 5.0, 60.0, np.array([-1.0, -1.0, 0.0]), np.array([3.0, 1.0, 2.0]))
    plan = Plan.of(drones, name="test", certificate=certificate.name, limits=certificate.limits, bounds=bounds)
    plan.save(path)
    return str(path)


@contextmanager
def opened(*arguments: str) -> Iterator[Room]:
    with rooms() as make:
        yield make(*arguments)


@pytest.fixture
def room() -> Iterator[Room]:
    with opened() as room:
        yield room


def set_plan(room: Room, value: str) -> str:
    (result,) = room.node.set_parameters([Parameter("plan", value=value)])
    return "" if result.successful else result.reason


def await_process(room: Room) -> None:
    end = time.monotonic() + 30.0
    while room.node._plans.state == "a plan is being verified":
        assert time.monotonic() < end
        time.sleep(0.05)
        room.node._plans._look_at_process()


def test_a_plan_is_verified_beside_the_flight_flown_paused_and_held(room: Room, tmp_path: Path) -> None:
    assert room.ask("plan/start").message == "plan/start refused: no plan is set: set the parameter plan"
    room.run(0.5)
    assert set_plan(room, save(room, tmp_path / "plan.yaml", "cf1", "cf2")) == ""
    assert "a plan is being verified" in room.ask("plan/start").message
    await_process(room)
    answer = room.ask("plan/start")
    assert answer.success, answer.message
    end = time.monotonic() + 60.0
    while room.node._plans.state == "plan 'test': gathering":  # as a process of its own plans
        assert time.monotonic() < end
        room.run(0.5)
        time.sleep(0.05)
    assert room.node._plans._planning is not None
    assert room.node._plans.state == "plan 'test': flying"
    assert "abort it first" in set_plan(room, "")
    assert room.ask("plan/pause").success
    room.run(5.0)
    assert room.node._plans.state == "plan 'test': paused"
    assert room.ask("plan/resume").success
    room.run(12.0)
    assert room.node._plans.state == "plan 'test': flown to its end"
    assert np.abs(room.fleet.bodies.position - PLACES - [0.0, 0.4, 0.0]).max() < 0.1
    assert not room.ask("plan/abort").success


def test_files_that_are_no_plans_for_these_drones_are_refused(room: Room, tmp_path: Path) -> None:
    assert "must be the path of a plan file" in set_plan(room, str(tmp_path / "missing.yaml"))
    assert "must be the path of a plan file" in set_plan(room, "~nobody_at_all/plan.yaml")
    assert "File name too long" in set_plan(room, "a" * 5000)
    (tmp_path / "bent.yaml").write_text("flatsat_plan: 1\n")
    assert set_plan(room, str(tmp_path / "bent.yaml")) == ""
    await_process(room)
    assert "missing" in str(room.node.faults.newest("plan"))
    assert set_plan(room, save(room, tmp_path / "other.yaml", "cf9")) == ""
    await_process(room)
    assert "must be one of cf1, cf2" in str(room.node.faults.newest("plan"))
    assert "no plan is set" in room.ask("plan/start").message


def test_a_plan_given_at_the_start_is_proved_before_anything_flies(tmp_path: Path) -> None:
    with opened() as room:
        path = save(room, tmp_path / "plan.yaml", "cf1")
    with opened("-p", f"plan:={path}") as room:
        assert room.node._plans.state == "plan 'test': ready"
    bent = tmp_path / "bent.yaml"
    bent.write_text(Path(path).read_text().replace("clearance: 0.0", "clearance: 0.5"))
    with pytest.raises(FlatsatError, match="hash"), opened("-p", f"plan:={bent}"):
        pass


def test_a_process_that_cannot_be_had_is_told_and_the_flight_goes_on(
    room: Room, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    path = save(room, tmp_path / "plan.yaml", "cf1", "cf2")
    monkeypatch.setattr("flatsat_ros.nodes.plan_control.subprocess.Popen", refuse)
    assert set_plan(room, path) == ""
    assert "Resource temporarily unavailable" in room.node.faults.newest("plan")
    assert room.ask("plan/start").message == "plan/start refused: no plan is set: set the parameter plan"
    room.run(0.1)
