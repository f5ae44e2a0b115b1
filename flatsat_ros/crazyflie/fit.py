"""Whether a flight certificate holds for a vehicle: the plants of its proof must include the vehicle's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import is_packaged
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.crazyflie.vehicle import Dynamics, VehicleProfile

# s, from a command to the drone: the default of a controller, for computer and radio
LINK_DELAY = 0.028
# with less damping an attitude loop is no first-order lag
UNDERDAMPED = 0.75
# figures in files are rounded, relative
_ROUNDING = 1e-6


class _Figure(NamedTuple):
    """A figure of a vehicle beside what a certificate is for."""

    what: str
    value: float
    low: float
    high: float
    unit: str


def require_fit(certificate: Certificate, vehicle: VehicleProfile, link_delay: float, robot: str) -> None:
    """Refuse a certificate whose flight section is not for a vehicle.

    Args:
        certificate: any; without a flight section it fits.
        vehicle: the profile.
        link_delay: from a command to its arrival at the drone, s.
        robot: who is to fly it.

    Raises:
        FlatsatError: a figure of the vehicle is outside the intervals of the certificate; the text names it.
    """
    flight = certificate.flight
    if flight is None:
        return
    dynamics, attitude = vehicle.dynamics, vehicle.dynamics.attitude
    if flight.horizontal.box.low.frequency == 0.0 and attitude.damping < UNDERDAMPED:
        raise FlatsatError(
            f"certificate {certificate.name!r} is for attitudes without overshoot, but that of {robot}, vehicle "
            f"{vehicle.name!r}, has a damping of {attitude.damping:g}: must be at least {UNDERDAMPED}"
            + another(certificate, vehicle)
        )
    boxes = [axis.box for axis in flight.axes]
    figures = [
        *_sides(dynamics, boxes[0].low, boxes[0].high),
        *_upright(dynamics, boxes[1].low, boxes[1].high),
        *(
            _Figure(
                "a delay (dead time and link_delay)", vehicle.delay + link_delay, box.low.delay, box.high.delay, "s"
            )
            for box in boxes
        ),
    ]
    for what, value, low, high, unit in figures:
        if high == 0.0 and "drag" in what:
            continue  # the proof counts drag among the disturbances
        if not low - _ROUNDING * abs(low) <= value <= high + _ROUNDING * abs(high):
            raise FlatsatError(
                f"certificate {certificate.name!r} is not for {robot}, vehicle {vehicle.name!r}, which has {what} of "
                f"{value:.4g} {unit}".rstrip()
                + f": must be from {low:.4g} to {high:.4g} {unit}".rstrip()
                + another(certificate, vehicle)
            )


def another(certificate: Certificate, vehicle: VehicleProfile) -> str:
    """Return the end of a refusal: which certificate of the same rate is packaged for a vehicle, if any."""
    name = f"{vehicle.name}_adaptive_{round(1.0 / certificate.period)}hz"
    if name != certificate.name and is_packaged(name):
        return f"; {name} is packaged for this vehicle"
    return "; synthesize one with --flight for this vehicle"


def _sides(dynamics: Dynamics, low: Plant, high: Plant) -> Iterator[_Figure]:
    """Return the figures of x and y."""
    attitude = dynamics.attitude
    yield _Figure("an attitude gain", dynamics.attitude_gain, low.gain, high.gain, "")
    yield _Figure("a horizontal drag", dynamics.drag_xy, low.drag, high.drag, "1/s")
    if low.frequency == 0.0:
        yield _Figure("an attitude lag", attitude.mean_delay, low.lag, high.lag, "s")
        return
    tilt = -GRAVITY * dynamics.velocity_tilt  # the loop's is against the motion
    yield _Figure("a natural frequency", attitude.natural_frequency, low.frequency, high.frequency, "rad/s")
    yield _Figure("an attitude damping", attitude.damping, low.damping, high.damping, "")
    yield _Figure("a tilt against the velocity", tilt, low.tilt, high.tilt, "1/s")


def _upright(dynamics: Dynamics, low: Plant, high: Plant) -> Iterator[_Figure]:
    """Return the figures of z."""
    yield _Figure("a thrust gain", dynamics.thrust_gain, low.gain, high.gain, "")
    yield _Figure("a vertical drag", dynamics.drag_z, low.drag, high.drag, "1/s")
    for word, lag in (("rising", dynamics.thrust_lag_up), ("falling", dynamics.thrust_lag_down)):
        yield _Figure(f"a lag of {word} thrust", lag, low.lag, high.lag, "s")
