"""`ros2 run flatsat_ros identify`: from flight logs to a vehicle profile, each figure with an interval."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell

if TYPE_CHECKING:
    from flatsat_ros.base.arrays import FloatArray
    from flatsat_ros.crazyflie.vehicle import VehicleProfile
    from flatsat_ros.identification.columns import ColumnMap
    from flatsat_ros.identification.identified import Identified
    from flatsat_ros.identification.log import ClaimedFlight, FlightLog
    from flatsat_ros.viewing.flight import Channel

_BASE = "cf21"
_PICTURES = (".png", ".pdf", ".svg")
_WAY = 1.0  # s, by which poses are longer on their way than others, up to which it is not a clock that was set


def main(argv: Sequence[str] | None = None) -> int:
    """Identify a drone; 0 if that went well, see `shell` for the others."""
    return shell.run(_parser, _run, argv)


def _parser() -> shell.Parser:
    parser = shell.Parser(
        "identify",
        "Identify a drone from logs of its flights: thrust, attitude, delay, drag, noise and disturbance, each with an "
        "interval for other flights of the same drone. Writes a vehicle profile and a page of pictures.",
        "logs: CSV of a known form or described by --columns, or bags with poses and cmd_vel_legacy of one drone. "
        "example: identify flight1.csv flight2.csv --output my_drone.yaml",
    )
    add_log_arguments(parser)
    parser.add_argument("--output", type=shell.path, metavar="FILE", help="vehicle profile to write, a .yaml file")
    parser.add_argument("--pictures", type=shell.path, metavar="FILE", help="page to draw: .png, .pdf or .svg")
    parser.add_argument("--force", action="store_true", help="overwrite the output")
    return parser


def add_log_arguments(parser: shell.Parser) -> None:
    """Add the arguments that say what the logs are."""
    parser.add_argument("logs", nargs="+", type=shell.path, metavar="LOG", help="a CSV file, or a bag")
    parser.add_argument(
        "--base", metavar="NAME_OR_PATH", help=f"profile of its kind, for what logs do not tell ({_BASE})"
    )
    parser.add_argument(
        "--columns", metavar="NAME_OR_PATH", help="column map of the CSV files (default: by the header)"
    )
    parser.add_argument(
        "--drone", metavar="NAME", help="whose flight, of a bag with several; each drone is judged by itself"
    )
    parser.add_argument(
        "--backend",
        choices=("cpp", "cflib"),
        help="crazyswarm2's, which gives the sign of pitch in bags (default: cpp)",
    )


def base_of(arguments: argparse.Namespace) -> VehicleProfile:
    """Return the profile that keeps what logs do not tell.

    Raises:
        FlatsatError: there is none of that name.
    """
    from flatsat_ros.crazyflie.vehicle import load_vehicle

    return load_vehicle(_BASE if arguments.base is None else arguments.base)


def _run(arguments: argparse.Namespace) -> int:
    from flatsat_ros.base.errors import refusal
    from flatsat_ros.base.files import check_writable
    from flatsat_ros.base.strict_yaml import write_yaml
    from flatsat_ros.crazyflie.vehicle import profile_document
    from flatsat_ros.identification.identified import profile_of
    from flatsat_ros.identification.report import draw, lines

    _check_output(arguments)
    if arguments.pictures is not None:
        if arguments.pictures.suffix not in _PICTURES:
            raise refusal("--pictures", str(arguments.pictures), "", "a .png, .pdf or .svg file")
        check_writable(arguments.pictures)
    base = base_of(arguments)
    found, _, names = identified_from(arguments, base)
    print("\n".join(lines(found, base)))
    if arguments.pictures is not None:
        draw(found, arguments.pictures)
        print(f"  drawn to {arguments.pictures}")
    if arguments.output is not None:
        profile = profile_of(found, base, arguments.output.stem)
        flights = f"{len(names)} flights: {', '.join(names)}"
        header = f"# Identified on {base.name} from {flights}.\n# The intervals are for other flights of this drone.\n"
        write_yaml(arguments.output, profile_document(profile), header)
        print(f"  written to {arguments.output}")
    else:
        print("  not written: give --output FILE")
    return 0


def identified_from(
    arguments: argparse.Namespace, base: VehicleProfile
) -> tuple[Identified, list[FlightLog], list[str]]:
    """Read the logs that the arguments name, say what is used of them, and identify the drone, with progress.

    Returns:
        What they tell, the logs, and their names.

    Raises:
        FlatsatError: a log is refused.
    """
    from tqdm import tqdm

    from flatsat_ros.base.errors import FlatsatError
    from flatsat_ros.identification.columns import load_columns
    from flatsat_ros.identification.identified import identify
    from flatsat_ros.identification.report import screening_lines
    from flatsat_ros.identification.screening import screen

    bags = [_is_bag(path) for path in arguments.logs]
    if (arguments.drone, arguments.backend) != (None, None) and not any(bags):
        raise FlatsatError("--drone, --backend: they are for bags, of which there is none among the logs")
    if arguments.columns is not None and all(bags):
        raise FlatsatError("--columns: it is for CSV files, of which there is none among the logs")
    columns = None if arguments.columns is None else load_columns(arguments.columns)
    logs, samples = [], []
    for path in arguments.logs:
        logs.append(_read(path, columns, arguments))
        samples.append(screen(logs[-1]))
        print("\n".join(screening_lines(samples[-1])), flush=True)
    with tqdm(total=4 + len(samples), unit=" fits", desc="identify", leave=False) as bar:

        def advance(what: str) -> None:
            bar.set_description(what)
            bar.update(1)

        return identify(samples, base, advance), logs, [each.name for each in samples]


def _check_output(arguments: argparse.Namespace) -> None:
    """Refuse an output that cannot be written before anything is computed."""
    from flatsat_ros.base.errors import FlatsatError, refusal

    output: Path | None = arguments.output
    if output is None:
        if arguments.force:
            raise FlatsatError("--force overwrites the output; without --output none is written")
        return
    if output.suffix != ".yaml":
        raise refusal("--output", str(output), "", "a .yaml file, whose name the profile has")
    shell.require_new(output, arguments.force)


def _is_bag(path: Path) -> bool:
    return path.is_dir() or path.suffix in (".mcap", ".db3")


def _read(path: Path, columns: ColumnMap | None, arguments: argparse.Namespace) -> FlightLog:
    """Read a CSV file or a bag."""
    from flatsat_ros.identification.log import read_log

    if _is_bag(path):
        return bag_log(path, arguments.drone, arguments.backend or "cpp")
    return read_log(path, columns)


def bag_log(path: Path, drone: str | None, backend: str) -> FlightLog:
    """Read poses and set-points of one drone from a bag, on the recorder's clock.

    Set-points have no stamps: their times are those at which they were recorded.

    Args:
        path: of the bag.
        drone: its name; None: the only one with both.
        backend: crazyswarm2's, cpp or cflib.

    Raises:
        FlatsatError: the bag cannot be read, or has no such drone with poses and set-points.
    """
    import numpy as np

    from flatsat_ros.base.errors import FlatsatError, quoted
    from flatsat_ros.base.files import located
    from flatsat_ros.crazyflie.wire import Backend
    from flatsat_ros.identification.log import FlightLog, angles_of
    from flatsat_ros.viewing.bag import read_flight

    tracks = {
        track.name: track.channels for track in read_flight(path).tracks if {"pose", "command"} <= track.channels.keys()
    }
    name = next(iter(tracks)) if drone is None and len(tracks) == 1 else drone
    if name not in tracks:
        names = ", ".join(sorted(tracks)) or "none"
        given = "--drone is not given" if drone is None else f"--drone = {quoted(drone)}"
        raise located(path, f"{given}: must be one that has both poses and cmd_vel_legacy: {names}")
    channels = tracks[name]
    pose, command, battery = channels["pose"], channels["command"], channels.get("battery")
    ticks = channels.get("tick")
    scale = (math.radians(1.0), Backend(backend).pitch_sign * math.radians(1.0), 1.0)
    sent = np.stack([command.column(each) for each in ("roll", "pitch", "thrust")], axis=-1)
    try:
        return FlightLog(
            name=f"{path.stem}/{name}" if len(tracks) > 1 else path.stem,
            pose_time=_measured(pose),
            position=np.stack([pose.column(axis) for axis in "xyz"], axis=-1),
            angles=angles_of([pose.column(f"q{axis}") for axis in "xyzw"]),
            command_time=command.times,
            command=sent * scale,
            voltage_time=np.empty(0) if battery is None else battery.times,
            voltage=np.empty(0) if battery is None else battery.column("voltage"),
            flown=None if ticks is None else _flown(ticks),
            arrived=pose.times,
        )
    except FlatsatError as error:
        raise located(path, error) from error


def _measured(pose: Channel) -> FloatArray:
    """Return when poses were measured, (n,), s on the recorder's clock; when they came, if their stamps do not tell.

    A recorder that is late makes a drone that moves look disturbed; its stamps do not. What clocks differ by and what
    each pose took on its way is not to be told apart: the least time on the way counts as none.
    """
    import numpy as np

    if pose.stamps is None:
        return pose.times
    way = pose.times - pose.stamps
    return pose.times if float(np.ptp(way)) > _WAY else pose.stamps + way.min()


def _flown(ticks: Channel) -> ClaimedFlight:
    """Return what our controller claimed in the ticks in FLY that have an error."""
    import numpy as np

    from flatsat_ros.flight.assumptions import Assumption
    from flatsat_ros.flight.modes import Mode
    from flatsat_ros.identification.log import ClaimedFlight

    error = np.stack([ticks.column(f"error_{axis}") for axis in "xyz"], axis=-1)
    flying = (ticks.column("mode") == Mode.FLY) & np.isfinite(error).all(axis=1)
    tube = np.stack([ticks.column("tube"), ticks.column("tube_z")], axis=-1)
    # outside the tube although all was as assumed for long is a claim, too, one that was broken
    claimed = np.isin(ticks.column("assumption"), (Assumption.NONE, Assumption.TUBE))
    return ClaimedFlight(error[flying], tube[flying], claimed[flying])


if __name__ == "__main__":
    sys.exit(main())
