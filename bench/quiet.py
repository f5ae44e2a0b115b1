"""How quiet drones stand once they have come to rest, over delays, kinds of drones and adaptation rates.

For each delay and vehicle profile the controller of the default flight certificate is made for that drone: its model is
the profile's, its horizon the delay. The same for attitude loops of second order as identified from real flights, with
the soft gains of a drone that nobody has identified. Nothing is proved here; what is looked at is whether a drone in
the identified simulation, which is no linear plant, swings.

    .venv/bin/python bench/quiet.py [--loops | --unidentified | --swaps | --packaged] [--delays MS ...]

Each flight: up, half a metre aside, ten seconds to settle; then for four seconds commands are taken, peak to peak, the
larger of roll and pitch, and distances to the reference. A profile that lifts less than 1.05 g is flown with so much.
With --loops the 72 loops of second order, with --unidentified the same with the packaged certificate of soft gains,
which says nothing of them; with --swaps they do not go aside, but three of each swap places, in legs of four seconds.
With --packaged the default flight certificate as it is, whose delays end
at some: how long after the motion began is it told that its tube is not claimed?
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.certificate.flight import Axis
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import AxisTube
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle
from flatsat_ros.demo.scenario import LEG_TIME, PAPER_WAYPOINTS
from flatsat_ros.flight.defaults import MU
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.gain import Tuning
from flatsat_ros.planning.spline import gentle_spline_through
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture
from flatsat_ros.synthesis.flight_design import ideal_block
from flatsat_ros.synthesis.flight_search import observer
from flatsat_ros.synthesis.flight_wishes import Plants, sides, upright

PROFILES = ("cf21", "cf21_plus", "cf21_markers", "cf2x_2025", "brushless", "thrust_kit")
DELAYS = (0, 10, 20, 30, 40, 50, 60)  # ms
RATES = (0.0, 1.0, 2.0, 5.0)  # mu
SWING_TARGET, AWAY_TARGET = 4.0, 0.01  # deg peak to peak, m
SWAP_TARGET = 0.06  # m, on the way

_NOISE = 5e-4  # m
_CLIMB, _SETTLE, _LOOK = 8.0, 10.0, 4.0  # s
_LEAST_THRUST = 1.05  # g: a drone with markers makes 1.0 to 1.1
SOFT_CERTIFICATE = "cf21_soft_50hz"
_ANY = AxisTube(100.0, 100.0, 100.0, 100.0)  # nothing is claimed
_SOFT, _SOFT_OBSERVER, _SOFT_LAG = (9.4, 3.2), (0.056, 0.121), 0.037  # K, densities of the observer, s


def made_for(base: Certificate, plants: tuple[Plants, Plants], delay: float, soft: bool) -> Certificate:
    """Return the controller of a certificate with models of some plants and a delay, s; its claims are none."""
    axes, blocks = [], []
    flight = base.flight
    assert flight is not None
    for number, (axis, kind) in enumerate(zip(flight.axes, plants, strict=True)):
        model, design = replace(kind.model, delay=delay, tilt=0.0), axis.design
        gains, gain_of_observer = (design.stiffness, design.rate), design.observer
        if soft:
            gains, gain_of_observer = _SOFT, observer(design.period, *_SOFT_OBSERVER)
            if number == 0:
                model = Plant(delay, _SOFT_LAG)
        own = Design.predicting(design.period, model, gain_of_observer, *gains)
        axes.append(_unproved(axis, kind, own, delay))
        blocks.append(ideal_block(*gains))
    flight = replace(flight, horizontal=axes[0], vertical=axes[1], margin=0.5 * base.limits.inner_radius)
    return replace(
        base, flight=flight, rate=min(rate for rate, _ in blocks), block=blocks[0][1], block_vertical=blocks[1][1]
    )


def _unproved(axis: Axis, kind: Plants, design: Design, delay: float) -> Axis:
    box = replace(kind.box, low=replace(kind.box.low, delay=delay), high=replace(kind.box.high, delay=delay))
    return replace(axis, design=design, box=box, tube=_ANY)


class Stood(NamedTuple):
    """How drones with all RATES, or three that had swapped places, stood.

    Attributes:
        swing: of their commands at rest, the largest, deg peak to peak.
        away: largest distance to the reference at rest, m.
        largest: largest horizontal distance to the reference from the beginning of the motion on, m.
        told: s from the beginning of the motion until of all of them it was told that no tube is claimed; inf: never.
    """

    swing: float
    away: float
    largest: float
    told: float


def flown(certificate: Certificate, vehicle: VehicleProfile, link_delay: float, swapping: bool = False) -> Stood:
    """Fly once."""
    rates = [MU] * len(PAPER_WAYPOINTS) if swapping else RATES
    count, duration = len(rates), 0.0
    policy = Policy(disturbance_max=0.8, thrust_error_max=0.25, drag=vehicle.dynamics.drag_z)
    pilot = Pilot(certificate, Tuning(np.array(rates), 0.05, 1.0, certificate.gain_max), policy, count)
    start = PAPER_WAYPOINTS * (1.0, 1.0, 0.0) if swapping else np.array([[2.0 * i, 0.0, 0.0] for i in range(count)])
    fleet = SimulatedFleet(
        vehicle, count, start=start, capture=MotionCapture(noise=_NOISE), command_delay=link_delay, seed=1,
        thrust_scale=max(1.0, certificate.limits.thrust_max / vehicle.thrust_max),
    )  # fmt: skip
    tilts: list[np.ndarray] = []
    errors: list[np.ndarray] = []

    def observe(_now: float, _samples: object, tick: Tick, _sent: object) -> None:
        tilts.append(np.where((tick.mode == Mode.FLY)[:, np.newaxis], tick.input[:, 1:], np.nan))
        errors.append(fleet.bodies.position - tick.reference[:, :3])

    now = fly(pilot, fleet, vehicle, 1.0)
    for index in range(count):
        fleet.firmware.request_arming(index, True)
        pilot.take_off(index, 1.0)
    now = fly(pilot, fleet, vehicle, _CLIMB, start=now)
    for index in range(count):
        if swapping:
            swap = gentle_spline_through(np.roll(PAPER_WAYPOINTS, -index, axis=0)[[0, 1, 2, 0]], LEG_TIME)
            pilot.set_reference(index, swap.shifted(now))
            duration = float(swap.times[-1])
        elif pilot.mode[index] == Mode.FLY:
            pilot.set_goal(index, start[index] + (0.5, 0.5, 1.0))
    told, largest = np.full(count, np.inf), np.zeros(count)

    def listen(present: float, _samples: object, tick: Tick, _sent: object, begin: float = now) -> None:
        told[:] = np.where(tick.assessment.guaranteed, told, np.minimum(told, present - begin))
        off = fleet.bodies.position[:, :2] - tick.reference[:, :2]
        largest[:] = np.maximum(largest, np.linalg.norm(off, axis=1))

    now = fly(pilot, fleet, vehicle, now + duration + _SETTLE, listen, start=now)
    fly(pilot, fleet, vehicle, now + _LOOK, observe, start=now)
    swing = np.degrees(np.ptp(np.array(tilts), axis=0)).max()
    away = float(np.linalg.norm(np.array(errors), axis=2).max())
    return Stood(float(swing), away, float(largest.max()), float(told.max()))


def packaged(delays: list[float]) -> Iterator[tuple[str, float, Stood]]:
    """Yield name, delay and what was flown with the default flight certificate as it is."""
    certificate, vehicle = load_certificate(DEFAULT_CERTIFICATE), load_vehicle("cf21")
    for delay in delays:
        yield DEFAULT_CERTIFICATE, delay, flown(certificate, vehicle, delay)


def identified() -> Iterator[tuple[str, VehicleProfile]]:
    """Yield name and vehicle of the loops of second order."""
    usual = load_vehicle("cf21")
    for wn, zeta, gain in itertools.product(
        (10.0, 14.8, 20.0, 25.0), (0.36, 0.42, 0.46, 0.5, 0.58, 0.67), (0.66, 0.75, 0.86)
    ):
        attitude = replace(usual.dynamics.attitude, natural_frequency=wn, damping=zeta, actuator_lag=0.0)
        dynamics = replace(usual.dynamics, attitude=attitude, attitude_gain=gain)
        yield f"{wn:g} rad/s, {zeta:g}, {gain:g}", replace(usual, dynamics=dynamics)


def loops(delays: list[float]) -> Iterator[tuple[str, float, Stood]]:
    """Yield name, delay and what was flown for loops of second order, with the soft controller."""
    base, usual = load_certificate(DEFAULT_CERTIFICATE), load_vehicle("cf21")
    plants = sides(usual, {}), upright(usual, {})
    for name, vehicle in identified():
        for delay in delays:
            yield name, delay, flown(made_for(base, plants, delay + vehicle.delay, soft=True), vehicle, delay)


def unidentified(delays: list[float]) -> Iterator[tuple[str, float, Stood]]:
    """Yield name, delay and what was flown for the same, with the packaged certificate of soft gains."""
    certificate = load_certificate(SOFT_CERTIFICATE)
    for name, vehicle in identified():
        for delay in delays:
            yield name, delay, flown(certificate, vehicle, delay)


def swaps(delays: list[float]) -> Iterator[tuple[str, float, Stood]]:
    """Yield name, delay and what was flown for the same, in swaps of places."""
    certificate = load_certificate(SOFT_CERTIFICATE)
    for name, vehicle in identified():
        for delay in delays:
            yield name, delay, flown(certificate, vehicle, delay, swapping=True)


def profiles(delays: list[float]) -> Iterator[tuple[str, float, Stood]]:
    """Yield name, delay and what was flown for the packaged profiles."""
    base = load_certificate(DEFAULT_CERTIFICATE)
    for name in PROFILES:
        vehicle = load_vehicle(name)
        thrust = max(min(base.limits.thrust_max, vehicle.thrust_max), _LEAST_THRUST * base.limits.gravity)
        limits = replace(base.limits, thrust_max=thrust)
        plain = replace(vehicle, dynamics=replace(vehicle.dynamics, velocity_tilt=0.0), intervals=None)
        plants, soft = (sides(plain, {}), upright(plain, {})), vehicle.dynamics.attitude.damping < 0.75
        for delay in delays:
            certificate = made_for(replace(base, limits=limits), plants, delay + vehicle.delay, soft)
            yield name, delay, flown(certificate, vehicle, delay)


def main() -> None:
    """Print a line a flight, and what does not meet the targets."""
    parser = argparse.ArgumentParser()
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--loops", dest="flights", action="store_const", const=loops)
    which.add_argument("--unidentified", dest="flights", action="store_const", const=unidentified)
    which.add_argument("--swaps", dest="flights", action="store_const", const=swaps)
    which.add_argument("--packaged", dest="flights", action="store_const", const=packaged)
    parser.set_defaults(flights=profiles)
    parser.add_argument("--delays", type=float, nargs="+", default=DELAYS, metavar="MS")
    given = parser.parse_args()
    delays, missed, count, furthest = [delay / 1e3 for delay in given.delays], 0, 0, 0.0
    for name, delay, (swing, away, largest, told) in given.flights(delays):
        met = swing <= SWING_TARGET and away <= AWAY_TARGET
        if given.flights is swaps:
            met = met and largest <= SWAP_TARGET
        count, missed, furthest = count + 1, missed + (not met), max(furthest, largest)
        mark = "" if met else "   missed"
        if given.flights is packaged:
            mark = f"   told after {told:.2f} s{mark}" if told < np.inf else f"   claimed all the time{mark}"
        places = f"{100.0 * away:>6.2f} cm, {100.0 * largest:.2f} on the way"
        print(f"{name:<24}{1e3 * delay:>4.0f} ms  {swing:>6.2f} deg  {places}{mark}", flush=True)
    bounds = f"{SWING_TARGET:g} deg and {100.0 * AWAY_TARGET:g} cm"
    if given.flights is swaps:
        bounds += f", {100.0 * SWAP_TARGET:g} cm on the way"
    print(f"{count - missed} of {count} at most {bounds}; {100.0 * furthest:.2f} cm on the way at most")


if __name__ == "__main__":
    main()
