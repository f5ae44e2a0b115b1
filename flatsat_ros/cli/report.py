"""One HTML file that shows a recorded flight: drones in space, quantities over time, figures, events, data as CSV.

Any ROS 2 bag will do, MCAP or SQLite: poses and set-points are enough, and what is missing is left out and said. The
file opens in a browser without network or server.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from flatsat_ros.cli import shell


def main(argv: Sequence[str] | None = None) -> int:
    """Write the report; 0 if that went well, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser("report", __doc__)
    parser.add_argument("bag", type=shell.path, metavar="BAG", help="the bag's folder, or its .mcap or .db3 file")
    parser.add_argument(
        "--output",
        "-o",
        type=shell.path,
        metavar="FILE",
        help="the HTML file (default: the bag's name, beside it, with .html)",
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.files import check_writable, make_folder, resolved, write_text
    from flatsat_ros.viewing.bag import read_flight
    from flatsat_ros.viewing.page import report

    bag = resolved(arguments.bag)
    target: Path = arguments.output or bag.parent / f"{bag.stem}.html"
    make_folder(target.parent)
    check_writable(target)
    flight = read_flight(bag, _progress)
    for note in flight.notes:
        print(note)
    write_text(target, report(flight))
    drones = f"{len(flight.tracks)} drone" + ("s" if len(flight.tracks) != 1 else "")
    print(f"{drones}, {flight.duration:.1f} s, {len(flight.events)} events: wrote {os.fspath(target)}")
    return 0


def _progress(messages: Iterable[Any], count: int) -> Iterable[Any]:
    from tqdm import tqdm

    bar: Iterable[Any] = tqdm(messages, "reading", count, leave=False, delay=2.0, unit=" messages")
    return bar


if __name__ == "__main__":
    sys.exit(main())
