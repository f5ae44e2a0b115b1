"""`ros2 run flatsat_ros validate`: whether flights support or contradict what a certificate assumes."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell
from flatsat_ros.cli.identify import add_log_arguments, base_of, identified_from

if TYPE_CHECKING:
    from flatsat_ros.certificate.certificate import Certificate
    from flatsat_ros.certificate.flight_tube import Assumptions


def main(argv: Sequence[str] | None = None) -> int:
    """Judge the assumptions; 0 if no flight contradicts one, 1 if one does, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser(
        "validate",
        "Say of each assumption of a certificate whether logs of flights support it, contradict it or tell nothing, "
        "and write the assumptions that they support.",
        "assumptions: thrust available at the largest thrust command, lag plus delay, thrust lag, attitude gain, "
        "noise, disturbance and its rate, pose gaps; of bags of our controller, the tube. Flights can contradict a "
        "certificate's assumptions; they prove none.",
    )
    add_log_arguments(parser)
    parser.add_argument("--certificate", required=True, metavar="NAME_OR_PATH", help="packaged name or file")
    parser.add_argument(
        "--vehicle",
        metavar="NAME_OR_PATH",
        help="the drone's own profile: the base, whose thrust map and intervals are judged, too",
    )
    parser.add_argument("--write", type=shell.path, metavar="FILE", help="assumptions file to write, for synthesize")
    parser.add_argument(
        "--coverage", type=shell.number, metavar="SHARE", help="of the samples, in what is written (0.999)"
    )
    parser.add_argument("--force", action="store_true", help="overwrite the assumptions")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError, refusal
    from flatsat_ros.certificate.certificate import load_certificate
    from flatsat_ros.crazyflie.vehicle import load_vehicle
    from flatsat_ros.identification.assumptions import COVERAGE, assumptions, require_coverage
    from flatsat_ros.identification.validation import CONTRADICTS, validate

    if arguments.write is None and (arguments.force or arguments.coverage is not None):
        raise FlatsatError("--coverage, --force: they go with --write; without it nothing is written")
    if arguments.vehicle is not None and arguments.base is not None:
        raise FlatsatError("--base: --vehicle is the base; must be one of them")
    if arguments.write is not None:
        if arguments.write.suffix != ".yaml":
            raise refusal("--write", str(arguments.write), "", "a .yaml file")
        given = {f"--{name}": getattr(arguments, name) for name in ("certificate", "vehicle", "base", "columns")}
        shell.require_apart("--write", arguments.write, given)
        shell.require_new(arguments.write, arguments.force)
    coverage = COVERAGE if arguments.coverage is None else arguments.coverage
    require_coverage(coverage)
    vehicle = None if arguments.vehicle is None else load_vehicle(arguments.vehicle)
    base = vehicle or base_of(arguments)
    certificate = load_certificate(arguments.certificate)
    found, logs, names = identified_from(arguments, base)
    verdicts = validate(certificate, found, logs, vehicle)
    for each in verdicts:
        print(f"  {each.verdict:12s} {each.assumption:26s} assumed: {each.bound:26s} flights: {each.shown}")
    if arguments.write is not None:
        from flatsat_ros.base.strict_yaml import write_yaml
        from flatsat_ros.identification.disturbances import BANDWIDTH

        header = (
            f"# What was seen in {', '.join(names)}.\n"
            f"# disturbance_rate m/s^3 up to {BANDWIDTH:.2g} Hz, noise m, pose_age s: {100 * coverage:.6g} % of the\n"
            "# samples keep them; acceleration, jerk, snap: of references, as in the certificate; lag s, delay s,\n"
            "# gain, frequency rad/s, damping: least and largest\n"
        )
        write_yaml(arguments.write, dict(assumptions(found, logs, base, references_of(certificate), coverage)), header)
        print(f"  written to {arguments.write}")
    contradicted = [each.assumption for each in verdicts if each.verdict == CONTRADICTS]
    if contradicted:
        print(f"{certificate.name}: contradicted in {', '.join(contradicted)}")
        return 1
    print(f"{certificate.name}: nothing in these flights contradicts it")
    return 0


def references_of(certificate: Certificate) -> Assumptions:
    """Return what a certificate assumes of references; where it says nothing, what is assumed in still air."""
    from dataclasses import replace

    from flatsat_ros.synthesis.flight_wishes import STILL

    flight = certificate.flight
    if flight is None:
        return STILL
    # without drag and tilt it needs no bound of the acceleration, and has 0; a drone that has drag does
    stated = math.isfinite(flight.acceleration)
    return flight.assumptions if stated else replace(flight.assumptions, acceleration=STILL.acceleration)


if __name__ == "__main__":
    sys.exit(main())
