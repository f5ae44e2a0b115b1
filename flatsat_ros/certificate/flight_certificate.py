"""The flight certificate: what is proved about the whole loop, and the file, of version 2, in which it travels.

Synthesis writes it, `FlightCertificate.verify` proves it again with numpy alone.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from flatsat_ros.base.errors import (
    FlatsatError,
    refusal,
    require,
    require_fields,
    require_not_negative,
    require_positive,
)
from flatsat_ros.base.files import located
from flatsat_ros.base.strict_yaml import read_yaml, section, write_yaml
from flatsat_ros.certificate.flight_cell import Box
from flatsat_ros.certificate.flight_loop import Design, Plant
from flatsat_ros.certificate.flight_return import Return, box_return
from flatsat_ros.certificate.flight_tube import Assumptions, Tube, box_tube
from flatsat_ros.law.input_set import InputSet

FORMAT = 2

# How a cell is written among the cuts of a box.
_CELL = "-"

_HEADER = """\
# A flatsat_ros flight certificate. Written by synthesis, verified on load: edit the inputs, not the figures.
# limits: thrust_max and thrust_min m/s^2 (normalised by the mass), tilt_max rad, gravity m/s^2
# sampling: period h s; the tubes hold for applied gains in [gain_min, gain_max], whatever they do
# room: margin m/s^2 of v_ref in the input set; compensation of the disturbance takes of it at most disturbance m/s^2
# assumptions: disturbance_rate m/s^3, noise m; acceleration m/s^2, jerk m/s^3 and snap m/s^4 of the reference
# horizontal, vertical: plants between low and high (delay s, lag s, frequency rad/s, tilt and drag 1/s), whose lag
#   changes in flight or not; model, observer (1, 1/s, 1/s^2), stiffness 1/s^2, rate 1/s, horizon s, lead s: the
#   controller; cuts of the box into cells; tube: bounds of |e| m, |e'| m/s, |v0| m/s^2 and |D/g - d^| m/s^2; back: a
#   start adds to |e| at most (position |e(0)| + position_velocity |e'(0)|) e^(-rate t), and to |v0| likewise
"""

_SCHEMA: dict[str, tuple[str, ...]] = {
    "limits": ("thrust_max", "tilt_max", "gravity", "thrust_min"),
    "sampling": ("period", "gain_min", "gain_max"),
    "room": ("margin", "disturbance"),
}
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
        return box_tube(self.design, self.box, self.cuts, gain_min, gain_max, assumptions, self.lag_varies)

    def returned(self, gain_min: float, gain_max: float) -> Return:
        """Return the way back that is proved by computation, at the rate that is claimed."""
        return box_return(
            self.design, self.box, self.cuts, gain_min, gain_max, self.back.rate, lag_varies=self.lag_varies
        )

    @classmethod
    def from_document(cls, name: str, document: object, period: float) -> Axis:
        """Build the axes called `name` from the parsed YAML, refusing whatever is not exactly their form."""
        values = section(name, document, _AXIS)
        plants = {}
        for key in ("low", "high", "model"):
            plants[key] = Plant(**section(f"{name}.{key}", values[key], tuple(f.name for f in fields(Plant))))
        if not isinstance(values["lag_varies"], bool):
            raise refusal(f"{name}.lag_varies", values["lag_varies"], "", "true or false")
        if not isinstance(values["cuts"], str):
            raise refusal(f"{name}.cuts", values["cuts"], "", f"names of figures and {_CELL!r}, separated by spaces")
        if not isinstance(values["observer"], list):
            raise refusal(f"{name}.observer", values["observer"], "", "a list of three gains")
        claims = {}
        for key, kind in (("tube", Tube), ("back", Return)):
            claims[key] = section(f"{name}.{key}", values[key], tuple(f.name for f in fields(kind)))
            for claim, value in claims[key].items():
                require_positive(f"{name}.{key}.{claim}", value, "")
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
class FlightCertificate:
    """What is proved about the loop that flies.

    Attributes:
        name: what the user calls it.
        limits: the input set V_c.
        gain_min: smallest applied gain k, at most 1.
        gain_max: largest applied gain.
        margin: m, m/s^2, of the acceleration that the reference asks for in V_c.
        disturbance: largest |D/g|, m/s^2.
        assumptions: of the tube.
        horizontal: of x and y.
        vertical: of z.
        provenance: how the certificate was made. Nothing reads it but people.

    Raises:
        FlatsatError: a value is not a number of its range, or the axes have different periods. Inequalities are checked
            by `verify`.
    """

    name: str
    limits: InputSet
    gain_min: float
    gain_max: float
    margin: float
    disturbance: float
    assumptions: Assumptions
    horizontal: Axis
    vertical: Axis
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_fields(self, require_positive, gain_min="", gain_max="", margin="m/s^2")
        require_fields(self, require_not_negative, disturbance="m/s^2")
        periods = self.horizontal.design.period, self.vertical.design.period
        require(
            periods[0] == periods[1], "period of the vertical axis", periods[1], "s", f"{periods[0]:g}, of the others"
        )

    def certified_start(self) -> tuple[float, float]:
        """Return the largest distances |e(0)|, m, horizontal and vertical, each alone, from which a drone returns.

        It begins at rest against the reference. Negative: no start is certified.
        """
        room = self.margin - self.disturbance - math.hypot(*(a.tube.disturbance for a in self._axes))
        distances = []
        for axis, other in (self._axes, self._axes[::-1]):
            own = math.sqrt(max(room**2 - other.tube.nominal**2, 0.0)) if room > 0.0 else 0.0
            distances.append(axis.back.certified(axis.tube, own))
        return distances[0], distances[1]

    @property
    def _axes(self) -> tuple[Axis, Axis]:
        return self.horizontal, self.vertical

    @property
    def period(self) -> float:
        """The period h, s."""
        return self.horizontal.design.period

    def margins(self) -> dict[str, float]:
        """Return by how much, relatively, each inequality holds; negative ones and NaN fail."""
        margins = {
            "gain_min <= 1": 1.0 - self.gain_min,
            "1 <= gain_max": self.gain_max - 1.0,
            "the margin is one that a hovering drone has": 1.0 - self.margin / self.limits.inner_radius,
        }
        sides, upright = self.horizontal.tube, self.vertical.tube
        estimate = self.disturbance + math.hypot(sides.disturbance, upright.disturbance)
        taken = math.hypot(sides.nominal, upright.nominal) + estimate
        margins["|v0| + |d^| <= margin, so that every applied gain is at least 1"] = 1.0 - taken / self.margin
        for name in _AXES:
            axis: Axis = getattr(self, name)
            tube = axis.proved(self.gain_min, self.gain_max, self.assumptions)
            back = axis.returned(self.gain_min, self.gain_max)
            for kind, proved, claimed in (("tube", tube, axis.tube), ("way back", back, axis.back)):
                for claim in fields(proved):
                    if claim.name != "rate":
                        ratio = getattr(proved, claim.name) / getattr(claimed, claim.name)
                        margins[f"{name} {kind}, {claim.name}"] = 1.0 - ratio
        return margins

    def verify(self) -> dict[str, float]:
        """Check every inequality with numpy alone, and without tolerance.

        Returns:
            The relative margin of each inequality.

        Raises:
            FlatsatError: an inequality does not hold; the text names it and by how much it fails.
        """
        margins = self.margins()
        for name, margin in margins.items():
            if not margin >= 0.0:
                raise FlatsatError(f"certificate {self.name!r}: '{name}' fails by {-margin:.6g} (relative): must hold")
        return margins

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> FlightCertificate:
        """Read a certificate and verify it.

        Args:
            path: of a YAML file.

        Raises:
            FlatsatError: the file cannot be read, a key is unknown or missing, a value has the wrong form, or an
                inequality does not hold.
        """
        document = read_yaml(path)
        try:
            certificate = cls.from_document(document)
            certificate.verify()
        except FlatsatError as error:
            raise located(path, error) from error
        return certificate

    @classmethod
    def from_document(cls, document: object) -> FlightCertificate:
        """Build a certificate from the parsed YAML document, refusing whatever is not exactly its form."""
        keys = ("flatsat_certificate", "name", *_SCHEMA, "assumptions", *_AXES, "provenance")
        root = section("the flight certificate", document, keys)
        if root["flatsat_certificate"] != FORMAT or isinstance(root["flatsat_certificate"], bool):
            raise refusal(
                "flatsat_certificate", root["flatsat_certificate"], "", f"{FORMAT}, that of flight certificates"
            )
        if not isinstance(root["name"], str) or not root["name"]:
            raise refusal("name", root["name"], "", "a non-empty string")
        if not isinstance(root["provenance"], dict):
            raise refusal("provenance", root["provenance"], "", "a mapping")
        limits, sampling, room = (section(key, root[key], names) for key, names in _SCHEMA.items())
        assumptions = section("assumptions", root["assumptions"], tuple(f.name for f in fields(Assumptions)))
        period = sampling.pop("period")
        return cls(
            name=root["name"],
            limits=InputSet(**limits),
            **sampling,
            **room,
            assumptions=Assumptions(**assumptions),
            horizontal=Axis.from_document("horizontal", root["horizontal"], period),
            vertical=Axis.from_document("vertical", root["vertical"], period),
            provenance=root["provenance"],
        )

    def to_document(self) -> dict[str, Any]:
        """Return the certificate as plain lists, numbers and strings, the form of the YAML file."""
        return {
            "flatsat_certificate": FORMAT,
            "name": self.name,
            "limits": {name: getattr(self.limits, name) for name in _SCHEMA["limits"]},
            "sampling": {name: getattr(self, name) for name in _SCHEMA["sampling"]},
            "room": {name: getattr(self, name) for name in _SCHEMA["room"]},
            "assumptions": asdict(self.assumptions),
            **{name: getattr(self, name).to_document() for name in _AXES},
            "provenance": dict(self.provenance),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Verify and write the certificate; the file is replaced in one step, never left half written.

        Args:
            path: of the YAML file, in a folder that exists.

        Raises:
            FlatsatError: an inequality does not hold, or the file cannot be written.
        """
        self.verify()
        write_yaml(path, self.to_document(), _HEADER)
