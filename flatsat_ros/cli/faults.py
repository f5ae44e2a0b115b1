"""`ros2 run flatsat_ros faults`: every fault in every phase of flight, judged by bounds that were set beforehand."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from flatsat_ros.cli import shell

_FOLDER, _TABLE, _PAGE = Path("out/faults"), "table.json", "faults.md"
_BAR = "{desc} {bar} {n}/{total} [{elapsed}<{remaining}]{postfix}"


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the matrix, or one row again; 0 if no row failed, else 1, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    from flatsat_ros.falsification.faults.phases import Phase
    from flatsat_ros.falsification.faults.table import FAULTS

    parser = shell.Parser(
        "faults",
        "Fly every fault in every phase of flight on simulated time, and judge by bounds that were set beforehand.",
        "faults: " + ", ".join(FAULTS),
    )
    parser.add_argument("--fault", choices=FAULTS, metavar="NAME", help="this one only")
    parser.add_argument("--phase", choices=[phase.value for phase in Phase], help="this one only")
    parser.add_argument("--workers", type=int, help="processes (default: one for each core)")
    parser.add_argument("--output", type=shell.path, help=f"folder of {_TABLE} and {_PAGE} (default: {_FOLDER})")
    parser.add_argument("--replay", metavar="FAULT:PHASE[:SEED]", help="one row again, moment by moment")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    return _fly(arguments) if arguments.replay is None else _replay(arguments)


def _fly(arguments: argparse.Namespace) -> int:
    from tqdm import tqdm

    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.base.files import write_text
    from flatsat_ros.falsification.faults.page import page, summary
    from flatsat_ros.falsification.faults.phases import Phase
    from flatsat_ros.falsification.faults.rows import fly_rows, save
    from flatsat_ros.falsification.faults.table import FAULTS

    workers = os.cpu_count() or 1 if arguments.workers is None else arguments.workers
    if workers < 1:
        raise FlatsatError(f"--workers {workers}: must be at least 1")
    folder = _FOLDER if arguments.output is None else arguments.output
    shell.require_folder(folder, [_TABLE, _PAGE])
    names = list(FAULTS) if arguments.fault is None else [arguments.fault]
    phases = list(Phase) if arguments.phase is None else [Phase(arguments.phase)]
    wanted = [(name, phase) for name in names for phase in phases]
    rows = []
    began = time.monotonic()
    with (
        closing(fly_rows(wanted, workers)) as flown,
        tqdm(total=len(wanted), desc="faults", bar_format=_BAR, mininterval=0.5) as bar,
    ):
        for row in flown:
            rows.append(row)
            failed = sum(row.failed for row in rows)
            bar.set_postfix_str(f"{failed} failed, {row.fault}:{row.phase}", refresh=False)
            bar.update()
    save(rows, folder / _TABLE)
    write_text(folder / _PAGE, page(rows))
    for row in rows:
        if row.failed:
            print(f"FAILED {row.fault}:{row.phase}: {'; '.join(row.broken)}")
    print(f"{summary(rows)} In {time.monotonic() - began:.0f} s; see {folder / _PAGE}")
    return 1 if any(row.failed for row in rows) else 0


def _replay(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.falsification.faults.page import history
    from flatsat_ros.falsification.faults.phases import Phase
    from flatsat_ros.falsification.faults.rows import SEED, replay
    from flatsat_ros.falsification.faults.table import FAULTS

    shell.require_alone(arguments, "replay")
    phases = [phase.value for phase in Phase]
    name, _, rest = arguments.replay.partition(":")
    phase, _, seed = rest.partition(":")
    if name not in FAULTS or phase not in phases or not (seed or "0").isdecimal():
        raise FlatsatError(
            f"--replay {arguments.replay}: must be FAULT:PHASE or FAULT:PHASE:SEED with a fault of --help and a phase "
            f"of {', '.join(phases)}"
        )
    row, scene = replay(name, Phase(phase), int(seed) if seed else SEED)
    print(history(row, scene))
    return 1 if row.failed else 0


if __name__ == "__main__":
    sys.exit(main())
