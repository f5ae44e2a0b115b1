"""The robots of a crazyswarm2 set-up, read from the user's own crazyflies.yaml (fileversion 3)."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from flatsat_ros.base.arrays import finite_array
from flatsat_ros.base.errors import FlatsatError, refusal, require, require_number
from flatsat_ros.base.files import located, shown, user_path
from flatsat_ros.base.strict_yaml import read_yaml


class Robot(NamedTuple):
    """One enabled robot.

    Attributes:
        name: prefix of its topics.
        uri: of its link; empty if the file has none.
        position: (3,) initial position, m, world frame.
        kind: its entry in robot_types; empty if the file has none.
    """

    name: str
    uri: str
    position: tuple[float, float, float]
    kind: str


def read_crazyflies(path: str | os.PathLike[str]) -> list[Robot]:
    """Return the enabled robots in the order of the file; whatever else crazyswarm2 keeps in it is left alone.

    Raises:
        FlatsatError: the file cannot be read, has no enabled robot, or an entry is not what crazyswarm2 takes.
    """
    file = user_path(path)
    content = read_yaml(file)
    try:
        robots = content.get("robots") if isinstance(content, dict) else None
        if not isinstance(robots, dict):
            raise refusal("robots", robots, "", "a mapping from names to settings")
        enabled = [robot for name, settings in robots.items() if (robot := _robot(name, settings))]
        require(bool(enabled), "robots", list(robots), "", "at least one that is enabled")
    except FlatsatError as error:
        raise located(file, error) from error
    return enabled


def _robot(name: str, settings: Any) -> Robot | None:
    """Return one robot, None if it is not enabled."""
    where = f"robots.{shown(name)}"
    require(isinstance(settings, dict), where, settings, "", "a mapping")
    enabled = settings.get("enabled", True)
    require(isinstance(enabled, bool), f"{where}.enabled", enabled, "", "true or false")
    if not enabled:
        return None
    place = f"{where}.initial_position"
    position = finite_array(place, settings.get("initial_position", (0.0, 0.0, 0.0)))
    require(position.shape == (3,), f"shape of {place}", position.shape, "", "(3,): x, y, z")
    x, y, z = (require_number(f"an entry of {place}", value, "m") for value in position.tolist())
    return Robot(name, str(settings.get("uri") or ""), (x, y, z), str(settings.get("type") or ""))
