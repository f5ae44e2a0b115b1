"""`ros2 run flatsat_ros synthesize`: limits and goals in, certificate out."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell
from flatsat_ros.cli.synthesize_flight import certificate_name, write_designs, write_flight

if TYPE_CHECKING:
    from flatsat_ros.base.arrays import FloatArray
    from flatsat_ros.certificate.certificate import Certificate
    from flatsat_ros.certificate.sampled_loop import Timing
    from flatsat_ros.crazyflie.vehicle import VehicleProfile
    from flatsat_ros.law.input_set import InputSet

# what is taken when the user does not say otherwise: the paper's experiment
_TILT_MAX_DEG = 10.0
_RATE = 1.25
_PERIOD = 0.1

# what goes with --flight
_FLIGHT = ("vehicle", "assume", "seconds", "tilt_max_deg", "gain_max", "period", "name", "output", "force")

_PICTURES = (".png", ".pdf", ".svg")


def main(argv: Sequence[str] | None = None) -> int:
    """Make certificates or check one; 0 when done, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _numbers(text: str) -> list[float]:
    """Read numbers separated by commas."""
    return [shell.number(item) for item in text.split(",")]


def _parser() -> shell.Parser:
    from flatsat_ros.base.constants import GRAVITY

    parser = shell.Parser(
        "synthesize",
        "Compute a certificate: Lyapunov matrix, invariant sets and gain interval of one vehicle's loop.",
        "example: synthesize --vehicle cf21 --cover 1.2,1.2,0.8 --output cf21.yaml --plot cf21.png",
    )
    own = parser.add_argument_group("inputs")
    own.add_argument("--name", help="name of the certificate (default: the output file's)")
    thrust = own.add_mutually_exclusive_group()
    thrust.add_argument("--thrust-max", type=shell.number, metavar="M_S2", help="T_max, m/s^2, normalised by the mass")
    thrust.add_argument(
        "--thrust-max-g", type=shell.number, metavar="G", help=f"T_max as a multiple of g = {GRAVITY} m/s^2"
    )
    own.add_argument("--tilt-max-deg", type=shell.number, metavar="DEG", help=f"eps_max (default: {_TILT_MAX_DEG})")
    own.add_argument("--period", type=shell.number, metavar="S", help=f"sampling period h (default: {_PERIOD})")
    own.add_argument(
        "--lag", type=shell.number, metavar="S", help="lag tau of the acceleration (default: vehicle's, or 0)"
    )
    own.add_argument(
        "--delay", type=shell.number, metavar="S", help="delay d of the command (default: vehicle's, or 0)"
    )
    own.add_argument(
        "--vehicle", metavar="NAME_OR_PATH", help="vehicle profile: lag, delay, and the bound and default of T_max"
    )
    goals = parser.add_argument_group("goals")
    goals.add_argument("--rate", type=shell.number, metavar="1/S", help=f"decay rate alpha (default: {_RATE}) or beta")
    goals.add_argument("--cover", type=_numbers, metavar="DX,DY,DZ[,VX,VY,VZ]", help="cover these start errors, m, m/s")
    goals.add_argument("--drift", type=_numbers, metavar="H[,V]", help="withstand this drift of the position, m/s")
    goals.add_argument("--push", type=_numbers, metavar="H[,V]", help="withstand this push, m/s^2")
    goals.add_argument(
        "--kappa",
        type=shell.number,
        metavar="K",
        help="with lag or delay: certify kappa-sets down to this (default: 1)",
    )
    goals.add_argument(
        "--gain-max", type=shell.number, metavar="G", help="a smaller cap: larger sets with lag or delay"
    )
    own.add_argument(
        "--output", type=shell.path, metavar="FILE", help="certificate to write; without it nothing is written"
    )
    own.add_argument("--plot", type=shell.path, metavar="FILE", help="a page of pictures, PNG, PDF or SVG")
    parser.add_argument(
        "--verify", type=shell.path, metavar="FILE", help="only check this certificate and print its margins"
    )
    flight = parser.add_argument_group("certificates of the whole loop that flies")
    flight.add_argument(
        "--flight", action="store_true", help="search and prove a tube around references; needs --vehicle"
    )
    flight.add_argument(
        "--assume", metavar="still|gusts|FILE", help="about air, measurement and references (default: still)"
    )
    flight.add_argument(
        "--seconds", type=shell.number, metavar="S", help="of search for each kind of axes (default: 90)"
    )
    flight.add_argument("--designs", type=shell.path, metavar="FILE", help="prove stored designs again instead")
    paper = parser.add_argument_group("certificates of the paper")
    paper.add_argument("--paper", choices=("simulation", "experiment", "robust", "all"), help="compute these instead")
    paper.add_argument("--output-dir", type=shell.path, metavar="DIR", help="folder to write them to (default: config)")
    parser.add_argument("--force", action="store_true", help="overwrite existing files")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    if arguments.verify is not None:
        shell.require_alone(arguments, "verify")
        _verify(arguments.verify)
    elif arguments.paper is not None:
        shell.require_alone(arguments, "paper", "output_dir", "force")
        _write_paper(arguments)
    elif arguments.designs is not None:
        shell.require_alone(arguments, "designs", "output_dir", "force")
        _write_designs(arguments)
    elif arguments.flight:
        shell.require_alone(arguments, "flight", *_FLIGHT)
        if arguments.output is not None:
            shell.require_new(arguments.output, arguments.force)
        write_flight(arguments, arguments.output)
    else:
        _write_own(arguments)
    return 0


def _verify(path: Path) -> None:
    """Check a certificate and print its margins."""
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.base.files import located
    from flatsat_ros.certificate.certificate import Certificate
    from flatsat_ros.synthesis.report import margins

    certificate = Certificate.read(path)
    try:
        proved = certificate.margins()
        print("\n".join(margins(proved)))
        certificate.check(proved)
    except FlatsatError as error:
        raise located(path, error) from error
    print(f"certificate {certificate.name} in {path} holds")


def _write_paper(arguments: argparse.Namespace) -> None:
    from functools import partial

    from flatsat_ros.synthesis.nominal import PAPER, synthesize_paper
    from flatsat_ros.synthesis.robust_design import synthesize_paper_robust

    makers = {name: partial(synthesize_paper, name) for name in PAPER} | {"paper_robust": synthesize_paper_robust}
    names = [name for name in makers if arguments.paper in ("all", name.removeprefix("paper_"))]
    targets = {name: (arguments.output_dir or Path("config")) / f"{name}.yaml" for name in names}
    for target in targets.values():
        shell.require_new(target, arguments.force)
    for name, target in targets.items():
        _finish(makers[name](), target, None, None)


def _write_designs(arguments: argparse.Namespace) -> None:
    """Prove stored designs again."""
    from flatsat_ros.synthesis.flight_design import read_designs

    folder = arguments.output_dir or Path("config")
    for name in read_designs(arguments.designs):
        shell.require_new(folder / f"{name}.yaml", arguments.force)
    write_designs(arguments.designs, folder)


def _write_own(arguments: argparse.Namespace) -> None:
    from flatsat_ros.base.errors import FlatsatError, refusal
    from flatsat_ros.crazyflie.vehicle import load_vehicle
    from flatsat_ros.synthesis.wishes import CertificateWishes

    output, plot = arguments.output, arguments.plot
    for option in ("assume", "seconds"):
        if getattr(arguments, option) is not None:
            raise FlatsatError(f"--{option} goes with --flight")
    if arguments.output_dir is not None:
        raise FlatsatError(
            "--output-dir goes with --paper and --designs; a certificate of your own is written to --output"
        )
    if arguments.force and output is None and plot is None:
        raise FlatsatError("--force overwrites files; without --output and --plot none is written")
    shell.require_apart("--plot", plot, {"--output": output})
    for target in (output, plot):
        if target is not None:
            shell.require_new(target, arguments.force)
    if plot is not None and plot.suffix not in _PICTURES:
        raise refusal("--plot", str(plot), "", f"a file whose name ends in {', '.join(_PICTURES)}")
    vehicle = None if arguments.vehicle is None else load_vehicle(arguments.vehicle)
    limits, inputs = _limits(arguments, vehicle)
    lowest = 1.0 if arguments.kappa is None else arguments.kappa
    if not 0.0 < lowest <= 1.0:
        raise refusal("--kappa", lowest, "", "above 0 and at most 1")
    highest = math.inf if arguments.gain_max is None else arguments.gain_max
    if not highest >= 1.0:
        raise refusal("--gain-max", highest, "", "at least 1")
    drift, push = (_pair(option, getattr(arguments, option)) for option in ("drift", "push"))
    timing = _timing(arguments, vehicle)
    if arguments.cover is not None:
        inputs["cover"] = ",".join(map(str, arguments.cover))
    rate = arguments.rate
    if rate is None and arguments.cover is None and drift is None and push is None:
        rate = _RATE
    wishes = CertificateWishes(limits, timing, rate, arguments.cover, drift, push, lowest, highest)
    _finish(wishes.certificate(certificate_name(arguments.name, output), inputs), output, plot, arguments.cover)


def _timing(arguments: argparse.Namespace, vehicle: VehicleProfile | None) -> Timing:
    """Return period, lag and delay that are asked for, and refuse what another option makes them ignore."""
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.certificate.sampled_loop import Timing

    lag, delay = arguments.lag, arguments.delay
    if vehicle is not None:
        lag, delay = vehicle.lag if lag is None else lag, vehicle.delay if delay is None else delay
    timing = Timing(_PERIOD if arguments.period is None else arguments.period, lag or 0.0, delay or 0.0)
    if arguments.drift is not None or arguments.push is not None:
        if arguments.kappa is not None or arguments.gain_max is not None or arguments.lag or arguments.delay:
            raise FlatsatError(
                "--drift, --push: certified for the plain hold; drop --lag, --delay, --kappa, --gain-max, or give "
                "--flight: its certificates are of loops with lag and delay that are disturbed"
            )
        if not timing.immediate:
            raise FlatsatError(
                f"--drift, --push: certified for the plain hold; {arguments.vehicle} has a lag of {timing.lag:.6g} s "
                f"and a delay of {timing.delay:.6g} s: give --lag 0 --delay 0 to leave them out, or --flight to "
                "certify the disturbed loop with them"
            )
    elif timing.immediate and arguments.kappa is not None:
        raise FlatsatError(
            "--kappa goes with --lag, --delay or --vehicle; without lag and delay all kappa-sets are certified"
        )
    return timing


def _pair(option: str, values: list[float] | None) -> FloatArray | None:
    """Return (x and y, z) from one or two numbers."""
    import numpy as np

    from flatsat_ros.base.errors import refusal

    if values is None:
        return None
    if len(values) > 2:
        raise refusal(f"--{option}", list(values), "", "one number, or two as H,V")
    return np.array([values[0], values[-1]])


def _limits(arguments: argparse.Namespace, vehicle: VehicleProfile | None) -> tuple[InputSet, dict[str, str]]:
    """Return the input set that the arguments ask for, and how they ask for it."""
    from flatsat_ros.base.constants import GRAVITY
    from flatsat_ros.base.errors import FlatsatError, refusal
    from flatsat_ros.law.input_set import InputSet

    inputs = {} if vehicle is None else {"vehicle": vehicle.name}
    if arguments.thrust_max_g is not None:
        thrust, inputs["thrust_max"] = arguments.thrust_max_g * GRAVITY, f"{arguments.thrust_max_g} g"
    elif arguments.thrust_max is not None:
        thrust, inputs["thrust_max"] = arguments.thrust_max, f"{arguments.thrust_max} m/s^2"
    elif vehicle is not None:
        thrust, inputs["thrust_max"] = vehicle.thrust_max, f"all that {vehicle.name} lifts"
    else:
        raise FlatsatError("no thrust limit: give --thrust-max, --thrust-max-g or --vehicle")
    tilt = _TILT_MAX_DEG if arguments.tilt_max_deg is None else arguments.tilt_max_deg
    inputs["tilt_max"] = f"{tilt} deg"
    limits = InputSet(thrust, math.radians(tilt), GRAVITY)
    if vehicle is not None and thrust > vehicle.thrust_max:
        most = f"{vehicle.thrust_max:.6g} m/s^2 ({vehicle.thrust_max / GRAVITY:.4g} g)"
        weight = f"with {1e3 * vehicle.mass_for(thrust):.3g} g to take off, not {1e3 * vehicle.mass:.3g} g, it would do"
        if (voltage := vehicle.voltage_for(thrust)) is not None:
            weight += f"; so it would at {voltage:.3g} V under load, not {vehicle.voltage:.3g} V"
        raise refusal("thrust_max", thrust, "m/s^2", f"at most {most}, what {vehicle.name} lifts; {weight}")
    return limits, inputs


def _finish(certificate: Certificate, output: Path | None, plot: Path | None, cover: Sequence[float] | None) -> None:
    """Write the certificate and its pictures, and print it."""
    from flatsat_ros.synthesis.goals import start_corners
    from flatsat_ros.synthesis.report import table

    lines = table(certificate, None if cover is None else start_corners(cover))
    if output is not None:
        certificate.save(output)
    print(lines)
    print(f"  written to {output}" if output is not None else "  not written: give --output FILE")
    if plot is not None:
        from flatsat_ros.synthesis.pictures import draw

        draw(certificate, plot)
        print(f"  pictures in {plot}")
    print()


if __name__ == "__main__":
    sys.exit(main())
