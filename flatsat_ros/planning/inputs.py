"""Missions from files: way-points of one drone (CSV), of many (YAML), and missions of lsc_planner (JSON)."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import FlatsatError, one_line, quoted, refusal, require, require_number
from flatsat_ros.base.files import located, read_text, unreadable
from flatsat_ros.base.numerals import number_of
from flatsat_ros.base.strict_yaml import read_yaml, section
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.separation import DOWNWASH
from flatsat_ros.planning.mission import Asked, Mission
from flatsat_ros.planning.polynomials import is_polynomials, read_polynomials
from flatsat_ros.plans import Box
from flatsat_ros.plans.tubes import promise

_BYTES_MAX = 1024 * 1024
_ROWS_MAX = 500
_AROUND = 0.5  # m: the box around way-points, where none is given
_BODY = 0.15  # m, radius, where none is given
_COLUMNS = ("x", "y", "z", "yaw", "t", "radius")


@dataclass(frozen=True)
class Wishes:
    """What a user asks of a plan beside way-points; None for what the file or a default says.

    Attributes:
        tube: radius, m, that is wanted, see `plans.tubes.promise`; None for what the certificate proves, or 0.05 if it
            has no flight section.
        margin: m/s^2; None for what the certificate assumes, or half the radius of the ball around hover in the input
            set.
        jerk_max, snap_max: m/s^3, m/s^4; None for what the certificate assumes, or 2 and 20.
        speed_max: m/s; None for no bound.
        clearance: m.
        floor: m; None for that of the mission, else the height of the first way-point.
        laps: how often a loop is flown; None for what the mission says, from rest to rest where it says nothing.
    """

    tube: float | None = None
    margin: float | None = None
    jerk_max: float | None = None
    snap_max: float | None = None
    speed_max: float | None = None
    clearance: float = 0.0
    floor: float | None = None
    laps: int | None = None


@dataclass(frozen=True, eq=False)
class _Content:
    """What a file says."""

    drones: tuple[Asked, ...]
    times: FloatArray | None = None
    box: tuple[FloatArray, FloatArray] | None = None
    downwash: float = DOWNWASH
    obstacles: tuple[Box, ...] = ()
    laps: int | None = None


def read_mission(
    path: str | os.PathLike[str],
    certificate: Certificate,
    wishes: Wishes,
    name: str,
    present: Callable[[Sequence[str]], Mapping[str, Sequence[float]]] | None = None,
) -> Mission:
    """Return what a file asks for.

    Args:
        path: of a .csv, .yaml or .json file.
        certificate: whose input set the references keep.
        wishes: of the user.
        name: of the plan.
        present: tells the places of drones, by name, m, from which they set out: the file, a .yaml, has only where they
            shall go. None for a file that has both.

    Raises:
        FlatsatError: the file cannot be read, is not of its form, or asks for what no plan can keep.
    """
    readers = {".csv": _from_csv, ".yaml": _from_yaml, ".json": _from_json}
    kind = Path(path).suffix.lower()
    if kind not in readers:
        raise located(path, f"must be one whose name ends in {', '.join(readers)}")
    if present is not None and kind != ".yaml":
        raise located(
            path, "must be one whose name ends in .yaml: goals of drones by name, to set out from where they are"
        )
    try:
        content = readers[kind](path) if present is None else _from_yaml(path, present)
        lower, upper = content.box or _around(content.drones)
        if wishes.floor is not None:
            lower = np.array([*lower[:2], require_number("floor", wishes.floor, "m")])
        bounds, tube = promise(
            certificate, lower, upper, downwash=content.downwash, tube=wishes.tube, margin=wishes.margin,
            jerk_max=wishes.jerk_max, snap_max=wishes.snap_max, speed_max=wishes.speed_max,
        )  # fmt: skip
        return Mission(
            name, content.drones, certificate.name, certificate.limits, bounds, tube, content.times, content.downwash,
            wishes.clearance, content.obstacles, content.laps if wishes.laps is None else wishes.laps,
            certificate.flight if wishes.tube is None else None,
        )  # fmt: skip
    except FlatsatError as error:
        if str(error).startswith(os.fspath(path)):
            raise
        raise located(path, error) from error


def _around(drones: Sequence[Asked]) -> tuple[FloatArray, FloatArray]:
    """Return a box around all way-points; its floor is that of the lowest first one, or the lowest of polynomials."""
    places = np.concatenate([drone.places for drone in drones])
    lower, upper = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    lower[2] = min(
        float(drone.waypoints[0, 2] if drone.given is None else drone.places[:, 2].min()) for drone in drones
    )
    return lower, upper


def _from_csv(path: str | os.PathLike[str]) -> _Content:
    text = read_text(path, _BYTES_MAX)
    if is_polynomials(text.partition("\n")[0]):
        return _Content((_following("cf1", path, _BODY),))
    try:
        rows = list(csv.reader(io.StringIO(text)))
    except csv.Error as error:  # line ends or NULs inside of fields, fields without an end
        raise unreadable(path, error) from error
    names = [cell.strip() for cell in rows[0]] if rows else []
    valid = "x,y,z, then yaw, t and radius where they are known"
    if names[:3] != ["x", "y", "z"] or len(set(names)) < len(names) or not set(names) <= set(_COLUMNS):
        raise refusal("first line", ",".join(names), "", f"the names of the columns: {valid}")
    body = [row for row in rows[1:] if row]
    require(2 <= len(body) <= _ROWS_MAX, "number of way-points", len(body), "", f"from 2 to {_ROWS_MAX}")
    columns = np.array([_numbers(f"way-point {number}", row, len(names)) for number, row in enumerate(body, 1)])
    table = dict(zip(names, columns.T, strict=True))
    yaw = table.get("yaw", np.zeros(1))
    if np.ptp(yaw) > 0.0:
        raise refusal("yaw", sorted(set(yaw.tolist())), "rad", "the same in all lines: a reference holds one yaw")
    times = table.get("t")
    drone = Asked("cf1", np.stack([table[axis] for axis in "xyz"], axis=1), _BODY, float(yaw[0]), table.get("radius"))
    return _Content((drone,), None if times is None else times - times[0])


def _following(name: str, path: str | os.PathLike[str], body: float) -> Asked:
    """Return a drone that follows the polynomials of a file."""
    curve, yaw = read_polynomials(path)
    return Asked.following(name, curve, body, yaw)


def _numbers(name: str, cells: Sequence[str], count: int) -> list[float]:
    if len(cells) != count:
        raise refusal(name, ",".join(cells), "", f"{count} numbers, one for each column")
    try:
        values = [number_of(cell) for cell in cells]
    except ValueError as error:
        raise refusal(name, ",".join(cells), "", "numbers") from error
    if not all(map(math.isfinite, values)):
        raise refusal(name, ",".join(cells), "", "finite numbers")
    return values


def _from_yaml(
    path: str | os.PathLike[str], present: Callable[[Sequence[str]], Mapping[str, Sequence[float]]] | None = None
) -> _Content:
    document = read_yaml(path)
    if not isinstance(document, dict) or "drones" not in document:
        raise refusal(
            "the mission",
            document,
            "",
            "a mapping with the key drones, and body, downwash, times, box, obstacles, laps if wanted",
        )
    given: dict[str, Any] = {
        "body": _BODY,
        "downwash": DOWNWASH,
        "times": None,
        "box": None,
        "obstacles": {},
        "laps": None,
    } | document
    values = section("the mission", given, ("drones", "body", "downwash", "times", "box", "obstacles", "laps"))
    if not isinstance(values["drones"], dict) or not values["drones"]:
        raise refusal(
            "drones",
            values["drones"],
            "",
            "a mapping from names to lists of way-points [x, y, z] or files of polynomials",
        )
    if present is not None:
        values["drones"] = _from_present(values["drones"], present(list(values["drones"])))
    drones = tuple(
        _following(name, Path(path).parent / places, values["body"])
        if isinstance(places, str)
        else Asked(name, finite_array(f"way-points of {name}", places, 3), values["body"])
        for name, places in values["drones"].items()
    )
    box = None
    if present is not None:
        places = np.concatenate([drone.waypoints for drone in drones])
        box = (places.min(axis=0) - (_AROUND, _AROUND, 0.0), places.max(axis=0) + _AROUND)
    if values["box"] is not None:
        corners = section("box", values["box"], ("lower", "upper"))
        box = (finite_array("lower", corners["lower"], 3), finite_array("upper", corners["upper"], 3))
    times = None if values["times"] is None else finite_array("times", values["times"])
    if not isinstance(values["obstacles"], dict):
        raise refusal("obstacles", values["obstacles"], "", "a mapping from names to boxes")
    obstacles = tuple(_obstacle(name, entry) for name, entry in values["obstacles"].items())
    return _Content(drones, times, box, values["downwash"], obstacles, values["laps"])


def _from_present(drones: Mapping[str, Any], present: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Return the way-points of drones that set out from where they are."""
    found = {}
    for name, places in drones.items():
        goals = None if isinstance(places, str) else finite_array(f"goals of {name}", places, 3)
        if goals is None or goals.ndim not in (1, 2) or goals.size == 0:
            raise refusal(f"goals of {name}", places, "", "a place [x, y, z], or a list of them")
        found[name] = [list(present[name]), *np.atleast_2d(goals).tolist()]
    return found


def _obstacle(name: str, entry: object) -> Box:
    """Return an obstacle; only boxes are known."""
    kind = _needed(f"obstacle {name}", entry, "type")["type"]
    require(kind == "box", f"type of obstacle {name}", kind, "", "'box', with lower and upper corner")
    values = section(f"obstacle {name}", entry, ("type", "lower", "upper"))
    return Box.between(name, values["lower"], values["upper"])


def _from_json(path: str | os.PathLike[str]) -> _Content:
    """Read a mission of lsc_planner: kinds of quadrotors, one world with its dimension, agents with start and goal."""
    try:
        document = json.loads(
            read_text(path, _BYTES_MAX), parse_constant=_no_constant, object_pairs_hook=_with_each_key_once
        )
    except (ValueError, RecursionError) as error:
        if isinstance(error, FlatsatError):
            raise
        raise unreadable(path, error) from error
    root = _needed("the mission", document, "quadrotors", "world", "agents")
    obstacles = root.get("obstacles") or []
    require(isinstance(obstacles, list), "obstacles", obstacles, "", "a list")
    dimension = finite_array(
        "dimension", _needed("world", _entries("world", root["world"])[0], "dimension")["dimension"]
    )
    require(dimension.shape == (6,), "dimension", dimension.tolist(), "m", "x_min, y_min, z_min, x_max, y_max, z_max")
    drones, downwash = [], set()
    for number, entry in enumerate(_entries("agents", root["agents"]), 1):
        agent = _needed(f"agent {number}", entry, "type", "start", "goal")
        kind = _needed("quadrotors", root["quadrotors"], str(agent["type"]))[str(agent["type"])]
        vehicle = _needed(f"quadrotor {quoted(agent['type'])}", kind, "radius", "downwash")
        waypoints = finite_array(f"start and goal of agent {number}", [agent["start"], agent["goal"]], 3)
        drones.append(Asked(f"cf{agent.get('cid', number)}", waypoints, vehicle["radius"]))
        downwash.add(require_number("downwash", vehicle["downwash"], ""))
    require(len(downwash) == 1, "downwash", sorted(downwash), "", "the same for all drones")
    boxes = tuple(_obstacle(f"obstacle{number}", entry) for number, entry in enumerate(obstacles, 1))
    return _Content(tuple(drones), None, (dimension[:3], dimension[3:]), downwash.pop(), boxes)


def _with_each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise FlatsatError(f"key {quoted(key)} stands there twice")
        found[key] = value
    return found


def _no_constant(name: str) -> float:
    raise refusal("number", name, "", "finite")


def _entries(name: str, value: object) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise refusal(name, value, "", "a list with at least one entry")
    return value


def _needed(name: str, value: object, *keys: str) -> dict[str, Any]:
    """Return a mapping that has at least the given keys: these files say much more that a plan does not need."""
    missing = [key for key in keys if not isinstance(value, dict) or key not in value]
    if missing or not isinstance(value, dict):
        needed, lacking = (one_line(", ".join(names), 100) for names in (keys, missing))
        raise FlatsatError(f"{name}: must be a mapping with {needed}; {lacking} is missing")
    return value
