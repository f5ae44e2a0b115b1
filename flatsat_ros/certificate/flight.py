"""The flight section of a certificate: what is proved about the whole loop that flies.

The other sections are about the ideal loop of a drone that knows its state and answers at once. Their P gives the law,
and they are true of the predicted state, on which the law acts. This section bounds how far the real drone is from its
reference, and says that its applied gain stays in the interval.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import refusal, require, require_fields, require_not_negative, require_positive
from flatsat_ros.base.strict_yaml import section
from flatsat_ros.certificate.enclosures import UP, decimal, sine
from flatsat_ros.certificate.exact import spare
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_return import Return, box_claims
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube, box_tube
from flatsat_ros.law.input_set import InputSet

# How a cell is written among the cuts of a box.
_CELL = "-"

# `sine` is below the sine by less than this.
_SMALL = Fraction(1, 10**20)

HEADER = """\
# flight: the whole loop; the tubes hold for applied gains in [gain_min, gain_max], whatever they do
#   margin m/s^2 to the limit of the tilt, of what a reference asks the law for (acceleration, drag and lead);
#   compensation of the disturbance takes of it at most disturbance m/s^2
#   assumptions: disturbance_rate m/s^3, noise m; acceleration m/s^2, jerk m/s^3 and snap m/s^4 of the reference;
#     pose_age s of the newest pose at a tick
#   horizontal, vertical: plants between low and high (delay s, lag s, frequency rad/s, tilt and drag 1/s), whose lag
#     changes in flight or not; model, observer (1, 1/s, 1/s^2), horizon s, lead s: the controller; cuts of the box into
#     cells; tube: bounds of |e| m, |e'| m/s, |v0| m/s^2 and |D/g - d^| m/s^2; back: a start adds to |e| at most
#     (position |e(0)| + position_velocity |e'(0)|) e^(-rate t), and likewise (nominal ...) to |v0| + |D/g - d^|
"""

# claims do not change what is proved: certificates that differ in nothing else are proved once in a process
_box_tube, _box_claims = lru_cache(maxsize=8)(box_tube), lru_cache(maxsize=8)(box_claims)

_FIGURES = ("gain_min", "gain_max", "margin", "disturbance")
_AXES = ("horizontal", "vertical")
_CONTROLLER = ("observer", "stiffness", "rate", "horizon", "lead")
_AXIS = ("low", "high", "lag_varies", "model", *_CONTROLLER, "cuts", "tube", "back")


@dataclass(frozen=True)
class Axis:
    """What is proved of the axes that share a loop: of x and y, or of z.

    Attributes:
        box: the plants.
        lag_varies: whether their lag, frequency and damping change in flight.
        design: the controller.
        cuts: of the box into cells, as `box_tube` reads them.
        tube: the claim.
        back: the claim of how starts outside return into it.
    """

    box: PlantBox
    lag_varies: bool
    design: Design
    cuts: tuple[str, ...]
    tube: AxisTube
    back: Return

    def proved(self, gain_min: float, gain_max: float, assumptions: Assumptions) -> AxisTube:
        """Return the tube that is proved by computation, whatever is claimed."""
        return _box_tube(self.design, self.box, self.cuts, gain_min, gain_max, assumptions, self.lag_varies)

    def claims(self, gain_min: float, gain_max: float, assumptions: Assumptions) -> tuple[AxisTube, Return]:
        """Return the tube, and the way back at the rate that is claimed, that are proved by computation."""
        rate, varies = self.back.rate, self.lag_varies
        return _box_claims(self.design, self.box, self.cuts, gain_min, gain_max, rate, assumptions, varies)

    @classmethod
    def from_document(cls, name: str, document: object, period: float) -> Axis:
        """Build the axes called `name` from the parsed YAML, refusing whatever is not exactly their form."""
        values = section(f"flight.{name}", document, _AXIS)
        plants = {}
        for key in ("low", "high", "model"):
            plants[key] = Plant(**section(f"flight.{name}.{key}", values[key], tuple(f.name for f in fields(Plant))))
        if not isinstance(values["lag_varies"], bool):
            raise refusal(f"flight.{name}.lag_varies", values["lag_varies"], "", "true or false")
        if not isinstance(values["cuts"], str):
            raise refusal(
                f"flight.{name}.cuts", values["cuts"], "", f"names of figures and {_CELL!r}, separated by spaces"
            )
        if not isinstance(values["observer"], list):
            raise refusal(f"flight.{name}.observer", values["observer"], "", "a list of three gains")
        claims = {}
        for key, kind in (("tube", AxisTube), ("back", Return)):
            claims[key] = section(f"flight.{name}.{key}", values[key], tuple(f.name for f in fields(kind)))
            for claim, value in claims[key].items():
                require_positive(f"flight.{name}.{key}.{claim}", value, "")
        figures = {key: values[key] for key in _CONTROLLER} | {"observer": tuple(values["observer"])}
        return cls(
            box=PlantBox(plants["low"], plants["high"]),
            lag_varies=values["lag_varies"],
            design=Design(period=period, model=plants["model"], **figures),
            cuts=tuple("" if cut == _CELL else cut for cut in values["cuts"].split()),
            tube=AxisTube(**claims["tube"]),
            back=Return(**claims["back"]),
        )

    def to_document(self) -> dict[str, Any]:
        """Return the axes as plain numbers, strings and mappings."""
        figures = {key: getattr(self.design, key) for key in _CONTROLLER} | {"observer": list(self.design.observer)}
        return {
            "low": asdict(self.box.low),
            "high": asdict(self.box.high),
            "lag_varies": self.lag_varies,
            "model": asdict(self.design.model),
            **figures,
            "cuts": " ".join(cut or _CELL for cut in self.cuts),
            "tube": asdict(self.tube),
            "back": asdict(self.back),
        }


class Taken(NamedTuple):
    """Distances to the limits of V_c, m/s^2."""

    tilt_max: Fraction
    thrust_max: Fraction
    thrust_min: Fraction


@dataclass(frozen=True)
class FlightSection:
    """What is proved about the loop that flies.

    Attributes:
        gain_min: smallest applied gain k, at most 1.
        gain_max: largest applied gain.
        margin: m, m/s^2, the distance of f to the limit of the tilt. f is what a reference asks the law for: its
            acceleration, with drag and lead (`flight.preview`).
        disturbance: largest |D/g|, m/s^2.
        assumptions: of the tube.
        horizontal: of x and y.
        vertical: of z.

    Raises:
        FlatsatError: a value is not a number of its range, or the axes have different periods. Inequalities are checked
            by `Certificate.verify`.
    """

    gain_min: float
    gain_max: float
    margin: float
    disturbance: float
    assumptions: Assumptions
    horizontal: Axis
    vertical: Axis

    def __post_init__(self) -> None:
        require_fields(self, require_positive, gain_min="", gain_max="", margin="m/s^2")
        require_fields(self, require_not_negative, disturbance="m/s^2")
        periods = self.horizontal.design.period, self.vertical.design.period
        require(
            periods[0] == periods[1], "period of the vertical axis", periods[1], "s", f"{periods[0]:g}, of the others"
        )

    @property
    def pose_age(self) -> float:
        """Largest age, s, of the newest pose at a tick."""
        return self.assumptions.pose_age

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """Of x and y, and of z."""
        return self.horizontal, self.vertical

    @property
    def acceleration(self) -> float:
        """Largest acceleration of a reference, m/s^2; infinite where no plant has drag or tilt, which alone need it."""
        plants = (plant for axis in self.axes for plant in (axis.design.model, axis.box.low, axis.box.high))
        return self.assumptions.acceleration if any(plant.drag or plant.tilt for plant in plants) else math.inf

    def demanded(self, demand: FloatArray, margin: float) -> float:
        """Return the largest ratio of what a reference asks for to what is assumed; up to 1 it keeps the assumptions.

        Args:
            demand: (3, 2) largest acceleration, jerk and snap, horizontal and vertical, m/s^2 and so on.
            margin: of its f in `room`, m/s^2.
        """
        assumed = self.assumptions
        ratio = self.margin / margin if margin > 0.0 else math.inf
        for asked, most in zip(demand.max(axis=1), (self.acceleration, assumed.jerk, assumed.snap), strict=True):
            if asked > 0.0:
                ratio = max(ratio, float(asked) / most if most > 0.0 else math.inf)
        return ratio

    def taken(self, limits: InputSet) -> Taken:
        """Return how near to each limit v0 and the compensation may bring a command, m/s^2; rounded up.

        v0 - d^ = v0 + (D/g - d^) - D/g lies in a cylinder and a ball of the radius `disturbance` around it. Along a
        normal the ball takes its radius, and the cylinder what its rim does: of the cone's cos(eps) and sin(eps), and
        of the sphere's, which meets V_c at angles of at most eps to the vertical, the most of these.

        Args:
            limits: the input set V_c.
        """
        tubes = [axis.tube for axis in self.axes]
        across, along = (decimal(tube.nominal) + decimal(tube.disturbance) for tube in tubes)
        most, sin = decimal(self.disturbance), sine(decimal(limits.tilt_max))
        cos, sin = _root(1 - sin * sin), sin + _SMALL
        steep = across * across * (1 - sin * sin) > along * along * sin * sin  # the rim's direction is beyond eps
        thrust = across * sin + along * cos if steep else _root(across * across + along * along)
        return Taken(most + across * cos + along * sin, most + thrust, most + along)

    def room(self, limits: InputSet) -> InputSet:
        """Return a part of V_c in which a margin of `margin` leaves v0 and the compensation inside V_c.

        Args:
            limits: the input set V_c.
        """
        taken, margin = self.taken(limits), decimal(self.margin)
        thrust, floor = (float(max(value - margin, Fraction(0))) for value in (taken.thrust_max, taken.thrust_min))
        if not thrust + floor:
            return limits
        return replace(
            limits, thrust_max=(limits.thrust_max - thrust) / UP, thrust_min=(limits.thrust_min + floor) * UP
        )

    def certified_start(self, limits: InputSet) -> tuple[float, float]:
        """Return the largest distances |e(0)|, m, horizontal and vertical, each alone, from which a drone returns.

        It begins at rest, and its reference stays where it is. Negative: no start is certified.

        Args:
            limits: the input set V_c.
        """
        tilt, (cone, sphere, floor) = limits.tilt_max, map(float, self.left(limits))
        sides = min(cone / math.cos(tilt), sphere / math.sin(tilt))
        upright = min(cone / math.sin(tilt), sphere, floor)
        return sides / self.horizontal.back.nominal, upright / self.vertical.back.nominal

    def left(self, limits: InputSet) -> Taken:
        """Return the distance that v0 and the compensation leave to each limit in a hover, m/s^2; rounded down."""
        taken, gravity = self.taken(limits), decimal(limits.gravity)
        return Taken(
            gravity * sine(decimal(limits.tilt_max)) - taken.tilt_max,
            decimal(limits.thrust_max) - gravity - taken.thrust_max,
            gravity - decimal(limits.thrust_min) - taken.thrust_min,
        )

    def margins(self, limits: InputSet, gain_max: float) -> dict[str, float]:
        """Return by how much, relatively, each inequality holds; negative ones fail. Their signs are exact.

        Args:
            limits: the input set V_c.
            gain_max: the cap that the controller uses.
        """
        taken, left = self.taken(limits), self.left(limits)
        margins = {
            "flight: gain_min <= 1": spare(decimal(self.gain_min), Fraction(1)),
            "flight: the cap of the gain is in the interval": spare(decimal(gain_max), decimal(self.gain_max)),
            "flight: the margin is one that a hovering drone has": spare(
                decimal(self.margin), left.tilt_max + taken.tilt_max
            ),
            "flight: v0 and d^ take at most the margin of the tilt, so that every applied gain is at least 1": spare(
                taken.tilt_max, decimal(self.margin)
            ),
            "flight: and of the thrust what a hovering drone has": min(
                spare(taken.thrust_max, taken.thrust_max + left.thrust_max),
                spare(taken.thrust_min, taken.thrust_min + left.thrust_min),
            ),
        }
        for name, axis in zip(_AXES, self.axes, strict=True):
            tube, back = axis.claims(self.gain_min, self.gain_max, self.assumptions)
            for kind, proved, claimed in (("tube", tube, axis.tube), ("way back", back, axis.back)):
                for claim in fields(proved):
                    if claim.name != "rate":
                        bound, most = getattr(proved, claim.name), decimal(getattr(claimed, claim.name))
                        slack = spare(Fraction(bound), most) if math.isfinite(bound) else -math.inf
                        margins[f"flight: {name} {kind}, {claim.name}"] = slack
        return margins

    @classmethod
    def from_document(cls, document: object, period: float) -> FlightSection:
        """Build the section from the parsed YAML, refusing whatever is not exactly its form."""
        values = section("flight", document, (*_FIGURES, "assumptions", *_AXES))
        known = section("flight.assumptions", values["assumptions"], tuple(f.name for f in fields(Assumptions)))
        return cls(
            **{name: values[name] for name in _FIGURES},
            assumptions=Assumptions(**known),
            horizontal=Axis.from_document("horizontal", values["horizontal"], period),
            vertical=Axis.from_document("vertical", values["vertical"], period),
        )

    def to_document(self) -> Mapping[str, Any]:
        """Return the section as plain numbers, strings, lists and mappings."""
        return {
            **{name: getattr(self, name) for name in _FIGURES},
            "assumptions": asdict(self.assumptions),
            **{name: axis.to_document() for name, axis in zip(_AXES, self.axes, strict=True)},
        }


def _root(square: Fraction) -> Fraction:
    """Return a close upper bound of a square root."""
    return Fraction(math.isqrt(math.ceil(square * 10**40)) + 1, 10**20)
