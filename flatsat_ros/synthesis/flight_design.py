"""From a stored design to a flight certificate: every figure is proved here, none is searched.

A design says what the controller knows and does, for which plants, and under which assumptions. The box of plants is
cut into cells until the proved tube is close to that of its worst corner; claims are rounded up.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

import flatsat_ros
from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.base.files import located
from flatsat_ros.base.strict_yaml import read_yaml, section
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_return import Return
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.flight_cover import cover
from flatsat_ros.synthesis.rounding import DIGITS, round_down, round_up

# Digits of what is claimed, and by how much, relatively, a claim is above what was computed before it is rounded up.
_DIGITS, _ABOVE = 5, 1e-6

# Shares of the wished rate of return that are tried, one after another.
_SLOWER = (1.0, 0.4, 0.16, 0.064)

_FIGURES = ("period", "thrust_max_g", "tilt_max_deg", "gain_max", "margin", "disturbance", "return_rate")
_AXIS = ("low", "high", "lag_varies", "model", "observer", "stiffness", "rate", "excess")


@dataclass(frozen=True)
class AxisDesign:
    """The controller of the axes that share a loop, and the plants that it flies.

    Attributes:
        box: the plants.
        lag_varies: whether their lag, frequency and damping change in flight.
        design: the controller; it predicts over all of its model's delay and lag.
        excess: relative, by how much the tube of the box may be above that of its worst corner.
    """

    box: PlantBox
    lag_varies: bool
    design: Design
    excess: float

    @classmethod
    def from_document(cls, name: str, document: object, period: float) -> AxisDesign:
        """Build it from parsed YAML; figures of plants that are left out are those of `Plant`."""
        values = section(name, document, _AXIS)
        plants = {}
        for key in ("low", "high", "model"):
            given = values[key]
            names = tuple(given) if isinstance(given, dict) and set(given) <= _PLANT else tuple(sorted(_PLANT))
            plants[key] = Plant(**section(f"{name}.{key}", given, names))
        design = Design.predicting(
            period, plants["model"], tuple(values["observer"]), values["stiffness"], values["rate"]
        )
        return cls(PlantBox(plants["low"], plants["high"]), values["lag_varies"], design, values["excess"])


_PLANT = {figure.name for figure in fields(Plant)}


@dataclass(frozen=True)
class FlightDesign:
    """All that a flight certificate is made from.

    Attributes:
        limits: the input set V_c.
        gain_max: largest applied gain.
        margin: m/s^2, of the reference's acceleration in V_c.
        disturbance: m/s^2, largest |D/g|.
        return_rate: 1/s, of the way back into the tube; where so fast a one cannot be shown, a share of _SLOWER of it.
        assumptions: of the tube.
        horizontal: of x and y.
        vertical: of z.
    """

    limits: InputSet
    gain_max: float
    margin: float
    disturbance: float
    return_rate: float
    assumptions: Assumptions
    horizontal: AxisDesign
    vertical: AxisDesign

    @classmethod
    def from_document(cls, name: str, document: object) -> FlightDesign:
        """Build a design from parsed YAML, refusing whatever is not exactly its form."""
        values = section(name, document, (*_FIGURES, "assumptions", "horizontal", "vertical"))
        known = section(f"{name}.assumptions", values["assumptions"], tuple(f.name for f in fields(Assumptions)))
        period = values["period"]
        return cls(
            limits=InputSet(values["thrust_max_g"] * GRAVITY, math.radians(values["tilt_max_deg"]), GRAVITY),
            **{key: values[key] for key in _FIGURES[3:]},
            assumptions=Assumptions(**known),
            horizontal=AxisDesign.from_document(f"{name}.horizontal", values["horizontal"], period),
            vertical=AxisDesign.from_document(f"{name}.vertical", values["vertical"], period),
        )

    def certificate(self, name: str, provenance: Mapping[str, Any]) -> Certificate:
        """Prove what the design does and return the certificate, which is not verified yet.

        Args:
            name: of the certificate.
            provenance: inputs, for people.

        Raises:
            FlatsatError: a tube is not bounded, or the gains are no stabilising ones.
        """
        axes = [self._proved(design) for design in (self.horizontal, self.vertical)]
        flight = FlightSection(1.0, self.gain_max, self.margin, self.disturbance, self.assumptions, *axes)
        (rate, sides), (rate_upright, upright) = (
            ideal_block(axis.design.stiffness, axis.design.rate) for axis in flight.axes
        )
        ball = round_down(self.limits.inner_radius**2)
        return Certificate(
            name=name,
            limits=self.limits,
            rate=min(rate, rate_upright),
            block=sides,
            block_vertical=upright,
            ball=ball,
            level=round_down(ball / max(axis.design.rate for axis in flight.axes)),
            period=self.horizontal.design.period,
            gain_min=1.0,
            gain_max=self.gain_max,
            provenance={"package": f"flatsat_ros {flatsat_ros.__version__}", **provenance},
            flight=flight,
        )

    def _proved(self, design: AxisDesign) -> Axis:
        """Return the axes with claims that hold."""
        found = cover(
            design.design,
            design.box,
            1.0,
            self.gain_max,
            self.assumptions,
            design.lag_varies,
            design.excess,
        )
        nothing = Return(0.0, 1.0, 1.0, 1.0, 1.0)
        axis = Axis(design.box, design.lag_varies, design.design, found.cuts, found.tube, nothing)
        for share in _SLOWER:
            rate = share * self.return_rate
            axis = replace(axis, back=replace(nothing, rate=rate))
            _, back = axis.claims(1.0, self.gain_max, self.assumptions)
            if math.isfinite(back.nominal):
                break
        else:
            raise refusal("return_rate", self.return_rate, "1/s", "much smaller, no return so fast can be shown")
        tube = AxisTube(*(_above(value) for value in asdict(found.tube).values()))
        ways = {key: _above(value) for key, value in asdict(back).items() if key != "rate"}
        return replace(axis, tube=tube, back=Return(rate, **ways))


def _above(value: float) -> float:
    return round_up(value * (1.0 + _ABOVE), _DIGITS)


def ideal_block(stiffness: float, rate: float) -> tuple[float, FloatArray]:
    """Return the largest alpha and a block P = [[p, K1], [K1, K2]] with V' <= -alpha V in the ideal loop at k >= 1.

    With d = 2 K2^2 - 2 K1 - alpha K2 >= 0 the residual A'P + P A - 2 P B B'P + alpha P is at most 0 if
    (p - 2 K1 K2 + alpha K1)^2 <= (2 K1^2 - alpha p) d. Some p satisfies that, and p = 2 K1 K2 - alpha K1 - alpha d / 2
    does then, as long as the discriminant is not negative:

        2 K1^2 - 2 K1 K2 alpha + (K1 + K2^2) alpha^2 / 2 - K2 alpha^3 / 4 >= 0

    Args:
        stiffness: K1, 1/s^2.
        rate: K2, 1/s.

    Raises:
        FlatsatError: the gains have no such P.
    """
    square = rate * rate
    require(stiffness < square, "stiffness", stiffness, "1/s^2", f"below the square of the rate, {square:g}")
    cubic = [-rate / 4.0, (stiffness + square) / 2.0, -2.0 * stiffness * rate, 2.0 * stiffness * stiffness]
    roots = np.roots(cubic)
    real = roots.real[np.abs(roots.imag) <= 1e-6 * np.abs(roots)]
    alpha = min([2.0 * rate - 2.0 * stiffness / rate, *real[real > 0.0].tolist()])
    alpha = round_down(alpha * (1.0 - _ABOVE), _DIGITS)
    corner = (2.0 * rate - alpha) * stiffness - alpha * (square - stiffness - alpha * rate / 2.0)
    return alpha, np.array([[float(f"{corner:.{DIGITS - 1}e}"), stiffness], [stiffness, rate]])


def read_designs(path: str | os.PathLike[str]) -> dict[str, tuple[str, FlightDesign]]:
    """Return the stored designs of a file, each with the vehicle that it is for, by the name of its certificate.

    Raises:
        FlatsatError: the file cannot be read, or a design has another form.
    """
    document = read_yaml(path)
    try:
        if not isinstance(document, dict):
            raise refusal("designs", document, "", "a mapping from names of certificates to designs")
        designs = {}
        for name, values in document.items():
            values = dict(values) if isinstance(values, dict) else {}
            vehicle = values.pop("vehicle", None)
            if not isinstance(vehicle, str):
                raise refusal(f"{name}.vehicle", vehicle, "", "the name of a vehicle profile")
            designs[name] = vehicle, FlightDesign.from_document(name, values)
        return designs
    except FlatsatError as error:
        raise located(path, error) from error
