"""What is asked of a flight certificate: a vehicle's plants as boxes, and assumptions about air and measurement."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, refusal, require, require_number
from flatsat_ros.base.files import located
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Plant
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.crazyflie.fit import UNDERDAMPED
from flatsat_ros.crazyflie.vehicle import VehicleProfile

# What is taken for granted without better knowledge: references like a swap of places in 4 s, poses at 100 Hz of which
# one may get lost; in still air and in gusts.
STILL = Assumptions(disturbance_rate=0.17, noise=5e-4, acceleration=0.4, jerk=0.6, snap=0.7, pose_age=0.02)
GUSTS = replace(STILL, disturbance_rate=0.5, noise=1e-3)
ASSUMED = {"still": STILL, "gusts": GUSTS}

# From a command to the drone, s: radio, computation and what is left of the attitude loop beside its mean lag.
DELAY = (0.01, 0.04)

# Relative uncertainty of what a profile says.
_LAG, _DRAG, _THRUST = 0.2, 0.1, 0.03

_INTERVALS = ("delay", "lag", "gain", "frequency", "damping")

# To this speed, m/s, references shall be able to change with all the acceleration that is assumed.
_SPEED = 1.0


@dataclass(frozen=True)
class Plants:
    """The plants that the controller's axes fly.

    Attributes:
        box: all of them.
        lag_varies: whether their lag changes in flight.
        model: of the profile, with a gain of 1; the search moves its delay, lag, frequency and damping.
    """

    box: PlantBox
    lag_varies: bool
    model: Plant


def sides(vehicle: VehicleProfile, intervals: dict[str, tuple[float, float]]) -> Plants:
    """Return the plants of x and of y.

    Args:
        vehicle: the profile.
        intervals: of figures of `Plant` that are known better than by the profile.
    """
    dynamics, known = vehicle.dynamics, vehicle.intervals
    attitude = dynamics.attitude
    found = {"delay": DELAY, "drag": _around(dynamics.drag_xy, _DRAG), "gain": (dynamics.attitude_gain,) * 2}
    second = attitude.damping < UNDERDAMPED
    if second:
        found |= {"frequency": (attitude.natural_frequency,) * 2, "damping": (attitude.damping,) * 2}
        lean = known.velocity_tilt if known is not None and known.velocity_tilt else (dynamics.velocity_tilt,) * 2
        found["tilt"] = -GRAVITY * lean[1], -GRAVITY * lean[0]  # the loop's tilt is against the motion
    else:
        found["lag"] = _around(attitude.mean_delay, _LAG)
    if known is not None:
        names = {"frequency": "natural_frequency", "damping": "damping", "gain": "attitude_gain", "drag": "drag_xy"}
        found |= {name: getattr(known, other) or found[name] for name, other in names.items() if name in found}
    return _plants(found | {name: value for name, value in intervals.items() if name in found}, False)


def upright(vehicle: VehicleProfile, intervals: dict[str, tuple[float, float]]) -> Plants:
    """Return the plants of z; the arguments are those of `sides`, of which only the delay matters."""
    dynamics, known = vehicle.dynamics, vehicle.intervals
    lags = sorted((dynamics.thrust_lag_up, dynamics.thrust_lag_down))
    found = {
        "delay": intervals.get("delay", DELAY),
        "lag": (known.thrust_lag if known is not None else None) or (lags[0], lags[1]),
        "gain": _around(dynamics.thrust_gain, _THRUST),
        "drag": _around(dynamics.drag_z, _DRAG),
    }
    return _plants(found, lags[0] < lags[1])


def asked_for(assumptions: Assumptions, *models: Plant) -> float:
    """Return what references ask the law for where they accelerate most, half-way to full speed, m/s^2.

    Args:
        assumptions: about references.
        models: whose drag is led for.
    """
    return max(
        (model.drag + model.tilt) * (_SPEED / 2.0 + model.lead * assumptions.acceleration) + assumptions.acceleration
        for model in models
    )


def _around(value: float, share: float) -> tuple[float, float]:
    return value * (1.0 - share), value * (1.0 + share)


def _plants(found: dict[str, tuple[float, float]], lag_varies: bool) -> Plants:
    low, high = (Plant(**{name: ends[i] for name, ends in found.items()}) for i in (0, 1))
    middle = {name: (ends[0] + ends[1]) / 2.0 for name, ends in found.items() if name != "gain"}
    return Plants(PlantBox(low, high), lag_varies, Plant(**middle))


def assumed(name_or_path: str) -> tuple[Assumptions, dict[str, tuple[float, float]]]:
    """Return assumptions and intervals of plants: "still", "gusts", or what a YAML file says.

    A file has fields of `Assumptions`, those that it lacks are those of "still", and, where they are known, intervals
    `delay`, `lag`, `gain`, `frequency` and `damping`, lists of two numbers. `validate --write` makes such files.

    Raises:
        FlatsatError: the file cannot be read, a key is unknown or missing, or a value is out of its bounds.
    """
    if name_or_path in ASSUMED:
        return ASSUMED[name_or_path], {}
    document = read_yaml(name_or_path)
    try:
        return _assumptions(document)
    except FlatsatError as error:
        raise located(name_or_path, error) from error


def _assumptions(document: Any) -> tuple[Assumptions, dict[str, tuple[float, float]]]:
    names = tuple(field.name for field in fields(Assumptions))
    if not isinstance(document, dict):
        raise refusal("assumptions", document, "", f"a mapping with keys of {', '.join((*names, *_INTERVALS))}")
    given = tuple(name for name in _INTERVALS if name in document)
    kept = tuple(name for name in names if name in document)
    unknown = [name for name in document if name not in (*given, *kept)]
    if unknown:
        raise refusal("assumptions: key", unknown[0], "", f"one of {', '.join((*names, *_INTERVALS))}")
    values = document
    intervals = {}
    for name in given:
        ends = values[name]
        if not isinstance(ends, list) or len(ends) != 2:
            raise refusal(name, ends, "", "a list of two numbers")
        low, high = (require_number(name, end, "", least=0.0) for end in ends)
        require(low <= high, name, ends, "", "an interval, the smaller end first")
        intervals[name] = low, high
    return replace(STILL, **{name: values[name] for name in kept}), intervals
