"""What a row of the matrix must keep: bounds that are data, and the judgement of a flight by them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from flatsat_ros.falsification.faults.scene import Remark, Scene
from flatsat_ros.flight.supervisor import Mode

SEPARATION = 0.4  # m: drones never come nearer to each other
_SLOW = 0.3  # m/s: a drone that hovers
_ALOFT = 0.05  # m above the floor
_BYSTANDER = 0.5  # m: drones without a fault stay so near to their paths


class End(Enum):
    """How a flight may end for a drone; the value is what stands in the page."""

    DONE = "does what it was told"
    ALOFT = "keeps flying"
    DOWN = "stands, motors stopped"
    SAFE = "keeps flying or stands"
    GROUNDED = "never takes off"


@dataclass(frozen=True)
class Bounds:
    """What the drones with a fault must keep.

    Attributes:
        end: how the flight may end. In a landing what keeps flying must land.
        impact: largest speed at which they may meet the floor, m/s.
        distance: farthest that they may get from their paths, sideways or above, m.
        told: regular expression of what must be told about each of them; empty for nothing.
        arrival: how near a drone must be to the end of its path to have done what it was told, m.
        separation: least distance of any two drones, m.
    """

    end: End
    impact: float = 1.0
    distance: float = 1.0
    told: str = ""
    arrival: float = 0.15
    separation: float = SEPARATION


def broken(
    scene: Scene, bounds: Bounds, victims: Sequence[int], remarks: Iterable[Remark], *, lands: bool
) -> Iterator[str]:
    """Yield which bounds a flight broke, each as a sentence; a figure that is not a number breaks its bound.

    Args:
        scene: the flight, at its end.
        bounds: of the drones with a fault; those without have narrower ones.
        victims: the drones with a fault.
        remarks: what was told since the fault.
        lands: the drones were on their way to the floor.
    """
    if scene.failure:
        yield f"the controller ended: {scene.failure}"
    bystanders = Bounds(End.ALOFT, distance=_BYSTANDER)
    remarks, record = list(remarks), scene.record
    for drone in range(scene.fleet.count):
        own = bounds if drone in victims else bystanders
        name = f"drone {drone}"
        if record.met[drone] and not record.impact[drone] <= own.impact:
            yield f"{name} met the floor at {record.impact[drone]:.2f} m/s"
        if not record.distance[drone] <= own.distance:
            yield f"{name} was {record.distance[drone]:.2f} m off its path"
        if not record.separation[drone] >= bounds.separation:
            yield f"{name} came within {record.separation[drone]:.2f} m of another"
        problem = _end(scene, drone, own, lands=lands)
        if problem:
            yield f"{name} {problem}"
        texts = [remark.text for remark in remarks if remark.drone == drone]
        if drone in victims and own.told and not any(re.search(own.told, text, re.IGNORECASE) for text in texts):
            yield f"nothing was told of {name} that matches {own.told!r}"


def _end(scene: Scene, drone: int, bounds: Bounds, *, lands: bool) -> str:
    """Return what is wrong with the end of a drone's flight, empty for nothing."""
    bodies, record, mode, wanted = scene.fleet.bodies, scene.record, scene.mode[drone], bounds.end
    grounded = bool(bodies.grounded[drone])
    off = float(np.linalg.norm(bodies.position[drone] - record.paths[drone][-1]))
    # IDLE: somebody else flies it
    steered = mode in (Mode.FLY, Mode.IDLE)
    hovers = not grounded and steered and float(np.linalg.norm(bodies.velocity[drone])) <= _SLOW
    stands = grounded and scene.fleet.power.ratio[drone] == 0.0 and not record.relaunched[drone]
    if wanted is End.GROUNDED:
        return "" if grounded and record.height[drone] <= _ALOFT else f"rose to {record.height[drone]:.2f} m"
    if wanted is End.DOWN or (lands and wanted in (End.DONE, End.ALOFT)):
        return "" if stands else _state(scene, drone)
    if wanted is End.SAFE:
        return "" if stands or hovers else _state(scene, drone)
    if not hovers:
        return _state(scene, drone)
    return f"is {off:.2f} m from its goal" if wanted is End.DONE and not off <= bounds.arrival else ""


def _state(scene: Scene, drone: int) -> str:
    """Return in words how a drone ends."""
    mode = scene.mode[drone]
    again = " after it had risen from the floor again" if scene.record.relaunched[drone] else ""
    where = "on the floor" if scene.fleet.bodies.grounded[drone] else "in the air"
    motors = "motors on" if scene.fleet.power.ratio[drone] else "motors off"
    return f"ends {where}, {motors}, in {mode.name if mode else 'no mode'}{again}"
