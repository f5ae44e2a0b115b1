"""Tubes that a certificate proves: how far a drone can be off a reference that keeps given bounds.

The flight section of a certificate holds for references that ask for no more than it assumes. Where a plan has wider
bounds of jerk and snap, the same proof is computed for these. A tenth is set aside for changes of pace, see `pacing`.

The margin that the proof needs is that of f (`plans.bounds`), for the models that the controller leads references
for. Of it, too, a tenth of what may be asked for is set aside, and where the models' delays differ what the vertical
part of f can have moved in between.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Flight
from flatsat_ros.flight.preview import led_for
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.drone import Tube
from flatsat_ros.plans.pacing import EXCESS
from flatsat_ros.plans.plan import Plan

RESERVE = EXCESS  # what references ask for at a change of pace, over the bounds of the plan
_STEP = 1e4  # 1/m: radii are stated in tenths of a millimetre, rounded up
_CERTIFICATE = "certificate"
_JERK, _SNAP, _TUBE = 2.0, 20.0, 0.05  # m/s^3, m/s^4, m, where nothing is proved


class Promise(NamedTuple):
    """What references keep, and the tube that goes with it.

    Attributes:
        bounds: of the references.
        tube: of each drone.
    """

    bounds: Bounds
    tube: Tube


def _tube(proved: Flight, downwash: float) -> Tube:
    """Return the tube of a section in the downwash metric."""
    sides, upright = (axis.tube.position for axis in proved.axes)
    radius = math.hypot(sides, upright / downwash)
    return Tube(math.ceil(radius * _STEP) / _STEP, _CERTIFICATE)


def _proved(flight: Flight, limits: InputSet, jerk_max: float, snap_max: float) -> Flight:
    """Return the section with tubes of references with these bounds; a second of computation at most.

    Raises:
        FlatsatError: nothing is proved for them.
    """
    jerk, snap = RESERVE * jerk_max, RESERVE * snap_max
    assumed = flight.assumptions
    if jerk <= assumed.jerk and snap <= assumed.snap:
        return flight
    asked = replace(assumed, jerk=jerk, snap=snap)
    axes = [replace(axis, tube=axis.proved(flight.gain_min, flight.gain_max, asked)) for axis in flight.axes]
    found = replace(flight, assumptions=asked, horizontal=axes[0], vertical=axes[1])
    bounded = all(math.isfinite(axis.tube.nominal) for axis in axes)
    need = float(found.taken(limits).tilt_max) if bounded else math.inf
    if not need <= flight.margin or min(found.left(limits)) <= 0:  # every applied gain is at least 1, see `margins`
        valid = "less: what the loop needs for it is more than the certificate's margin of "
        raise refusal(
            f"jerk_max {jerk_max:g} m/s^3, snap_max {snap_max:g} m/s^4: need", round(need, 3), "m/s^2",
            f"{valid}{flight.margin:g} m/s^2",
        )  # fmt: skip
    return found


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
) -> Promise:
    """Return what references shall keep, and the tube that the certificate proves for it.

    Args:
        certificate: of the tubes.
        lower: (3,) m, corner of the box of the references.
        upper: (3,) m, the other one.
        downwash: heights count by its inverse.
        tube: radius, m, that the user states: nothing is assumed for it, nor proved. None for what is proved, or 0.05
            without a flight section.
        margin: m/s^2; None for what the flight section needs, or half the radius of the ball around hover.
        jerk_max: m/s^3; None for what it assumes, or 2.
        snap_max: m/s^4; None for what it assumes, or 20.
        speed_max: m/s; None for no bound.

    Raises:
        FlatsatError: nothing is proved for these bounds.
    """
    flight, limits = certificate.flight, certificate.limits
    usual = (limits.inner_radius / 2.0, _JERK, _SNAP)
    if flight is not None:
        assumed = flight.assumptions
        usual = (limits.inner_radius / 2.0, assumed.jerk / RESERVE, assumed.snap / RESERVE)
    wanted = zip(usual, (margin, jerk_max, snap_max), strict=True)
    figures = [own if given is None else given for own, given in wanted]
    bounds = Bounds(figures[0], figures[1], figures[2], np.asarray(lower), np.asarray(upper), speed_max)
    if flight is None:
        return Promise(bounds, Tube(_TUBE if tube is None else tube))
    drag, lead = led_for(flight)
    bounds, room = replace(bounds, drag=drag, lead=lead), limits
    if tube is None:
        proved = _proved(flight, limits, bounds.jerk_max, bounds.snap_max)
        room, most = proved.room(limits), flight.acceleration / RESERVE
        bounds = replace(
            bounds, acceleration_max=most if math.isfinite(most) else None, thrust_max=room.thrust_max,
            thrust_min=room.thrust_min,
        )  # fmt: skip
    least = least_margin(flight, room, bounds)
    bounds = replace(bounds, margin=least if margin is None else margin)
    if tube is not None:
        return Promise(bounds, Tube(tube))
    require_margin(bounds, flight, room)
    return Promise(bounds, _tube(proved, downwash))


def least_margin(flight: Flight, room: InputSet, bounds: Bounds) -> float:
    """Return the margin in the room that f must keep, m/s^2, so that the section's is kept at changes of pace, too.

    Args:
        flight: the section.
        room: `Flight.room` of it.
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
    limits = certificate.limits
    proved = _proved(flight, limits, bounds.jerk_max, bounds.snap_max)
    room = proved.room(limits)
    for name, ours, theirs in zip(("drag", "lead"), (bounds.drag, bounds.lead), led_for(flight), strict=True):
        if ours != theirs:
            raise refusal(f"plan {plan.name!r}: {name}", ours, "", f"{theirs}, of certificate {certificate.name!r}")
    held = bounds.room(limits)
    for name, beyond in (
        ("thrust_max", held.thrust_max > room.thrust_max), ("thrust_min", held.thrust_min < room.thrust_min),
    ):  # fmt: skip
        if beyond:
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


def require_margin(bounds: Bounds, flight: Flight, room: InputSet) -> None:
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
