"""A flight certificate in words: what it promises, what each wish costs, and which wish to give up if none exists."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.crazyflie.intervals import Interval
from flatsat_ros.synthesis.flight_cover import CoverError, cover
from flatsat_ros.synthesis.flight_design import AxisDesign, FlightDesign
from flatsat_ros.synthesis.flight_search import Goal, corner_boxes, search
from flatsat_ros.synthesis.flight_wishes import Plants, asked_for

_GAINS = (1.0, 1.5, 2.5, 4.0)

_UNITS = {
    "disturbance_rate": "m/s^3",
    "noise": "m",
    "acceleration": "m/s^2",
    "jerk": "m/s^3",
    "snap": "m/s^4",
    "pose_age": "s",
}

# The share of a wish that is kept when it is tried whether giving up the rest helps, and the time for a search, s.
_LESS = 0.5
_LOOK = 10.0

# The most intervals of plants that are halved, one after another, until there is a proof.
_HALVED = 6


def sentence(certificate: Certificate) -> str:
    """Return what the flight section promises, in one sentence."""
    flight = _flight(certificate)
    a, sides, upright = flight.assumptions, flight.horizontal.tube, flight.vertical.tube
    return (
        f"stays within {100.0 * sides.position:.1f} cm horizontally and {100.0 * upright.position:.1f} cm vertically "
        f"of every reference with acceleration below {a.acceleration:g} m/s^2, jerk below {a.jerk:g} m/s^3 and snap "
        f"below {a.snap:g} m/s^4, whatever gain between {flight.gain_min:g} and {flight.gain_max:g} is applied, while "
        f"what disturbs it is below {flight.disturbance:g} m/s^2 and changes by less than "
        f"{a.disturbance_rate:g} m/s^3, positions are measured to {1e3 * a.noise:g} mm and the newest is never older "
        f"than {1e3 * a.pose_age:g} ms"
    )


def trade(certificate: Certificate) -> Iterator[str]:
    """Return the lines of a table: what the worst corner's tube would be with other wishes."""
    flight = _flight(certificate)
    yield "  tube of the worst corner, horizontal and vertical, cm"
    yield f"    {'as certified':<38}{_tubes(flight, flight.gain_max, flight.assumptions)}"
    for gain in _GAINS:
        yield f"    {f'any gain to {gain:g}':<38}{_tubes(flight, gain, flight.assumptions)}"
    for field in fields(Assumptions):
        value = getattr(flight.assumptions, field.name)
        less = replace(flight.assumptions, **{field.name: 0.0})
        words = f"{field.name} 0 instead of {value:g} {_UNITS[field.name]}"
        yield f"    {words:<38}{_tubes(flight, flight.gain_max, less)}"
    nominal, wrong = _taken(certificate)
    needed = nominal + wrong + flight.disturbance
    yield f"  margin of the reference to the tilt limit {flight.margin:.3g} m/s^2, of which {needed:.3g} are needed:"
    yield f"    {nominal:.3g} for v0, {flight.disturbance:.3g} for the disturbance, {wrong:.3g} for its error"
    limit = math.degrees(certificate.limits.tilt_max)
    yield f"  tilt limit {limit:.3g} deg, of which {_tilt_needed(certificate):.3g} are needed"


def require_tilt(certificate: Certificate) -> None:
    """Refuse a limit of the tilt that leaves the gain no room; say which one would do, and what else may be given up.

    Raises:
        FlatsatError: the loop may need more acceleration than the limit has beside what references ask for.
    """
    flight = _flight(certificate)
    needed = sum(_taken(certificate)) + flight.disturbance
    if needed <= flight.margin:
        return
    tilt, enough = math.degrees(certificate.limits.tilt_max), math.ceil(10.0 * _tilt_needed(certificate)) / 10.0
    share = max(_shares(flight), key=lambda pair: pair[1])[0]
    others = f"--gain-max below {flight.gain_max:g}, or less {share}, for which the loop needs most"
    valid = f"at least {enough:g} deg, for {needed:.3g} m/s^2 beside the reference's; or give up: {others}"
    raise refusal("--tilt-max-deg", round(tilt, 3), "deg", valid)


def _shares(flight: FlightSection) -> Iterator[tuple[str, float]]:
    """Yield each assumption, and by how much |v0| at the worst corners would be smaller without it, m/s^2."""
    nominal = _worst(flight, flight.gain_max, flight.assumptions, "nominal")
    for field in fields(Assumptions):
        less = replace(flight.assumptions, **{field.name: 0.0})
        yield field.name, sum(nominal) - sum(_worst(flight, flight.gain_max, less, "nominal"))


def _taken(certificate: Certificate) -> tuple[float, float]:
    """Return the parts of the margin to the tilt limit that v0 and the disturbance's error need, m/s^2."""
    sides, upright = (axis.tube for axis in _flight(certificate).axes)
    cos, sin = math.cos(certificate.limits.tilt_max), math.sin(certificate.limits.tilt_max)
    return cos * sides.nominal + sin * upright.nominal, cos * sides.disturbance + sin * upright.disturbance


def _tilt_needed(certificate: Certificate) -> float:
    """Return the tilt, degrees, whose limit has room for the loop and for what references ask it for."""
    flight = _flight(certificate)
    room = asked_for(flight.assumptions, *(axis.design.model for axis in flight.axes))
    needed = sum(_taken(certificate)) + flight.disturbance + room
    return math.degrees(math.asin(min(1.0, needed / certificate.limits.gravity)))


def _tubes(flight: FlightSection, gain_max: float, assumptions: Assumptions) -> str:
    return "".join(f"{100.0 * value:8.2f}" for value in _worst(flight, gain_max, assumptions, "position"))


def _worst(flight: FlightSection, gain_max: float, assumptions: Assumptions, signal: str) -> list[float]:
    """Return a signal's bound in the tube of the worst corner, horizontal and vertical."""
    values = []
    for axis in flight.axes:
        goal = Goal(axis.design.period, gain_max, math.inf, assumptions)
        plants = Plants(axis.box, axis.lag_varies, axis.design.model)
        values.append(float(getattr(goal.worst(axis.design, plants, corner_boxes(plants, 0.0)), signal)))
    return values


def _flight(certificate: Certificate) -> FlightSection:
    assert certificate.flight is not None, "a flight certificate has its section"
    return certificate.flight


@dataclass(frozen=True)
class _Less:
    """A wish that is partly given up: which one, in words, and the goal and plants that are left."""

    words: str
    goal: Goal
    plants: Plants


def searched(goal: Goal, plants: Plants, progress: Callable[[str], None], seconds: float) -> AxisDesign:
    """Return what `search` finds, or refuse and name a wish whose reduction makes a design possible.

    Raises:
        FlatsatError: no design has a bounded tube; the text says what to give up.
    """
    try:
        return search(goal, plants, progress, seconds)
    except FlatsatError as error:
        for less in _lesser(goal, plants):
            try:
                search(less.goal, less.plants, lambda _: None, _LOOK)
            except FlatsatError:
                continue
            raise FlatsatError(f"no design has a bounded tube: there is one with {less.words}") from error
        raise FlatsatError(f"{error}: of more than one of gain_max, pose_age and the plants' intervals") from error


def _lesser(goal: Goal, plants: Plants) -> Iterator[_Less]:
    """Yield the wishes that may be partly given up, the cheapest first."""
    age = _LESS * goal.assumptions.pose_age
    if age > 0.0:
        assumptions = replace(goal.assumptions, pose_age=age)
        yield _Less(f"a pose_age of {age:g} s", replace(goal, assumptions=assumptions), plants)
    gain = 1.0 + _LESS * (goal.gain_max - 1.0)
    yield _Less(f"--gain-max {gain:g}", replace(goal, gain_max=gain), plants)
    for name in plants.box.spread:
        low, high = plants.box.spread[name]
        middle, reach = (low + high) / 2.0, _LESS * (high - low) / 2.0
        ends = middle - reach, middle + reach
        box = replace(
            plants.box, low=replace(plants.box.low, **{name: ends[0]}), high=replace(plants.box.high, **{name: ends[1]})
        )
        yield _Less(f"the {name} known to be within {ends[0]:.4g} and {ends[1]:.4g}", goal, replace(plants, box=box))


def proved(design: FlightDesign, name: str, provenance: Mapping[str, Any]) -> Certificate:
    """Return the certificate of a design, or refuse and name narrower intervals of the plants for which one exists.

    Args:
        design: what is to be proved.
        name: of the certificate.
        provenance: inputs, for people.

    Raises:
        FlatsatError: there is no proof of the intervals, or a tube is not bounded.
    """
    try:
        return design.certificate(name, provenance)
    except CoverError as error:
        axis = design.horizontal if error.box == design.horizontal.box else design.vertical
        known = narrower(axis, error.figure, 1.0, design.gain_max, design.assumptions)
        within = ", ".join(f"the {figure} within {low:.4g} and {high:.4g}" for figure, (low, high) in known.items())
        raise FlatsatError(f"{error}: there is a proof with {within}" if within else str(error)) from error


def narrower(
    axis: AxisDesign, figure: str, gain_min: float, gain_max: float, assumptions: Assumptions, cells_max: int = 500
) -> dict[str, Interval]:
    """Halve intervals of plants, each time the one with the most cuts, until few cells cover the rest of the box.

    Args:
        axis: the plants and their controller.
        figure: the first.
        gain_min: smallest applied gain.
        gain_max: largest applied gain.
        assumptions: of the tube.
        cells_max: the largest number of cells.

    Returns:
        The intervals that were halved, about their middles; none if halving _HALVED times is not enough.
    """
    box, known = axis.box, dict[str, Interval]()
    for _ in range(_HALVED):
        low, high = box.spread[figure]
        ends = (3.0 * low + high) / 4.0, (low + 3.0 * high) / 4.0
        known[figure] = ends
        box = PlantBox(replace(box.low, **{figure: ends[0]}), replace(box.high, **{figure: ends[1]}))
        try:
            cover(axis.design, box, gain_min, gain_max, assumptions, axis.lag_varies, axis.excess, cells_max)
        except CoverError as error:
            figure = error.figure
        else:
            return known
    return {}
