"""What people read: the page of the matrix, and the story of one of its flights."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from math import inf

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE
from flatsat_ros.falsification.faults.accepted import ACCEPTED
from flatsat_ros.falsification.faults.criteria import Remark
from flatsat_ros.falsification.faults.fault import Fault
from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS, LiveFault
from flatsat_ros.falsification.faults.phases import PLANS, Phase
from flatsat_ros.falsification.faults.rows import Row
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.falsification.faults.table import FAULTS, LIVE
from flatsat_ros.flight.modes import Mode

_HEAD = """# Faults

What happens when something goes wrong around the controller. Written by `ros2 run flatsat_ros faults`, which flies
every fault in every phase of flight; edit the package, not this page.

The flights are on simulated time: the pilot that the controller runs, with certificate {certificate}, vehicle
profile `cf21` and the simulated drones with their firmware. What a row must keep was written down before it was flown,
but for take-offs that lose their poses: before the thrust has been learnt they may meet the floor at 1.5 m/s, with 10 %
of the thrust missing at 2 m/s, which was set after the first flights. One row again, moment by moment, and one with
real processes:

```sh
ros2 run flatsat_ros faults{option} --replay poses_lost_1s:hover
ros2 run flatsat_ros faults{option} --live --fault poses_lost_1s
```
"""
_RESULTS = """The worst over all phases: the largest speed at which a drone with the fault met the floor, and how far it
got from its path, sideways or above. What is said goes to the log, with the drone's name; here stands what was said
first, in a hover if anything was. **Bold**: a row broke a bound.
"""
_PHASES = """The largest speed at the floor, m/s, and the distance from the path, m, in each phase; bold as above.
"""
_LIVE = """`sim_drone`, a relay with faults and `controller` as processes of their own fly two drones, in real time, in
a hover. The speed at the floor is that between two poses, 10 ms apart.
"""
_BOUNDS = """What drones with the fault must keep. Drones without it keep flying, or land in a landing, within 0.5 m of
their paths, and meet the floor at 1 m/s at most. No two drones come nearer than 0.4 m.
"""
_RESULTS_HEAD = ["fault", "what goes wrong", "the drone", "impact m/s", "distance m", "what is said"]
_BOUNDS_HEAD = ["fault", "the drone", "impact m/s", "distance m", "must be told (regular expression)"]
_SAID = 90  # letters of a remark in the page


def page(rows: Sequence[Row]) -> str:
    """Return the page, in Markdown, of the rows flown."""
    found = {(row.fault, row.phase): row for row in rows}
    flown = {name for name, phase in found if phase != LIVE}
    faults = [fault for fault in FAULTS.values() if fault.name in flown]
    live = [fault for fault in LIVE_FAULTS.values() if (fault.name, LIVE) in found]
    parts = [_head(rows), summary(rows) + "\n"]
    if faults:
        worst = (_result(f, [found[f.name, p.value] for p in Phase if (f.name, p.value) in found]) for f in faults)
        parts.append("## Results\n\n" + _RESULTS + "\n" + _table(_RESULTS_HEAD, worst))
    if live:
        results = (_result(fault, [found[fault.name, LIVE]]) for fault in live)
        parts.append("## Real processes\n\n" + _LIVE + "\n" + _table(_RESULTS_HEAD, results))
    parts.append("## Accepted\n\n" + (_accepted(found) or "None: a user need do nothing else than what is said.\n"))
    broken = [row for row in rows if row.failed]
    if broken:
        lines = (f"- `{row.fault}:{row.phase}`: {'; '.join(row.broken)}\n" for row in broken)
        parts.append("## Failed\n\n" + "".join(lines))
    if faults:
        head = ["fault", *(phase.value for phase in Phase)]
        cells = ([f"`{f.name}`", *(cell(found.get((f.name, p.value))) for p in Phase)] for f in faults)
        parts.append("## Phase by phase\n\n" + _PHASES + "\n" + _table(head, cells))
        parts.append("When the fault happens:\n\n" + _table(["phase", "the drones"], _phases()))
    return "\n".join([*parts, bounds_of([*faults, *live])])


def _head(rows: Sequence[Row]) -> str:
    """Return the beginning of the page, with the certificate that was flown."""
    names = sorted({row.certificate for row in rows}) or [DEFAULT_CERTIFICATE]
    option = "" if names == [DEFAULT_CERTIFICATE] else " --certificate NAME_OR_PATH"
    return _HEAD.format(certificate=" and ".join(f"`{name}`" for name in names), option=option)


def bounds_of(faults: Iterable[Fault | LiveFault]) -> str:
    """Return the part of the page that tells the bounds."""
    return "## Bounds\n\n" + _BOUNDS + "\n" + _table(_BOUNDS_HEAD, (_bounds(fault) for fault in faults))


def summary(rows: Sequence[Row]) -> str:
    """Return in one sentence how many rows passed."""
    accepted, failed = sum(row.accepted for row in rows), sum(row.failed for row in rows)
    return f"{len(rows)} rows: {len(rows) - accepted - failed} passed, {accepted} accepted, {failed} failed."


def cell(row: Row | None) -> str:
    """Return the figures of a row: impact and distance."""
    return "" if row is None else _marked(f"{_figure(row.impact_m_s)}, {_figure(row.distance_m)}", [row])


def _result(fault: Fault | LiveFault, rows: Sequence[Row]) -> list[str]:
    """Return the worst of a fault's rows, and what was said first, in the first phase in which anything was."""
    impact = _figure(max((row.impact_m_s for row in rows if row.impact_m_s is not None), default=None))
    unknown = any(row.distance_m is None for row in rows)
    distance = _figure(None if unknown else max(row.distance_m or 0.0 for row in rows))
    said = next((row.said[0] for row in rows if row.said), "").partition(": ")[2]
    said = said if len(said) <= _SAID else f"{said[:_SAID].rstrip()} ..."
    said = said.replace("|", "\\|")
    ends = fault.bounds.end.value
    return [
        f"`{fault.name}`",
        fault.meaning,
        ends,
        _marked(impact, rows),
        _marked(distance, rows),
        said.replace("|", "\\|"),
    ]


def _marked(text: str, rows: Sequence[Row]) -> str:
    """Mark the figures of rows that broke a bound."""
    if any(row.failed for row in rows):
        return f"**{text}**"
    return f"{text} (accepted)" if any(row.accepted for row in rows) else text


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _bounds(fault: Fault | LiveFault) -> list[str]:
    """Return the row of a fault's bounds, those of single phases behind them."""
    bounds, special = fault.bounds, fault.special if isinstance(fault, Fault) else {}
    others = "".join(f"; {phase.value}: {other.end.value}" for phase, other in special.items())
    told = f"`{bounds.told}`".replace("|", "\\|") if bounds.told else ""
    return [f"`{fault.name}`", bounds.end.value + others, f"{bounds.impact:g}", f"{bounds.distance:g}", told]


def _phases() -> list[list[str]]:
    return [[phase.value, PLANS[phase].meaning] for phase in Phase]


def _accepted(found: Mapping[tuple[str, str], Row]) -> str:
    """Return what happens in the rows that are accepted, and what a user must do."""
    lines = []
    for entry in ACCEPTED:
        rows = [found[entry.fault, phase] for phase in entry.all_phases if (entry.fault, phase) in found]
        if broken := [row for row in rows if row.accepted]:
            where = ", ".join(row.phase for row in broken)
            fall = f", and meets the floor at {entry.bounds.impact:g} m/s at most" if entry.bounds.impact < inf else ""
            kept = f"It stays within {entry.bounds.distance:g} m of its path{fall}."
            lines.append(f"- `{entry.fault}` ({where}): {entry.happens} {kept} What to do: {entry.advice}\n")
            lines += [f"  - {row.phase}: {'; '.join(row.broken)}\n" for row in broken]
    return "".join(lines)


def history(row: Row, scene: Scene) -> str:
    """Return the story of one flight: every tick and every remark, then what came of it."""
    lines = [
        f"{row.fault}, {FAULTS[row.fault].meaning}; {row.phase}, seed {row.seed}",
        "    t s drone mode         position m             velocity m/s        roll  pitch deg thrust PWM",
    ]
    remarks = deque(scene.remarks)
    for moment in scene.moments or ():
        while remarks and remarks[0].time <= moment.time:
            lines.append(_said(remarks.popleft()))
        for drone, mode in enumerate(moment.mode):
            figures = "".join(f"{x:8.3f}" for x in (*moment.position[drone], *moment.velocity[drone]))
            sent = moment.command[drone]
            command = "" if sent is None else f"{sent.roll:7.2f}{sent.pitch:7.2f}    {sent.thrust:7.0f}"
            lines.append(f"{moment.time:7.2f} {drone:>5} {Mode(int(mode)).name:<7}{figures}{command}")
    lines += map(_said, remarks)
    verdict = "passed" if row.passed else "accepted" if row.accepted else "FAILED"
    came_to = (
        ("impact", row.impact_m_s, "m/s"),
        ("distance", row.distance_m, "m"),
        ("separation", row.separation_m, "m"),
    )
    # to the digits of the table
    told = (f"{name} -" if value is None else f"{name} {value} {unit}" for name, value, unit in came_to)
    lines.append(f"{verdict}: {', '.join(told)}")
    return "\n".join(lines + [f"BROKEN: {problem}" for problem in row.broken])


def _said(remark: Remark) -> str:
    return f"{remark.time:7.2f} {remark.drone:>5} {remark.text}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
