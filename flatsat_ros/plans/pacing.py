"""Braking and going on along a reference: the same way, at another pace.

With the progress s(t) a reference p is flown as p(s(t)). Two references at the same progress are as far apart as at the
time s, so what is proved about their distances holds at every pace that they share. The pace sigma = s' goes between 0
and 1 by 10 u^3 - 15 u^4 + 6 u^5, whose first two derivatives are 0 at both ends. So the jerk stays continuous:

    v = p' sigma,  a = p'' sigma^2 + p' sigma',  j = p''' sigma^3 + 3 p'' sigma sigma' + p' sigma''.

p(s(t)) has a degree of 30. Every 40 ms or less it is met in position, velocity, acceleration and jerk by polynomials of
degree 7, which for the references of plans are off by less than 1 nm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.trajectory import SIZE, Trajectory
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.bounds import Bounds

_STEP = 0.04  # s
# from position, velocity, acceleration and jerk at u = 1, less what u^0 .. u^3 give, to coefficients of u^4 .. u^7
_JUMPS = np.linalg.inv(np.array([[math.perm(power, order) for power in range(4, SIZE)] for order in range(4)]))
# s, that stopping may take, and setting out again. The shortest duration is taken with which the reference exceeds its
# bounds by at most a tenth.
_STOPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0)
_STARTS = (*_STOPS, 8.0, 10.0, 12.0)
EXCESS = 1.1
_LOOKS, _STEPS = 100, 31  # number of times of a reference at which a change is checked, and of times within the change
_FACTORIALS = np.array([math.factorial(order) for order in range(4)], dtype=float)
_BINOMIALS = np.array([[math.comb(j, i) for j in range(SIZE)] for i in range(SIZE)], dtype=float)


def braked(reference: Trajectory, begin: float, duration: float) -> Trajectory:
    """Return the reference that begins to slow down at a time, s, and rests a duration, s, later.

    It has then made half as much progress as it would have, at full pace, since the beginning.
    """
    if begin >= reference.times[-1]:
        return reference
    slowing = _paced(reference, begin, begin, duration, stops=True)
    if begin <= reference.times[0]:
        return slowing
    kept = int(np.searchsorted(reference.times, begin, side="left"))
    return Trajectory(
        np.concatenate([reference.times[:kept], slowing.times]),
        np.concatenate([reference.coefficients[:kept], slowing.coefficients]),
        reference.yaw,
    )


def resumed(reference: Trajectory, progress: float, begin: float, duration: float) -> Trajectory:
    """Return the reference that rests until a time, s, sets out then, and is at full pace a duration, s, later.

    Args:
        reference: at full pace all the time.
        progress: the time of the reference, s, at whose place it rests.
        begin: s.
        duration: s.
    """
    start = _paced(reference, progress, begin, duration, stops=False)
    full = begin + duration
    rest = reference.shifted(full - progress - duration / 2.0)
    if full >= rest.times[-1]:
        return start
    if full <= rest.times[0]:  # it has not set out yet
        still = np.zeros((1, SIZE, 3))
        still[0, 0] = rest.coefficients[0, 0]
        pieces = [start.coefficients, still, rest.coefficients]
        return Trajectory(np.concatenate([start.times, rest.times]), np.concatenate(pieces), rest.yaw)
    index = int(np.searchsorted(rest.times, full, side="right")) - 1
    # the segment that is under way, about another origin
    elapsed = float(full - rest.times[index])
    powers = np.arange(SIZE)
    moved = _BINOMIALS * np.power(elapsed, np.maximum(powers - powers[:, None], 0)) @ rest.coefficients[index]
    return Trajectory(
        np.concatenate([start.times, rest.times[index + 1 :]]),
        np.concatenate([start.coefficients, moved[None], rest.coefficients[index + 1 :]]),
        rest.yaw,
    )


def change_duration(references: Sequence[Trajectory], bounds: Bounds, limits: InputSet, *, stops: bool) -> float:
    """Return how long a change of pace shall take, s, wherever it begins.

    Args:
        references: whose pace changes.
        bounds: that they keep; what a change asks for is at most a tenth more, where the longest suffices for that.
        limits: the input set.
        stops: whether they stop; otherwise they set out.
    """
    durations = _STOPS if stops else _STARTS
    sampled = _sampled(references)
    for duration in durations:
        if _are_bearable(sampled, duration, bounds, limits, stops=stops):
            return duration
    return durations[-1]


def have_room(references: Sequence[Trajectory], bounds: Bounds, limits: InputSet) -> bool:
    """Tell whether the longest changes of pace ask for at most a tenth more than the bounds that references keep."""
    sampled = _sampled(references)
    return all(
        _are_bearable(sampled, durations[-1], bounds, limits, stops=stops)
        for durations, stops in ((_STOPS, True), (_STARTS, False))
    )


def _sampled(references: Sequence[Trajectory]) -> list[tuple[FloatArray, FloatArray]]:
    """Return times (M,), s, of each reference, at which changes are looked at, and its rates then."""
    sampled = []
    for reference in references:
        times = np.linspace(reference.times[0], reference.times[-1], _LOOKS)
        sampled.append((times, _rates(reference, times)))
    return sampled


def _are_bearable(
    sampled: Sequence[tuple[FloatArray, FloatArray]], duration: float, bounds: Bounds, limits: InputSet, *, stops: bool
) -> bool:
    """Tell whether changes of a duration, s, ask for at most a tenth more than bounds allow, wherever they begin."""
    course = _course(np.linspace(0.0, 1.0, _STEPS), duration, stops=stops)
    return all(_is_bearable(*each, course, bounds, limits) for each in sampled)


def _is_bearable(times: FloatArray, rates: FloatArray, course: FloatArray, bounds: Bounds, limits: InputSet) -> bool:
    """Tell whether a change of pace, wherever it begins, asks for at most a tenth more than bounds allow.

    Args:
        times: (M,) s, at which it may begin.
        rates: (5, M, 3) of the reference at these times.
        course: of the change, see `_course`.
        bounds: of the reference.
        limits: the input set.
    """
    _, pace, first, second, third = course[..., np.newaxis]
    at = times[:, np.newaxis] + course[0]
    _, p1, p2, p3, p4 = (
        np.stack([np.interp(at, times, rate[:, axis], right=0.0) for axis in range(3)], axis=-1) for rate in rates
    )
    velocity, acceleration = p1 * pace, p2 * pace**2 + p1 * first
    jerk = p3 * pace**3 + 3.0 * p2 * pace * first + p1 * second
    snap = p4 * pace**4 + 6.0 * p3 * pace**2 * first + p2 * (3.0 * first**2 + 4.0 * pace * second) + p1 * third
    for value, most in ((acceleration, bounds.acceleration_max), (jerk, bounds.jerk_max), (snap, bounds.snap_max)):
        if most is not None and float((value * value).sum(axis=-1).max()) > (EXCESS * most) ** 2:
            return False
    room, factors = bounds.room(limits), {1: velocity, 2: acceleration, 3: jerk}
    f = sum(np.array(factor, dtype=np.float64) * factors[order] for order, factor in bounds.asked.items())
    return float(room.margin(f).min()) >= room.inner_radius - EXCESS * (room.inner_radius - bounds.margin)


def _course(u: FloatArray, duration: float, *, stops: bool) -> FloatArray:
    """Return progress, s, and pace of a change with its first three derivatives (5, K), at shares u (K,) of it."""
    rise, area = u**3 * (10.0 + u * (6.0 * u - 15.0)), u**4 * (2.5 + u * (u - 3.0))
    slope, bend = 30.0 * u**2 * (1.0 - u) ** 2, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
    turn = 60.0 * (1.0 - 6.0 * u * (1.0 - u))
    sign = -1.0 if stops else 1.0
    rates = [slope / duration, bend / duration**2, turn / duration**3]
    made, pace = (u - area, 1.0 - rise) if stops else (area, rise)
    return np.array([duration * made, pace, *(sign * rate for rate in rates)])


def _paced(reference: Trajectory, progress: float, begin: float, duration: float, *, stops: bool) -> Trajectory:
    """Return the piece on which the pace changes, from 1 to 0 if it stops and else from 0 to 1."""
    count = max(2, math.ceil(duration / _STEP) + 1)
    u = np.linspace(0.0, 1.0, count)
    course = _course(u, duration, stops=stops)
    pace, change, second, _ = course[1:, :, np.newaxis]
    place, p1, p2, p3, _ = _rates(reference, progress + course[0])
    acceleration = p2 * pace**2 + p1 * change
    jerk = p3 * pace**3 + 3.0 * p2 * pace * change + p1 * second
    rates = np.array([place, p1 * pace, acceleration, jerk])
    return Trajectory(begin + duration * u, _septic(duration / (count - 1), rates), reference.yaw)


def _rates(reference: Trajectory, times: FloatArray) -> FloatArray:
    """Return position, velocity, acceleration, jerk and snap (5, M, 3) at times (M,), s."""
    inside = np.clip(times, reference.times[0], reference.times[-1])
    segment = np.minimum(np.searchsorted(reference.times, inside, side="right"), len(reference.times) - 1) - 1
    elapsed, powers = inside - reference.times[segment], np.arange(SIZE)
    rates = []
    for order in range(5):
        factors = np.array([math.perm(power, order) for power in range(SIZE)], dtype=float)
        basis = factors * np.power(elapsed[:, None], np.maximum(powers - order, 0))
        rates.append(np.einsum("mp,mpa->ma", basis, reference.coefficients[segment]))
    found = np.array(rates)
    found[1:, inside != times] = 0.0  # it rests before its start and after its end
    return found


def _septic(span: float, rates: FloatArray) -> FloatArray:
    """Return the polynomials (M - 1, 8, 3) of degree 7 that meet rates (4, M, 3), position to jerk, each span, s."""
    scaled = rates * span ** np.arange(4.0)[:, None, None]
    coefficients = np.zeros((rates.shape[1] - 1, SIZE, 3))
    low = scaled[:, :-1] / _FACTORIALS[:, None, None]
    # what the first four coefficients make of each derivative at the end
    reached = np.array(
        [sum(math.perm(power, order) * low[power] for power in range(order, 4)) for order in range(4)]
    )  # fmt: skip
    high = np.einsum("ij,jmd->imd", _JUMPS, scaled[:, 1:] - reached)
    coefficients[:, :4], coefficients[:, 4:] = low.transpose(1, 0, 2), high.transpose(1, 0, 2)
    return np.asarray(coefficients / span ** np.arange(float(SIZE))[:, None])
