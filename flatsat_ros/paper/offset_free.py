"""Beyond the paper: how far simulated drones with wrong thrust or in wind hang from where they should be.

The paper's swap with its law, with the disturbance compensated, and with the thrust estimated as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.closed_form import closed_form_certificate
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.demo.scenario import LEG_TIME, PAPER_WAYPOINTS, swap_between
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.paper.studies import POSE_NOISE
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

# the paper's swap, at the rate and with the thrust that a lab flies
LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
RATE, PERIOD, MU, V_INF = 1.25, 0.02, 2.0, 0.05
PLACES = PAPER_WAYPOINTS
CLIMB, WATCHED = 15.0, 0.5  # s: from the floor to the start of the swap, of the hover before it

PAPER = Policy(goal_mode=GoalMode.STEP)
OFFSET_FREE = Policy(disturbance_max=0.8, goal_mode=GoalMode.STEP)
ESTIMATING = Policy(disturbance_max=0.8, thrust_error_max=0.2, goal_mode=GoalMode.STEP)
HOVER_TARGET, SWAP_TARGET = 0.01, 0.04  # m


class Trouble(NamedTuple):
    """What is wrong with the drones, or with the air."""

    name: str
    thrust_scale: float
    wind: float  # m/s, along x


VEHICLES = ("cf21", "cf21_plus")
TROUBLES = (
    Trouble("5 % of thrust missing", 0.95, 0.0),
    Trouble("5 % too much thrust", 1.05, 0.0),
    Trouble("wind of 1 m/s", 1.0, 1.0),
)
# more than may be compensated as a disturbance
TOO_MUCH = (Trouble("10 % of thrust missing", 0.9, 0.0), Trouble("15 % too much thrust", 1.15, 0.0))


class SwapErrors(NamedTuple):
    """One flight of three drones; the worst of them."""

    hover: float  # m, mean distance from the goal before the swap
    swap: float  # m, root mean square error of the swap
    within: bool  # whether every command kept the limits


def swap(vehicle: str, trouble: Trouble, policy: Policy) -> SwapErrors:
    """Let three drones take off, hover and swap places three times.

    Args:
        vehicle: packaged profile.
        trouble: what is wrong.
        policy: what the pilot estimates and compensates.
    """
    certificate = closed_form_certificate(LIMITS, RATE, PERIOD, "50 Hz")
    pilot = Pilot(certificate, Tuning(MU, V_INF, 1.0, certificate.gain_max), policy, len(PLACES))
    profile = load_vehicle(vehicle)
    fleet = SimulatedFleet(
        profile,
        len(PLACES),
        start=PLACES * (1.0, 1.0, 0.0),
        thrust_scale=trouble.thrust_scale,
        wind=Wind(mean=(trouble.wind, 0.0, 0.0)),
        capture=MotionCapture(noise=POSE_NOISE),
        seed=1,
    )
    errors = []
    within = True

    def observe(_now: float, _samples: list[Sample], tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        nonlocal within
        errors.append(np.linalg.norm(fleet.bodies.position - tick.reference[:, :3], axis=1))
        within &= bool((tick.input[:, 0] <= LIMITS.thrust_max * (1.0 + 1e-12)).all())
        within &= bool((np.abs(tick.input[:, 1:]) <= LIMITS.tilt_max * (1.0 + 1e-9)).all())

    for i, place in enumerate(PLACES):
        pilot.set_reference(i, Trajectory.hold(place))
    now = fly(pilot, fleet, profile, CLIMB, observe)
    hovered = np.array(errors[-round(WATCHED / PERIOD) :]).mean(axis=0)
    errors.clear()
    for i in range(len(PLACES)):
        pilot.set_reference(i, swap_between(PLACES, i, len(PLACES)).shifted(now))
    fly(pilot, fleet, profile, now + len(PLACES) * LEG_TIME, observe, start=now)
    swapped = np.sqrt(np.mean(np.square(errors), axis=0))
    return SwapErrors(float(hovered.max()), float(swapped.max()), within)
