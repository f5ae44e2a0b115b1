"""`ros2 run flatsat_ros synthesize`: limits and goals in, certificate out."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.report import margins, table

# what is taken when the user does not say otherwise: the paper's experiment
_TILT_MAX_DEG = 10.0
_RATE = 1.25
_PERIOD = 0.1


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Report a bad command line like any other bad input: in one line."""
        raise FlatsatError(f"{message}; see --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments without the program's name; those of the process if None.

    Returns:
        0, or 2 after one line on stderr if the input cannot be used or a certificate does not hold.
    """
    try:
        arguments = _parser().parse_args(argv)
        if arguments.verify is not None:
            _verify(arguments.verify)
        elif arguments.paper is not None:
            _write_paper(arguments)
        else:
            _write_own(arguments)
    except (FlatsatError, OSError) as error:
        print(f"synthesize: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def _numbers(text: str) -> list[float]:
    """Read numbers separated by commas."""
    return [float(item) for item in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="synthesize",
        description="Compute a certificate: Lyapunov matrix, invariant sets and gain interval of one vehicle's loop.",
        epilog="example: synthesize --vehicle cf21 --cover 1.2,1.2,0.8 --output cf21.yaml --plot cf21.png",
        allow_abbrev=False,
    )
    own = parser.add_argument_group("inputs")
    own.add_argument("--name", help="name of the certificate (default: the output file's)")
    thrust = own.add_mutually_exclusive_group()
    thrust.add_argument("--thrust-max", type=float, metavar="M_S2", help="T_max, m/s^2, normalised by the mass")
    thrust.add_argument("--thrust-max-g", type=float, metavar="G", help=f"T_max as a multiple of g = {GRAVITY} m/s^2")
    own.add_argument("--tilt-max-deg", type=float, metavar="DEG", help=f"eps_max (default: {_TILT_MAX_DEG})")
    own.add_argument("--period", type=float, metavar="S", help=f"sampling period h (default: {_PERIOD})")
    own.add_argument("--lag", type=float, metavar="S", help="lag tau of the acceleration (default: vehicle's, or 0)")
    own.add_argument("--delay", type=float, metavar="S", help="delay d of the command (default: vehicle's, or 0)")
    own.add_argument(
        "--vehicle", metavar="NAME_OR_PATH", help="vehicle profile: lag, delay, and the bound and default of T_max"
    )
    goals = parser.add_argument_group("goals")
    goals.add_argument("--rate", type=float, metavar="1/S", help=f"decay rate alpha (default: {_RATE}) or beta")
    goals.add_argument("--cover", type=_numbers, metavar="DX,DY,DZ[,VX,VY,VZ]", help="cover these start errors, m, m/s")
    goals.add_argument("--drift", type=_numbers, metavar="H[,V]", help="withstand this drift of the position, m/s")
    goals.add_argument("--push", type=_numbers, metavar="H[,V]", help="withstand this push, m/s^2")
    goals.add_argument(
        "--kappa", type=float, metavar="K", help="with lag or delay: certify kappa-sets down to this (default: 1)"
    )
    goals.add_argument("--gain-max", type=float, metavar="G", help="a smaller cap: larger sets with lag or delay")
    own.add_argument("--output", type=Path, metavar="FILE", help="certificate to write; without it nothing is written")
    own.add_argument("--plot", type=Path, metavar="FILE", help="a page of pictures, PNG, PDF or SVG")
    parser.add_argument("--verify", type=Path, metavar="FILE", help="only check this certificate and print its margins")
    paper = parser.add_argument_group("certificates of the paper")
    paper.add_argument("--paper", choices=("simulation", "experiment", "robust", "all"), help="compute these instead")
    paper.add_argument("--output-dir", type=Path, metavar="DIR", help="folder to write them to (default: config)")
    parser.add_argument("--force", action="store_true", help="overwrite existing files")
    return parser


def _write_own(arguments: argparse.Namespace) -> None:
    if arguments.output_dir is not None:
        raise FlatsatError("--output-dir goes with --paper; a certificate of your own is written to --output")
    for target in (arguments.output, arguments.plot):
        _require_writable(target, arguments.force)
    vehicle = None
    if arguments.vehicle is not None:
        vehicle = load_vehicle(arguments.vehicle)
    limits, inputs = _limits(arguments, vehicle)
    name = arguments.name or (arguments.output.stem if arguments.output else "unnamed")
    period = _PERIOD if arguments.period is None else arguments.period
    if arguments.drift is not None or arguments.push is not None:
        certificate = _robust(arguments, limits, inputs, period, name)
    else:
        certificate = _nominal(arguments, vehicle, limits, inputs, period, name)
    _finish(certificate, arguments, arguments.output)


def _nominal(
    arguments: argparse.Namespace,
    vehicle: VehicleProfile | None,
    limits: InputSet,
    inputs: dict[str, str],
    period: float,
    name: str,
) -> Certificate:
    from flatsat_ros.synthesis.goals import rate_covering  # cvxpy takes a second to import
    from flatsat_ros.synthesis.nominal import synthesize

    lag, delay = arguments.lag, arguments.delay
    if vehicle is not None:
        lag, delay = vehicle.lag if lag is None else lag, vehicle.delay if delay is None else delay
    timing = Timing(period, lag or 0.0, delay or 0.0)
    lowest = 1.0 if arguments.kappa is None else arguments.kappa
    if not 0.0 < lowest <= 1.0:
        raise FlatsatError(f"--kappa {lowest}: must lie in (0, 1]")
    highest = math.inf if arguments.gain_max is None else arguments.gain_max
    if not highest >= 1.0:
        raise FlatsatError(f"--gain-max {highest}: must be at least 1")
    rate = arguments.rate
    if arguments.cover is not None:
        inputs["cover"] = ",".join(map(str, arguments.cover))
        if rate is None:
            rate = rate_covering(limits, arguments.cover, timing, lowest, highest)
    return synthesize(
        limits,
        _RATE if rate is None else rate,
        period,
        name,
        inputs,
        lag=timing.lag,
        delay=timing.delay,
        lowest=lowest,
        highest=highest,
    )


def _robust(
    arguments: argparse.Namespace, limits: InputSet, inputs: dict[str, str], period: float, name: str
) -> Certificate:
    if arguments.lag or arguments.delay or arguments.kappa is not None or arguments.gain_max is not None:
        raise FlatsatError("--drift, --push: certified for the plain hold; drop --lag, --delay, --kappa, --gain-max")
    from flatsat_ros.synthesis.goals import robust_rate_covering
    from flatsat_ros.synthesis.robust_design import synthesize_robust

    drift, push = (_pair(option, getattr(arguments, option)) for option in ("drift", "push"))
    rate = arguments.rate
    if arguments.cover is not None:
        inputs["cover"] = ",".join(map(str, arguments.cover))
        if rate is None:
            rate = robust_rate_covering(limits, arguments.cover, period, drift, push)
    return synthesize_robust(limits, drift, push, period, name, inputs, rate)


def _pair(option: str, values: list[float] | None) -> FloatArray:
    """Return (x and y, z) from one or two numbers."""
    values = values or [0.0]
    if len(values) > 2:
        raise FlatsatError(f"--{option} {','.join(map(str, values))}: must be one number, or two as H,V")
    return np.array([values[0], values[-1]])


def _write_paper(arguments: argparse.Namespace) -> None:
    others = set(vars(arguments)) - {"paper", "output_dir", "force", "verify"}
    given = [f"--{name.replace('_', '-')}" for name in sorted(others) if getattr(arguments, name) is not None]
    if given:
        raise FlatsatError(f"{', '.join(given)}: the paper's certificates take no inputs; drop it or --paper")

    from flatsat_ros.synthesis.nominal import PAPER, synthesize_paper
    from flatsat_ros.synthesis.robust_design import synthesize_paper_robust

    makers = {name: partial(synthesize_paper, name) for name in PAPER} | {"paper_robust": synthesize_paper_robust}
    names = [name for name in makers if arguments.paper in ("all", name.removeprefix("paper_"))]
    targets = {name: (arguments.output_dir or Path("config")) / f"{name}.yaml" for name in names}
    for target in targets.values():
        _require_writable(target, arguments.force)
    for name, target in targets.items():
        _finish(makers[name](), arguments, target)


def _verify(path: Path) -> None:
    """Check a certificate and print its margins."""
    certificate = Certificate.load(path)
    print(f"certificate {certificate.name} in {path} holds")
    print("\n".join(margins(certificate)))


def _limits(arguments: argparse.Namespace, vehicle: VehicleProfile | None) -> tuple[InputSet, dict[str, str]]:
    """Return the input set that the arguments ask for, and how they ask for it."""
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
        raise FlatsatError(
            f"thrust_max = {thrust:.6g} m/s^2 ({thrust / GRAVITY:.4g} g) is more than {vehicle.name} lifts: must be "
            f"at most {vehicle.thrust_max:.6g} m/s^2 ({vehicle.thrust_max / GRAVITY:.4g} g)"
        )
    return limits, inputs


def _require_writable(target: Path | None, force: bool) -> None:
    """Refuse, before anything is computed, a target that exists or whose folder does not."""
    if target is None:
        return
    if not target.parent.is_dir():
        raise FlatsatError(f"{target}: the folder {target.parent} does not exist")
    if target.exists() and not force:
        raise FlatsatError(f"{target} exists: give --force to overwrite it")


def _finish(certificate: Certificate, arguments: argparse.Namespace, target: Path | None) -> None:
    """Write the certificate and its pictures, and print it."""
    start = None
    if arguments.cover is not None:
        from flatsat_ros.synthesis.goals import corners

        start = corners(arguments.cover)
        if not certificate.sets.classify(start).guaranteed.all():
            kappa = float(certificate.sets.kappa(start).min())
            raise FlatsatError(
                f"these start errors need kappa = {kappa:.4g}, certified is {certificate.gain_min:.4g} and more"
                + (", or the disturbance lifts them out of D" if certificate.robust else "")
                + ": without --rate the largest rate that covers them is chosen"
            )
    lines = table(certificate, start)
    if target is not None:
        certificate.save(target)
    print(lines)
    print(f"  written to {target}" if target is not None else "  not written: give --output FILE")
    if arguments.plot is not None:
        from flatsat_ros.synthesis.pictures import draw

        draw(certificate, arguments.plot)
        print(f"  pictures in {arguments.plot}")
    print()


if __name__ == "__main__":
    sys.exit(main())
