"""docs/flight_modes.md: the state table of a drone, printed from `flight.modes`. Run by `make docs`."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import fields
from inspect import cleandoc
from pathlib import Path

from flatsat_ros.flight.modes import CONDITIONS, TABLE, Mode, Situation

PAGE = Path(__file__).parent / "flight_modes.md"

_BEGIN = """# The state table of a drone

Printed by `make docs` from `TABLE`, `CONDITIONS` and `Situation` of `flatsat_ros/flight/modes.py`: change it
there. What is commanded in each mode stands in [interfaces.md](interfaces.md#flight-modes).

In each mode the events are tried from above; the first one whose terms all hold leads to the next mode, which is told
in the log, with the event's text, and shown in /diagnostics and in the telemetry. `hand_over` leads from FLY to IDLE
and is no event; a drone that is asked to land or to hold its place stays in FLY.

| mode | event | when | next mode | what is told |
|---|---|---|---|---|
"""
_TERMS = """
## Terms

| term | meaning |
|---|---|
"""


def page() -> str:
    """Return the whole page."""
    return _BEGIN + "".join(_transitions()) + _TERMS + "".join(_terms())


def _transitions() -> Iterator[str]:
    for mode in Mode:
        for event, after in TABLE[mode]:
            terms = ", ".join(CONDITIONS[event])
            yield f"| {mode.value} `{mode.name}` | `{event.name}` | {terms} | `{after.name}` | {event.value} |\n"


def _terms() -> Iterator[str]:
    text = cleandoc(Situation.__doc__ or "")
    used = {term.removeprefix("not ") for terms in CONDITIONS.values() for term in terms}
    for entry in fields(Situation):
        described = re.search(rf"^    {entry.name}: (.*(?:\n        .*)*)", text, re.MULTILINE)
        if described is None:
            raise ValueError(f"{entry.name} is not described")
        if entry.name not in ("elapsed", "policy"):
            yield f"| {entry.name} | {' '.join(described[1].split()).removesuffix('.')} |\n"
    for name in sorted(used - {entry.name for entry in fields(Situation)}):
        meaning = cleandoc(getattr(Situation, name).__doc__).removesuffix(".")
        yield f"| {name} | {meaning[0].lower() + meaning[1:]} |\n"


def main() -> int:
    """Write the page; return 1 after one line on stderr if that changed it, which in the gate nobody would commit."""
    text = page()
    if PAGE.read_text(encoding="utf-8") == text:
        return 0
    PAGE.write_text(text, encoding="utf-8")
    print(f"make docs: {PAGE.name} was not that of the code and is written again: commit it", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
