"""A drone as its flights show it: each figure with an interval, what cannot be told, and the vehicle profile of it.

The interval of a figure is for other flights of the same drone. From the estimates x_i of n flights, each fitted alone,
with standard deviation s it is x +- t S sqrt(1 + 1/n), where S^2 = (4 S0^2 + (n - 1) s^2) / (n + 3) takes the usual
spread S0 of flights of one drone for four more flights, and t is the 97.5 % point of Student's distribution for n + 3
degrees of freedom. Few flights, often of one hour, are more alike than others are: S0 is what 48 flights of a
Crazyflie 2.1 over several days had. For the natural frequency it is small where a flight tells it sharply, and large
where it does not, since there it trades with the delay, which differs from log to log where clocks do. Delay and
available thrust come from the common fit, which has one of each for each flight. The interval is at least 2.2 standard
deviations of the common fit, and what the method resolves.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError, require
from flatsat_ros.crazyflie.intervals import Intervals
from flatsat_ros.crazyflie.vehicle import PWM_FULL, VehicleProfile
from flatsat_ros.identification.fit import BLOCK, BOUNDS, Fit, excited, fit
from flatsat_ros.identification.residuals import EVERY, REACH, ComparedFlight
from flatsat_ros.identification.response import Figures
from flatsat_ros.identification.screening import STEP, Samples

_DEVIATIONS = 2.2  # standard deviations of the common fit in an interval: 95 % for 25 blocks
# the largest standard deviation up to which a flight or a fit counts as telling a figure: a share of it, or in its unit
_SHARES = {"attitude_gain": 0.1, "natural_frequency": 0.25, "damping": 0.25, "thrust_lag": 0.35}
_WIDTHS = {
    **{"lag_and_delay": 0.02, "velocity_tilt": 0.02, "thrust_slope": 0.15, "drag_xy": 0.12, "drag_z": 0.12},
    **{"thrust_voltage": 0.2, "thrust_available": 0.3},
}
NAMES = (*_SHARES, *_WIDTHS)
# the usual standard deviation between flights of one drone, likewise; _WEIGHT is how many flights it counts for
_USUAL = {
    **{"attitude_gain": 0.05, "natural_frequency": 0.15, "damping": 0.15, "lag_and_delay": 0.02, "thrust_lag": 0.35},
    **{"velocity_tilt": 0.01, "thrust_slope": 0.15, "drag_xy": 0.04, "drag_z": 0.1, "thrust_available": 0.2},
    **{"thrust_voltage": 0.35},
}
_WEIGHT = 4
_TRADED = 4.0  # standard deviations of a flight's own natural frequency that it may be off beside, the delay with it
# what the method resolves, likewise: rows of 10 ms, a second-order attitude, one thrust lag for up and down
_RESOLVED = {
    **{"attitude_gain": 0.01, "natural_frequency": 0.08, "damping": 0.08, "lag_and_delay": 0.005, "thrust_lag": 0.1},
    **{"velocity_tilt": 0.002, "thrust_slope": 0.02, "drag_xy": 0.03, "drag_z": 0.03, "thrust_available": 0.1},
    **{"thrust_voltage": 0.05},
}


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        value: of the common fit, in the unit of `Intervals`.
        interval: for other flights of the same drone; None: not known.
        flights: number of flights that tell it, each for itself.
        estimates: theirs, one for each flight, NaN for those that do not tell it.
    """

    value: float
    interval: tuple[float, float] | None
    flights: int
    estimates: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Identified:
    """What the flights of one drone tell.

    Attributes:
        flights: as they were compared.
        common: the fit to all.
        figures: by the names of `Intervals`; one whose interval is None keeps the value of the base profile.
        noise: (K, 3) of measured positions, as in `Samples`.
        pose_noise: standard deviation of a measured coordinate, m, the largest of the flights.
    """

    flights: tuple[ComparedFlight, ...]
    common: Fit
    figures: Mapping[str, Figure]
    noise: FloatArray
    pose_noise: float

    @property
    def voltage(self) -> float | None:
        """Mean voltage of the battery, V, for which the thrust is meant; None where thrust over voltage is not told."""
        if self.figures["thrust_voltage"].interval is None:
            return None
        logged = [each.motion.samples.mean_voltage for each in self.flights]
        return float(np.nanmean(logged))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the figures that the flights do not tell."""
        return tuple(name for name, figure in self.figures.items() if figure.interval is None)


def identify(
    samples: Sequence[Samples], base: VehicleProfile, advance: Callable[[str], None] = lambda _: None
) -> Identified:
    """Find the figures of a drone from its flights.

    Args:
        samples: of flights of the same drone.
        base: profile of its kind: where to start, and what the flights do not tell.
        advance: told what is done next; called 4 + len(samples) times.

    Raises:
        FlatsatError: a flight is there twice, or too short to be compared.
    """
    _require_different(samples)
    flights = [ComparedFlight.of(each) for each in samples]
    free, begin = excited(flights), profile_figures(base)
    common = fit(flights, begin, free, advance=lambda: advance("fitting all flights"))
    told = [name for name in free if name not in NAMES or _is_sharp(name, common, base.pwm_max)]
    if len(told) < len(free):  # what the flights do not tell must not bend the rest
        common = fit(flights, begin, told, starts=1)
    free = tuple(told)
    alone = []
    for flight in flights:
        advance(f"fitting {flight.motion.samples.name} alone")
        alone.append(fit([flight], common.figures, [name for name in excited([flight]) if name in free], starts=1))
    figures = {name: _figure(name, common, alone, base.pwm_max) for name in NAMES}
    noise = np.concatenate([each.noise for each in samples])
    return Identified(tuple(flights), common, figures, noise, max(each.pose_noise for each in samples))


def profile_of(identified: Identified, base: VehicleProfile, name: str) -> VehicleProfile:
    """Return the profile of the drone: the base with what the flights tell.

    A log tells force over mass, not both: the mass is the base's and the force is that of such a mass. One lag serves
    rising and falling thrust. The delay on board stays the base's: a log tells only its sum with lag and clocks.

    Raises:
        FlatsatError: at the largest thrust command the drone does not lift itself.
    """
    value = {key: figure.value for key, figure in identified.figures.items() if figure.interval is not None}
    dynamics, attitude = base.dynamics, base.dynamics.attitude
    if "natural_frequency" in value and "damping" in value:
        attitude = dataclasses.replace(
            attitude,
            natural_frequency=value["natural_frequency"],
            damping=value["damping"],
            actuator_lag=0.0,
            integral_zero=0.0,
            integral_pole=0.0,
        )
    lag = value.get("thrust_lag")
    dynamics = dataclasses.replace(
        dynamics,
        attitude=attitude,
        attitude_gain=value.get("attitude_gain", dynamics.attitude_gain),
        thrust_gain=1.0,
        thrust_lag_up=lag or dynamics.thrust_lag_up,
        thrust_lag_down=lag or dynamics.thrust_lag_down,
        drag_xy=max(value.get("drag_xy", dynamics.drag_xy), 0.0),
        drag_z=max(value.get("drag_z", dynamics.drag_z), 0.0),
        velocity_tilt=value.get("velocity_tilt", dynamics.velocity_tilt),
    )
    slope, available = identified.common.figures.thrust_slope, identified.figures["thrust_available"].value
    full = available * (PWM_FULL / base.pwm_max) ** slope
    intervals = {key: figure.interval for key, figure in identified.figures.items()}
    try:
        return dataclasses.replace(
            base,
            name=name,
            force_max=base.mass * full,
            thrust_slope=slope,
            thrust_voltage=value.get("thrust_voltage", base.thrust_voltage),
            voltage=base.voltage if identified.voltage is None else identified.voltage,
            dynamics=dynamics,
            intervals=Intervals(**intervals),
        )
    except FlatsatError as error:
        raise FlatsatError(f"the drone of these flights makes no profile: {error}") from error


def profile_figures(base: VehicleProfile) -> Figures:
    """Return the figures of a profile, its attitude as of second order."""
    dynamics = base.dynamics
    return Figures(
        attitude_gain=dynamics.attitude_gain,
        natural_frequency=dynamics.attitude.natural_frequency,
        damping=dynamics.attitude.damping,
        velocity_tilt=dynamics.velocity_tilt,
        thrust_slope=base.thrust_slope,
        thrust_lag=0.5 * (dynamics.thrust_lag_up + dynamics.thrust_lag_down),
        drag_xy=dynamics.drag_xy,
        drag_z=dynamics.drag_z,
        delay=dynamics.dead_time,
        thrust_voltage=base.thrust_voltage,
    )


def _figure(name: str, common: Fit, alone: Sequence[Fit], pwm_max: float) -> Figure:
    """Return one figure with its interval."""
    value = estimate(name, common, pwm_max)
    estimates = _estimates(name, common, alone, pwm_max)
    if not telling(name, common, pwm_max):
        return Figure(value, None, 0, estimates)
    relative = name in _SHARES
    width = max(_RESOLVED[name], _DEVIATIONS * _deviation(name, common, pwm_max) / (value if relative else 1.0))
    found = np.array([each for each in estimates if not math.isnan(each)])
    usual = _USUAL[name]
    if name == "natural_frequency":
        own = [_deviation(name, each, pwm_max) / estimate(name, each, pwm_max) for each in alone]
        usual = math.hypot(usual, _TRADED * float(np.median(own)))
    width = max(width, width_between(np.log(found) if relative else found, usual))
    ends = (value * math.exp(-width), value * math.exp(width)) if relative else (value - width, value + width)
    least, most, _ = BOUNDS.get(name, (0.0, math.inf, 0.0))
    return Figure(value, (max(ends[0], least), min(ends[1], most)), len(found), estimates)


def width_between(found: FloatArray, usual: float) -> float:
    """Return half of the interval for another flight, about the mean of flights.

    Args:
        found: (n,) what each of them tells.
        usual: standard deviation between flights of one drone, S0.
    """
    count = max(len(found), 1)
    spread = float(np.var(found, ddof=1)) if count > 1 else 0.0
    freedom = _WEIGHT + count - 1
    pooled = math.sqrt((_WEIGHT * usual**2 + (count - 1) * spread) / freedom)
    return float(student.ppf(0.975, freedom)) * pooled * math.sqrt(1.0 + 1.0 / count)


def _estimates(name: str, common: Fit, alone: Sequence[Fit], pwm_max: float) -> tuple[float, ...]:
    """Return what each flight tells, NaN for nothing; delay and thrust differ from flight to flight in any fit."""
    if name == "lag_and_delay" and "delay" in common.free:
        return tuple(common.of(k).lag_and_delay for k in range(len(alone)))
    if name == "thrust_available":
        ratio = (pwm_max / PWM_FULL) ** common.figures.thrust_slope
        return tuple(each.thrust_full * ratio for each in common.misfits)
    return tuple(estimate(name, each, pwm_max) if telling(name, each, pwm_max) else math.nan for each in alone)


def estimate(name: str, found: Fit, pwm_max: float) -> float:
    """Return a figure of a fit, by its name in `Intervals`."""
    if name == "thrust_available":
        full = float(np.mean([each.thrust_full for each in found.misfits]))
        return float(full * (pwm_max / PWM_FULL) ** found.figures.thrust_slope)
    return float(getattr(found.figures, name))


def _deviation(name: str, found: Fit, pwm_max: float) -> float:
    """Return the standard deviation of a figure of a fit."""
    if name == "lag_and_delay":
        wn, zeta = found.figures.natural_frequency, found.figures.damping
        return found.deviation({"damping": 2.0 / wn, "natural_frequency": -2.0 * zeta / wn**2, "delay": 1.0})
    if name == "thrust_available":
        # at the thrust flown it is the scatter of the residuals, farther up that of the slope, too
        held = [each.position[:, 2] / (REACH * STEP) ** 2 for each in found.misfits]
        count = sum(max(len(each) * EVERY * STEP / BLOCK, 1.0) for each in held)
        flown = float(np.std(np.concatenate(held))) / math.sqrt(count)
        value = estimate(name, found, pwm_max)
        away = math.log(max(value / GRAVITY, 1e-3)) / found.figures.thrust_slope
        return math.hypot(flown, found.deviation({"thrust_slope": value * away}))
    return found.deviation({name: 1.0})


def telling(name: str, found: Fit, pwm_max: float) -> bool:
    """Tell whether a fit tells a figure: it was free, inside its bounds, and is known well enough."""
    value = estimate(name, found, pwm_max)
    free = name == "thrust_available" or ("delay" if name == "lag_and_delay" else name) in found.free
    if free and name in BOUNDS:
        least, most, step = BOUNDS[name]
        free = least + 0.01 * step < value < most - 0.01 * step
    return free and _is_sharp(name, found, pwm_max)


def _is_sharp(name: str, found: Fit, pwm_max: float) -> bool:
    """Tell whether the residuals of a fit leave little doubt about a figure."""
    limit = _SHARES[name] * estimate(name, found, pwm_max) if name in _SHARES else _WIDTHS[name]
    return _deviation(name, found, pwm_max) <= limit


def _require_different(samples: Sequence[Samples]) -> None:
    """Refuse a flight that is there twice, under whatever name."""
    seen: dict[bytes, str] = {}
    for each in samples:
        key = each.position[each.usable][:500].tobytes()
        require(key not in seen, "log", each.name, "", f"a flight of its own: it has the poses of {seen.get(key)}")
        seen[key] = each.name
