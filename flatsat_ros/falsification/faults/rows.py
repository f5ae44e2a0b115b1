"""The rows of the matrix: one fault in one phase, flown and judged."""

from __future__ import annotations

import json
import math
from collections.abc import Generator, Iterable, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.base.errors import one_line
from flatsat_ros.base.files import located, read_text, write_text
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE
from flatsat_ros.falsification.faults.accepted import is_accepted
from flatsat_ros.falsification.faults.criteria import DroneOutcome, Remark, broken
from flatsat_ros.falsification.faults.fault import Fault
from flatsat_ros.falsification.faults.phases import PLANS, STANDING, Phase
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.falsification.faults.table import EXISTING, FAULTS
from flatsat_ros.falsification.workers import results_of
from flatsat_ros.flight.modes import AIRBORNE

SEED = 1
_RESTING = 4.0  # s after which drones that stand on the floor are not watched any more
_SLICE = 0.5  # s
_ROUNDING = 1e-6  # s, of the times of ticks
_PER_METRE = 5.0  # s more for every metre above the first
_REMARKS = 6  # of a row, at most
_BYTES_MAX = 10_000_000


@dataclass(frozen=True)
class Row:
    """What came of one fault in one phase.

    Attributes:
        fault, phase: which.
        passed: all bounds were kept.
        accepted: one was not, and the page says what happens then and what a user must do.
        impact_m_s: largest speed at which a drone with the fault met the floor; None if none did.
        distance_m: farthest that one of them was from its path; None if that is not a finite number.
        said: what was told about them since the fault.
        seed: of everything random.
        separation_m: least distance of any two drones in the air; None if there was none.
        broken: the bounds that were broken, as sentences.
        certificate: name of that which was flown.
    """

    fault: str
    phase: str
    passed: bool
    accepted: bool
    impact_m_s: float | None
    distance_m: float | None
    said: list[str]
    seed: int
    separation_m: float | None
    broken: list[str]
    certificate: str

    @property
    def failed(self) -> bool:
        """Whether it broke a bound, and nothing says why it may."""
        return not (self.passed or self.accepted)


def fly_rows(
    wanted: Sequence[tuple[str, Phase]], workers: int, certificate: str = DEFAULT_CERTIFICATE
) -> Generator[Row]:
    """Yield the rows of faults in phases, in their order.

    Args:
        wanted: names of faults, each with a phase.
        workers: number of processes.
        certificate: that is flown: a packaged name or a path.
    """
    yield from results_of(partial(_row, certificate=certificate), wanted, workers)


def _row(which: tuple[str, Phase], certificate: str) -> Row:
    return fly_row(*which, certificate=certificate)


def fly_row(name: str, phase: Phase, seed: int = SEED, certificate: str = DEFAULT_CERTIFICATE) -> Row:
    """Fly one row.

    Args:
        name: of the fault.
        phase: in which it begins.
        seed: of all that is drawn.
        certificate: that is flown: a packaged name or a path.
    """
    fault = FAULTS[name]
    if fault.fleet or _is_early(fault, phase):
        return replay(name, phase, seed, certificate)[0]
    return _finish(name, phase, deepcopy(_reached(phase, fault.height, seed, certificate)))


def replay(name: str, phase: Phase, seed: int = SEED, certificate: str = DEFAULT_CERTIFICATE) -> tuple[Row, Scene]:
    """Fly one row from its beginning, and return it with its flight, whose moments are kept.

    The arguments are those of `fly_row`.
    """
    fault = FAULTS[name]
    scene = Scene(PLANS[phase].starts, seed, keep=True, certificate=certificate, **fault.fleet)
    if not _is_early(fault, phase):
        _reach(phase, scene, fault.height)
        return _finish(name, phase, scene), scene
    begin = STANDING + (fault.since_take_off or 0.0)
    _plan(scene, fault, begin)
    _reach(phase, scene, fault.height)
    return _judged(name, phase, scene, begin), scene


def _is_early(fault: Fault, phase: Phase) -> bool:
    """Tell whether a fault begins before the drones have risen."""
    return phase is Phase.TAKE_OFF and fault.since_take_off is not None


@cache
def _reached(phase: Phase, height: float, seed: int, certificate: str) -> Scene:
    """Return a flight at the moment of the fault: the same for every fault that is not there before."""
    scene = Scene(PLANS[phase].starts, seed, certificate=certificate)
    _reach(phase, scene, height)
    return scene


def _reach(phase: Phase, scene: Scene, height: float) -> None:
    with np.errstate(all="ignore"):  # what is not finite is judged, not warned of
        scene.let_pass(STANDING)
        PLANS[phase].reach(scene, height)


def _finish(name: str, phase: Phase, scene: Scene) -> Row:
    """Let the fault happen now."""
    begin = scene.time
    _plan(scene, FAULTS[name], begin)
    return _judged(name, phase, scene, begin)


def _plan(scene: Scene, fault: Fault, begin: float) -> None:
    scene.plan(begin, lambda scene: scene.record.forget_touches())
    for delay, action in fault.steps:
        scene.plan(begin + delay, action)


def _watch(scene: Scene, fault: Fault, begin: float) -> None:
    """Fly on until nothing more is to be expected."""
    last = max(begin + max((delay for delay, _ in fault.steps), default=0.0), scene.time)
    end = last + fault.watched + _PER_METRE * max(fault.height - 1.0, 0.0)
    with np.errstate(all="ignore"):  # see _reach
        while scene.time < end and scene.time - max(scene.record.resting_since, last, scene.acted) < _RESTING:
            scene.let_pass(_SLICE)
            if scene.pilot is not None and np.isin(scene.pilot.mode, AIRBORNE).any():
                last = scene.time  # who is on the floor does not stand yet


def _judged(name: str, phase: Phase, scene: Scene, begin: float) -> Row:
    """Watch a flight since its fault to its end, and judge it."""
    fault = FAULTS[name]
    _watch(scene, fault, begin)
    if not fault.steps:
        begin = 0.0  # what was wrong from the first moment on may have been told of before
    victims = [drone for drone in fault.victims if drone < scene.fleet.count]
    bounds = fault.special.get(phase, fault.bounds)
    remarks = [remark for remark in scene.remarks if remark.time > begin - _ROUNDING]
    outcomes = scene.outcomes()
    problems = [f"the controller ended: {scene.failure}"] if scene.failure else []
    lands, shown = PLANS[phase].lands, scene.certificate.name
    problems += broken(outcomes, bounds, victims, remarks, lands=lands)
    judged = bool(problems) and not scene.failure
    accepted = judged and is_accepted(shown, name, phase.value, outcomes, victims, remarks, lands=lands)
    return row_of(name, phase.value, scene.seed, outcomes, victims, remarks, problems, shown, accepted=accepted)


def row_of(
    name: str,
    phase: str,
    seed: int,
    outcomes: Sequence[DroneOutcome],
    victims: Sequence[int],
    remarks: Iterable[Remark],
    problems: list[str],
    certificate: str,
    *,
    accepted: bool = False,
) -> Row:
    """Return the row of a flight.

    Args:
        name: of the fault.
        phase: of flight.
        seed: of everything random.
        outcomes: of all drones.
        victims: the drones with the fault.
        remarks: what was told since the fault.
        problems: the bounds that were broken.
        certificate: name of that which was flown.
        accepted: the bounds that were broken may be.
    """
    said = dict.fromkeys(f"drone {remark.drone}: {remark.text}" for remark in remarks if remark.drone in victims)
    own = [outcomes[drone] for drone in victims]
    return Row(
        fault=name,
        phase=phase,
        passed=not problems,
        accepted=accepted,
        impact_m_s=max((_rounded(outcome.impact) or 0.0 for outcome in own if outcome.met), default=None),
        distance_m=_rounded(float(np.max([outcome.distance for outcome in own], initial=-np.inf))),
        said=list(said)[:_REMARKS],
        seed=seed,
        separation_m=_rounded(float(np.min([outcome.separation for outcome in outcomes], initial=np.inf))),
        broken=problems,
        certificate=certificate,
    )


def _rounded(value: float) -> float | None:
    """Return a figure in millimetres or mm/s, None for one that is not finite."""
    return round(value, 3) if math.isfinite(value) else None


def merged(old: Iterable[Row], new: Iterable[Row]) -> list[Row]:
    """Return rows with new ones in the place of old ones of the same fault and phase, in the order of the matrix.

    Those whose fault is in the matrix no more are left out.
    """
    rows = {(row.fault, row.phase): row for row in (*old, *new)}
    return [rows[which] for which in EXISTING if which in rows]


def save(rows: Iterable[Row], path: Path) -> None:
    """Write rows as {"rows": [...]}.

    Raises:
        FlatsatError: the file cannot be written.
    """
    write_text(path, json.dumps({"rows": [asdict(row) for row in rows]}, indent=1, allow_nan=False) + "\n")


def load(path: Path) -> list[Row]:
    """Read what `save` wrote.

    Raises:
        FlatsatError: the file cannot be read or holds something else.
    """
    text = read_text(path, _BYTES_MAX)
    try:
        entries: list[dict[str, Any]] = json.loads(text)["rows"]
        return [Row(**entry) for entry in entries]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise located(path, f"must be a table that faults wrote: {one_line(str(error))}") from error
