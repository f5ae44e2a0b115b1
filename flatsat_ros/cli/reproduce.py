"""`ros2 run flatsat_ros reproduce`: every number of the paper beside ours, its figures from our own runs."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.paper.table import Table


def main(argv: Sequence[str] | None = None) -> int:
    """Reproduce the paper; 0 when done, whatever the verdicts, 2 if it could not be."""
    parser = argparse.ArgumentParser(
        prog="reproduce",
        description="Recompute the numbers of arXiv 2308.15177 and redraw its figures; takes a minute or two.",
        epilog="What is wrong in the paper, and why: docs/errata.md.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--output", type=Path, default=Path("out/reproduce"), help="for table and figures (default: %(default)s)"
    )
    folder = parser.parse_args(argv).output
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = _reproduce(folder)
    except (FlatsatError, OSError) as error:
        print(f"reproduce: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    print("\nwrote " + ", ".join(os.fspath(path) for path in written))
    return 0


def _reproduce(folder: Path) -> list[Path]:
    # solver and pictures take seconds to import: not for --help
    from flatsat_ros.paper import claims as reproduce_claims
    from flatsat_ros.paper import numbers as reproduce_numbers
    from flatsat_ros.paper import pictures as reproduce_pictures
    from flatsat_ros.paper.runs import run_all

    runs, table = run_all(folder), Table()
    reproduce_numbers.controller_parameters(table, runs.simulation)
    reproduce_claims.study_1(table, runs)
    reproduce_numbers.robustness(table, runs.robust)
    reproduce_claims.study_2(table, runs)
    reproduce_claims.tracking(table, runs)
    reproduce_numbers.experiment_parameters(table, runs.experiment)
    reproduce_claims.test_1(table, runs)
    reproduce_claims.test_2(table, runs)
    print(table.text())
    documents = {
        folder / "table.md": table.markdown(),
        folder / "table.json": json.dumps(table.document(), indent=2) + "\n",
    }
    for path, content in documents.items():
        path.write_text(content, encoding="utf-8")
    return [*documents, *reproduce_pictures.draw(runs, folder)]


if __name__ == "__main__":
    sys.exit(main())
