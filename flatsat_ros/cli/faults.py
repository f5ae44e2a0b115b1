"""`ros2 run flatsat_ros faults`: every fault in every phase of flight, judged by bounds that were set beforehand."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell

if TYPE_CHECKING:
    from flatsat_ros.falsification.faults.rows import Row

_FOLDER, _TABLE, _PAGE = Path("out/faults"), "table.json", "faults.md"
_BAR = "{desc} {bar} {n}/{total} [{elapsed}<{remaining}]{postfix}"


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the matrix, or one row again; 0 if every row passed or is accepted, else 1, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE
    from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS
    from flatsat_ros.falsification.faults.phases import Phase
    from flatsat_ros.falsification.faults.table import FAULTS

    parser = shell.Parser(
        "faults",
        "Fly every fault in every phase of flight on simulated time, and judge by bounds that were set beforehand.",
        f"faults: {', '.join(FAULTS)}; with --live: {', '.join(LIVE_FAULTS)}",
    )
    parser.add_argument("--live", action="store_true", help="with real processes and in real time, in a hover")
    parser.add_argument("--fault", metavar="NAME", help="this one only")
    parser.add_argument("--phase", choices=[phase.value for phase in Phase], help="this one only")
    parser.add_argument(
        "--certificate", metavar="NAME_OR_PATH", help=f"that the drones are flown with (default: {DEFAULT_CERTIFICATE})"
    )
    parser.add_argument("--workers", type=shell.integer, help="processes (default: one for each core)")
    parser.add_argument("--output", type=shell.path, help=f"folder of {_TABLE} and {_PAGE} (default: {_FOLDER})")
    parser.add_argument("--replay", metavar="FAULT:PHASE[:SEED]", help="one row again, moment by moment")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.falsification.faults.accepted import ACCEPTED, require_sound
    from flatsat_ros.falsification.faults.table import EXISTING

    require_sound(ACCEPTED, EXISTING)
    if arguments.replay is not None:
        return _replay(arguments)
    return _fly_live(arguments) if arguments.live else _fly(arguments)


def _fly(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import refusal, require
    from flatsat_ros.falsification.faults.phases import Phase
    from flatsat_ros.falsification.faults.rows import fly_rows
    from flatsat_ros.falsification.faults.table import FAULTS
    from flatsat_ros.falsification.workers import WORKERS_MAX

    workers = os.cpu_count() or 1 if arguments.workers is None else arguments.workers
    require(1 <= workers <= WORKERS_MAX, "--workers", workers, "", f"from 1 to {WORKERS_MAX}")
    phases = list(Phase) if arguments.phase is None else [Phase(arguments.phase)]
    names = _names(arguments, FAULTS)
    wanted = [(name, phase) for name in names for phase in phases if phase in FAULTS[name].phases]
    if not wanted:
        valid = ", ".join(phase.value for phase in FAULTS[names[0]].phases)
        raise refusal("--phase", arguments.phase, "", f"one in which {names[0]} is flown, {valid}")
    certificate = _certificate(arguments)
    return _collect(fly_rows(wanted, workers, certificate), len(wanted), _folder(arguments), certificate)


def _fly_live(arguments: argparse.Namespace) -> int:
    from flatsat_ros.demo.live import require_ros
    from flatsat_ros.falsification.faults.live import fly_live
    from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS

    shell.require_alone(arguments, "live", "fault", "output", "certificate")
    require_ros()
    folder, certificate = _folder(arguments), _certificate(arguments)
    names = _names(arguments, LIVE_FAULTS)
    return _collect(fly_live(names, folder / "log", certificate), len(names), folder, certificate)


def _certificate(arguments: argparse.Namespace) -> str:
    from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE

    return DEFAULT_CERTIFICATE if arguments.certificate is None else str(arguments.certificate)


def _names(arguments: argparse.Namespace, faults: Mapping[str, object]) -> list[str]:
    from flatsat_ros.base.errors import nearest_name, refusal

    if arguments.fault is None:
        return list(faults)
    if arguments.fault not in faults:
        valid = f"a fault that --help names{nearest_name(arguments.fault, faults)}"
        raise refusal("--fault", arguments.fault, "", valid)
    return [arguments.fault]


def _folder(arguments: argparse.Namespace) -> Path:
    folder: Path = _FOLDER if arguments.output is None else arguments.output
    shell.require_folder(folder, [_TABLE, _PAGE])
    return folder


def _collect(flown: Generator[Row], count: int, folder: Path, certificate: str) -> int:
    """Show how far it is, write what came of it beside what was there, and return the exit code."""
    from tqdm import tqdm

    from flatsat_ros.base.errors import refusal
    from flatsat_ros.base.files import write_text
    from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
    from flatsat_ros.falsification.faults.accepted import ACCEPTED, not_needed
    from flatsat_ros.falsification.faults.page import page, summary
    from flatsat_ros.falsification.faults.rows import load, merged, save

    rows: list[Row] = []
    table, began = folder / _TABLE, time.monotonic()
    there = load(table) if table.exists() else []
    name = load_certificate(certificate).name
    if others := sorted({row.certificate for row in there} - {name}):
        raise refusal(f"certificate of the rows in {table}", ", ".join(others), "", f"{name}: take another --output")
    try:
        with closing(flown), tqdm(total=count, desc="faults", bar_format=_BAR, mininterval=0.5) as bar:
            for row in flown:
                rows.append(row)
                failed = sum(row.failed for row in rows)
                bar.set_postfix_str(f"{failed} failed, {row.fault}:{row.phase}", refresh=False)
                bar.update()
    finally:  # also when it is stopped
        kept = merged(there, rows)
        save(kept, table)
        write_text(folder / _PAGE, page(kept))
    for row in rows:
        if row.failed:
            print(f"FAILED {row.fault}:{row.phase}: {'; '.join(row.broken)}")
    print(f"{summary(rows)} In {time.monotonic() - began:.0f} s; see {folder / _PAGE}")
    for fault in not_needed(rows, ACCEPTED) if name == DEFAULT_CERTIFICATE else ():
        print(f"{fault} keeps its bounds in all phases in which it is accepted: it can be taken off the list")
    return 1 if any(row.failed for row in rows) else 0


def _replay(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import refusal
    from flatsat_ros.falsification.faults.page import history
    from flatsat_ros.falsification.faults.phases import Phase
    from flatsat_ros.falsification.faults.rows import SEED, replay
    from flatsat_ros.falsification.faults.table import FAULTS

    shell.require_alone(arguments, "replay", "certificate")
    name, _, rest = arguments.replay.partition(":")
    phase, _, seed = rest.partition(":")
    phases = [phase.value for phase in (FAULTS[name].phases if name in FAULTS else Phase)]
    if name not in FAULTS or phase not in phases or not (seed or "0").isdecimal():
        valid = f"FAULT:PHASE or FAULT:PHASE:SEED with a fault of --help and its phase, {', '.join(phases)}"
        raise refusal("--replay", arguments.replay, "", valid)
    row, scene = replay(name, Phase(phase), int(seed) if seed else SEED, _certificate(arguments))
    print(history(row, scene))
    return 1 if row.failed else 0


if __name__ == "__main__":
    sys.exit(main())
