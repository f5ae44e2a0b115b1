"""Tubes that a certificate proves: how far a drone can be off a reference that keeps given bounds.

The flight section of a certificate holds for references that ask for no more than it assumes. Where a plan has wider
bounds of jerk and snap, the same proof is computed for these. A tenth is set aside for changes of pace, see `pacing`.

The margin that the proof needs is that of f (`flight.preview`), which drag and lead move away from the acceleration by
at most drag |v| + lead (|j| + drag |a|). So much more margin is asked of accelerations where references are planned,
and where a plan is taken the margin of its f is looked at.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Flight
from flatsat_ros.flight.preview import needed_margin
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.drone import Tube
from flatsat_ros.plans.pacing import EXCESS
from flatsat_ros.plans.plan import Plan

RESERVE = EXCESS  # what references ask for at a change of pace, over the bounds of the plan
_STEP = 1e4  # 1/m: radii are stated in tenths of a millimetre, rounded up
_CERTIFICATE = "certificate"
_SPEED_SHARE = 0.5  # of what the margin and the jerk leave to move with, for holding the speed against drag


class Usual(NamedTuple):
    """Bounds of references if nothing else is asked for.

    Attributes:
        margin: of accelerations in the input set, m/s^2.
        jerk: m/s^3.
        snap: m/s^4.
        acceleration: m/s^2; None for no bound beside the margin.
        speed: m/s; None for no bound.
    """

    margin: float
    jerk: float
    snap: float
    acceleration: float | None = None
    speed: float | None = None


def certified_tube(flight: Flight, limits: InputSet, jerk_max: float, snap_max: float, downwash: float) -> Tube:
    """Return the tube, in the downwash metric, of references with these bounds; a second of computation at most.

    Args:
        flight: section of the certificate.
        limits: the input set of the certificate.
        jerk_max: of the plan, m/s^3; changes of pace may ask for a tenth more.
        snap_max: likewise, m/s^4.
        downwash: heights count by its inverse.

    Raises:
        FlatsatError: nothing is proved for these bounds.
    """
    sides, upright = (axis.tube.position for axis in _proved(flight, limits, jerk_max, snap_max).axes)
    radius = math.hypot(sides, upright / downwash)
    return Tube(math.ceil(radius * _STEP) / _STEP, _CERTIFICATE)


def _proved(flight: Flight, limits: InputSet, jerk_max: float, snap_max: float) -> Flight:
    """Return the section with tubes of references with these bounds; else as `certified_tube`."""
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


def default_bounds(certificate: Certificate, speed: float | None = None) -> Usual:
    """Return what references shall keep if nothing else is asked for.

    With a flight section that is what it assumes, less what changes of pace ask for beside; without one, the margin
    alone bounds accelerations.

    Args:
        certificate: of the tubes.
        speed: that is asked for, m/s.

    Raises:
        FlatsatError: the speed leaves no acceleration.
    """
    flight = certificate.flight
    if flight is None:
        return Usual(certificate.limits.inner_radius / 2.0, 2.0, 20.0, None, speed)
    radius, assumed = flight.room(certificate.limits).inner_radius, flight.assumptions
    jerk, acceleration = assumed.jerk / RESERVE, flight.acceleration / RESERVE
    models = [axis.design.model for axis in flight.axes]
    drag, lead = max(model.drag + model.tilt for model in models), max(model.lead for model in models)
    left = (radius - flight.margin) / RESERVE - lead * (jerk + drag * (acceleration if drag else 0.0))
    if drag:
        speed = speed or _SPEED_SHARE * left / drag
        if not drag * speed < left:
            valid = f"below {left / drag:.3g}: to hold it against drag takes all that the certificate's margin leaves"
            raise refusal("speed_max", speed, "m/s", valid)
        left -= drag * speed
    bound = acceleration if math.isfinite(acceleration) else None
    return Usual(radius - left, jerk, assumed.snap / RESERVE, bound, speed)


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
    require_margin(bounds, flight)
    limits = certificate.limits
    proved = certified_tube(flight, limits, bounds.jerk_max, bounds.snap_max, plan.downwash)
    flown = _proved(flight, limits, bounds.jerk_max, bounds.snap_max)
    for drone in drones:
        if drone.tube.radius < proved.radius:
            what = f"plan {plan.name!r}: tube of {drone.name}"
            valid = f"at least {proved.radius:.4f} m, which certificate {certificate.name!r} proves for its bounds"
            raise refusal(what, drone.tube.radius, "m", valid)
        path = plan.trajectory(drone.name)
        require_acceleration(drone.name, path, flight)
        margin = needed_margin(path, limits, flown)
        if margin < flight.margin:
            what = f"margin of what the reference of {drone.name} asks the law for, with its drag and lead,"
            valid = f"at least {flight.margin:g}, which the certificate needs: take a larger margin or a smaller speed"
            raise refusal(what, round(margin, 4), "m/s^2", valid)


def require_margin(bounds: Bounds, flight: Flight) -> None:
    """Refuse bounds with which references keep less margin than a flight section assumes.

    Raises:
        FlatsatError: they do.
    """
    if bounds.margin < flight.margin:
        raise refusal("margin", bounds.margin, "m/s^2", f"at least {flight.margin:g}, which the certificate assumes")


def require_acceleration(name: str, path: Trajectory, flight: Flight) -> None:
    """Refuse a reference that accelerates more than a flight section assumes, if its drones have drag.

    Raises:
        FlatsatError: it does; the text names the drone.
    """
    asked = float(path.demand()[0].max())
    if asked > flight.acceleration:
        valid = f"at most {flight.acceleration:g}, which the certificate assumes: take a larger margin"
        raise refusal(f"acceleration of the reference of {name}", asked, "m/s^2", valid)
