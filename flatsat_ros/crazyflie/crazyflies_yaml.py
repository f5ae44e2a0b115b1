"""The robots of a crazyswarm2 set-up, read from the user's own crazyflies.yaml.

Robots of a type without a connection, such as a person with markers, are tracked but not flown; they are reported.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from flatsat_ros.base.arrays import finite_array
from flatsat_ros.base.errors import FlatsatError, nearest_name, refusal, require, require_number
from flatsat_ros.base.files import located, shown, user_path
from flatsat_ros.base.strict_yaml import read_yaml

_VERSIONS = (1, 2, 3)
# what a type's `connection` may be: to a drone, which is the default, or to nothing that flies
_LINKED, _TRACKED = "crazyflie", "none"
_ORIGIN = (0.0, 0.0, 0.0)


class Robot(NamedTuple):
    """One enabled robot.

    Attributes:
        name: prefix of its topics.
        uri: of its link; empty if no robot of the file has one.
        position: (3,) initial position, m, world frame.
        kind: its entry in robot_types; empty if the file has none.
    """

    name: str
    uri: str
    position: tuple[float, float, float]
    kind: str


def read_crazyflies(path: str | os.PathLike[str], tell: Callable[[str], object] = lambda _: None) -> list[Robot]:
    """Return the enabled robots in the order of the file; whatever else crazyswarm2 keeps in it is left alone.

    Args:
        path: of the file.
        tell: called with a sentence for each robot that is only tracked, and if the file does not name its version.

    Raises:
        FlatsatError: the file cannot be read, has no enabled robot, an entry is not what crazyswarm2 takes, or a robot
            has no URI beside others that have one.
    """
    file = user_path(path)
    content = read_yaml(file, foreign=True)
    try:
        document = _document(content)
        if "fileversion" not in document:
            tell(f"{shown(file)} has no fileversion: its robots are read as those of version {_VERSIONS[-1]}")
        robots, types = document["robots"], document.get("robot_types")
        known = types if isinstance(types, dict) else {}
        enabled = [robot for name, settings in robots.items() if (robot := _robot(name, settings, known))]
        tracked = [robot.name for robot in enabled if _connection(robot.kind, known) == _TRACKED]
        for name in tracked:
            tell(f"{shown(name)} is tracked, not flown: connection: none; name it in other_poses to keep drones away")
        flown = [robot for robot in enabled if robot.name not in tracked]
        require(bool(flown), "robots", list(robots), "", "at least one that is enabled and flies")
        _require_addresses(flown)
    except FlatsatError as error:
        raise located(file, error) from error
    return flown


def _document(content: Any) -> dict[str, Any]:
    """Return the content of a file in crazyswarm2's form."""
    document = content if isinstance(content, dict) else {}
    if "crazyflies" in document and "robots" not in document:
        raise FlatsatError(_conversion(document["crazyflies"]))
    robots = document.get("robots")
    if not isinstance(robots, dict):
        raise refusal("robots", robots, "", "a mapping from names to settings")
    version = document.get("fileversion", _VERSIONS[-1])
    valid = isinstance(version, int) and version in _VERSIONS
    require(valid, "fileversion", version, "", f"one of {', '.join(map(str, _VERSIONS))}")
    return document


def _conversion(entries: Any) -> str:
    """Return how the list form of crazyswarm 1 is written for crazyswarm2, shown with its first entry."""
    first = entries[0] if isinstance(entries, list) and entries and isinstance(entries[0], dict) else {}
    number, channel = first.get("id"), first.get("channel")
    if not (isinstance(number, int) and 0 <= number < 256 and isinstance(channel, int)):
        number, channel = 1, 80
    return (
        "crazyflies is the list of crazyswarm 1: must be robots, crazyswarm2's; write each entry below it as cf<id>, "
        f"with the id in hexadecimal in its uri: cf{number}: {{enabled: true, uri: radio://0/{channel}/2M/"
        f"E7E7E7E7{number:02X}, initial_position: [x, y, z], type: cf21}}"
    )


def _robot(name: str, settings: Any, types: Mapping[str, Any]) -> Robot | None:
    """Return one robot, None if it is not enabled."""
    where = f"robots.{shown(name)}"
    _require_given(where, settings, "enabled, uri, initial_position and type")
    require(isinstance(settings, dict), where, settings, "", "a mapping")
    enabled = settings.get("enabled", True)
    _require_given(f"{where}.enabled", enabled, "true or false")
    require(isinstance(enabled, bool), f"{where}.enabled", enabled, "", "true or false")
    if not enabled:
        return None
    kind = str(settings.get("type") or "")
    if kind and types and kind not in types:
        raise refusal(f"{where}.type", kind, "", f"one of robot_types{nearest_name(kind, types)}")
    place = f"{where}.initial_position"
    flown = _connection(kind, types) == _LINKED
    given = settings.get("initial_position", _ORIGIN) if flown else _ORIGIN
    _require_given(place, given, "[x, y, z], in m")
    for entry in given if isinstance(given, list) else ():
        require(not isinstance(entry, str), f"an entry of {place}", entry, "m", "a plain decimal number")
    position = finite_array(place, given)
    require(position.shape == (3,), f"shape of {place}", position.shape, "", "(3,): x, y, z")
    x, y, z = (require_number(f"an entry of {place}", value, "m") for value in position.tolist())
    return Robot(name, str(settings.get("uri") or ""), (x, y, z), kind)


def _require_given(name: str, value: Any, valid: str) -> None:
    """Refuse an entry with nothing behind its colon."""
    if value is None:
        raise FlatsatError(f"{name} is empty: must be {valid}, or left out with its name")


def _connection(kind: str, types: Mapping[str, Any]) -> str:
    """Return how robots of a type are connected: to a drone, or not at all."""
    settings = types.get(kind)
    value = settings.get("connection", _LINKED) if isinstance(settings, dict) else _LINKED
    if value not in (_LINKED, _TRACKED):
        raise refusal(f"robot_types.{shown(kind)}.connection", value, "", f"{_LINKED} or {_TRACKED}")
    return str(value)


def _require_addresses(robots: list[Robot]) -> None:
    """Refuse robots without a URI beside others that have one: nobody should invent their addresses."""
    without = [robot.name for robot in robots if not robot.uri]
    if without and len(without) < len(robots):
        raise FlatsatError(
            f"robots.{shown(without[0])} has no uri, others have: must have one, be disabled, or be of a type with "
            "connection: none if it is only tracked"
        )
