"""The whole table, place by place in the order of the paper, from the runs to its files."""

from __future__ import annotations

import json
from pathlib import Path

from flatsat_ros.base.files import write_text
from flatsat_ros.paper import claims, numbers
from flatsat_ros.paper.runs import Runs
from flatsat_ros.paper.table import Table

FILES = ("table.md", "table.json")


def compared(runs: Runs) -> Table:
    """Return every number and claim of the paper beside what came out of the runs."""
    table = Table()
    numbers.controller_parameters(table, runs.simulation)
    claims.study_1(table, runs)
    numbers.robustness(table, runs.robust)
    claims.study_2(table, runs)
    claims.tracking(table, runs)
    numbers.experiment_parameters(table, runs.experiment)
    claims.test_1(table, runs)
    claims.test_2(table, runs)
    return table


def write(table: Table, folder: Path) -> list[Path]:
    """Write the table as `FILES` into a folder; return their paths.

    Raises:
        FlatsatError: a file cannot be written.
    """
    written = [folder / name for name in FILES]
    for path, text in zip(written, (table.markdown(), json.dumps(table.document(), indent=2) + "\n"), strict=True):
        write_text(path, text)
    return written
