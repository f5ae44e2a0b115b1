"""Beyond the paper: how far simulated drones with wrong thrust or in wind hang from where they should be.

The paper's swap with its law, with the disturbance compensated, and with the thrust estimated as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.flight.pilot import Pilot, Tick
from flatsat_ros.flight.supervisor import GoalMode, Policy
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.planning.spline import spline_through
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample

# the paper's swap, at the rate and with the thrust that a lab flies
LIMITS = InputSet(1.45 * GRAVITY, math.radians(10.0))
RATE, PERIOD, MU, V_INF = 1.25, 0.02, 2.0, 0.05
PLACES = np.array([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0]])
LEG, CLIMB, WATCHED = 4.0, 15.0, 0.5  # s: a leg of the swap, from the floor to its start, of the hover before it

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
    low, high = hold_gain_interval(RATE, PERIOD)
    ball = LIMITS.inner_radius**2
    proof = Certificate("50 Hz", LIMITS, RATE, closed_form_block(RATE), ball, ball / RATE, PERIOD, low, high)
    pilot = Pilot(proof, Tuning(MU, V_INF, 1.0, high), policy, len(PLACES))
    profile = load_vehicle(vehicle)
    fleet = SimulatedFleet(
        profile,
        len(PLACES),
        start=PLACES * (1.0, 1.0, 0.0),
        thrust_scale=trouble.thrust_scale,
        wind=Wind(mean=(trouble.wind, 0.0, 0.0)),
        capture=MotionCapture(noise=5e-4),
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
        legs = [PLACES[(i + leg) % len(PLACES)] for leg in range(len(PLACES) + 1)]
        pilot.set_reference(i, spline_through(legs, LEG).shifted(now))
    fly(pilot, fleet, profile, now + len(PLACES) * LEG, observe, start=now)
    swapped = np.sqrt(np.mean(np.square(errors), axis=0))
    return SwapErrors(float(hovered.max()), float(swapped.max()), within)
