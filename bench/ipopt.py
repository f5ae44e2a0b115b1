"""The shortest references as one nonlinear program, by CasADi and ipopt: what a lab would try first.

Spline space, limits and first guess are those of the planner. Control points and durations, of each leg for one drone
and of the whole for many, are unknowns at the same time; pairs keep apart at samples. Needs casadi, see
requirements/bench.in.
"""

from __future__ import annotations

import itertools
import math
import time
from typing import Any, NamedTuple

import casadi
import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.planning import Mission
from flatsat_ros.planning.improvement import _shapes as shapes_of_mission
from flatsat_ros.planning.program import raising
from flatsat_ros.planning.reference import shapes_of
from flatsat_ros.planning.shapes import Shapes
from flatsat_ros.plans.curve import AT_REST, DEGREE, ORDER, Curve, bezier_weights

_SHARE = 1.0 - 1e-3  # of the limits, which the planner keeps back for rounding as well
_RESERVE = 1e-4  # m/s^2, likewise
_SHORTEST_LEG = 0.1  # s
_SAMPLES = 3  # of each span, at which pairs keep apart
_SMOOTH = 1e-3  # s, weight of the mean squared jerk over the largest
_ENDED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
_SWIRL = 0.05  # detour of each drone to its right at first, as a share of the way: the planner's, too


class Answer(NamedTuple):
    """What ipopt says.

    Attributes:
        curves: its references, rounded as those of plans; none where it has not ended.
        seconds, solving: CPU time of everything, and of ipopt alone, s.
        status: how it ended.
    """

    curves: tuple[Curve, ...]
    seconds: float
    solving: float
    status: str


def shortest(mission: Mission, most: float) -> Answer:
    """Return the shortest references that ipopt finds for a mission without obstacles.

    Args:
        mission: what is asked.
        most: CPU time for ipopt, s.
    """
    begin = time.process_time()
    shapes, guess = _guess(mission)
    spans = len(shapes.lengths) // len(guess)
    times = casadi.SX.sym("h", len(guess))
    pace, usual = casadi.SX(1.0), 1.0
    if len(mission.drones) == 1:
        widths = [times[leg] / spans for leg in range(len(guess)) for _ in range(spans)]
    else:
        guess = guess.sum(keepdims=True)
        widths = np.diff(shapes.knots).tolist()
        pace, usual = times[0], float(guess[0])
    weights = _weights(widths)
    smooth, free, beziers = [], [], []
    for number, drone in enumerate(mission.drones):
        own = casadi.SX.sym(f"c{number}", shapes.count - 2 * AT_REST, 3)
        ends = [casadi.repmat(casadi.DM(place).T, AT_REST, 1) for place in drone.waypoints[[0, -1]]]
        way = drone.waypoints[-1] - drone.waypoints[0]
        detour = np.outer(shapes.modes[:, 0], [way[1], -way[0], 0.0]) * (_SWIRL if len(mission.drones) > 1 else 0.0)
        smooth.append((shapes.fixed @ drone.waypoints + detour)[AT_REST:-AT_REST])
        free.append(own)
        beziers.append(_beziers(casadi.vertcat(ends[0], own, ends[1]), weights, widths))
    asked = _Asked()
    for drone, own in zip(mission.drones, beziers, strict=True):
        _keep_limits(asked, mission, own, pace, usual)
        for number in range(1, len(drone.waypoints) - 1):
            missed = own[0][int(shapes.passed[number]) * ORDER, :].T - casadi.DM(drone.waypoints[number])
            if drone.allowed[number] > 0.0:
                asked.ask(casadi.sumsqr(missed), 0.0, drone.allowed[number] ** 2)
            else:
                asked.ask(missed, 0.0, 0.0)
    _keep_apart(asked, mission, [own[0] for own in beziers])
    # without a little smoothness all that is not at a limit is free, and ipopt wanders
    jerks = [casadi.sumsqr(own[3]) / own[3].shape[0] for own in beziers]
    smoothness = sum(jerks) / len(jerks) / (mission.bounds.jerk_max * usual**3) ** 2
    unknowns = casadi.vertcat(times, *(casadi.vec(own) for own in free))
    cost = casadi.sum1(times) + _SMOOTH * smoothness
    solver = casadi.nlpsol(
        "shortest", "ipopt", {"x": unknowns, "f": cost, "g": casadi.vertcat(*asked.values)},
        {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 2000, "max_cpu_time": most}},
    )  # fmt: skip
    count = len(guess)
    start = np.concatenate([guess, *(points.T.ravel() for points in smooth)])
    lowest = np.concatenate([np.full(count, _SHORTEST_LEG), np.full(start.size - count, -math.inf)])
    solving = time.process_time()
    found = solver(x0=start, lbx=lowest, lbg=np.concatenate(asked.lower), ubg=np.concatenate(asked.upper))
    end, status = time.process_time(), solver.stats()["return_status"]
    if status not in _ENDED:
        return Answer((), end - begin, end - solving, status)
    values = np.asarray(found["x"]).ravel()
    durations = casadi.Function("widths", [times], [casadi.vertcat(*widths) * pace])(values[:count])
    knots = np.concatenate([[0], np.cumsum(np.rint(1e6 * np.asarray(durations).ravel()).astype(int))])
    rows = values[count:].reshape(len(mission.drones), 3, -1).transpose(0, 2, 1)
    curves = []
    for drone, points in zip(mission.drones, rows, strict=True):
        first, last = np.repeat(drone.waypoints[[0, -1]], AT_REST, axis=0).reshape(2, AT_REST, 3)
        curves.append(Curve.rounded(knots.tolist(), np.concatenate([first, points, last])))
    return Answer(tuple(curves), end - begin, end - solving, status)


class _Asked:
    """Expressions between bounds."""

    def __init__(self) -> None:
        self.values: list[casadi.SX] = []
        self.lower: list[FloatArray] = []
        self.upper: list[FloatArray] = []

    def ask(self, value: casadi.SX, low: float, high: float) -> None:
        rows = casadi.vec(value)
        self.values.append(rows)
        self.lower.append(np.full(rows.numel(), low))
        self.upper.append(np.full(rows.numel(), high))


def _guess(mission: Mission) -> tuple[Shapes, FloatArray]:
    """Return the spline space and durations of the legs, s, to begin with: about right for the jerk."""
    ways = np.linalg.norm(np.diff(mission.waypoints, axis=1), axis=2).max(axis=0)
    proportions = np.sqrt(ways + 0.1)
    shapes = shapes_of(proportions) if len(mission.drones) == 1 else shapes_of_mission(mission)
    total = np.cbrt(60.0 * np.maximum(ways, 1e-3) / mission.bounds.jerk_max).sum()
    return shapes, np.asarray(proportions * (total / proportions.sum()))


def _keep_limits(asked: _Asked, mission: Mission, beziers: list[casadi.SX], pace: casadi.SX, usual: float) -> None:
    """Ask for the limits of one reference at its Bezier points; each point that spans share is asked for once.

    Args:
        asked: gets them.
        mission: whose limits they are.
        beziers: of the reference, whose k-th derivative is multiplied by the k-th power of the pace.
        pace: an expression, or 1.
        usual: its value, about, by which limits are scaled.
    """
    bounds = mission.bounds
    limits = bounds.room(mission.limits)
    distinct = []
    for order, values in enumerate(beziers):
        each, rows = ORDER - order, values.shape[0]
        distinct.append(values[[row for row in range(rows) if row % each < each - 1 or row == rows - 1], :])
    margin, square, scale = bounds.margin + _RESERVE, pace**2, usual**2
    # f times the square of the pace, of the degree of the lowest derivative in it
    lowest, each = min(bounds.asked), ORDER - min(bounds.asked)
    led = sum(
        casadi.mtimes(casadi.DM(np.kron(np.eye(own.shape[0] // (ORDER - order)), raising(order, lowest))), own)
        * casadi.repmat(casadi.DM([[float(factor) for factor in factors]]), each * own.shape[0] // (ORDER - order), 1)
        * pace ** (2 - order)
        for order, factors in bounds.asked.items()
        for own in [beziers[order]]
    )
    led = led[[row for row in range(led.shape[0]) if row % each < each - 1 or row == led.shape[0] - 1], :]
    across, up = casadi.sum2(led[:, :2] ** 2), led[:, 2] + limits.gravity * square
    room = up * math.sin(limits.tilt_max) - margin * square
    asked.ask(room / scale, 0.0, math.inf)
    asked.ask((room**2 - math.cos(limits.tilt_max) ** 2 * across) / scale**2, 0.0, math.inf)
    asked.ask((across + up**2 - ((limits.thrust_max - margin) * square) ** 2) / scale**2, -math.inf, 0.0)
    asked.ask((up - (limits.thrust_min + margin) * square) / scale, 0.0, math.inf)
    for order, bound in (
        (1, bounds.speed_max), (2, bounds.acceleration_max), (3, bounds.jerk_max), (4, bounds.snap_max),
    ):  # fmt: skip
        if bound is not None:
            most = (_SHARE * bound) ** 2
            share = casadi.sum2(distinct[order] ** 2) / most - pace ** (2 * order)
            asked.ask(share / usual ** (2 * order), -math.inf, 0.0)
    for axis in range(3):
        asked.ask(distinct[0][:, axis], bounds.lower[axis], bounds.upper[axis])


def _keep_apart(asked: _Asked, mission: Mission, positions: list[casadi.SX]) -> None:
    """Ask that pairs keep apart at samples."""
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    bernstein = np.array([math.comb(DEGREE, k) * t**k * (1.0 - t) ** (DEGREE - k) for k in range(ORDER)]).T
    stretch = casadi.DM([1.0, 1.0, 1.0 / mission.downwash]).T
    places = [
        casadi.vertcat(*(
            casadi.mtimes(casadi.DM(bernstein), own[row : row + ORDER, :]) for row in range(0, own.shape[0], ORDER)
        ))
        for own in positions
    ]  # fmt: skip
    for i, j in itertools.combinations(range(len(places)), 2):
        apart = (places[i] - places[j]) * casadi.repmat(stretch, places[i].shape[0], 1)
        asked.ask(casadi.sum2(apart**2), mission.distances[i, j] ** 2, math.inf)


def _weights(widths: list[Any]) -> list[Any]:
    """Return for each span the matrix from its control points to Bezier points of the position."""
    edges = [0.0 * widths[0]]
    for width in widths:
        edges.append(edges[-1] + width)
    padded = [edges[0]] * (DEGREE - 1) + edges + [edges[-1]] * (DEGREE - 1)
    matrices = []
    for span in range(len(widths)):
        local, left, right = np.empty((1, 2 * DEGREE), dtype=object), *np.empty((2, 1), dtype=object)
        local[0] = padded[span : span + 2 * DEGREE]
        left[0], right[0] = edges[span], edges[span + 1]
        rows = bezier_weights(local, left, right)[0]
        matrices.append(casadi.vertcat(*(casadi.horzcat(*row) for row in rows.tolist())))
    return matrices


def _beziers(points: casadi.SX, weights: list[Any], widths: list[casadi.SX]) -> list[casadi.SX]:
    """Return the Bezier points (M (6 - order), 3) of position to snap."""
    rows: list[list[casadi.SX]] = [[] for _ in range(5)]
    for span, (matrix, width) in enumerate(zip(weights, widths, strict=True)):
        values = casadi.mtimes(matrix, points[span : span + ORDER, :])
        for order in range(5):
            rows[order].append(values)
            values = (DEGREE - order) * (values[1:, :] - values[:-1, :]) / width
    return [casadi.vertcat(*each) for each in rows]
