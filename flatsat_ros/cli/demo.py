"""The demo: simulated Crazyflies swap places, as the controller flies by default, over ROS or without."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell

if TYPE_CHECKING:
    from flatsat_ros.demo.scenario import Scenario


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the demo; 0 if it kept its promises, 1 if not, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    from flatsat_ros.demo.scenario import LEG_TIME

    parser = shell.Parser("demo", __doc__)
    parser.add_argument("--paper", action="store_true", help="fly Test 2 of the paper, with its certificate at 10 Hz")
    parser.add_argument(
        "--dynamics",
        choices=("identified", "ideal"),
        default="identified",
        help="of the drones; ideal ones with --paper",
    )
    parser.add_argument(
        "--seconds",
        type=shell.number,
        default=3 * LEG_TIME,
        help=f"of swapping, in legs of {LEG_TIME:g} s, or as slow as the certificate wants (default: %(default)g)",
    )
    parser.add_argument("--plan", type=shell.path, metavar="FILE", help="fly this plan instead, see the program plan")
    parser.add_argument(
        "--robots",
        type=shell.integer,
        help="let so many fly to the opposite places of a circle instead, by a plan that is made and proved first; "
        "with --paper the number of drones that swap",
    )
    parser.add_argument(
        "--wind",
        type=shell.number,
        default=0.0,
        metavar="M_S",
        help="steady, along x, with --plan or --robots; at most what the certificate assumes",
    )
    parser.add_argument(
        "--rate", type=shell.number, help="of the controller, Hz, with --paper (default: the certificate's)"
    )
    parser.add_argument("--headless", action="store_true", help="one process on simulated time, no ROS: fast, no bag")
    parser.add_argument("--console", action="store_true", help="show the flight live on a page of this machine, too")
    parser.add_argument("--offset-free", action="store_true", help="with --paper, compensate the estimated disturbance")
    parser.add_argument(
        "--output", type=shell.path, default=Path("out/demo"), help="for the results (default: %(default)s)"
    )
    return parser


def _scenario(arguments: argparse.Namespace, folder: Path) -> Scenario:
    """Return what is to be flown."""
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.demo.scenario import plan, planned_flight

    if arguments.plan is not None:
        _require_unused(arguments, "--plan", "paper", "dynamics", "seconds", "robots", "rate", "offset_free")
        return planned_flight(arguments.plan, arguments.wind)
    if arguments.robots is not None and not arguments.paper:
        from flatsat_ros.cli.plan import tell_round
        from flatsat_ros.demo.exchange import exchange

        _require_unused(arguments, "--robots", "dynamics", "seconds", "rate", "offset_free")
        return exchange(folder, arguments.robots, arguments.wind, tell_round)
    if arguments.wind:
        raise FlatsatError("--wind: used with --plan or --robots only, and without --paper")
    return plan(
        folder,
        3 if arguments.robots is None else arguments.robots,
        arguments.seconds,
        arguments.rate,
        arguments.dynamics,
        paper=arguments.paper,
        offset_free=arguments.offset_free,
    )


def _require_unused(arguments: argparse.Namespace, beside: str, *names: str) -> None:
    """Refuse options that a flight, named by the option that asks for it, would ignore."""
    from flatsat_ros.base.errors import FlatsatError

    usual = _parser()
    for option in (name for name in names if getattr(arguments, name) != usual.get_default(name)):
        raise FlatsatError(f"--{option.replace('_', '-')}: not used with {beside}; drop one or the other")


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.base.files import write_text
    from flatsat_ros.demo import headless, live, pictures, record
    from flatsat_ros.viewing.bag import read_flight
    from flatsat_ros.viewing.page import report
    from flatsat_ros.viewing.recorder import Recorder, setup_of

    folder: Path = arguments.output
    if not arguments.headless:
        live.require_ros()
    elif arguments.console:
        raise FlatsatError("--console: not used with --headless; drop one or the other")
    shell.require_folder(folder, [record.SUMMARY, record.REPORT, record.PLAN, *pictures.FILES])
    scenario = _scenario(arguments, folder)
    if arguments.headless:
        recorder = Recorder(scenario.robots, setup_of(scenario.certificate, scenario.policy))
        flown = headless.fly(scenario, recorder.observe)
        shown = recorder.flight("Swap on simulated time")
    else:
        flown = live.fly(scenario, folder, console=arguments.console)
        shown = read_flight(folder / live.BAG)
    summary = flown.summary()
    print(record.table(summary, flown.limits))
    written = [record.write(summary, folder), *pictures.draw(flown, folder)]
    if arguments.plan is None and scenario.plan_path is not None:
        written.append(scenario.plan_path)
    if not arguments.headless:
        written.append(folder / live.BAG)
    write_text(folder / record.REPORT, report(shown))
    print("wrote " + ", ".join(os.fspath(path) for path in written))
    print(f"to see the flight, open in a browser: {os.fspath(folder / record.REPORT)}")
    broken = record.failures(summary)
    for sentence in broken:
        print(f"FAILED: {sentence}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
