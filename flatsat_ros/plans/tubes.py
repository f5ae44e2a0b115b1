"""Tubes that a certificate proves: how far a drone can be off a reference that keeps given bounds.

The flight section of a certificate holds for references that ask for no more than it assumes. Where a plan has wider
bounds of jerk and snap, the same proof is computed for these. A tenth is set aside for changes of pace, see `pacing`.
"""

from __future__ import annotations

import math
from dataclasses import replace

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight import Flight
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.plans.bounds import Bounds
from flatsat_ros.plans.drone import Tube
from flatsat_ros.plans.pacing import EXCESS
from flatsat_ros.plans.plan import Plan

RESERVE = EXCESS  # what references ask for at a change of pace, over the bounds of the plan
_STEP = 1e4  # 1/m: radii are stated in tenths of a millimetre, rounded up
_CERTIFICATE = "certificate"


def certified_tube(flight: Flight, jerk_max: float, snap_max: float, downwash: float) -> Tube:
    """Return the tube, in the downwash metric, of references with these bounds; a second of computation at most.

    Args:
        flight: section of the certificate.
        jerk_max: of the plan, m/s^3; changes of pace may ask for a tenth more.
        snap_max: likewise, m/s^4.
        downwash: heights count by its inverse.

    Raises:
        FlatsatError: nothing is proved for these bounds.
    """
    jerk, snap = RESERVE * jerk_max, RESERVE * snap_max
    assumed = flight.assumptions
    if jerk <= assumed.jerk and snap <= assumed.snap:
        sides, upright = (axis.tube.position for axis in flight.axes)
    else:
        asked = replace(assumed, jerk=jerk, snap=snap)
        tubes = [axis.proved(flight.gain_min, flight.gain_max, asked) for axis in flight.axes]
        sides, upright = (tube.position for tube in tubes)
        estimate = flight.disturbance + math.hypot(*(tube.disturbance for tube in tubes))
        taken = math.hypot(*(tube.nominal for tube in tubes)) + estimate
        if not taken <= flight.margin:  # every applied gain is at least 1, see `Flight.margins`
            valid = "less: what the loop needs for it is more than the certificate's margin of "
            raise refusal(
                f"jerk_max {jerk_max:g} m/s^3, snap_max {snap_max:g} m/s^4: need", round(taken, 3), "m/s^2",
                f"{valid}{flight.margin:g} m/s^2",
            )  # fmt: skip
    radius = math.hypot(sides, upright / downwash)
    return Tube(math.ceil(radius * _STEP) / _STEP, _CERTIFICATE)


def default_bounds(certificate: Certificate) -> tuple[float, float, float, float | None]:
    """Return margin, jerk, snap and acceleration that references shall keep if nothing else is asked for.

    With a flight section they are what it assumes, less what changes of pace ask for beside; without one, the margin
    alone bounds accelerations. In m/s^2, m/s^3, m/s^4 and m/s^2.
    """
    radius, flight = certificate.limits.inner_radius, certificate.flight
    if flight is None:
        return radius / 2.0, 2.0, 20.0, None
    margin = radius - (radius - flight.margin) / RESERVE
    assumed, acceleration = flight.assumptions, flight.acceleration / RESERVE
    bound = acceleration if math.isfinite(acceleration) else None
    return margin, assumed.jerk / RESERVE, assumed.snap / RESERVE, bound


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
    proved = certified_tube(flight, bounds.jerk_max, bounds.snap_max, plan.downwash)
    for drone in drones:
        if drone.tube.radius < proved.radius:
            what = f"plan {plan.name!r}: tube of {drone.name}"
            valid = f"at least {proved.radius:.4f} m, which certificate {certificate.name!r} proves for its bounds"
            raise refusal(what, drone.tube.radius, "m", valid)
        require_acceleration(drone.name, plan.trajectory(drone.name), flight)


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
