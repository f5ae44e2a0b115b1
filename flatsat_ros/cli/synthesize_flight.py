"""`synthesize --flight` and `synthesize --designs`: certificates of the whole loop that flies."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from flatsat_ros.cli import shell

if TYPE_CHECKING:
    from flatsat_ros.certificate.certificate import Certificate

# what is taken when the user does not say otherwise
_TILT_MAX_DEG, _GAIN_MAX, _PERIOD, _ASSUMED = 20.0, 4.0, 0.02, "still"
_DISTURBANCE = 0.5  # m/s^2: drag in about 1 m/s of wind
_RETURN_RATE = 0.5  # 1/s
# share of the room for the gain that v0 of the horizontal axes, and that of the vertical one, may take
_SHARE = 0.6
_SECONDS = 90.0  # of search, for each kind of axes


def write_flight(arguments: argparse.Namespace, output: Path | None) -> None:
    """Search, prove, write and print a flight certificate for a vehicle.

    Raises:
        FlatsatError: wishes cannot be met; the text names one to give up.
    """
    from flatsat_ros.base.constants import GRAVITY
    from flatsat_ros.base.errors import FlatsatError, refusal, require_positive
    from flatsat_ros.crazyflie.vehicle import load_vehicle
    from flatsat_ros.law.input_set import InputSet
    from flatsat_ros.synthesis.flight_design import FlightDesign
    from flatsat_ros.synthesis.flight_search import Goal
    from flatsat_ros.synthesis.flight_trade import proved, require_tilt, searched, sentence, trade
    from flatsat_ros.synthesis.flight_wishes import asked_for, assumed, sides, upright

    if arguments.vehicle is None:
        raise FlatsatError("--flight needs --vehicle, whose plants it is for")
    vehicle, assume = load_vehicle(arguments.vehicle), _ASSUMED if arguments.assume is None else arguments.assume
    shell.require_apart("--output", output, {"--assume": assume})
    assumptions, intervals = assumed(assume)
    name = certificate_name(arguments.name, output)
    seconds = _SECONDS if arguments.seconds is None else require_positive("--seconds", arguments.seconds, "s")
    gain = _GAIN_MAX if arguments.gain_max is None else arguments.gain_max
    if not gain >= 1.0:
        raise refusal("--gain-max", gain, "", "at least 1")
    tilt = _TILT_MAX_DEG if arguments.tilt_max_deg is None else arguments.tilt_max_deg
    period = _PERIOD if arguments.period is None else arguments.period
    limits = InputSet(vehicle.thrust_max, math.radians(tilt), GRAVITY)
    kinds = {"horizontal": sides(vehicle, intervals), "vertical": upright(vehicle, intervals)}
    asked = asked_for(assumptions, *(plants.model for plants in kinds.values()))
    margin = math.floor(1e3 * (limits.inner_radius - asked)) / 1e3
    room = margin - _DISTURBANCE
    if not room > 0.0:
        least, way_out = GRAVITY + asked + _DISTURBANCE, "give up tilt_max or acceleration"
        if vehicle.thrust_max <= least + 1e-3:
            lacking = f"{vehicle.name} lacks {least - vehicle.thrust_max:.3g} m/s^2 of thrust"
            way_out = f"{lacking}, take off with below {1e3 * vehicle.mass_for(least):.3g} g"
            if (voltage := vehicle.voltage_for(least)) is not None:
                way_out += f" or above {voltage:.3g} V under load, not {vehicle.voltage:.3g} V"
        raise refusal("margin of the reference", margin, "m/s^2", f"above {_DISTURBANCE} m/s^2: {way_out}")
    axes = []
    for kind, plants in kinds.items():
        goal = Goal(period, gain, _SHARE * room, assumptions)
        print(f"searching the {kind} design", file=sys.stderr, flush=True)
        axes.append(searched(goal, plants, _progress(), seconds))
    design = FlightDesign(limits, gain, margin, _DISTURBANCE, _RETURN_RATE, assumptions, *axes)
    certificate = proved(design, name, {"inputs": {"vehicle": vehicle.name, "assume": assume}})
    require_tilt(certificate)
    _finish(certificate, output)
    print("\n".join(trade(certificate)))
    print(f"{vehicle.name} {sentence(certificate)}")


def certificate_name(given: str | None, output: Path | None) -> str:
    """Return the name of a certificate that is made: the one that is given, or that of its file.

    Raises:
        FlatsatError: it is empty.
    """
    from flatsat_ros.base.errors import require

    name = given if given is not None else output.stem if output is not None else "unnamed"
    require(bool(name), "--name", name, "", "a name")
    return name


def write_designs(path: Path, folder: Path) -> None:
    """Prove all stored designs of a file again and write their certificates into a folder."""
    from flatsat_ros.synthesis.flight_design import read_designs

    for name, (vehicle, design) in read_designs(path).items():
        begin = time.monotonic()
        certificate = design.certificate(name, {"inputs": {"vehicle": vehicle, "design": "config/designs/flight.yaml"}})
        certificate.save(folder / f"{name}.yaml")
        print(f"{name}: {time.monotonic() - begin:.1f} s", flush=True)


def _finish(certificate: Certificate, output: Path | None) -> None:
    """Verify and write a certificate, and print every inequality with its slack."""
    from flatsat_ros.synthesis.report import margins

    print(f"certificate {certificate.name}")
    print("\n".join(margins(certificate.verify())))
    if output is not None:
        certificate.save(output)
    print(f"  written to {output}" if output is not None else "  not written: give --output FILE")


def _progress() -> Callable[[str], None]:
    """Return what prints a better cost at most once a second."""
    last = -math.inf

    def told(words: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= 1.0:
            last = now
            print(f"  {words}", file=sys.stderr, flush=True)

    return told
