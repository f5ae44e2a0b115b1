"""Tubes that a certificate proves: how far a drone can be off a reference that keeps given bounds.

The flight section of a certificate holds for references that ask for no more than it assumes. Where a plan has other
bounds of acceleration, jerk and snap, the same proof is computed for these: less has a smaller tube, more a larger one.
A tenth is set aside for changes of pace, see `pacing`.

The margin that the proof needs is that of f (`plans.bounds`), for the models that the controller leads references
for. Of it, too, a tenth of what may be asked for is set aside, and where the models' delays differ what the vertical
part of f can have moved in between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import FlightSection
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube
from flatsat_ros.flight.preview import led_for
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.curve import Curve
from flatsat_ros.plans.drone import Tube
from flatsat_ros.plans.pacing import EXCESS, have_room
from flatsat_ros.plans.plan import Plan

RESERVE = EXCESS  # what references ask for at a change of pace, over the bounds of the plan
_STEP = 1e4  # 1/m: radii are stated in tenths of a millimetre, rounded up
_GRAIN = 1e-6  # m, m/s and m/s^2, of the figures of tubes that are computed
_CERTIFICATE = "certificate"
# A smaller tube is proved for references that use at most the share _WORTH of their bounds. Bounds are not narrowed
# below the share _LEAST, since the ways to the first places keep them, too, and would take long. _WIDENED are factors
# by which narrowed bounds are widened again until there is room for changes of pace.
_WORTH, _LEAST, _WIDENED = 0.9, 0.2, (1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
_JERK, _SNAP, _TUBE = 2.0, 20.0, 0.05  # m/s^3, m/s^4, m, where nothing is proved


class Promise(NamedTuple):
    """What references keep, and the tube that goes with it.

    Attributes:
        bounds: of the references.
        tube: of each drone.
    """

    bounds: Bounds
    tube: Tube


def _tube(proved: FlightSection, downwash: float) -> Tube:
    """Return the tube of a section in the downwash metric."""
    sides, upright = (axis.tube.position for axis in proved.axes)
    radius = math.hypot(sides, upright / downwash)
    return Tube(math.ceil(radius * _STEP) / _STEP, _CERTIFICATE)


def _asked(flight: FlightSection, bounds: Bounds) -> Assumptions:
    """Return what the section must assume for references with these bounds."""
    assumed, acceleration = flight.assumptions, bounds.acceleration_max
    figures = {"jerk": RESERVE * bounds.jerk_max, "snap": RESERVE * bounds.snap_max}
    if (
        math.isfinite(flight.acceleration)
        and acceleration is not None
        and RESERVE * acceleration < assumed.acceleration
    ):
        figures["acceleration"] = RESERVE * acceleration
    # dividing and multiplying by the reserve need not give the same number again
    return replace(assumed, **{
        name: most if (most := getattr(assumed, name)) * (1.0 - 1e-12) <= asked <= most else asked
        for name, asked in figures.items()
    })  # fmt: skip


def _proved(flight: FlightSection, limits: InputSet, bounds: Bounds) -> FlightSection:
    """Return the section with tubes of references with these bounds; up to two seconds of computation.

    Raises:
        FlatsatError: nothing is proved for them.
    """
    asked = _asked(flight, bounds)
    if asked == flight.assumptions:
        return flight
    found = _with_tubes(flight, asked)
    bounded = all(math.isfinite(axis.tube.nominal) for axis in found.axes)
    need = float(found.taken(limits).tilt_max) if bounded else math.inf
    if not need <= flight.margin or min(found.left(limits)) <= 0:  # every applied gain is at least 1, see `margins`
        valid = "less: what the loop needs for it is more than the certificate's margin of "
        raise refusal(
            f"jerk_max {bounds.jerk_max:g} m/s^3, snap_max {bounds.snap_max:g} m/s^4: need", round(need, 3), "m/s^2",
            f"{valid}{flight.margin:g} m/s^2",
        )  # fmt: skip
    return found


def _with_tubes(flight: FlightSection, assumed: Assumptions) -> FlightSection:
    """Return the section with the tubes that are proved under other assumptions, whether or not they leave room."""
    axes = [
        replace(axis, tube=_rounded_up(axis.proved(flight.gain_min, flight.gain_max, assumed))) for axis in flight.axes
    ]
    return replace(flight, assumptions=assumed, horizontal=axes[0], vertical=axes[1])


def _rounded_up(tube: AxisTube) -> AxisTube:
    """Return a tube in whole millionths, so that other machines, whose last digits differ, find the same one."""
    grains = (value / _GRAIN if math.isfinite(value) else value for value in astuple(tube))
    return AxisTube(*(_GRAIN * (math.ceil(each) + 1.0) if math.isfinite(each) else each for each in grains))


def promise(
    certificate: Certificate,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    downwash: float,
    tube: float | None = None,
    margin: float | None = None,
    jerk_max: float | None = None,
    snap_max: float | None = None,
    speed_max: float | None = None,
    acceleration_max: float | None = None,
) -> Promise:
    """Return what references shall keep, and the tube that the certificate proves for it.

    Args:
        certificate: of the tubes.
        lower: (3,) m, corner of the box of the references.
        upper: (3,) m, the other one.
        downwash: heights count by its inverse.
        tube: radius, m, that is wanted. Acceleration, jerk and snap, where they are left open, are then the same share
            of what the flight section assumes, at most all of it, for which a tube of this radius is proved. Where none
            is, the radius is the user's word, and nothing is proved. None for what is proved, or 0.05 without a
            flight section.
        margin: m/s^2; None for what the flight section needs, or half the radius of the ball around hover.
        jerk_max: m/s^3; None for what it assumes, or 2.
        snap_max: m/s^4; None for what it assumes, or 20.
        speed_max: m/s; None for no bound.
        acceleration_max: m/s^2; None for what it assumes, or no bound.

    Raises:
        FlatsatError: nothing is proved for these bounds, and no tube is given.
    """
    if tube is not None:
        tube = Tube(tube).radius  # a number, at least 0
    flight, limits = certificate.flight, certificate.limits
    usual = limits.inner_radius / 2.0, _JERK, _SNAP
    if flight is not None:
        assumed = flight.assumptions
        share = 1.0 if tube is None else _share(flight, limits, tube, downwash)
        usual = limits.inner_radius / 2.0, share * assumed.jerk / RESERVE, share * assumed.snap / RESERVE
        if acceleration_max is None and math.isfinite(flight.acceleration):
            acceleration_max = share * flight.acceleration / RESERVE
    wanted = zip(usual, (margin, jerk_max, snap_max), strict=True)
    figures = [own if given is None else given for own, given in wanted]
    bounds = Bounds(
        figures[0], figures[1], figures[2], np.asarray(lower), np.asarray(upper), speed_max, acceleration_max
    )  # fmt: skip
    if flight is None:
        return Promise(bounds, Tube(_TUBE if tube is None else tube))
    drag, lead = led_for(flight)
    bounds = replace(bounds, drag=drag, lead=lead)
    try:
        proved = _proved(flight, limits, bounds)
    except FlatsatError:
        if tube is None:
            raise
        return _stated(flight, limits, bounds, margin, tube)
    radius = _tube(proved, downwash).radius
    if tube is not None and tube < radius:
        return _stated(flight, limits, bounds, margin, tube)
    room = proved.room(limits)
    bounds = replace(bounds, thrust_max=room.thrust_max, thrust_min=room.thrust_min)
    bounds = replace(bounds, margin=least_margin(flight, room, bounds) if margin is None else margin)
    require_margin(bounds, flight, room)
    return Promise(bounds, Tube(radius if tube is None else tube, _CERTIFICATE))


def narrowed(
    promised: Promise, curves: Sequence[Curve], flight: FlightSection, limits: InputSet, downwash: float
) -> Promise:
    """Return what references keep that ask for markedly less than they may, and the smaller tube that goes with it.

    Changes of pace keep their room: bounds are those of the references, or as many times as much as changes need.

    Args:
        promised: what they may ask for, and its tube, proved by the section.
        curves: the references, from rest to rest.
        flight: the section.
        limits: the input set V_c.
        downwash: heights count by its inverse.
    """
    bounds = promised.bounds
    asked = {name: getattr(bounds, name) for name in ("acceleration_max", "jerk_max", "snap_max")}
    most = {name: value for name, value in asked.items() if value is not None}
    used = {name: _LEAST * value for name, value in most.items()}
    for claim in (claim for curve in curves for claim in bounds.claims(curve, limits)):
        name = f"{claim.name}_max"
        if name in used:
            used[name] = max(used[name], most[name] - claim.slack)
    share = max(value / most[name] for name, value in used.items())
    paths = [curve.trajectory() for curve in curves]
    for factor in (each for each in _WIDENED if each * share <= _WORTH):
        less: dict[str, Any] = {name: math.ceil(factor * value * 1e6 + 1.0) / 1e6 for name, value in used.items()}
        if have_room(paths, replace(bounds, **less), limits):
            break
    else:
        return promised
    found = replace(bounds, **less)
    proved = _proved(flight, limits, found)
    room, tube = proved.room(limits), _tube(proved, downwash)
    found = replace(found, thrust_max=room.thrust_max, thrust_min=room.thrust_min)
    found = replace(found, margin=max(bounds.margin, least_margin(flight, room, found)))
    kept = all(claim.slack >= 0.0 for curve in curves for claim in found.claims(curve, limits))
    smaller = tube.radius < promised.tube.radius
    return Promise(found, tube) if kept and smaller and have_room(paths, found, limits) else promised


def _stated(flight: FlightSection, limits: InputSet, bounds: Bounds, margin: float | None, tube: float) -> Promise:
    """Return what references keep where the tube is the user's word."""
    bounds = replace(bounds, acceleration_max=None)
    least = least_margin(flight, limits, bounds)
    return Promise(replace(bounds, margin=least if margin is None else margin), Tube(tube))


def _share(flight: FlightSection, limits: InputSet, radius: float, downwash: float) -> float:
    """Return the share of what a section assumes of references with which a tube of a radius, m, is proved; 1 if none.

    Every bound that makes a tube is linear in what is assumed, and the tube is the largest of them, so the radius is a
    convex function of the share: it is never above the line between those of 0 and of 1.
    """
    most = _tube(flight, downwash).radius
    wanted = math.floor(radius * _STEP) / _STEP
    if wanted >= most:
        return 1.0
    assumed = replace(flight.assumptions, acceleration=0.0, jerk=0.0, snap=0.0)
    least = _tube(_with_tubes(flight, assumed), downwash).radius
    left = wanted - least - 8.0 * _GRAIN  # the figures of tubes are rounded up: not exactly on a line
    return left / (most - least) if left > 0.0 else 1.0


def least_margin(flight: FlightSection, room: InputSet, bounds: Bounds) -> float:
    """Return the margin in the room that f must keep, m/s^2, so that the section's is kept at changes of pace, too.

    Args:
        flight: the section.
        room: `FlightSection.room` of it.
        bounds: of the references; their margin does not matter.
    """
    sides, upright = (axis.design.model for axis in flight.axes)
    apart, (_, drag), (_, lead) = abs(sides.delay - upright.delay), bounds.drag, bounds.lead
    turning = abs(drag) * (bounds.acceleration_max or 0.0)  # without a bound of accelerations nothing is claimed
    moving = bounds.jerk_max + turning + lead * (bounds.snap_max + abs(drag) * bounds.jerk_max)
    radius = room.inner_radius
    return radius - (radius - flight.margin) / RESERVE + apart * moving


def require_tubes(plan: Plan, certificate: Certificate) -> None:
    """Refuse a plan whose tubes are said to be the certificate's and are not, or whose input set is another.

    Raises:
        FlatsatError: what differs is named.
    """
    plan.require_made_for(certificate)
    drones = [drone for drone in plan.drones if drone.tube.source == _CERTIFICATE]
    if not drones:
        return
    flight, bounds = certificate.flight, plan.bounds
    if flight is None:
        raise FlatsatError(
            f"plan {plan.name!r}: its tubes are those of certificate {plan.certificate!r}, but "
            f"{certificate.name!r} has no flight section, which proves tubes"
        )
    limits, least = certificate.limits, min(drone.tube.radius for drone in drones)
    held, proved = bounds.room(limits), flight
    if least < _tube(flight, plan.downwash).radius or not _holds(flight, bounds) or _beyond(held, flight.room(limits)):
        proved = _proved(flight, limits, bounds)
    room = proved.room(limits)
    for name, ours, theirs in zip(("drag", "lead"), (bounds.drag, bounds.lead), led_for(flight), strict=True):
        if ours != theirs:
            raise refusal(f"plan {plan.name!r}: {name}", ours, "", f"{theirs}, of certificate {certificate.name!r}")
    for name in _beyond(held, room):
        valid = f"{getattr(room, name):.6g}, which the certificate leaves to references"
        raise refusal(f"plan {plan.name!r}: {name}", getattr(held, name), "m/s^2", valid)
    most = flight.acceleration / RESERVE
    if math.isfinite(most) and not (bounds.acceleration_max or math.inf) <= most:
        valid = f"at most {most:g}, a tenth less than the certificate assumes"
        raise refusal(f"plan {plan.name!r}: acceleration_max", bounds.acceleration_max, "m/s^2", valid)
    require_margin(bounds, flight, room)
    tube = _tube(proved, plan.downwash)
    for drone in drones:
        if drone.tube.radius < tube.radius:
            what = f"plan {plan.name!r}: tube of {drone.name}"
            valid = f"at least {tube.radius:.4f} m, which certificate {certificate.name!r} proves for its bounds"
            raise refusal(what, drone.tube.radius, "m", valid)


def _holds(flight: FlightSection, bounds: Bounds) -> bool:
    """Tell whether the section as it is holds for references with these bounds."""
    asked, assumed = _asked(flight, bounds), flight.assumptions
    return asked.jerk <= assumed.jerk and asked.snap <= assumed.snap


def _beyond(held: InputSet, room: InputSet) -> list[str]:
    """Return the names of the thrusts that one set leaves room for and another does not."""
    beyond = {
        "thrust_max": held.thrust_max > room.thrust_max, "thrust_min": held.thrust_min < room.thrust_min,
    }  # fmt: skip
    return [name for name, is_beyond in beyond.items() if is_beyond]


def require_margin(bounds: Bounds, flight: FlightSection, room: InputSet) -> None:
    """Refuse bounds with which references keep less margin in the room than a flight section needs.

    Raises:
        FlatsatError: they do.
    """
    least = least_margin(flight, room, bounds)
    if bounds.margin < least:
        raise refusal(
            "margin", bounds.margin, "m/s^2",
            f"at least {least:.6g}, of which the certificate needs {flight.margin:g} and changes of pace the rest",
        )  # fmt: skip
