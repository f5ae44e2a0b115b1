"""What people read: the page of the matrix, and the story of one of its flights."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from flatsat_ros.falsification.faults.criteria import Remark
from flatsat_ros.falsification.faults.fault import Fault
from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS, LiveFault
from flatsat_ros.falsification.faults.phases import PLANS, Phase
from flatsat_ros.falsification.faults.rows import LIVE, Row
from flatsat_ros.falsification.faults.scene import Scene
from flatsat_ros.falsification.faults.table import ACCEPTED, FAULTS
from flatsat_ros.flight.supervisor import Mode

_HEAD = """# Faults

Written by `ros2 run flatsat_ros faults`; edit the package, not this page.

Every fault happens in every phase of flight, on simulated time: the pilot that the controller runs, with certificate
`cf21_50hz`, vehicle profile `cf21` and the simulated drones with their firmware. What a row must keep was written down
before it was flown. One row again, moment by moment:

```sh
ros2 run flatsat_ros faults --replay poses_lost_1s:hover
```

A cell tells the largest speed at which a drone with the fault met the floor, m/s, and how far it got from its path,
sideways or above, m. **Bold** cells broke a bound.
"""


def page(rows: Sequence[Row]) -> str:
    """Return the page, in Markdown, of the rows flown."""
    found = {(row.fault, row.phase): row for row in rows}
    faults = [fault for fault in FAULTS.values() if any((fault.name, phase.value) in found for phase in Phase)]
    live = [fault for fault in LIVE_FAULTS.values() if (fault.name, LIVE) in found]
    parts = [_HEAD, summary(rows) + "\n"]
    if faults:
        head = ["fault", "what goes wrong", *(phase.value for phase in Phase)]
        cells = ([f"`{f.name}`", f.meaning, *(cell(found.get((f.name, p.value))) for p in Phase)] for f in faults)
        parts.append("## Results\n\n" + _table(head, cells))
        parts.append("When the fault happens:\n\n" + _table(["phase", "the drones"], _phases()))
    if live:
        cells = ([f"`{f.name}`", f.meaning, cell(found[f.name, LIVE])] for f in live)
        parts.append("## Real processes\n\n" + _LIVE + "\n" + _table(["fault", "what goes wrong", "hover"], cells))
    parts.append("## Bounds\n\n" + _BOUNDS + "\n" + _table(_BOUNDS_HEAD, (_bounds(fault) for fault in faults)))
    if live:
        parts.append(_table(_BOUNDS_HEAD, (_bounds(fault) for fault in live)))
    parts.append("## Accepted\n\n" + (_accepted(rows) or "None.\n"))
    broken = [row for row in rows if row.failed]
    if broken:
        parts.append(
            "## Failed\n\n" + "".join(f"- `{row.fault}:{row.phase}`: {'; '.join(row.broken)}\n" for row in broken)
        )
    return "\n".join(parts)


def summary(rows: Sequence[Row]) -> str:
    """Return in one sentence how many rows passed."""
    accepted, failed = sum(row.accepted for row in rows), sum(row.failed for row in rows)
    return f"{len(rows)} rows: {len(rows) - accepted - failed} passed, {accepted} accepted, {failed} failed."


def cell(row: Row | None) -> str:
    """Return the figures of a row: impact and distance."""
    if row is None:
        return ""
    impact, distance = (f"{value:.2f}" if value is not None else "-" for value in (row.impact_m_s, row.distance_m))
    text = f"{impact}, {distance}"
    return text if row.passed else f"{text} (accepted)" if row.accepted else f"**{text}**"


_LIVE = """`ros2 run flatsat_ros faults --live`: two drones hover; `sim_drone`, a relay with faults and `controller` are
processes of their own. The speed at the floor is that between two poses, 10 ms apart.
"""
_BOUNDS = """What drones with the fault must keep. Drones without it keep flying, or land in a landing, within 0.5 m of
their paths, and meet the floor at 1 m/s at most. No two drones come nearer than 0.4 m.
"""
_BOUNDS_HEAD = ["fault", "the drone", "impact m/s", "distance m", "must be told (regular expression)"]


def _bounds(fault: Fault | LiveFault) -> list[str]:
    """Return the row of a fault's bounds, those of single phases behind them."""
    bounds, special = fault.bounds, fault.special if isinstance(fault, Fault) else {}
    others = "".join(f"; {phase.value}: {other.end.value}" for phase, other in special.items())
    told = f"`{bounds.told}`".replace("|", "\\|") if bounds.told else ""
    return [f"`{fault.name}`", bounds.end.value + others, f"{bounds.impact:g}", f"{bounds.distance:g}", told]


def _phases() -> list[list[str]]:
    return [[phase.value, PLANS[phase].meaning] for phase in Phase]


def _accepted(rows: Iterable[Row]) -> str:
    reasons = ((row, ACCEPTED[row.fault, row.phase]) for row in rows if row.accepted)
    return "".join(f"- `{row.fault}:{row.phase}`: {'; '.join(row.broken)}. {reason}\n" for row, reason in reasons)


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
    lines.append(f"impact {row.impact_m_s} m/s, distance {row.distance_m} m, separation {row.separation_m} m")
    return "\n".join(lines + [f"BROKEN: {problem}" for problem in row.broken])


def _said(remark: Remark) -> str:
    return f"{remark.time:7.2f} {remark.drone:>5} {remark.text}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
