"""Where drones set out from: the places that they hold, or above the ground; who cannot set out is named."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.present_places import ABOVE, PresentPlaces, place_of, settled

pytestmark = pytest.mark.in_process


def row(mode: Mode, error: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> FloatArray:
    values = dict.fromkeys(FIELDS, 0.0) | {"mode": float(mode)}
    values |= dict(zip(("error_x", "error_y", "error_z"), error, strict=True))
    return np.array([values[name] for name in FIELDS])


def test_who_flies_sets_out_from_the_place_it_holds_and_who_is_on_the_ground_from_above() -> None:
    pose = np.array([1.0, 2.0, 1.03])
    assert place_of("cf1", pose, row(Mode.FLY, (0.01, -0.02, 0.03))) == pytest.approx([0.99, 2.02, 1.0])
    assert place_of("cf1", pose, row(Mode.IDLE, (9.0, 9.0, 9.0))) == pytest.approx([1.0, 2.0, 1.03 + ABOVE])
    with pytest.raises(FlatsatError, match="mode of cf1 = 'FALLEN': must be FLY, or on the ground"):
        place_of("cf1", pose, row(Mode.FALLEN))


def test_who_is_on_its_way_is_refused() -> None:
    still = [np.array([1.0, 2.0, 1.0 + 1e-3 * i]) for i in range(5)]
    assert settled("cf1", still) == pytest.approx([1.0, 2.0, 1.002])
    with pytest.raises(FlatsatError, match=r"way that cf1 made while it was looked at = 0.04.* must be at most 0.03 m"):
        settled("cf1", [still[0], still[0] + [0.04, 0.0, 0.0]])


def listener(poses: dict[str, list[FloatArray]], rows: dict[str, FloatArray]) -> Any:
    """As much of a node as listening needs."""
    queues = [deque(SimpleNamespace(position=tuple(place)) for place in each) for each in poses.values()]
    return SimpleNamespace(
        _poses=SimpleNamespace(look=lambda: None, queues=queues, take=lambda index: queues[index].popleft()),
        _robots=list(poses), _rows=rows, _heard={robot: [] for robot in poses}, _begun=100.0, places=None,
    )  # fmt: skip


def test_places_are_known_after_a_moment_of_listening_and_who_is_not_heard_is_named() -> None:
    place = np.array([1.0, 2.0, 1.0])
    node = listener({"cf1": [place], "cf2": [place + 1.0]}, {"cf1": row(Mode.FLY), "cf2": row(Mode.FLY)})
    PresentPlaces._listen(node, 101.0)
    assert node.places is None
    for queue, later in zip(node._poses.queues, (place, place + 1.0), strict=True):
        queue.append(SimpleNamespace(position=tuple(later)))
    PresentPlaces._listen(node, 102.0)
    assert {robot: found.tolist() for robot, found in node.places.items()} == {"cf1": [1, 2, 1], "cf2": [2, 3, 2]}
    deaf = listener({"cf1": [place], "cf2": [place]}, {"cf1": row(Mode.FLY)})
    PresentPlaces._listen(deaf, 101.0)
    with pytest.raises(FlatsatError, match=r"^cf2: no poses and telemetry within 10 s: the controller must run"):
        PresentPlaces._listen(deaf, 110.5)


def test_the_program_prints_places_or_why_it_has_none(capsys: pytest.CaptureFixture[str]) -> None:
    known: Any = SimpleNamespace(places={"cf1": np.array([1.0, 2.0, 0.5])}, refused="")
    PresentPlaces.finish(known)
    assert capsys.readouterr().out == '{"cf1": [1.0, 2.0, 0.5]}\n'
    known.places, known.refused = None, "cf1: why"
    PresentPlaces.finish(known)
    assert capsys.readouterr().err == "error: cf1: why\n"
