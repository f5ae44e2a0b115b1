"""Small flight sections, proved in a moment, and certificates around them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Axis, FlightSection
from flatsat_ros.certificate.flight_return import Return
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.synthesis.flight_design import ideal_block

LIMITS = InputSet(14.2, 0.262, 9.81)
# claims of an axis until something is proved of it
NONE, BACK = AxisTube(1.0, 1.0, 1.0, 1.0), Return(0.5, 1.0, 1.0, 1.0, 1.0)
_ROOM = 1.001


def flight_of(
    sides: Axis, upright: Axis, assumptions: Assumptions, gain_max: float, margin: float, disturbance: float
) -> FlightSection:
    """Return a section for gains from 1 on that claims what is proved, hardly enlarged; margin, disturbance: m/s^2."""
    proved = []
    for axis in (sides, upright):
        tube, back = map(asdict, axis.claims(1.0, gain_max, assumptions))
        larger = {name: value * (_ROOM if name != "rate" else 1.0) for name, value in back.items()}
        tube = {name: value * _ROOM for name, value in tube.items()}
        proved.append(replace(axis, tube=AxisTube(**tube), back=Return(**larger)))
    return FlightSection(1.0, gain_max, margin, disturbance, assumptions, *proved)


def certificate_of(flight: FlightSection, gain_max: float, provenance: Mapping[str, Any] | None = None) -> Certificate:
    """Return a certificate for applied gains from 1 on with the law of a flight section."""
    designs = [axis.design for axis in flight.axes]
    rates, blocks = zip(*(ideal_block(design.stiffness, design.rate) for design in designs), strict=True)
    ball = LIMITS.inner_radius**2 * 0.999
    return Certificate(
        name="small",
        limits=LIMITS,
        rate=min(rates),
        block=blocks[0],
        ball=ball,
        level=0.999 * ball / designs[0].rate,
        period=designs[0].period,
        gain_min=1.0,
        gain_max=gain_max,
        block_vertical=blocks[1],
        provenance=provenance or {},
        flight=flight,
    )
