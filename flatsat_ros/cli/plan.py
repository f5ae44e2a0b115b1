"""`ros2 run flatsat_ros plan`: way-points in, a proved plan out."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell

if TYPE_CHECKING:
    from flatsat_ros.certificate.certificate import Certificate
    from flatsat_ros.planning.mission import Mission
    from flatsat_ros.planning.planner import Round
    from flatsat_ros.plans import Plan

_SECONDS = 20.0
_SHOWN = 5  # pairs


def main(argv: Sequence[str] | None = None) -> int:
    """Plan, or prove a plan again; 0 when done, see `shell` for the others."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # products of small matrices: threads only wait for each other
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser(
        "plan",
        "Plan references through way-points that are proved to keep all limits and, for many drones, to keep apart by "
        "both bodies and both tubes at all times.",
        "example: plan waypoints.csv --output tour.yaml",
    )
    parser.add_argument(
        "file", nargs="?", type=shell.path, metavar="FILE",
        help="way-points: .csv with columns x,y,z[,yaw][,t][,radius], or crazyswarm's polynomials, for one drone; "
        ".yaml for many, .json for missions",
    )  # fmt: skip
    parser.add_argument("--output", type=shell.path, metavar="FILE", help="plan to write; without it none is written")
    parser.add_argument(
        "--verify", type=shell.path, metavar="FILE", help="only prove this plan again, without a solver"
    )
    parser.add_argument(
        "--certificate",
        metavar="NAME_OR_PATH",
        help="whose limits the references keep; with a flight section it proves tubes (default: cf21_adaptive_50hz; "
        "for --verify the plan's own)",
    )
    wishes = parser.add_argument_group("wishes")
    for option, unit, text in (
        (
            "tube",
            "M",
            "how far a drone may be off its reference; references are then so slow that the certificate proves it, or, "
            "where it cannot, it is your word (default: what the certificate proves for all it assumes of references, "
            "or 0.05)",
        ),
        (
            "margin",
            "M_S2",
            "of what references ask the law for to the input set (default: what the certificate needs, or half the "
            "radius of the ball around hover)",
        ),
        ("jerk-max", "M_S3", "largest jerk (default: what the certificate assumes, less a tenth, or 2)"),
        ("snap-max", "M_S4", "largest snap (default: what the certificate assumes, less a tenth, or 20)"),
        ("speed-max", "M_S", "largest speed (default: not bounded)"),
        ("clearance", "M", "kept between drones beside bodies and tubes (default: 0)"),
        ("floor", "M", "lowest height of references (default: the mission's, else that of the first way-point)"),
        ("seconds", "S", f"how long to search (default: {_SECONDS:g}); the best plan by then, or by Ctrl-C, is kept"),
    ):
        wishes.add_argument(f"--{option}", type=shell.number, metavar=unit, help=text)
    wishes.add_argument(
        "--laps", type=shell.integer, metavar="N",
        help="fly way-points that end where they begin N times without a stop (default: the mission's, else from rest "
        "to rest)",
    )  # fmt: skip
    parser.add_argument(
        "--from-poses", action="store_true",
        help="the file has goals only, .yaml: drones set out from where they are, as a running controller tells",
    )  # fmt: skip
    parser.add_argument("--trade", action="store_true", help="only show which tube goes with which duration")
    parser.add_argument("--force", action="store_true", help="overwrite the output")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import FlatsatError

    if arguments.verify is not None:
        shell.require_alone(arguments, "verify", "certificate")
        _verify(arguments.verify, arguments.certificate)
    elif arguments.file is None:
        raise FlatsatError("no way-points: give a file, or --verify with a plan; see --help")
    else:
        _plan(arguments)
    return 0


def _verify(path: Path, certificate: str | None) -> None:
    """Prove a plan again, with the tubes that the named certificate or else its own proves; print what is left."""
    from flatsat_ros.base.resources import is_packaged
    from flatsat_ros.certificate.certificate import load_certificate
    from flatsat_ros.plans import Plan
    from flatsat_ros.plans.tubes import require_tubes

    plan = Plan.load(path)
    is_proved = any(drone.tube.source == "certificate" for drone in plan.drones)
    if certificate is None and is_proved and is_packaged(plan.certificate):
        certificate = plan.certificate
    if certificate is not None:
        require_tubes(plan, load_certificate(certificate))
    print(f"plan {plan.name} in {path} holds: proved with integers, for all times")
    _tell(plan)
    if is_proved and certificate is None:
        print(f"  {plan.certificate} is not packaged: that it proves the tubes was not looked at; give --certificate")


def _plan(arguments: argparse.Namespace) -> None:
    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, load_certificate
    from flatsat_ros.planning.inputs import Wishes, read_mission
    from flatsat_ros.planning.planner import plan

    output: Path | None = arguments.output
    for option in ("output", "seconds") if arguments.trade else ():
        if getattr(arguments, option) is not None:
            raise FlatsatError(f"--{option}: not used with --trade, which makes no plan; drop one or the other")
    if output is not None:
        shell.require_apart("--output", output, {"FILE": arguments.file})
        shell.require_new(output, arguments.force)
    elif arguments.force:
        raise FlatsatError("--force overwrites the output; without --output none is written")
    options = ("tube", "margin", "jerk_max", "snap_max", "speed_max", "clearance", "floor", "laps")
    given = {name: getattr(arguments, name) for name in options if getattr(arguments, name) is not None}
    certificate = load_certificate(DEFAULT_CERTIFICATE if arguments.certificate is None else arguments.certificate)
    name = (output or arguments.file).stem
    present = _present if arguments.from_poses else None
    mission = read_mission(arguments.file, certificate, Wishes(**given), name, present)
    if arguments.trade:
        _show_trade(mission, certificate)
        return
    seconds = _SECONDS if arguments.seconds is None else arguments.seconds
    found = plan(mission, seconds, tell_round)
    if output is not None:
        found.save(output)
    print(f"plan {found.name} for certificate {found.certificate}: proved with integers, for all times")
    _tell(found)
    if any(drone.tube.source == "certificate" for drone in found.drones):
        print("  a smaller tube takes longer: --trade shows how much, --tube asks for it")
    if "polynomials" in found.provenance:
        print(f"  polynomials {found.provenance['polynomials']}")
    print(f"  written to {output}" if output is not None else "  not written: give --output FILE")


def _present(names: Sequence[str]) -> Mapping[str, Sequence[float]]:
    """Return where drones are now, m; a process of its own asks, for this one needs no ROS.

    Raises:
        FlatsatError: it cannot tell; the text says why.
    """
    from flatsat_ros.base.errors import FlatsatError

    parameter = f"robot_names:=[{', '.join(names)}]"
    command = [sys.executable, "-m", "flatsat_ros.nodes.present_places", "--ros-args", "-p", parameter]
    asked = subprocess.run(command, capture_output=True, text=True, check=False)
    if asked.returncode != 0:
        lines = asked.stderr.strip().splitlines() or [f"it ended with exit code {asked.returncode}"]
        raise FlatsatError(f"present places are not known: {lines[-1].removeprefix('error: ')}")
    return dict(json.loads(asked.stdout))


def _show_trade(mission: Mission, certificate: Certificate) -> None:
    """Print which tubes and durations go with which bounds."""
    from flatsat_ros.planning.trade import trade

    print("acceleration m/s^2  jerk m/s^3  snap m/s^4  tube m  duration s, at least")
    for choice in trade(mission, certificate):
        most = "-" if choice.acceleration_max is None else f"{choice.acceleration_max:.3f}"
        tube = "   -  " if choice.tube is None else f"{choice.tube:6.4f}"
        bound = choice.refused if choice.bound is None else f"{choice.bound:.2f}"
        print(f"{most:>18}  {choice.jerk_max:10.3f}  {choice.snap_max:10.3f}  {tube}  {bound}", flush=True)


def tell_round(proved: Round) -> None:
    """Say on stderr what has been proved."""
    beside = "" if proved.bound is None else f", {proved.duration / proved.bound:.3f} of the slowest drone alone"
    print(f"  proved: {proved.duration:.3f} s{beside}", file=sys.stderr, flush=True)


def _tell(plan: Plan) -> None:
    """Print duration, limits and the nearest pairs of a plan."""
    bounds, laps = plan.bounds, plan.laps
    of = (
        ""
        if laps is None
        else f", {laps.count} laps of {plan.drones[0].curve.duration:.3f} s, {laps.ramp:g} s to set out"
    )
    print(f"  {f'{len(plan.drones)} drones, ' if len(plan.drones) > 1 else ''}{plan.duration:.3f} s{of}")
    speed = "" if bounds.speed_max is None else f", speed at most {bounds.speed_max:g} m/s"
    if bounds.acceleration_max is not None:
        speed += f", acceleration at most {bounds.acceleration_max:.4g} m/s^2"
    led = ", drag and lead counted," if len(bounds.asked) > 1 else ","
    print(
        f"  margin {bounds.margin:.4g} m/s^2 to the input set{led} jerk at most {bounds.jerk_max:g} m/s^3, snap "
        f"{bounds.snap_max:g} m/s^4{speed}"
    )
    print(f"  box {bounds.lower.tolist()} to {bounds.upper.tolist()} m")
    for radius, source in sorted({(drone.tube.radius, drone.tube.source) for drone in plan.drones}):
        proved = f"proved by {plan.certificate}" if source == "certificate" else "given, not proved by a certificate"
        print(f"  tubes of {radius:g} m: {proved}")
    drones = {drone.name: drone for drone in plan.drones}
    nearest = [(pair, plan.required(drones[pair.first], drones[pair.second])) for pair in plan.pairs]
    nearest += [(passage, plan.required(drones[passage.first])) for passage in plan.passages]
    nearest.sort(key=lambda each: each[0].distance / 1e4 - float(each[1]))
    for pair, required in nearest[:_SHOWN]:
        print(
            f"  {pair.first}, {pair.second}: at least {pair.distance / 1e4:.4f} m apart (asked {float(required):.4f}), "
            f"nearest at {pair.start / 1e6:.2f} s"
        )
    if len(nearest) > _SHOWN:
        print(f"  and {len(nearest) - _SHOWN} pairs with more room")


if __name__ == "__main__":
    sys.exit(main())
