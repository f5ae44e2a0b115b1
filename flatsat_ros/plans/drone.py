"""One drone of a plan: its reference, the way-points that it passes, and how much room the drone takes around it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

from flatsat_ros.base.errors import (
    FlatsatError,
    quoted,
    refusal,
    require,
    require_fields,
    require_not_negative,
    require_number,
    require_positive,
)
from flatsat_ros.base.strict_yaml import section
from flatsat_ros.plans import tables
from flatsat_ros.plans.curve import NANOMETRE, Curve

_MET = 1000  # nm: how exactly way-points are met
_ROWS_MAX = 10_000
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_DRONE = ("body", "tube", "yaw", "degree", "knots", "control_points", "waypoints")
_TUBE = ("source", "radius")
_SOURCES = ("given", "certificate")


class Waypoint(NamedTuple):
    """A place that a reference passes: time, us, a knot; x, y, z, nm, world frame; how far away it may pass, nm."""

    time: int
    x: int
    y: int
    z: int
    radius: int = 0


def require_name(name: object) -> None:
    """Refuse a name of a drone that no robot can have.

    Raises:
        FlatsatError: it is not made of at most 64 letters, digits and underscores, or does not begin with a letter.
    """
    good = isinstance(name, str) and NAME.fullmatch(name) is not None
    require(good, "name of a drone", name, "", "a letter, then letters, digits or _, at most 64 in all")


@dataclass(frozen=True)
class Tube:
    """How far a drone may be off its reference.

    Attributes:
        radius: m, in the downwash metric.
        source: what says so; "given": the user does, and nothing proves it; "certificate": the flight section of the
            certificate that the plan was made for, for the plan's bounds of jerk and snap (`plans.tubes`).

    Raises:
        FlatsatError: the radius is not a number from 0 on, or there is no such source.
    """

    radius: float
    source: str = "given"

    def __post_init__(self) -> None:
        require_fields(self, require_not_negative, radius="m")
        require(self.source in _SOURCES, "source of a tube", self.source, "", " or ".join(map(repr, _SOURCES)))


@dataclass(frozen=True, eq=False)
class PlannedDrone:
    """One drone of a plan.

    Attributes:
        name: the robot's.
        curve: its reference.
        body: radius, m, in the downwash metric.
        tube: how far it may be off.
        yaw: held, rad, counter-clockwise.
        waypoints: what the reference passes on time, start and goal among them.

    Raises:
        FlatsatError: the name is no robot's, or body or yaw is not a number of its range.
    """

    name: str
    curve: Curve
    body: float
    tube: Tube
    yaw: float = 0.0
    waypoints: tuple[Waypoint, ...] = ()

    def __post_init__(self) -> None:
        require_name(self.name)
        require_fields(self, require_positive, body="m")
        require_fields(self, require_number, yaw="rad")

    @property
    def radius(self) -> Fraction:
        """What others keep away from its reference by, m: body and tube."""
        return Fraction(self.body) + Fraction(self.tube.radius)

    def require_met(self) -> None:
        """Refuse a way-point that the reference does not pass on time, within its radius and 1 um.

        Raises:
            FlatsatError: there is one.
        """
        if not self.waypoints:
            return
        values, divisors = self.curve.bezier()
        ends = [*values[:, 0], values[-1, -1]], [*divisors, divisors[-1]]
        knots = {knot: (point, divisor) for knot, point, divisor in zip(self.curve.knots, *ends, strict=True)}
        for time, *place, radius in self.waypoints:
            if time not in knots:
                raise refusal(f"{self.name}: time of a way-point", time / 1e6, "s", "one of the knots")
            point, divisor = knots[time]
            # of metres, so that nanometres are their 1e-9
            offset = sum(
                (Fraction(int(value), int(divisor)) / NANOMETRE - goal) ** 2
                for value, goal in zip(point, place, strict=True)
            )
            if offset > (radius + _MET) ** 2:
                what = f"{self.name}: distance from its way-point at t = {time / 1e6:.4f} s"
                raise refusal(what, math.sqrt(offset) * 1e-9, "m", f"at most {(radius + _MET) * 1e-9:g} m")

    @classmethod
    def from_document(cls, name: str, document: object, *, closed: bool) -> PlannedDrone:
        """Build one drone from its part of the document of a plan.

        Args:
            name: of the drone.
            document: its part, parsed.
            closed: whether the references of the plan are closed.

        Raises:
            FlatsatError: the part is not exactly of its form; the text names the drone.
        """
        try:
            values = section("the drone", document, _DRONE)
            knots, points, waypoints = (
                tables.integer_rows(key, values[key], digits, _ROWS_MAX)
                for key, digits in (("knots", (6,)), ("control_points", (9, 9, 9)), ("waypoints", (6, 9, 9, 9, 9)))
            )
            return cls(
                name=name,
                curve=Curve(
                    tuple(knot for (knot,) in knots), tuple((x, y, z) for x, y, z in points), values["degree"], closed
                ),
                body=values["body"],
                tube=Tube(**section("tube", values["tube"], _TUBE)),
                yaw=values["yaw"],
                waypoints=tuple(Waypoint(*row) for row in waypoints),
            )
        except FlatsatError as error:
            raise FlatsatError(f"drone {quoted(name)}: {error}") from error

    def to_document(self) -> dict[str, Any]:
        """Return the drone's part of the document."""
        return {
            "body": self.body,
            "tube": {"source": self.tube.source, "radius": self.tube.radius},
            "yaw": self.yaw,
            "degree": self.curve.degree,
            "knots": tables.written([(knot,) for knot in self.curve.knots], (6,)),
            "control_points": tables.written(self.curve.points, (9, 9, 9)),
            "waypoints": tables.written(self.waypoints, (6, 9, 9, 9, 9)),
        }
