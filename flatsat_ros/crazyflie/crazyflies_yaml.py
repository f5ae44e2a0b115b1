"""The robots of a crazyswarm2 set-up, read from the user's own crazyflies.yaml (fileversion 3)."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

from flatsat_ros.base.arrays import finite_array
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.files import user_path
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
    content = read_yaml(user_path(path))
    robots = content.get("robots") if isinstance(content, dict) else None
    if not isinstance(robots, dict):
        raise FlatsatError(f"{os.fspath(path)}: must have a mapping `robots` from names to settings")
    enabled = [robot for name, settings in robots.items() if (robot := _robot(str(name), settings, os.fspath(path)))]
    if not enabled:
        raise FlatsatError(
            f"{os.fspath(path)}: none of the robots {', '.join(map(str, robots))} is enabled: must be one"
        )
    return enabled


def _robot(name: str, settings: Any, path: str) -> Robot | None:
    """Return one robot, None if it is not enabled."""
    where = f"{path}: robots.{name}"
    if not isinstance(settings, dict):
        raise FlatsatError(f"{where} = {settings!r}: must be a mapping")
    enabled = settings.get("enabled", True)
    if not isinstance(enabled, bool):
        raise FlatsatError(f"{where}.enabled = {enabled!r}: must be true or false")
    if not enabled:
        return None
    try:
        position = finite_array("initial_position", settings.get("initial_position", (0.0, 0.0, 0.0)), 3)
    except (TypeError, ValueError) as error:
        raise FlatsatError(f"{where}: {error}") from error
    if position.shape != (3,):
        raise FlatsatError(f"{where}.initial_position has shape {position.shape}: must be [x, y, z]")
    x, y, z = position.tolist()
    return Robot(name, str(settings.get("uri") or ""), (x, y, z), str(settings.get("type") or ""))
