"""`make fuzz`: bad input of every kind, new each time, until something breaks or there was enough of it."""

from __future__ import annotations

import argparse
import os
import secrets
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "support"))

from fuzzing import MODULES, is_available
from fuzzing.campaign import BATCH, Batch, Outcome, replay, run_batch, unfinished
from tqdm import tqdm

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.cli import shell
from flatsat_ros.falsification.workers import results_of

_INPUTS = 1_000_000
_FOLDER = Path("out/fuzz")
_PROGRESS = 2.0  # s


def main(argv: Sequence[str] | None = None) -> int:
    """Try inputs, or one again; 0 if nothing broke, 1 if something did, 2 for what is refused, 130 after Ctrl-C."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser("fuzz", __doc__, f"kinds: {', '.join(MODULES)}")
    parser.add_argument("--inputs", type=int, help=f"in all (default: {_INPUTS})")
    parser.add_argument(
        "--kind", action="append", choices=MODULES, metavar="KIND", help="this one only; again for more"
    )
    parser.add_argument("--seed", type=int, help="of the first batch (default: a new one every time)")
    parser.add_argument("--workers", type=int, help="processes (default: one for each core)")
    parser.add_argument("--replay", type=shell.path, metavar="FILE", help="one input again, which a run has kept")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    if arguments.replay is not None:
        shell.require_alone(arguments, "replay")
        return _replay(arguments.replay)
    inputs = _INPUTS if arguments.inputs is None else arguments.inputs
    workers = os.cpu_count() or 1 if arguments.workers is None else arguments.workers
    if min(inputs, workers) < 1:
        raise FlatsatError("--inputs and --workers must be above 0")
    kinds = [name for name in arguments.kind or MODULES if is_available(name)]
    for name in set(arguments.kind or MODULES) - set(kinds):
        print(f"{name}: left out, {MODULES[name][1]} is not installed")
    if not kinds:
        raise refusal("--kind", ", ".join(arguments.kind), "", "a kind whose libraries are installed")
    seed = secrets.randbelow(2**32) if arguments.seed is None else arguments.seed
    return _try(kinds, inputs, seed, workers)


def _try(kinds: Sequence[str], inputs: int, seed: int, workers: int) -> int:
    """Try batches, each kind for as long as the others; no more of a kind in which something broke."""
    tally: dict[str, Counter[str]] = {name: Counter() for name in kinds}
    broken: dict[str, Outcome] = {}

    def batches() -> Iterator[Batch]:
        left, begun = inputs, Counter[str]()
        while left > 0:
            sound = [name for name in kinds if name not in broken]
            if not sound:
                return
            name = min(sound, key=lambda name: (tally[name]["ms"], begun[name]))
            yield Batch(name, seed + begun[name], min(BATCH, left), _FOLDER)
            begun[name] += 1
            left -= BATCH

    print(f"seed {seed}, {', '.join(kinds)}")
    began = time.monotonic()
    try:
        with (
            closing(results_of(run_batch, batches(), workers)) as outcomes,
            tqdm(total=inputs, unit=" inputs", desc="fuzz", mininterval=_PROGRESS) as bar,
        ):
            for outcome in outcomes:
                tally[outcome.kind].update(outcome.counts)
                tally[outcome.kind]["ms"] += round(1000.0 * outcome.seconds)
                if outcome.finding and outcome.kind not in broken:
                    broken[outcome.kind] = outcome
                    bar.write(_told(outcome))
                bar.update(outcome.counts.total())
                bar.set_postfix(findings=len(broken), refresh=False)
    except FlatsatError:  # a worker process died, of what it was trying
        for file in unfinished(_FOLDER):
            print(f"perhaps of this: {_command(file)}")
        raise
    print(f"{'kind':14}{'inputs':>10}{'taken':>10}{'refused':>10}{'inputs/s':>10}  finding")
    for name, counts in tally.items():
        tried = counts["taken"] + counts["refused"] + counts["broken"]
        rate = 1000.0 * tried / max(counts["ms"], 1)
        found = broken[name].finding.splitlines()[-1] if name in broken else "none"
        print(f"{name:14}{tried:>10}{counts['taken']:>10}{counts['refused']:>10}{rate:>10.0f}  {found}")
    total = sum(counts["taken"] + counts["refused"] + counts["broken"] for counts in tally.values())
    print(f"{total} inputs in {time.monotonic() - began:.0f} s, {len(broken)} findings, seed {seed}")
    return 1 if broken else 0


def _told(outcome: Outcome) -> str:
    return f"{outcome.kind}: {outcome.finding}\nagain: {_command(outcome.kept)}"


def _command(file: Path | None) -> str:
    return f'make fuzz ARGS="--replay {file}"'


def _replay(file: Path) -> int:
    finding = replay(file)
    print(finding or f"{file}: nothing breaks")
    return 1 if finding else 0


if __name__ == "__main__":
    sys.exit(main())
