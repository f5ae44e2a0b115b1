"""Paths to rest: from any motion of the reference to rest at a goal, within limits that the drone can follow.

The velocity changes, by a polynomial of degree 5 in time, from what it is (with its acceleration and jerk) to a
constant one along a straight line, and likewise from there to rest; so position, velocity, acceleration and jerk are
continuous and the snap is bounded. Braking is the same thing without a line between. With both changes of the same
length T,

    D = goal - p0 - T v0/2 - T^2 a0/10 - T^3 j0/120

is what is left to the straight line, whatever its speed V: the direction is D/|D|, V = min(V_max, |D|/T), and the
constant part takes (|D| - V T)/V. The shortest T that keeps all limits is taken. Where there is none, the acceleration
is brought to zero first, by a cubic in time, if that is better. Who moves away from the goal, or too fast towards it,
would go far astray in such a T: where braking first and then setting out from rest takes less time, or is less wide,
that is the path.

Horizontal and vertical are planned apart, so that one can stand still while the other moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.path_limits import HORIZONTAL, VERTICAL, Demand, PathLimits, ReferenceBox
from flatsat_ros.flight.pieces import (
    BERNSTEIN,
    NODES,
    Part,
    at_nodes,
    constant,
    derived,
    integrated,
    of_all_axes,
    value,
)
from flatsat_ros.flight.trajectory import SIZE, Trajectory, quintic

# of what the law may be asked for, what holding the speed against drag may take; the rest is left to change it
_CRUISE = 0.8

# a turn is led through rest if otherwise it would be wider than braking takes by more than this, m
_WIDER = 0.1
# and a wall may be exceeded by this, m, if otherwise a path would lead so much farther astray
_BRUSHED = 0.05

# durations that are tried, s
_DURATIONS = 0.2 * 1.1 ** np.arange(90.0)
_ROUNDING = 1e-9
_STILL = 1e-9  # m: what is nearer is there

# largest second and third derivative of 10 s^3 - 15 s^4 + 6 s^5 on [0, 1]
_PEAKS = (10.0 / math.sqrt(3.0), 60.0)
# 1 less this, and its first two derivatives, at the nodes
_LAST = (
    1.0 - NODES**3 * (10.0 + NODES * (6.0 * NODES - 15.0)),
    -30.0 * NODES**2 * (1.0 - NODES) ** 2,
    -60.0 * NODES * (1.0 - NODES) * (1.0 - 2.0 * NODES),
)
_ZERO = np.zeros(1)


def path_to(
    motion: FloatArray,
    goal: FloatArray,
    start: float,
    limits: PathLimits,
    box: ReferenceBox,
    yaw: float = 0.0,
    *,
    wait: bool = False,
) -> Trajectory:
    """Return the path from a motion to rest at a goal.

    Args:
        motion: (4, 3) position (m), velocity (m/s), acceleration (m/s^2) and jerk (m/s^3) at the start.
        goal: (3,) m; entries that are NaN mean: as soon as it can be braked along that axis.
        start: time of the start, s.
        limits: of the path. Where the motion already exceeds one, the path comes back to it.
        box: is not left, unless the motion is outside or cannot be braked before the wall.
        yaw: psi to hold, rad.
        wait: the horizontal part brakes and waits, only the vertical one goes to the goal.
    """
    across = goal[:2] if not wait else np.full(2, np.nan)
    parts = [
        _to_rest(motion[:, axes], part, limits, asked, _Walls(box.low[axes], box.high[axes]))
        for axes, part, asked in (
            (HORIZONTAL, across, limits.horizontal),
            (VERTICAL, goal[2:], limits.vertical),
        )
    ]
    return of_all_axes(parts, start, yaw)


class _Walls(NamedTuple):
    """The box along some axes, (d,) each."""

    low: FloatArray
    high: FloatArray


class _Change(NamedTuple):
    """How a motion (4, d) comes to rest at a goal: the length T of its changes, s, the velocity between them, m/s."""

    excess: float
    motion: FloatArray
    duration: float
    cruise: FloatArray
    cruise_time: float  # s


def _to_rest(motion: FloatArray, goal: FloatArray, limits: PathLimits, asked: Demand, walls: _Walls) -> Part:
    """Return the path of some axes; the arguments are those of `path_to`, (4, d) and (d,)."""
    if asked.drag > 0.0:
        limits = limits.slower(_CRUISE * asked.most / asked.drag)
    excess, direct = _straight(motion, goal, limits, asked, walls)
    if not motion[1].any() or np.isnan(goal).all():
        return direct
    worse, braking = _straight(motion, np.full_like(goal, np.nan), limits, asked, walls)
    rest = np.zeros_like(motion)
    rest[0] = braking.coefficients[-1, 0]
    worst, onward = _straight(rest, goal, limits, asked, walls)
    longer = excess <= _ROUNDING and _end(braking) + _end(onward) >= _end(direct)
    wide = _aside(direct, motion[0], goal) > _aside(braking, motion[0], goal) + _WIDER
    if (longer and not wide) or max(worse, worst) > _ROUNDING:
        return direct
    return Part(
        np.concatenate([braking.ends, _end(braking) + onward.ends]),
        np.concatenate([braking.coefficients[:-1], onward.coefficients]),
    )


def _end(part: Part) -> float:
    """Return the time at which a part is at rest, s."""
    return float(part.ends[-1]) if part.ends.size else 0.0


def _aside(part: Part, start: FloatArray, goal: FloatArray) -> float:
    """Return how far a part leads away from the line from a start to a goal, (d,) each, m."""
    times = np.diff(part.ends, prepend=0.0)[:, np.newaxis, np.newaxis] * NODES[:, np.newaxis]
    places = (times ** np.arange(SIZE)) @ part.coefficients[:-1] - start
    way = goal - start
    share = np.clip(places @ way / max(float(way @ way), _STILL), 0.0, 1.0)
    off = places - share[..., np.newaxis] * way
    return float(np.sqrt((off * off).sum(axis=-1)).max(initial=0.0))


def _straight(
    motion: FloatArray, goal: FloatArray, limits: PathLimits, asked: Demand, walls: _Walls
) -> tuple[float, Part]:
    """Return the path to a goal without a rest on the way, and by how much it exceeds its limits."""
    if not motion[1:].any() and not (np.abs(np.nan_to_num(goal - motion[0])) >= _STILL).any():  # it is there, at rest
        return 0.0, Part(np.zeros(0), constant(motion[0]))
    lengths: list[float] = []
    pieces: list[FloatArray] = []
    change = _change(motion, goal, limits, asked, walls)
    if change.excess > _ROUNDING and motion[2:].any():
        duration, piece = _settled(motion, limits, asked)
        later = np.zeros_like(motion)
        later[0], later[1] = value(piece, duration), value(derived(piece), duration)
        settled = _change(later, goal, limits, asked, walls)
        if settled.excess < change.excess:
            lengths, pieces, change = [duration], [piece], settled
    place, v0, a0, j0 = change.motion
    if change.motion[1:].any() or change.cruise.any():
        v1, zero = change.cruise, np.zeros_like(place)
        first, last = quintic(
            np.full(2, change.duration),
            [np.array([v0, v1]), np.array([a0, zero]), np.array([j0, zero])],
            [np.array([v1, zero]), np.zeros((2, v1.size)), np.zeros((2, v1.size))],
        )
        line = constant(place)[0]
        line[1] = v1
        for length, piece in ((change.duration, integrated(first, place)), (change.cruise_time, line)):
            if length > _ROUNDING:
                piece[0] = place
                lengths, pieces = [*lengths, length], [*pieces, piece]
                place = value(piece, length)
        if v1.any():
            lengths, pieces = [*lengths, change.duration], [*pieces, integrated(last, place)]
            place = value(pieces[-1], change.duration)
    return change.excess, Part(np.cumsum(lengths), np.array([*pieces, constant(place)[0]]))


def _change(motion: FloatArray, goal: FloatArray, limits: PathLimits, asked: Demand, walls: _Walls) -> _Change:
    """Return the change with the shortest T that keeps all limits, or the one that exceeds them least."""
    p0, v0, a0, j0 = motion
    t = _DURATIONS[:, np.newaxis]
    left = np.where(np.isnan(goal), 0.0, goal - p0 - t * v0 / 2.0 - t**2 * a0 / 10.0 - t**3 * j0 / 120.0)
    distance = np.sqrt((left * left).sum(axis=1))
    distance[distance < _STILL] = 0.0
    speed = np.minimum(limits.speed, distance / _DURATIONS)
    cruise = left * (speed / np.maximum(distance, _STILL))[:, np.newaxis]

    # control points of the velocity, (K, 6, d), and of its derivatives
    first, second = v0 + t * a0 / 5.0, v0 + 2.0 * t * a0 / 5.0 + t**2 * j0 / 20.0
    velocity = np.stack(np.broadcast_arrays(v0, first, second, cruise, cruise, cruise), axis=1)
    rates = [at_nodes(velocity)]
    excess = _excess(rates[0], limits.speed, v0)
    derivative, factor = velocity, np.ones(1)
    for bound, present, degree in ((limits.acceleration, a0, 5.0), (limits.jerk, j0, 4.0), (limits.snap, _ZERO, 3.0)):
        derivative, factor = np.diff(derivative, axis=1), factor * degree / _DURATIONS
        rates.append(at_nodes(derivative * factor[:, np.newaxis, np.newaxis]))
        excess += _excess(rates[-1], bound, present)
    excess += _excess(asked.of(*rates[:3]), asked.most, asked.of(v0, a0, j0))
    # the last change, from the constant velocity to rest
    for bound, peak, power in ((limits.jerk, _PEAKS[0], 2), (limits.snap, _PEAKS[1], 3)):
        excess += np.maximum(peak * speed / _DURATIONS**power / bound - 1.0, 0.0)
    last = [share[np.newaxis, :, np.newaxis] * (speed / _DURATIONS**i)[:, None, None] for i, share in enumerate(_LAST)]
    excess += _excess(last[1], limits.acceleration) + _excess(asked.of(*last), asked.most)
    # the position, within the box or as near to it as the motion is
    travelled = np.cumsum(velocity, axis=1) * (t / 6.0)[:, np.newaxis]
    places = p0 + BERNSTEIN[6][:, 1:] @ travelled
    beyond = np.maximum(walls.low - places, places - walls.high)
    beyond -= np.maximum(np.maximum(walls.low - p0, p0 - walls.high), 0.0)
    outside = np.maximum(beyond, 0.0).max(axis=(1, 2))

    # where none keeps all limits, none shall make a detour instead
    off = np.maximum(np.fmin(p0, goal) - places, places - np.fmax(p0, goal))
    detour = np.where(np.isnan(goal), 0.0, off).max(axis=(1, 2))
    best = _first(excess + outside, excess + outside + np.maximum(detour, 0.0))
    if outside.any():
        brushing = _first(excess + np.maximum(outside - _BRUSHED, 0.0), excess + outside)
        astray = off.max(axis=(1, 2))
        if astray[best] > astray[brushing] + _WIDER:
            best = brushing
    excess += outside
    duration, pace = float(_DURATIONS[best]), float(speed[best])
    cruise_time = (float(distance[best]) - pace * duration) / pace if pace > 0.0 else 0.0
    return _Change(float(excess[best]), motion, duration, cruise[best], cruise_time)


def _settled(motion: FloatArray, limits: PathLimits, asked: Demand) -> tuple[float, FloatArray]:
    """Return the shortest piece (8, d) that ends without acceleration and jerk, and its length, s."""
    place, v0, a0, j0 = motion
    t = _DURATIONS[:, np.newaxis]
    zero = np.zeros_like(t * a0)
    # control points of the acceleration, (K, 4, d)
    control = np.stack(np.broadcast_arrays(a0, a0 + t * j0 / 3.0, zero, zero), axis=1)
    gained = np.cumsum(np.pad(control, ((0, 0), (1, 0), (0, 0))), axis=1) * (t / 4.0)[:, np.newaxis]
    rates = [v0 + at_nodes(gained), at_nodes(control)]
    excess = _excess(rates[1], limits.acceleration, a0)
    derivative, factor = control, np.ones(1)
    for bound, present, degree in ((limits.jerk, j0, 3.0), (limits.snap, zero[0], 2.0)):
        derivative, factor = np.diff(derivative, axis=1), factor * degree / _DURATIONS
        rates.append(at_nodes(derivative * factor[:, np.newaxis, np.newaxis]))
        excess += _excess(rates[-1], bound, present)
    excess += _excess(asked.of(*rates[:3]), asked.most, asked.of(v0, a0, j0))
    duration = float(_DURATIONS[_first(excess, excess)])
    piece = np.zeros((SIZE, place.size))
    c2 = (-3.0 * a0 - 2.0 * duration * j0) / duration**2
    c3 = (2.0 * a0 + duration * j0) / duration**3
    piece[:6] = place, v0, a0 / 2.0, j0 / 6.0, c2 / 12.0, c3 / 20.0
    return duration, piece


def _first(excess: FloatArray, cost: FloatArray) -> int:
    """Return the first candidate without excess, or the one with the least cost."""
    feasible = np.flatnonzero(excess <= _ROUNDING)
    return int(feasible[0]) if feasible.size else int(cost.argmin())


def _excess(values: FloatArray, bound: float, present: FloatArray = _ZERO) -> FloatArray:
    """Return by how much, relatively, values (K, nodes, d) exceed a bound, or the present size if that is more.

    Args:
        values: of which the norms count.
        bound: of the Euclidean norm.
        present: (d,).
    """
    allowed = max(bound, float(np.sqrt((present * present).sum())))
    return np.asarray(np.maximum(np.sqrt((values * values).sum(axis=2)).max(axis=1) / allowed - 1.0, 0.0))
