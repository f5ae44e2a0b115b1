"""What a row of the matrix must keep: bounds that are data, and the judgement of a flight by them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from flatsat_ros.flight.modes import Mode

SEPARATION = 0.4  # m: drones never come nearer to each other
RISEN = 0.05  # m above the floor: a drone is off it
_BYSTANDER = 0.5  # m: drones without a fault stay so near to their paths


class Remark(NamedTuple):
    """Something that the pilot told.

    Attributes:
        time: s since the beginning of the flight.
        drone: whom it is about.
        text: what it told.
    """

    time: float
    drone: int
    text: str


class End(Enum):
    """How a flight may end for a drone; the value is what stands in the page."""

    DONE = "does what it was told"
    ALOFT = "keeps flying"
    DOWN = "stands, motors stopped"
    SAFE = "keeps flying or stands"
    GROUNDED = "never takes off"


@dataclass(frozen=True)
class Criteria:
    """What the drones with a fault must keep.

    Attributes:
        end: how the flight may end. In a landing what keeps flying must land.
        impact: largest speed at which they may meet the floor, m/s.
        distance: farthest that they may get from their paths, sideways or above, m.
        told: regular expression of what must be told about each of them; empty for nothing.
        speed: fastest that they may be when they keep flying, m/s.
        arrival: how near a drone must be to the end of its path to have done what it was told, m.
        separation: least distance of any two drones, m.
        again: they may rise from the floor again before they stand.
    """

    end: End
    impact: float = 1.0
    distance: float = 1.0
    told: str = ""
    speed: float = 0.3
    arrival: float = 0.15
    separation: float = SEPARATION
    again: bool = False


@dataclass(frozen=True)
class DroneOutcome:
    """What came of the flight of one drone.

    Attributes:
        met: it met the floor.
        impact: largest speed at which it did, m/s.
        distance: farthest it was from its path, m.
        height: highest it was above the floor, m.
        separation: least distance to another drone while it was in the air, m.
        relaunched: it rose again after it had met the floor.
        grounded: in the end it is on the floor.
        motors: in the end they turn, or are told to.
        speed: in the end, m/s.
        off: how far it is from the end of its path in the end, m.
        mode: in the end; None if there is no controller.
    """

    met: bool
    impact: float
    distance: float
    height: float
    separation: float
    relaunched: bool
    grounded: bool
    motors: bool
    speed: float
    off: float
    mode: Mode | None

    def stands(self, *, again: bool) -> bool:
        """Tell whether it is on the floor, with its motors off; unless `again`, it must not have risen meanwhile."""
        return self.grounded and not self.motors and (again or not self.relaunched)

    def hovers(self, speed: float) -> bool:
        """Tell whether it is in the air, not faster than a speed, m/s, and steered, in IDLE by somebody else."""
        return not self.grounded and self.speed <= speed and self.mode in (Mode.FLY, Mode.IDLE)

    def describe(self) -> str:
        """Return in words how it ends."""
        again = " after it had risen from the floor again" if self.relaunched else ""
        where = "on the floor" if self.grounded else f"in the air at {self.speed:.2f} m/s"
        mode = self.mode.name if self.mode is not None else "no mode"
        return f"ends {where}, motors {'on' if self.motors else 'off'}, in {mode}{again}"


def broken(
    outcomes: Sequence[DroneOutcome],
    bounds: Criteria,
    victims: Sequence[int],
    remarks: Iterable[Remark],
    *,
    lands: bool,
) -> Iterator[str]:
    """Yield which bounds a flight broke, each as a sentence; a figure that is not a number breaks its bound.

    Args:
        outcomes: of all drones.
        bounds: of the drones with a fault; those without have narrower ones.
        victims: the drones with a fault.
        remarks: what was told since the fault.
        lands: the drones were on their way to the floor.
    """
    bystanders = Criteria(End.ALOFT, distance=_BYSTANDER)
    remarks = list(remarks)
    for drone, outcome in enumerate(outcomes):
        own = bounds if drone in victims else bystanders
        name = f"drone {drone}"
        if outcome.met and not outcome.impact <= own.impact:
            yield f"{name} met the floor at {outcome.impact:.2f} m/s"
        if not outcome.distance <= own.distance:
            yield f"{name} was {outcome.distance:.2f} m off its path"
        if not outcome.separation >= bounds.separation:
            yield f"{name} came within {outcome.separation:.2f} m of another"
        problem = _end(outcome, own, lands=lands)
        if problem:
            yield f"{name} {problem}"
        texts = [remark.text for remark in remarks if remark.drone == drone]
        if drone in victims and own.told and not any(re.search(own.told, text, re.IGNORECASE) for text in texts):
            yield f"nothing was told of {name} that matches {own.told!r}"


def _end(outcome: DroneOutcome, bounds: Criteria, *, lands: bool) -> str:
    """Return what is wrong with the end of a drone's flight, empty for nothing."""
    wanted, hovers, stands = bounds.end, outcome.hovers(bounds.speed), outcome.stands(again=bounds.again)
    if wanted is End.GROUNDED:
        return "" if outcome.grounded and outcome.height <= RISEN else f"rose to {outcome.height:.2f} m"
    if wanted is End.DOWN or (lands and wanted in (End.DONE, End.ALOFT)):
        return "" if stands else outcome.describe()
    if wanted is End.SAFE:
        return "" if stands or hovers else outcome.describe()
    if not hovers:
        return outcome.describe()
    return f"is {outcome.off:.2f} m from its goal" if wanted is End.DONE and not outcome.off <= bounds.arrival else ""
