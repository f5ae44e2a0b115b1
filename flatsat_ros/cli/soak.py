"""Fly simulated drones with one controller, real processes, for long, and see whether anything grows.

Memory, descriptors, threads, shared memory, ticks missed, and what is left behind at the end.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from flatsat_ros.cli import shell

_FOLDER, _SUMMARY = Path("out/soak"), "summary.json"
_LONGEST = 60 * 24 * 7.0  # minutes
_MOST = 49  # drones


def main(argv: Sequence[str] | None = None) -> int:
    """Fly for long; 0 if nothing grew, was missed or left behind, else 1, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser("soak", __doc__)
    parser.add_argument("--minutes", type=shell.number, default=60.0, help="of flight (default: %(default)g)")
    parser.add_argument("--drones", type=shell.integer, default=10, help="their number (default: %(default)s)")
    parser.add_argument(
        "--output", type=shell.path, default=_FOLDER, help=f"folder of {_SUMMARY} and logs (default: %(default)s)"
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import require, require_number
    from flatsat_ros.base.files import write_text
    from flatsat_ros.demo.live import require_ros
    from flatsat_ros.falsification.soak.flight import fly
    from flatsat_ros.falsification.soak.verdict import lines, summary

    minutes = require_number("--minutes", arguments.minutes, "min", 0.1, _LONGEST)
    require(1 <= arguments.drones <= _MOST, "--drones", arguments.drones, "", f"from 1 to {_MOST}")
    require_ros()
    folder: Path = arguments.output
    shell.require_folder(folder, [_SUMMARY])
    figures = summary(fly(arguments.drones, 60.0 * minutes, folder / "log", lambda line: print(line, flush=True)))
    write_text(folder / _SUMMARY, json.dumps(figures, indent=1) + "\n")
    print("\n".join(lines(figures)))
    problems = figures["problems"]
    assert isinstance(problems, list)
    for problem in problems:
        print(f"FAILED: {problem}", file=sys.stderr)
    print(f"{'FAILED' if problems else 'passed'}; see {folder / _SUMMARY}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
