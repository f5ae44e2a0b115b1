"""What the demo flies: three drones that swap places, with what the controller does by default or as in the paper."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError, refusal, require
from flatsat_ros.base.resources import config_path
from flatsat_ros.certificate.certificate import DEFAULT_CERTIFICATE, Certificate, load_certificate
from flatsat_ros.crazyflie.fit import LINK_DELAY, require_fit
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.flight.defaults import DISTURBANCE_MAX, V_INF, default_policy
from flatsat_ros.flight.path_limits import ReferenceBox
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.preview import needed_margin
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.plans import Plan
from flatsat_ros.plans.prepared import PreparedPlan

# the paper's way-points, {[0,-6,1],[6,6,1],[-6,6,1]} x 10 cm in x and y, m
PAPER_WAYPOINTS = np.array([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0]])
_NEIGHBOUR_DISTANCE = 1.25  # m, between neighbours on the ring that replaces the triangle for more drones
LEG_TIME = 4.0  # s from one way-point to the next; the paper prints none
VEHICLE = "cf21"
POSE_NOISE = 1e-4  # m, standard deviation of the simulated motion capture: certificates take five of them for granted
LEAD = 0.5  # s from sending the trajectories to their start
_BESIDE = 0.06  # m, that drones of a plan stand farther apart than the rules of take-off and landing keep them
_SEPARATION_MIN = 0.1  # m
_LOWEST, _BELOW = 0.3, 0.5  # m above the floor, that references are at least; that the floor is put below others


@dataclass(frozen=True, eq=False)
class Scenario:
    """What is flown.

    Attributes:
        robots: names.
        start: (N, 3) places on the floor, m.
        gathering: (N, 3) first way-points, m.
        swaps: the reference of each robot, times from 0.
        certificate: flown by all.
        certificate_path: its file.
        dynamics: ideal or identified.
        policy: of the flight layer.
        paper: the flight is Test 2 of the paper: goals are steps, no drone's gain restarts.
        plan: whose references the swaps are; None without one.
        plan_path: its file.
        wind: steady, along x, m/s.
        floor: its height, m: a plan's origin need not be on it.
    """

    robots: list[str]
    start: FloatArray
    gathering: FloatArray
    swaps: list[Trajectory]
    certificate: Certificate
    certificate_path: Path
    dynamics: str
    policy: Policy
    paper: bool
    plan: PreparedPlan | None = None
    plan_path: Path | None = None
    wind: float = 0.0
    floor: float = 0.0

    @property
    def height(self) -> float:
        """How high the drones take off, m: to their first way-points, so that the gain grows as in one climb."""
        return float(self.gathering[0, 2]) - self.floor

    @property
    def duration(self) -> float:
        """Length of the swap, s."""
        return max(float(swap.times[-1]) for swap in self.swaps)

    @property
    def lead(self) -> float:
        """How long before the swap its references are sent, s; those of a plan are sent one in each tick."""
        return LEAD if self.plan is None else LEAD + len(self.robots) * self.certificate.period


def plan(
    folder: Path,
    count: int = 3,
    seconds: float = 3 * LEG_TIME,
    rate: float | None = None,
    dynamics: str = "identified",
    *,
    paper: bool = False,
    offset_free: bool = False,
) -> Scenario:
    """Return what is to be flown.

    Args:
        folder: where a certificate for another rate is written.
        count: number of drones.
        seconds: of swapping, rounded up to whole legs.
        rate: of the controller, Hz, in the paper's flight; None for that of the certificate.
        dynamics: ideal or identified; the paper's flight alone can do with the ideal one.
        paper: Test 2 of the paper instead of what the controller does by default.
        offset_free: let the controller compensate disturbances in the paper's flight.

    Raises:
        FlatsatError: the number of drones, the time or the rate cannot be flown, or something is asked for that only
            the paper's flight has.
    """
    if not 1 <= count <= 64:
        raise refusal("--robots", count, "", "from 1 to 64")
    if not 0.0 < seconds <= 3600.0:
        raise refusal("--seconds", seconds, "s", "above 0 and at most 3600")
    others = {"--rate": rate is not None, "--dynamics ideal": dynamics == "ideal", "--offset-free": offset_free}
    for option, given in others.items():
        if given and not paper:
            raise FlatsatError(f"{option}: not used without --paper; the default flight is that of its certificate")
    certificate, path = _certificate_of(folder, rate) if paper else default_certificate()
    ring = _ring(count)
    legs = math.ceil(seconds / LEG_TIME - 1e-9)
    swaps = [swap_between(ring, i, legs) if paper else gentle_swap(certificate, ring, i, legs) for i in range(count)]
    for swap in swaps:
        swap.require_margin(certificate.limits)
    gathering = ring[:count]
    drag = load_vehicle(VEHICLE).dynamics.drag_z
    return Scenario(
        robots=[f"cf{i + 1}" for i in range(count)],
        start=gathering * (1.0, 1.0, 0.0),
        gathering=gathering,
        swaps=swaps,
        certificate=certificate,
        certificate_path=path,
        dynamics=dynamics,
        policy=Policy(goal_mode=GoalMode.STEP, disturbance_max=DISTURBANCE_MAX if offset_free else 0.0)
        if paper
        else default_policy(drag),
        paper=paper,
    )


def planned_flight(path: Path, wind: float = 0.0) -> Scenario:
    """Return the flight of a plan file, from the floor below its first points, by the demo's certificate.

    The floor is at 0, or half a metre below the lowest point of the references where that is not above it by so much as
    drones need to take off: way-points often begin where a drone stood, in a room whose origin is elsewhere.

    Args:
        path: of the plan.
        wind: steady, along x, m/s.

    Raises:
        FlatsatError: the plan does not hold, is for another certificate, leaves the room, or its drones would stand too
            near to each other on the floor; or the wind is more than the certificate assumes.
    """
    certificate, certificate_path = default_certificate()
    require_wind(certificate, wind)
    prepared = PreparedPlan.load(path, certificate)
    robots = list(prepared.references)
    swaps = [prepared.references[robot] for robot in robots]
    gathering = np.array([swap.sample(0.0)[:3] for swap in swaps])
    lowest = min(float(swap.bounds()[0][2]) for swap in swaps)
    floor = 0.0 if lowest >= _LOWEST else math.floor(10.0 * (lowest - _BELOW)) / 10.0
    drag = load_vehicle(VEHICLE).dynamics.drag_z
    policy = replace(default_policy(drag), floor=floor, separation=_separation(prepared.plan))
    _require_inside(policy.box, robots, swaps)
    start = gathering * (1.0, 1.0, 0.0) + (0.0, 0.0, floor)
    apart = policy.separation + _BESIDE
    _require_room_on_the_floor("first", robots, gathering, apart)
    _require_room_on_the_floor("last", robots, np.array([swap.end for swap in swaps]), apart)
    return Scenario(
        robots, start, gathering, swaps, certificate, certificate_path, "identified", policy, False, prepared, path,
        wind, floor,
    )  # fmt: skip


def require_wind(certificate: Certificate, wind: float) -> None:
    """Refuse a steady wind, m/s, of more than the certificate assumes.

    Raises:
        FlatsatError: it is more, or not a number of at least 0.
    """
    drag = load_vehicle(VEHICLE).dynamics.drag_xy
    assumed = 0.0 if certificate.flight is None else certificate.flight.disturbance / drag
    valid = f"from 0 to {assumed:.4g} m/s, whose drag on a hovering drone is what the certificate assumes"
    require(0.0 <= wind <= assumed, "--wind", wind, "m/s", valid)


def _require_inside(room: ReferenceBox, robots: Sequence[str], paths: Sequence[Trajectory]) -> None:
    """Refuse references that leave the room.

    Raises:
        FlatsatError: one does; the text names its drone and the side.
    """
    for robot, path in zip(robots, paths, strict=True):
        for corner in path.bounds():
            for axis, value, low, high in zip("xyz", corner.tolist(), room.low, room.high, strict=True):
                if not low <= value <= high:
                    valid = f"from {low:g} to {high:g} m, in the room of the demo"
                    raise refusal(f"{axis} of the reference of {robot}", round(value, 3), "m", valid)


def _separation(plan: Plan) -> float:
    """Return the separation for drones that do not follow the plan, m: the least that the plan keeps, or the default.

    The smaller one counts, so that drones which a plan leads side by side have room to take off and to land there.
    """
    asked = [float(plan.required(*pair)) - _BESIDE for pair in itertools.combinations(plan.drones, 2)]
    return max(_SEPARATION_MIN, min([Policy().separation, *asked]))


def _require_room_on_the_floor(which: str, robots: Sequence[str], points: FloatArray, least: float) -> None:
    """Refuse drones that would stand nearer to each other below points (N, 3), m, than a distance, m.

    Raises:
        FlatsatError: two of them would; the text names them.
    """
    for (i, one), (j, other) in itertools.combinations(enumerate(points[:, :2]), 2):
        apart = float(np.linalg.norm(one - other))
        if apart < least:
            what = f"distance of {robots[i]} and {robots[j]} on the floor below their {which} points"
            raise refusal(what, round(apart, 3), "m", f"at least {least:.3g} m, to take off and land")


def default_certificate() -> tuple[Certificate, Path]:
    """Return the certificate of the whole loop that the demo flies, and its file."""
    certificate = load_certificate(DEFAULT_CERTIFICATE)
    require_fit(certificate, load_vehicle(VEHICLE), LINK_DELAY, "the demo's drones")
    return certificate, config_path(DEFAULT_CERTIFICATE)


def _certificate_of(folder: Path, rate: float | None) -> tuple[Certificate, Path]:
    """Return the paper's certificate, or one like it for another rate, Hz, written into a folder, and its file."""
    path = config_path("paper_experiment")
    certificate = Certificate.load(path)
    if rate is None:
        return certificate, path
    if not 1.0 <= rate <= 500.0:
        raise refusal("--rate", rate, "Hz", "from 1 to 500")
    from flatsat_ros.synthesis.nominal import synthesize

    certificate = synthesize(certificate.limits, certificate.rate, 1.0 / rate, f"demo_{rate:g}_hz")
    path = folder / "certificate.yaml"
    certificate.save(path)
    return certificate, path


def gentle_swap(certificate: Certificate, places: FloatArray, index: int, legs: int) -> Trajectory:
    """Return the reference as `swap_between` does, as slow as the certificate's flight section wants it."""
    return gentle_tour(certificate, places[(index + np.arange(legs + 1)) % len(places)])


def gentle_tour(certificate: Certificate, points: FloatArray) -> Trajectory:
    """Return a reference from rest to rest through points (M, 3), m, as slow as a certificate's flight section wants.

    Raises:
        FlatsatError: none is slow enough within half a minute a leg.
    """
    from flatsat_ros.planning.spline import gentle_spline_through

    flight = certificate.flight
    for leg_time in LEG_TIME * 1.1 ** np.arange(20.0):
        tour = gentle_spline_through(list(points), float(leg_time))
        if flight is None or flight.demanded(tour.demand(), needed_margin(tour, certificate.limits, flight)) <= 1.0:
            return tour
    raise FlatsatError(f"no tour is as slow as {certificate.name!r} assumes: must be one within half a minute a leg")


def swap_between(places: FloatArray, index: int, legs: int) -> Trajectory:
    """Return the reference of a drone that goes from place to place, from rest to rest, `LEG_TIME` for each leg.

    Args:
        places: (M, 3) in the order in which they are visited, m.
        index: of the place at which the drone begins.
        legs: how often it goes on to the next place; after the last place comes the first.
    """
    from flatsat_ros.planning.spline import spline_through  # scipy takes a while to import

    return spline_through([places[(index + leg) % len(places)] for leg in range(legs + 1)], LEG_TIME)


def _ring(count: int) -> FloatArray:
    """Return the way-points: the paper's triangle for up to three drones, a ring with room for all otherwise."""
    if count <= len(PAPER_WAYPOINTS):
        return PAPER_WAYPOINTS
    angle = 2.0 * np.pi * np.arange(count) / count
    radius = _NEIGHBOUR_DISTANCE / (2.0 * math.sin(math.pi / count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones(count)], axis=1)


def record_of(scenario: Scenario, robots: dict[str, RobotRecord], swap_start: float) -> FlightRecord:
    """Return the record of a scenario flown."""
    certificate = scenario.certificate
    return FlightRecord(
        robots,
        certificate.limits,
        certificate.level,
        V_INF,
        certificate.gain_max,
        1.0 / certificate.period,
        scenario.dynamics,
        (swap_start, swap_start + scenario.duration),
        None if scenario.plan is None else scenario.plan.plan,
        scenario.floor,
    )
