"""`ros2 run flatsat_ros excitation`: the flight after which a log tells all figures of a drone, as a trajectory."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress

from flatsat_ros.cli import shell

_CERTIFICATE, _AT = "cf21_50hz", (0.0, 0.0, 1.0)
_FAR = 500.0  # m, from the origin, as of way-points
_TYPE = "trajectory_msgs/msg/MultiDOFJointTrajectory"


def main(argv: Sequence[str] | None = None) -> int:
    """Write the trajectory; 0 when done, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _place(text: str) -> tuple[float, ...]:
    """Read x,y,z, m."""
    with suppress(ValueError):
        place = tuple(map(shell.number, text.split(",")))
        if len(place) == 3 and all(abs(x) <= _FAR for x in place):
            return place
    from flatsat_ros.base.errors import quoted

    raise argparse.ArgumentTypeError(f"{quoted(text)}: must be X,Y,Z, three numbers within {_FAR:g} m")


def _parser() -> shell.Parser:
    parser = shell.Parser(
        "excitation",
        "Write the excitation flight as a message for <robot>/trajectory: sines of 0.2 to 3 Hz on x and y, steps of "
        "thrust on z, within a box of 2 m. Its log tells identify all figures of the drone.",
        "example: excitation --output excitation.yaml",
    )
    parser.add_argument("--output", required=True, type=shell.path, metavar="FILE", help="message to write, YAML")
    parser.add_argument(
        "--certificate", default=_CERTIFICATE, metavar="NAME_OR_PATH", help=f"that it is flown with ({_CERTIFICATE})"
    )
    parser.add_argument("--at", type=_place, default=_AT, metavar="X,Y,Z", help="where it begins and ends, m (0,0,1)")
    parser.add_argument("--force", action="store_true", help="overwrite the output")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.files import write_text
    from flatsat_ros.certificate.certificate import load_certificate
    from flatsat_ros.identification.excitation import excitation, message_text

    shell.require_new(arguments.output, arguments.force)
    certificate = load_certificate(arguments.certificate)
    path = excitation(certificate, arguments.at)
    low, high = path.bounds()
    write_text(arguments.output, message_text(path))
    ranges = ", ".join(f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in zip("xyz", low, high, strict=True))
    print(f"{path.times[-1]:.0f} s; {ranges} m; {path.margin(certificate.limits).distance:.2g} m/s^2 from the limits")
    print(f"written to {arguments.output}; with the drone at the beginning and its flight recorded, fly it with")
    print(f'  ros2 topic pub --once /cf1/trajectory {_TYPE} "$(cat {arguments.output})"')
    return 0


if __name__ == "__main__":
    sys.exit(main())
