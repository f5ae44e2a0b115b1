"""`ros2 run flatsat_ros synthesize`: limits and decay rate in, certificate out."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from flatsat_ros._resources import config_path
from flatsat_ros.core.certificate import Certificate
from flatsat_ros.core.errors import FlatsatError
from flatsat_ros.core.input_set import InputSet
from flatsat_ros.core.vehicle import VehicleProfile

_GRAVITY = 9.81

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
        0, or 2 after one line on stderr if the input cannot be used.
    """
    try:
        arguments = _parser().parse_args(argv)
        if arguments.paper is not None:
            _write_paper(arguments)
        else:
            _write_own(arguments)
    except (FlatsatError, OSError) as error:
        print(f"synthesize: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="synthesize",
        description="Compute a certificate: Lyapunov matrix, invariant set and gain interval of one vehicle.",
        epilog="example: synthesize --vehicle cf21 --thrust-max-g 1.4 --rate 1.25 --output cf21.yaml",
        allow_abbrev=False,
    )
    own = parser.add_argument_group("inputs")
    own.add_argument("--name", help="name of the certificate (default: the output file's)")
    thrust = own.add_mutually_exclusive_group()
    thrust.add_argument("--thrust-max", type=float, metavar="M_S2", help="T_max, m/s^2, normalised by the mass")
    thrust.add_argument("--thrust-max-g", type=float, metavar="G", help="T_max as a multiple of g = 9.81 m/s^2")
    own.add_argument("--tilt-max-deg", type=float, metavar="DEG", help=f"eps_max (default: {_TILT_MAX_DEG})")
    own.add_argument("--rate", type=float, metavar="1/S", help=f"decay rate alpha of V (default: {_RATE})")
    own.add_argument("--period", type=float, metavar="S", help=f"sampling period h (default: {_PERIOD})")
    own.add_argument(
        "--vehicle", metavar="NAME_OR_PATH", help="vehicle profile: its thrust is the default of T_max and bounds it"
    )
    own.add_argument("--output", type=Path, metavar="FILE", help="certificate to write; without it nothing is written")
    paper = parser.add_argument_group("certificates of the paper")
    paper.add_argument("--paper", choices=("simulation", "experiment", "all"), help="compute these instead")
    paper.add_argument("--output-dir", type=Path, metavar="DIR", help="folder to write them to (default: config)")
    parser.add_argument("--force", action="store_true", help="overwrite existing files")
    return parser


def _write_own(arguments: argparse.Namespace) -> None:
    if arguments.output_dir is not None:
        raise FlatsatError("--output-dir goes with --paper; a certificate of your own is written to --output")
    _require_writable(arguments.output, arguments.force)
    limits, inputs = _limits(arguments)
    name = arguments.name or (arguments.output.stem if arguments.output else "unnamed")
    rate = _RATE if arguments.rate is None else arguments.rate
    period = _PERIOD if arguments.period is None else arguments.period

    from flatsat_ros.synthesis.nominal import synthesize  # cvxpy takes a second to import

    certificate = synthesize(limits, rate, period, name, inputs)
    _finish(certificate, arguments.output)


def _write_paper(arguments: argparse.Namespace) -> None:
    others = ("name", "thrust_max", "thrust_max_g", "tilt_max_deg", "rate", "period", "vehicle", "output")
    given = [f"--{name.replace('_', '-')}" for name in others if getattr(arguments, name) is not None]
    if given:
        raise FlatsatError(f"{', '.join(given)}: the paper's certificates take no inputs; drop it or --paper")

    from flatsat_ros.synthesis.nominal import PAPER, synthesize_paper

    names = [name for name in PAPER if arguments.paper in ("all", name.removeprefix("paper_"))]
    targets = {name: (arguments.output_dir or Path("config")) / f"{name}.yaml" for name in names}
    for target in targets.values():
        _require_writable(target, arguments.force)
    for name, target in targets.items():
        _finish(synthesize_paper(name), target)


def _limits(arguments: argparse.Namespace) -> tuple[InputSet, dict[str, str]]:
    """Return the input set that the arguments ask for, and how they ask for it."""
    vehicle = None
    inputs = {}
    if arguments.vehicle is not None:
        vehicle = VehicleProfile.load(config_path(arguments.vehicle, "vehicles"))
        inputs["vehicle"] = vehicle.name
    if arguments.thrust_max_g is not None:
        thrust, inputs["thrust_max"] = arguments.thrust_max_g * _GRAVITY, f"{arguments.thrust_max_g} g"
    elif arguments.thrust_max is not None:
        thrust, inputs["thrust_max"] = arguments.thrust_max, f"{arguments.thrust_max} m/s^2"
    elif vehicle is not None:
        thrust, inputs["thrust_max"] = vehicle.thrust_max, f"all that {vehicle.name} lifts"
    else:
        raise FlatsatError("no thrust limit: give --thrust-max, --thrust-max-g or --vehicle")
    tilt = _TILT_MAX_DEG if arguments.tilt_max_deg is None else arguments.tilt_max_deg
    inputs["tilt_max"] = f"{tilt} deg"
    limits = InputSet(thrust, math.radians(tilt), _GRAVITY)
    if vehicle is not None and thrust > vehicle.thrust_max:
        raise FlatsatError(
            f"thrust_max = {thrust:.6g} m/s^2 ({thrust / _GRAVITY:.4g} g) is more than {vehicle.name} lifts: must be "
            f"at most {vehicle.thrust_max:.6g} m/s^2 ({vehicle.thrust_max / _GRAVITY:.4g} g)"
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


def _finish(certificate: Certificate, target: Path | None) -> None:
    """Write the certificate and print it."""
    if target is not None:
        certificate.save(target)
    print(_table(certificate))
    print(f"  written to {target}\n" if target is not None else "  not written: give --output FILE\n")


def _table(certificate: Certificate) -> str:
    limits, check = certificate.limits, certificate.provenance["cross_check"]
    rest_radius = limits.inner_radius * math.sqrt(2.0) / certificate.rate**2
    rows = [
        ("thrust limit T_max", f"{limits.thrust_max:.6g} m/s^2 ({limits.thrust_max / limits.gravity:.4g} g)"),
        ("tilt limit eps_max", f"{limits.tilt_max:.6g} rad ({math.degrees(limits.tilt_max):.4g} deg)"),
        ("decay rate alpha", f"{certificate.rate:.6g} 1/s"),
        ("P, per axis", "[[{:.7g}, {:.7g}], [{:.7g}, {:.7g}]]".format(*certificate.block.ravel())),
        ("input ball rho", f"{certificate.ball:.7g} m^2/s^4"),
        ("level eps", f"{certificate.level:.7g}"),
        ("largest offset from rest", f"{rest_radius:.4g} m"),
        ("period h", f"{certificate.period:.6g} s"),
        ("gain interval", f"[{certificate.gain_min:.6g}, {certificate.gain_max:.6g}]"),
        ("solver", f"{certificate.provenance['solver']}, {check['status']}"),
        *((f"difference in {key} below", f"{value:.0e}") for key, value in check["relative_difference_below"].items()),
    ]
    lines = [f"certificate {certificate.name}", *(f"  {label:<26}{value}" for label, value in rows)]
    lines.append("  relative margins (0: tight)")
    # a tight inequality shows its rounding, of either sign; verify has bounded it
    lines += [f"    {abs(round(value, 12)):<10.3g}{name}" for name, value in certificate.verify().items()]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
