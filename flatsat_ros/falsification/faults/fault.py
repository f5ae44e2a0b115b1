"""One fault of the matrix: what happens when, to whom, and what the drones must keep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from flatsat_ros.falsification.faults.criteria import Criteria
from flatsat_ros.falsification.faults.phases import STANDING, Phase, land_all
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.sim.faults import CommandFault, PoseFault, of_drones

Action = Callable[[Scene], None]

ONE = (0,)  # the drone that has the fault
ALL = (0, 1, 2)
EARLY = -STANDING
_FLOWN = 14.0  # s, to the landing of drones that had the fault before they took off


@dataclass(frozen=True, eq=False)
class Fault:
    """Something that goes wrong.

    Attributes:
        name: on the command line.
        meaning: what goes wrong, in words.
        steps: what happens, with the time since the beginning of the fault, s, in order.
        bounds: what the drones with the fault must keep.
        special: bounds in some phases instead.
        victims: the drones with the fault.
        fleet: arguments of the Scene: what is wrong from the first moment on.
        since_take_off: in the take-off it begins so long after the drones were told to rise, s, EARLY for anything that
            was set up wrong; None: when they have risen a little.
        height: of the flight, m.
        watched: for how long after the last step the drones are watched, s.
        phases: in which it is flown.
    """

    name: str
    meaning: str
    steps: tuple[tuple[float, Action], ...]
    bounds: Criteria
    special: Mapping[Phase, Criteria] = field(default_factory=dict)
    victims: tuple[int, ...] = ONE
    fleet: Mapping[str, Any] = field(default_factory=dict)
    since_take_off: float | None = None
    height: float = 1.0
    watched: float = 10.0
    phases: tuple[Phase, ...] = tuple(Phase)


def poses(make: Callable[[Scene], PoseFault], victims: tuple[int, ...] = ONE) -> Action:
    """Return the action that begins a fault of the victims' poses."""
    return lambda scene: scene.link.poses.append(of_drones(make(scene), *victims))


def commands(make: Callable[[Scene], CommandFault]) -> Action:
    """Return the action that begins a fault of the commands."""
    return lambda scene: scene.link.commands.append(make(scene))


def end(scene: Scene) -> None:
    """End all faults of poses and commands."""
    scene.link.poses.clear()
    scene.link.commands.clear()


def from_the_start(name: str, meaning: str, fault: Action, bounds: Criteria, **more: Any) -> Fault:
    """Return a fault that begins before the take-off; the drones fly with it, and are told to land.

    Args:
        name: on the command line, to which an ending is added.
        meaning: what goes wrong, in words.
        fault: begins it, for all drones.
        bounds: what they must keep.
        more: of `Fault`, what is other than by default.
    """
    given = {"victims": ALL, "since_take_off": EARLY, "phases": (Phase.TAKE_OFF,), **more}
    steps = ((0.0, fault), (_FLOWN, land_all))
    return Fault(f"{name}_from_start", f"{meaning}, from before the take-off on", steps, bounds, **given)
