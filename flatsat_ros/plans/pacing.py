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

_STEP = 0.04  # s
# of positions, velocities, accelerations and jerks at 0 and at 1, scaled by the span: coefficients of u^4 .. u^7
_JUMPS = np.linalg.inv(np.array([[math.perm(power, order) for power in range(4, SIZE)] for order in range(4)]))
# s, that a change of pace may take: the shortest whose jerk and snap exceed the reference's by less than a tenth
_CHANGES = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
EXCESS = 1.1
_TINY = 1e-300
_LOOKS = 200  # times at which a reference is looked at for that
_FACTORIALS = np.array([math.factorial(order) for order in range(4)], dtype=float)
_BINOMIALS = np.array([[math.comb(j, i) for j in range(SIZE)] for i in range(SIZE)], dtype=float)


def braked(reference: Trajectory, begin: float, duration: float) -> Trajectory:
    """Return the reference that begins to slow down at a time, s, and rests a duration, s, later.

    It has then made half as much progress as it would have, at full pace, since the beginning.
    """
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


def change_duration(references: Sequence[Trajectory]) -> float:
    """Return how long a change of pace shall take, s, wherever it begins."""
    u = np.linspace(0.0, 1.0, 41)
    rise, area = u**3 * (10.0 + u * (6.0 * u - 15.0)), u**4 * (2.5 + u * (u - 3.0))
    pace, made = 1.0 - rise, u - area
    slope, bend = 30.0 * u**2 * (1.0 - u) ** 2, np.abs(60.0 * u * (1.0 - u) * (1.0 - 2.0 * u))
    turn = np.abs(60.0 * (1.0 - 6.0 * u * (1.0 - u)))
    sizes = []
    most = np.full(5, _TINY)
    for reference in references:
        times = np.linspace(reference.times[0], reference.times[-1], _LOOKS)
        sizes.append((times, np.linalg.norm(_rates(reference, times), axis=2)))
        most = np.maximum(most, sizes[-1][1].max(axis=1))
    for duration in _CHANGES:
        d1, d2, d3 = slope / duration, bend / duration**2, turn / duration**3
        worst = 0.0
        for times, rates in sizes:
            at = times[:, None] + duration * made
            v, a, j, s = (np.interp(at, times, rate, right=0.0) for rate in rates[1:])
            jerk = j * pace**3 + 3.0 * a * pace * d1 + v * d2
            snap = s * pace**4 + 6.0 * j * pace**2 * d1 + a * (3.0 * d1**2 + 4.0 * pace * d2) + v * d3
            worst = max(worst, float(jerk.max()) / most[3], float(snap.max()) / most[4])
        if worst <= EXCESS:
            return duration
    return _CHANGES[-1]


def _paced(reference: Trajectory, progress: float, begin: float, duration: float, *, stops: bool) -> Trajectory:
    """Return the piece on which the pace changes, from 1 to 0 if it stops and else from 0 to 1."""
    count = max(2, math.ceil(duration / _STEP) + 1)
    u = np.linspace(0.0, 1.0, count)
    rise, area = u**3 * (10.0 + u * (6.0 * u - 15.0)), u**4 * (2.5 + u * (u - 3.0))  # and its integral
    slope, bend = 30.0 * u**2 * (1.0 - u) ** 2 / duration, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2
    sign = -1.0 if stops else 1.0
    pace = (1.0 - rise if stops else rise)[:, None]
    change, second = sign * slope[:, None], sign * bend[:, None]
    place, p1, p2, p3, _ = _rates(reference, progress + duration * (u - area if stops else area))
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
