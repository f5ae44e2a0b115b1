"""What an ordinary flight is made of: certificate, drones, air, motion capture and start, drawn from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate, load_certificate
from flatsat_ros.crazyflie.fit import require_fit
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.flight.policy import Policy
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.power import Battery
from flatsat_ros.sim.sensor import NOISE_BOUND, MotionCapture

_OWN = ("brushless", "cf21", "cf21_plus", "cf2x_2025", "thrust_kit")
# packaged certificates with a flight section, and the profile that each is for
CERTIFICATES = {
    **{f"{name}_{kind}_{rate}hz": name for name in _OWN for kind in ("adaptive", "tight") for rate in (50, 100)},
    "cf21_flight_50hz": "cf21",
    "cf21_soft_50hz": "cf21",
    "cf21_tight_10hz": "cf21",
    "cf21_markers_light_soft_50hz": "cf21_markers_light",
}
_MOST_DRONES = 6
_THRUST = 0.1  # of the thrust that a profile promises, missing or too much
_NOISE = 5e-4  # m, largest standard deviation of poses
_GUST, _WIND = 1.0, 1.5  # m/s, largest
_TABLE, _ALOFT = (0.2, 0.8), (0.6, 1.5)  # m, heights of a table, and of a drone that somebody else flies
_SECONDS = 40.0, 120.0
_NEIGHBOURS = 1.25  # m, between neighbours on the circle on which drones start
_BATTERY = Battery(voltage=4.1, sag=0.3, drain=0.001)  # V, V and V/s: 3.7 V are left at the end


class Start(Enum):
    """Where drones begin; the value is what people read."""

    FLOOR = "floor"
    TABLE = "table"
    AIR = "air"


@dataclass(frozen=True, eq=False)
class Drawn:
    """What was drawn.

    Attributes:
        seed: of all that is random.
        certificate: that is flown.
        vehicle: the drones: a profile moved inside the intervals of the certificate.
        delay: of the link, s, inside them as well.
        places: (N, 3) at the beginning, m.
        yaw: (N,) at the beginning, rad.
        start: where that is.
        floor: height of what the drones stand on first, m.
        thrust_scale: (N,) actual thrust over that of the profile.
        capture: motion capture.
        wind: the air.
        battery: of each drone.
        seconds: for which the drones are given something to do.
    """

    seed: int
    certificate: Certificate
    vehicle: VehicleProfile
    delay: float
    places: FloatArray
    yaw: FloatArray
    start: Start
    floor: float
    thrust_scale: FloatArray
    capture: MotionCapture
    wind: Wind
    battery: Battery
    seconds: float

    @property
    def blows(self) -> bool:
        """The air moves."""
        return self.wind.gust > 0.0 or any(self.wind.mean)

    @property
    def disturbs(self) -> bool:
        """The air moves more than the certificate assumes, as far as estimates tell: wind pushes, or gusts change."""
        flight, dynamics = self.certificate.flight, self.vehicle.dynamics
        assert flight is not None
        axis = flight.horizontal
        speed = float(np.hypot(*self.wind.mean[:2])) + (0.0 if axis.design.model.drag else Policy.speed_max)
        push = dynamics.drag_xy * speed / dynamics.attitude_gain
        return self.wind.gust > 0.0 or (self.blows and push + axis.tube.disturbance > flight.disturbance)

    @property
    def is_noisy(self) -> bool:
        """Poses may be farther from the truth than the certificate assumes."""
        flight = self.certificate.flight
        return flight is not None and NOISE_BOUND * self.capture.noise > flight.assumptions.noise

    def __str__(self) -> str:
        """Return it in a line."""
        mean, gust = np.hypot(*self.wind.mean[:2]), self.wind.gust
        air = f"wind {mean:.2f} m/s" if mean else f"gusts {gust:.2f} m/s" if gust else "still"
        thrust = ", ".join(f"{scale:.2f}" for scale in self.thrust_scale)
        poses = f"poses {self.capture.rate:g} Hz {1e3 * self.capture.noise:.2f} mm"
        return (
            f"{self.certificate.name}, {air}, {poses}, delay {1e3 * (self.delay + self.vehicle.delay):.0f} ms, "
            f"{self.start.value}, {len(self.places)} drones, thrust {thrust}"
        )


def drawn(seed: int, certificates: Sequence[str] = tuple(CERTIFICATES)) -> Drawn:
    """Draw a flight, with one of the packaged certificates."""
    random = np.random.default_rng(seed)
    name = str(random.choice(list(certificates)))
    certificate = load_certificate(name)
    vehicle, delay = _moved(certificate, load_vehicle(CERTIFICATES[name]), random)
    count = int(random.integers(1, _MOST_DRONES + 1))
    start = list(Start)[int(random.choice(3, p=(0.5, 0.25, 0.25)))]
    floor = float(random.uniform(*_TABLE)) if start is Start.TABLE else 0.0
    height = float(random.uniform(*_ALOFT)) if start is Start.AIR else floor
    air = int(random.integers(3))
    heading = float(random.uniform(-np.pi, np.pi))
    speed = float(random.uniform(0.0, _WIND))
    winds = (
        Wind(),
        Wind(gust=float(random.uniform(0.0, _GUST)), gust_time=float(random.uniform(0.5, 2.0))),
        Wind(mean=(speed * float(np.cos(heading)), speed * float(np.sin(heading)), 0.0)),
    )
    rate = max(1.0 / certificate.period, float(random.choice([1.0 / certificate.period, 100.0])))
    return Drawn(
        seed=seed,
        certificate=certificate,
        vehicle=vehicle,
        delay=delay,
        places=circle(count) + (0.0, 0.0, height),
        yaw=random.uniform(-np.pi, np.pi, count),
        start=start,
        floor=floor,
        thrust_scale=1.0 + random.uniform(-_THRUST, _THRUST, count),
        capture=MotionCapture(rate=rate, noise=float(random.choice([1e-4, random.uniform(0.0, _NOISE)]))),
        wind=winds[air],
        battery=Battery() if random.random() < 0.5 else _BATTERY,
        seconds=float(random.uniform(*_SECONDS)),
    )


def circle(count: int) -> FloatArray:
    """Return (N, 3) places on the floor from each of which a path leads to the next one without meeting another, m."""
    corners = max(count, 3)
    angle = 2.0 * np.pi * np.arange(count) / corners
    radius = _NEIGHBOURS / (2.0 * np.sin(np.pi / corners))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)], axis=1)


def _moved(
    certificate: Certificate, nominal: VehicleProfile, random: np.random.Generator
) -> tuple[VehicleProfile, float]:
    """Return a vehicle with figures anywhere in the intervals of a certificate, and a delay of the link, s."""
    assert certificate.flight is not None
    sides, upright = (axis.box for axis in certificate.flight.axes)
    dynamics, attitude = nominal.dynamics, nominal.dynamics.attitude

    def between(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    if sides.low.frequency == 0.0:
        slower = between(sides.low.lag, sides.high.lag) / attitude.mean_delay
        attitude = replace(
            attitude,
            natural_frequency=attitude.natural_frequency / slower,
            actuator_lag=attitude.actuator_lag * slower,
        )
    tilt = dynamics.velocity_tilt
    if sides.low.tilt < sides.high.tilt:
        tilt = -between(sides.low.tilt, sides.high.tilt) / GRAVITY
    vehicle = replace(
        nominal,
        intervals=None,
        dynamics=replace(
            dynamics,
            attitude=attitude,
            velocity_tilt=tilt,
            attitude_gain=between(sides.low.gain, sides.high.gain),
            thrust_gain=between(upright.low.gain, upright.high.gain),
            thrust_lag_up=between(upright.low.lag, upright.high.lag),
            thrust_lag_down=between(upright.low.lag, upright.high.lag),
            drag_xy=between(sides.low.drag, sides.high.drag) if sides.high.drag else dynamics.drag_xy,
        ),
    )
    least, most = max(sides.low.delay, upright.low.delay), min(sides.high.delay, upright.high.delay)
    delay = between(least, most) - vehicle.delay
    require_fit(certificate, vehicle, delay, "a drone that was drawn")
    return vehicle, delay
