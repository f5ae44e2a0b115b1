"""The demo: three simulated Crazyflies swap places (Test 2 of the paper), every node its own process."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.demo import record as demo_record
from flatsat_ros.demo.scenario import DISTURBANCE_MAX, LEG_TIME, plan


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the demo; 0 if it kept its promises, 1 if not, 2 if it could not be flown as asked."""
    arguments = _parser().parse_args(argv)
    try:
        return _run(arguments)
    except FlatsatError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument("--dynamics", choices=("identified", "ideal"), default="identified", help="of the drones")
    parser.add_argument(
        "--seconds",
        type=float,
        default=3 * LEG_TIME,
        help=f"of swapping, rounded up to whole legs of {LEG_TIME:g} s (default: %(default)g)",
    )
    parser.add_argument("--robots", type=int, default=3, help="number of drones (default: %(default)s)")
    parser.add_argument("--rate", type=float, help="of the controller, Hz (default: the certificate's)")
    parser.add_argument("--headless", action="store_true", help="one process on simulated time, no ROS: fast, no bag")
    parser.add_argument(
        "--offset-free", action="store_true", help="compensate the estimated disturbance, beyond the paper's law"
    )
    parser.add_argument("--output", type=Path, default=Path("out/demo"), help="for the results (default: %(default)s)")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    arguments.output.mkdir(parents=True, exist_ok=True)
    scenario = plan(
        arguments.output,
        arguments.robots,
        arguments.seconds,
        arguments.rate,
        arguments.dynamics,
        DISTURBANCE_MAX if arguments.offset_free else 0.0,
    )
    if arguments.headless:
        from flatsat_ros.demo import headless as demo_headless

        record = demo_headless.fly(scenario)
    else:
        from flatsat_ros.demo import live as demo_live

        record = demo_live.fly(scenario, arguments.output)
    summary = record.summary()
    text = json.dumps(summary, indent=2) + "\n"
    (arguments.output / "summary.json").write_text(text, encoding="utf-8")
    print(demo_record.table(summary, record.limits))
    from flatsat_ros.demo import pictures as demo_pictures

    written = [arguments.output / "summary.json", *demo_pictures.draw(record, arguments.output)]
    if not arguments.headless:
        written.append(arguments.output / "bag")
    print("wrote " + ", ".join(os.fspath(path) for path in written))
    broken = demo_record.failures(summary)
    for sentence in broken:
        print(f"FAILED: {sentence}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
