"""`ros2 run flatsat_ros validate`: whether flights support or contradict what a certificate assumes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from flatsat_ros.cli import shell
from flatsat_ros.cli.identify import add_log_arguments, identified_from


def main(argv: Sequence[str] | None = None) -> int:
    """Judge the assumptions; 0 if no flight contradicts one, 1 if one does, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser(
        "validate",
        "Say of each assumption of a certificate whether logs of flights support it, contradict it or tell nothing.",
        "assumptions: thrust available at the largest thrust command, lag plus delay, thrust lag, attitude gain, "
        "pose gaps. Flights can contradict a certificate's assumptions; they prove none.",
    )
    add_log_arguments(parser)
    parser.add_argument("--certificate", required=True, metavar="NAME_OR_PATH", help="packaged name or file")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.certificate.certificate import load_certificate
    from flatsat_ros.crazyflie.vehicle import load_vehicle
    from flatsat_ros.identification.validation import CONTRADICTS, validate

    certificate = load_certificate(arguments.certificate)
    found, logs, _ = identified_from(arguments, load_vehicle(arguments.base))
    verdicts = validate(certificate, found, logs)
    for each in verdicts:
        print(f"  {each.verdict:12s} {each.assumption:18s} assumed: {each.bound:34s} flights: {each.shown}")
    contradicted = [each.assumption for each in verdicts if each.verdict == CONTRADICTS]
    if contradicted:
        print(f"{certificate.name}: contradicted in {', '.join(contradicted)}")
        return 1
    print(f"{certificate.name}: nothing in these flights contradicts it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
