"""Column maps: which column of a CSV log is which quantity, in which unit and with which sign. They are YAML files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from flatsat_ros.base.errors import FlatsatError, quoted, refusal, require
from flatsat_ros.base.files import located
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml, section

# what one of a unit is in SI; thrust commands stay PWM, 0..65535
_UNITS = {
    "s": ("time", 1.0), "ms": ("time", 1e-3), "us": ("time", 1e-6),
    "m": ("length", 1.0), "mm": ("length", 1e-3),
    "rad": ("angle", 1.0), "deg": ("angle", 0.017453292519943295),
    "1": ("ratio", 1.0), "pwm": ("thrust", 1.0), "V": ("voltage", 1.0),
}  # fmt: skip
_QUATERNION = ("qx", "qy", "qz", "qw")
_ANGLES = ("roll", "pitch", "yaw")
_KINDS = (
    {"time": "time", "thrust_setpoint": "thrust", "voltage": "voltage"}
    | dict.fromkeys(("x", "y", "z"), "length")
    | dict.fromkeys(_QUATERNION, "ratio")
    | dict.fromkeys((*_ANGLES, "roll_setpoint", "pitch_setpoint"), "angle")
)
_NEEDED = ("time", "x", "y", "z", "roll_setpoint", "pitch_setpoint", "thrust_setpoint")


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes:
        name: in the header of the file.
        factor: what its numbers are multiplied by to have SI units and our signs (roll to -y, pitch to +x).
        optional: whether a file may be without it.
    """

    name: str
    factor: float
    optional: bool = False


@dataclass(frozen=True)
class ColumnMap:
    """The columns of one form of log, by quantity.

    Attributes:
        name: of the map.
        columns: time, x, y, z, qx, qy, qz, qw or roll, pitch, yaw, and roll_setpoint, pitch_setpoint, thrust_setpoint;
            voltage where it is known.

    Raises:
        FlatsatError: a quantity is missing.
    """

    name: str
    columns: Mapping[str, Column]

    def __post_init__(self) -> None:
        missing = [name for name in _NEEDED if name not in self.columns]
        if missing:
            raise FlatsatError(f"columns: {missing[0]!r} is missing; needed are {', '.join(_NEEDED)}")
        complete = [all(name in self.columns for name in names) for names in (_QUATERNION, _ANGLES)]
        if sum(complete) != 1:
            raise FlatsatError("columns: must have either qx, qy, qz, qw or roll, pitch, yaw")

    def missing(self, header: Iterable[str]) -> list[str]:
        """Return the columns that a file with these column names lacks."""
        found = set(header)
        return [column.name for column in self.columns.values() if not column.optional and column.name not in found]


def load_columns(name_or_path: str | os.PathLike[str]) -> ColumnMap:
    """Read a column map that the package ships, by its name, or one of the user's own.

    Args:
        name_or_path: such as `cflib`, or a path.

    Raises:
        FlatsatError: there is none, or it is not one; the text says why.
    """
    path = config_path(name_or_path, "logs")
    document = read_yaml(path)
    try:
        table = section("column map", document, ("columns",))["columns"]
        if not isinstance(table, dict):
            raise refusal("columns", table, "", "a mapping of quantities")
        return ColumnMap(path.stem, {name: _column(name, entry) for name, entry in table.items()})
    except FlatsatError as error:
        raise located(path, error) from error


def recognise(header: Iterable[str]) -> ColumnMap:
    """Return the packaged column map that fits a header.

    Raises:
        FlatsatError: none does; the text says what the nearest lacks.
    """
    names = tuple(header)
    maps = [load_columns(path) for path in packaged_columns()]
    best = min(maps, key=lambda known: len(known.missing(names)))
    lacking = best.missing(names)
    if lacking:
        known = ", ".join(sorted(each.name for each in maps))
        raise FlatsatError(
            f"the columns {quoted(','.join(names))} are none of a known form ({known}): {best.name} also has "
            f"{quoted(lacking)}; give a column map with --columns"
        )
    return best


def packaged_columns() -> list[Path]:
    """Return the paths of all column maps that the package ships."""
    return sorted(config_path("cflib", "logs").parent.glob("*.yaml"))


def _column(quantity: str, entry: object) -> Column:
    """Read one entry of a column map."""
    if quantity not in _KINDS:
        raise refusal("quantity", quantity, "", f"one of {', '.join(_KINDS)}")
    given = {"sign": 1, "optional": False} | entry if isinstance(entry, dict) else entry
    values = section(quantity, given, ("column", "unit", "sign", "optional"))
    units = [unit for unit, (kind, _) in _UNITS.items() if kind == _KINDS[quantity]]
    require(values["unit"] in units, f"{quantity}.unit", values["unit"], "", f"one of {', '.join(units)}")
    require(values["sign"] in (1, -1), f"{quantity}.sign", values["sign"], "", "1 or -1")
    require(type(values["column"]) is str, f"{quantity}.column", values["column"], "", "the name of a column")
    require(type(values["optional"]) is bool, f"{quantity}.optional", values["optional"], "", "true or false")
    return Column(values["column"], values["sign"] * _UNITS[values["unit"]][1], values["optional"])
