"""The phases of a flight in which faults happen: who flies where, and what the flight is like when the fault begins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.planning.spline import spline_through

STANDING = 1.0  # s on the floor before the take-off
_SETTLING = 12.0  # s from the take-off to a hover in which the thrust has been learnt
# of the height of the flight, but at most m: a drone that is so high has begun to climb; the latest time for it, s
_RISEN, _RISEN_MOST, _RISEN_LATEST = 0.5, 0.25, 6.0
_SLICE = 0.1  # s
_WAY = (0.0, 2.0, 0.0)  # m, of a drone that moves
_MOVING = 1.2  # s on the way
_SINKING = 1.0  # s since the landing began
_LEG_TIME = 4.0  # s, of the swap, from one place to the next
_SWAPPING = 1.5  # legs
_PAIR = np.array([[0.0, 0.0], [1.0, 0.0]])  # m: two drones as far apart as the default start positions
_TRIANGLE = np.array([[0.0, 0.0], [1.25, 0.0], [0.625, 1.08]])  # m: three drones that swap places


class Phase(Enum):
    """When a fault begins; the value is its name on the command line."""

    HOVER = "hover"
    MOVING = "moving"
    TAKE_OFF = "take-off"
    LANDING = "landing"
    SWAP = "swap"


@dataclass(frozen=True, eq=False)
class PhaseSetting:
    """What a phase is like.

    Attributes:
        meaning: what the drones are doing.
        starts: (N, 2) where they stand at first, m.
        reach: flies a scene from the standing drones to the moment of the fault; gets the height of the flight, m.
        lands: the drones are on their way to the floor.
    """

    meaning: str
    starts: FloatArray
    reach: Callable[[Scene, float], None]
    lands: bool = False


def _take_off(scene: Scene, height: float) -> None:
    for drone in range(scene.fleet.count):
        scene.record.extend_path(drone, scene.place[drone] + (0.0, 0.0, height))
        scene.take_off(drone, height)


def _climb(scene: Scene, height: float) -> None:
    risen = scene.place[:, 2] + min(_RISEN * height, _RISEN_MOST)
    latest = scene.time + _RISEN_LATEST
    _take_off(scene, height)
    while scene.time < latest and not (scene.place[:, 2] >= risen).all():
        scene.let_pass(_SLICE)


def _hover(scene: Scene, height: float) -> None:
    _take_off(scene, height)
    scene.let_pass(_SETTLING)


def _move(scene: Scene, height: float) -> None:
    _hover(scene, height)
    for drone in range(scene.fleet.count):
        goal = scene.record.paths[drone][-1] + _WAY
        scene.record.extend_path(drone, goal)
        scene.go_to(drone, goal)
    scene.let_pass(_MOVING)


def land_all(scene: Scene) -> None:
    """Ask all drones to land."""
    for drone in range(scene.fleet.count):
        scene.land(drone)


def _land(scene: Scene, height: float) -> None:
    _hover(scene, height)
    land_all(scene)
    scene.let_pass(_SINKING)


def _swap(scene: Scene, height: float) -> None:
    _hover(scene, height)
    places = [path[-1] for path in scene.record.paths]
    for drone in range(scene.fleet.count):
        corners = [places[(drone + leg) % len(places)] for leg in range(len(places) + 1)]
        swap = spline_through(corners, _LEG_TIME)
        times = np.linspace(0.0, float(swap.times[-1]), 16 * len(places) + 1)
        scene.record.extend_path(drone, *(swap.sample(time)[:3] for time in times))
        scene.ask(drone, lambda pilot, i=drone, path=swap: pilot.set_reference(i, path.shifted(scene.time)))  # type: ignore[misc]
    scene.let_pass(_SWAPPING * _LEG_TIME)


PLANS = {
    Phase.HOVER: PhaseSetting("two drones hover a metre apart", _PAIR, _hover),
    Phase.MOVING: PhaseSetting("two drones fly 2 m side by side", _PAIR, _move),
    Phase.TAKE_OFF: PhaseSetting("two drones have begun to climb", _PAIR, _climb),
    Phase.LANDING: PhaseSetting("two drones are landing", _PAIR, _land, lands=True),
    Phase.SWAP: PhaseSetting("three drones swap places, 1.25 m apart", _TRIANGLE, _swap),
}
