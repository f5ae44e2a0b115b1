"""Position 0.5 s ahead of a flying drone, from its poses so far and its commands, by an extended Kalman filter.

The model is that of `flatsat_ros.identification.response`, flown from estimates in place of smoothed measurements. Of
each flight the filter finds what differs from flight to flight as it goes, from the past alone: full thrust, marker
frame, a push that fades and, where it adapts, attitude gain and tilt with the velocity, for which the identified values
are where it begins. All flights are filtered side by side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import PWM_FULL
from flatsat_ros.identification.response import Figures, delayed_mean, lagging
from flatsat_ros.identification.screening import STEP, Samples

# the state: position, velocity, roll and pitch, their rates, marker frame, push; then full thrust, tilt with the
# velocity, attitude gain
P, V, ANGLE, RATE, FRAME, PUSH = (slice(*ends) for ends in ((0, 3), (3, 6), (6, 8), (8, 10), (10, 12), (12, 15)))
FULL, TILT, GAIN = 15, 16, 17
STATES = 18

_PUSH, _FADES = 0.1, 0.1  # m/s^2 and s, standard deviation and correlation time of the push
_DENSITIES = (
    (RATE, 10.0),
    (FRAME, 6e-3),
    (TILT, 1e-3),
    (GAIN, 1e-3),
)  # of random walks, in units of the state over sqrt s
_WANDERS = 0.02  # relative, of the full thrust, over sqrt s
_VELOCITY = 1e-3  # m/s of each step
_NOISE = (5e-4, 3e-3)  # m and rad, of the measurements with what the model lacks at the same rate
# standard deviations to begin with
_KNOWN = ((P, 1e-3), (V, 0.5), (ANGLE, 0.14), (RATE, 0.7), (FRAME, 0.03), (PUSH, _PUSH), (TILT, 0.03), (GAIN, 0.04))
_FULL_KNOWN = 0.1  # relative


@dataclass(frozen=True, eq=False)
class _Inputs:
    """Of flights (M, n) on the grid: what acts on them and what was measured; zeros behind the end of a log.

    Attributes:
        command: (M, n, 2) delayed roll and pitch, rad.
        thrust: (M, n) over the full thrust, mean of the STEP that follows.
        heading: (M, n, 2) cosine and sine of yaw.
        measured: (M, n, 5) position, m, roll and pitch of the markers, rad.
        usable: (M, n).
    """

    command: FloatArray
    thrust: FloatArray
    heading: FloatArray
    measured: FloatArray
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, flights: Sequence[Samples], figures: Figures) -> _Inputs:
        """Prepare flights."""
        rows, count = max(len(samples.position) for samples in flights), len(flights)
        sizes = (2, 1, 2, 5, 1)
        command, thrust, heading, measured, usable = (np.zeros((rows, count, size)) for size in sizes)
        for k, samples in enumerate(flights):
            end = len(samples.position)
            late = delayed_mean(samples.command, figures.delay)
            yaw = np.nan_to_num(samples.angles[:, 2])
            command[:end, k] = late[:, :2]
            lifts = lagging(late[:, 2] / PWM_FULL, figures)
            thrust[:end, k, 0] = (lifts + np.append(lifts[1:], lifts[-1])) / 2.0
            heading[:end, k] = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
            measured[:end, k] = np.concatenate([samples.position, np.nan_to_num(samples.angles[:, :2])], axis=1)
            usable[:end, k, 0] = samples.usable
        return cls(command, thrust[..., 0], heading, measured, usable[..., 0] > 0.0)


def ahead(
    flights: Sequence[Samples], figures: Figures, at: Sequence[NDArray[np.intp]], steps: int, *, adapt: bool
) -> list[FloatArray]:
    """Return for each flight the positions (K, 3), m, that are expected some steps after the samples `at` (K,).

    Args:
        flights: of one drone.
        figures: of its model.
        at: of each flight, the samples from which to predict.
        steps: how many.
        adapt: whether gain and tilt are found in flight, too.
    """
    inputs = _Inputs.of(flights, figures)
    states, found = _filtered(inputs, figures, adapt), []
    for k, begin in enumerate(at):
        x = states[begin, k]
        for step in range(steps):
            now = begin + step
            x = _moved(x, inputs.command[now, k], inputs.thrust[now, k], inputs.heading[begin, k], figures)
        found.append(x[:, P])
    return found


def _filtered(inputs: _Inputs, figures: Figures, adapt: bool) -> FloatArray:
    """Return the states (M, n, STATES), each from the measurements up to its own."""
    rows, count = inputs.thrust.shape
    frozen = [] if adapt else [TILT, GAIN]
    growth = np.zeros(STATES)
    for where, density in _DENSITIES:
        growth[where] = density**2 * STEP
    growth[PUSH], growth[V] = _PUSH**2 * (1.0 - math.exp(-2.0 * STEP / _FADES)), _VELOCITY**2
    first = np.zeros(STATES)
    for where, deviation in _KNOWN:
        first[where] = deviation**2
    growth[frozen] = first[frozen] = 0.0
    sees = np.zeros((5, STATES))
    sees[:3, P], sees[3:, ANGLE], sees[3:, FRAME] = np.eye(3), np.eye(2), np.eye(2)
    noise, diagonal = np.diag([_NOISE[0] ** 2] * 3 + [_NOISE[1] ** 2] * 2), np.arange(STATES)

    x, spread = np.zeros((count, STATES)), np.zeros((count, STATES, STATES))
    begun, states = np.zeros(count, dtype=bool), np.zeros((rows, count, STATES))
    for k in range(rows):
        new = inputs.usable[k] & ~begun
        x[new, P], x[new, FULL] = inputs.measured[k, new, :3], GRAVITY / np.maximum(inputs.thrust[k, new], 0.1)
        x[new, TILT], x[new, GAIN] = figures.velocity_tilt, figures.attitude_gain
        spread[new] = np.diag(first)
        spread[new, FULL, FULL] = (_FULL_KNOWN * x[new, FULL]) ** 2
        begun |= new
        use = inputs.usable[k]
        if use.any():
            across = spread[use] @ sees.T
            weight = np.linalg.solve(sees @ across + noise, across.transpose(0, 2, 1)).transpose(0, 2, 1)
            x[use] += np.einsum("nij,nj->ni", weight, inputs.measured[k, use] - x[use] @ sees.T)
            spread[use] -= weight @ across.transpose(0, 2, 1)
        states[k] = x
        linear = _linear(x, inputs.command[k], inputs.thrust[k], inputs.heading[k], figures)
        x = _moved(x, inputs.command[k], inputs.thrust[k], inputs.heading[k], figures)
        spread = linear @ spread @ linear.transpose(0, 2, 1)
        spread[:, diagonal, diagonal] += growth
        spread[:, FULL, FULL] += (_WANDERS * x[:, FULL]) ** 2 * STEP
        spread = (spread + spread.transpose(0, 2, 1)) / 2.0
    return states


def _force(angle: FloatArray, thrust: FloatArray, heading: FloatArray) -> FloatArray:
    """Return T R e3 (n, 3) of roll and pitch (n, 2), rad, and a thrust (n,), in its unit."""
    (sr, sp), (cr, cp) = np.sin(angle).T, np.cos(angle).T
    along, across, (cos, sin) = cr * sp * thrust, -sr * thrust, heading.T
    return np.stack([cos * along - sin * across, sin * along + cos * across, cr * cp * thrust], axis=-1)


def _moved(x: FloatArray, command: FloatArray, thrust: FloatArray, heading: FloatArray, figures: Figures) -> FloatArray:
    """Return states (n, STATES) a STEP later."""
    drag, velocity, (cos, sin) = _drag(figures), x[:, V], heading.T
    lean = np.stack([sin * velocity[:, 0] - cos * velocity[:, 1], cos * velocity[:, 0] + sin * velocity[:, 1]], axis=-1)
    goal = x[:, GAIN, None] * command + x[:, TILT, None] * lean
    wn, zeta, angle, rate = figures.natural_frequency, figures.damping, x[:, ANGLE], x[:, RATE]
    for _ in range(2):  # semi-implicit Euler at 200 Hz
        rate = rate + (wn * wn * (goal - angle) - 2.0 * zeta * wn * rate) * STEP / 2.0
        angle = angle + rate * STEP / 2.0
    force = _force((x[:, ANGLE] + angle) / 2.0, thrust * x[:, FULL], heading)
    acceleration = force - (0.0, 0.0, GRAVITY) - drag * velocity + x[:, PUSH]
    after = x.copy()
    after[:, P] += STEP * velocity + 0.5 * STEP**2 * acceleration
    after[:, V] += STEP * acceleration
    after[:, ANGLE], after[:, RATE] = angle, rate
    after[:, PUSH] *= math.exp(-STEP / _FADES)
    return after


def _linear(
    x: FloatArray, command: FloatArray, thrust: FloatArray, heading: FloatArray, figures: Figures
) -> FloatArray:
    """Return the derivatives (n, STATES, STATES) of `_moved` by the state, for small angles."""
    found = np.tile(np.eye(STATES), (len(x), 1, 1))
    (cos, sin), full, axes = heading.T, thrust * x[:, FULL], np.arange(3)
    found[:, axes, 3 + axes] = STEP
    found[:, 3 + axes, 3 + axes] -= STEP * _drag(figures)
    found[:, 3 + axes, 12 + axes] = STEP
    found[:, 3, 6], found[:, 4, 6] = STEP * sin * full, -STEP * cos * full
    found[:, 3, 7], found[:, 4, 7] = STEP * cos * full, STEP * sin * full
    found[:, V, FULL] = STEP * _force(x[:, ANGLE], thrust, heading)
    square, axes = figures.natural_frequency**2 * STEP, np.arange(2)
    found[:, 6 + axes, 6 + axes] -= square * STEP / 2.0
    found[:, 6 + axes, 8 + axes] = STEP
    found[:, 8 + axes, 6 + axes] = -square
    found[:, 8 + axes, 8 + axes] -= 2.0 * figures.damping * figures.natural_frequency * STEP
    turned = np.stack([np.stack([sin, -cos], axis=-1), np.stack([cos, sin], axis=-1)], axis=1)  # velocity to lean
    found[:, 8:10, 3:5] = square * x[:, TILT, None, None] * turned
    found[:, RATE, TILT] = square * np.einsum("nij,nj->ni", turned, x[:, 3:5])
    found[:, RATE, GAIN] = square * command
    found[:, 12:15, 12:15] *= math.exp(-STEP / _FADES)
    return found


def _drag(figures: Figures) -> FloatArray:
    return np.array([figures.drag_xy, figures.drag_xy, figures.drag_z])
