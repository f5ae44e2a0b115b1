"""`ros2 run flatsat_ros reproduce`: every number and figure of arXiv 2308.15177, from our own runs."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from flatsat_ros.cli import shell


def main(argv: Sequence[str] | None = None) -> int:
    """Reproduce the paper; 0 when done, whatever the verdicts, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser(
        "reproduce",
        "Recompute the numbers of arXiv 2308.15177 and redraw its figures; takes a minute or two.",
        "What is wrong in the paper, and why: docs/errata.md.",
    )
    parser.add_argument(
        "--output", type=shell.path, default=Path("out/reproduce"), help="for table and figures (default: %(default)s)"
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.paper import pictures, reproduction
    from flatsat_ros.paper.runs import run_all

    folder: Path = arguments.output
    shell.require_folder(folder, [*reproduction.FILES, *pictures.FILES])
    runs = run_all(folder)
    table = reproduction.compared(runs)
    print(table.text())
    written = [*reproduction.write(table, folder), *pictures.draw(runs, folder)]
    print("\nwrote " + ", ".join(os.fspath(path) for path in written))
    return 0


if __name__ == "__main__":
    sys.exit(main())
