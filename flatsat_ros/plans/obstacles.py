"""What stands still in the room: boxes that all drones keep away from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.plans import tables
from flatsat_ros.plans.curve import FARTHEST
from flatsat_ros.plans.drone import NAME

BOXES_MAX = 32  # in one plan

_COLUMNS = (None, 9, 9, 9, 9, 9, 9)


@dataclass(frozen=True)
class Box:
    """A closed box along the axes of the world.

    Attributes:
        name: of the obstacle.
        lower, upper: x, y, z of its corners, nm.

    Raises:
        FlatsatError: it has no name or is empty, or a corner lies farther than 500 m from the origin.
    """

    name: str
    lower: tuple[int, int, int]
    upper: tuple[int, int, int]

    def __post_init__(self) -> None:
        require(NAME.fullmatch(self.name) is not None, "name of an obstacle", self.name, "", "letters, digits, _")
        farthest = max(map(abs, (*self.lower, *self.upper)))
        require(farthest <= FARTHEST, f"a corner of {self.name}", farthest, "nm", f"at most {FARTHEST} nm from 0")
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise refusal(f"upper {axis} of {self.name}", high / 1e9, "m", f"above the lower one, {low / 1e9:g} m")

    @classmethod
    def between(cls, name: str, lower: object, upper: object) -> Box:
        """Return the box with corners in metres, rounded to nanometres.

        Args:
            name: of the obstacle.
            lower: (3,) m, world frame.
            upper: (3,) m.

        Raises:
            FlatsatError: a corner is not three finite numbers, or as the class.
        """
        corners = []
        for which, given in (("lower", lower), ("upper", upper)):
            corner = finite_array(f"{which} of {name}", given, 3)
            require(corner.shape == (3,), f"shape of {which} of {name}", corner.shape, "", "(3,)")
            x, y, z = (round(1e9 * value) for value in corner.tolist())
            corners.append((x, y, z))
        return cls(name, *corners)

    @property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper one, (3,) m."""
        return finite_array("lower", self.lower) * 1e-9, finite_array("upper", self.upper) * 1e-9


def require_distinct(boxes: tuple[Box, ...]) -> None:
    """Refuse too many boxes, and two of one name.

    Raises:
        FlatsatError: there are.
    """
    names = [box.name for box in boxes]
    require(len(names) <= BOXES_MAX, "number of obstacles", len(names), "", f"at most {BOXES_MAX}")
    require(len(set(names)) == len(names), "names of the obstacles", names, "", "different")


def written(boxes: Iterable[Box]) -> str:
    """Return the table of a plan file."""
    return tables.written([(box.name, *box.lower, *box.upper) for box in boxes], _COLUMNS)


def read(text: object) -> tuple[Box, ...]:
    """Return the boxes of such a table.

    Raises:
        FlatsatError: it is none.
    """
    boxes = []
    for name, *corners in tables.read("obstacles", text, _COLUMNS, BOXES_MAX):
        lower, upper = corners[:3], corners[3:]
        try:
            boxes.append(Box(str(name), tuple(lower), tuple(upper)))  # type: ignore[arg-type]
        except FlatsatError as error:
            raise FlatsatError(f"obstacles: {error}") from error
    return tuple(boxes)
