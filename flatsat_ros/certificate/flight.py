"""The flight section of a certificate: what is proved about the whole loop that flies.

The other sections speak of the ideal loop, a drone that knows its state and answers at once; their P gives the law, and
the law acts on the predicted state, of which they are true. This section says how far from its reference the real drone
is, and that its applied gain stays in the interval.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from fractions import Fraction
from functools import lru_cache
from typing import Any

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import refusal, require, require_fields, require_not_negative, require_positive
from flatsat_ros.base.strict_yaml import section
from flatsat_ros.certificate.enclosures import decimal
from flatsat_ros.certificate.exact import inner_radius, spare
from flatsat_ros.certificate.flight_cell import Box
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_return import Return, box_return
from flatsat_ros.certificate.flight_tube import Assumptions, Tube, box_tube
from flatsat_ros.law.input_set import InputSet

# How a cell is written among the cuts of a box.
_CELL = "-"

HEADER = """\
# flight: the whole loop; the tubes hold for applied gains in [gain_min, gain_max], whatever they do
#   margin m/s^2 of v_ref in the input set; compensation of the disturbance takes of it at most disturbance m/s^2
#   assumptions: disturbance_rate m/s^3, noise m; acceleration m/s^2, jerk m/s^3 and snap m/s^4 of the reference;
#     pose_age s of the newest pose at a tick
#   horizontal, vertical: plants between low and high (delay s, lag s, frequency rad/s, tilt and drag 1/s), whose lag
#     changes in flight or not; model, observer (1, 1/s, 1/s^2), horizon s, lead s: the controller; cuts of the box into
#     cells; tube: bounds of |e| m, |e'| m/s, |v0| m/s^2 and |D/g - d^| m/s^2; back: a start adds to |e| at most
#     (position |e(0)| + position_velocity |e'(0)|) e^(-rate t), and to |v0| likewise
"""

# claims do not change what is proved: certificates that differ in nothing else are proved once in a process
_box_tube, _box_return = lru_cache(maxsize=8)(box_tube), lru_cache(maxsize=8)(box_return)

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

    box: Box
    lag_varies: bool
    design: Design
    cuts: tuple[str, ...]
    tube: Tube
    back: Return

    def proved(self, gain_min: float, gain_max: float, assumptions: Assumptions) -> Tube:
        """Return the tube that is proved by computation, whatever is claimed."""
        return _box_tube(self.design, self.box, self.cuts, gain_min, gain_max, assumptions, self.lag_varies)

    def returned(self, gain_min: float, gain_max: float, pose_age: float) -> Return:
        """Return the way back that is proved by computation, at the rate that is claimed."""
        return _box_return(
            self.design, self.box, self.cuts, gain_min, gain_max, self.back.rate, pose_age, self.lag_varies
        )

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
        for key, kind in (("tube", Tube), ("back", Return)):
            claims[key] = section(f"flight.{name}.{key}", values[key], tuple(f.name for f in fields(kind)))
            for claim, value in claims[key].items():
                require_positive(f"flight.{name}.{key}.{claim}", value, "")
        figures = {key: values[key] for key in _CONTROLLER} | {"observer": tuple(values["observer"])}
        return cls(
            box=Box(plants["low"], plants["high"]),
            lag_varies=values["lag_varies"],
            design=Design(period=period, model=plants["model"], **figures),
            cuts=tuple("" if cut == _CELL else cut for cut in values["cuts"].split()),
            tube=Tube(**claims["tube"]),
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


@dataclass(frozen=True)
class Flight:
    """What is proved about the loop that flies.

    Attributes:
        gain_min: smallest applied gain k, at most 1.
        gain_max: largest applied gain.
        margin: m, m/s^2, of the acceleration that the reference asks for in V_c.
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
        """Return what a reference asks for over what is assumed, the largest ratio; at most 1 is kept.

        Args:
            demand: (3, 2) largest acceleration, jerk and snap, horizontal and vertical, m/s^2 and so on.
            margin: of its acceleration in V_c, m/s^2.
        """
        assumed = self.assumptions
        ratio = self.margin / margin
        for asked, most in zip(demand.max(axis=1), (self.acceleration, assumed.jerk, assumed.snap), strict=True):
            if asked > 0.0:
                ratio = max(ratio, float(asked) / most if most > 0.0 else math.inf)
        return ratio

    @property
    def compensation(self) -> float:
        """Largest |d^|, m/s^2, while |D/g| keeps its bound: clipped there or above, the compensation is not clipped."""
        return self.disturbance + math.hypot(*(axis.tube.disturbance for axis in self.axes))

    def certified_start(self) -> tuple[float, float]:
        """Return the largest distances |e(0)|, m, horizontal and vertical, each alone, from which a drone returns.

        It begins at rest against the reference. Negative: no start is certified.
        """
        room = self.margin - self.compensation
        distances = []
        for axis, other in (self.axes, self.axes[::-1]):
            own = math.sqrt(max(room**2 - other.tube.nominal**2, 0.0)) if room > 0.0 else 0.0
            distances.append(axis.back.certified(axis.tube, own))
        return distances[0], distances[1]

    def margins(self, limits: InputSet, gain_max: float) -> dict[str, float]:
        """Return by how much, relatively, each inequality holds; negative ones fail. Their signs are exact.

        Args:
            limits: the input set V_c.
            gain_max: the cap that the controller uses.
        """
        sides, upright = self.horizontal.tube, self.vertical.tube
        taken = _norm(sides.nominal, upright.nominal) + _norm(sides.disturbance, upright.disturbance)
        margins = {
            "flight: gain_min <= 1": spare(decimal(self.gain_min), Fraction(1)),
            "flight: the cap of the gain is in the interval": spare(decimal(gain_max), decimal(self.gain_max)),
            "flight: the margin is one that a hovering drone has": spare(decimal(self.margin), inner_radius(limits)),
            "flight: |v0| + |d^| <= margin, so that every applied gain is at least 1": spare(
                taken + decimal(self.disturbance), decimal(self.margin)
            ),
        }
        for name, axis in zip(_AXES, self.axes, strict=True):
            tube = axis.proved(self.gain_min, self.gain_max, self.assumptions)
            back = axis.returned(self.gain_min, self.gain_max, self.pose_age)
            for kind, proved, claimed in (("tube", tube, axis.tube), ("way back", back, axis.back)):
                for claim in fields(proved):
                    if claim.name != "rate":
                        bound, most = getattr(proved, claim.name), decimal(getattr(claimed, claim.name))
                        slack = spare(Fraction(bound), most) if math.isfinite(bound) else -math.inf
                        margins[f"flight: {name} {kind}, {claim.name}"] = slack
        return margins

    @classmethod
    def from_document(cls, document: object, period: float) -> Flight:
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


def _norm(first: float, second: float) -> Fraction:
    """Return a bound of the root of the sum of two squares, hardly above it."""
    square = decimal(first) ** 2 + decimal(second) ** 2
    return Fraction(math.isqrt(math.ceil(square * 10**40)) + 1, 10**20)
