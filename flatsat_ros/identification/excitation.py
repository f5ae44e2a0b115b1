"""The excitation flight: a path that makes all figures of a drone show in the log of its flight.

Horizontally sines under a window, x from slow to fast and y from fast to slow at the same time: 0.2 Hz for drag and
tilt with the velocity, 0.5 to 3 Hz for gain, lag and delay of the attitude. Vertically sines meanwhile, and then steps
of the acceleration for thrust map and thrust lag.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import refusal
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.trajectory import Trajectory

STEP_LEAST = 0.05 * GRAVITY  # m/s^2, smallest step of the thrust from which its slope and lag are to be told
# of the largest ball around hover in the input set: accelerations of the sines of one axis, and of the steps of z alone
_SHARE, _UPWARD = 0.5, 0.9
_MOST = 0.1 * GRAVITY  # m/s^2 of either, so that the path stays in its box
# Hz and s of the sines of x and y, each a whole number of periods, and of z beside them
_SLOW_TO_FAST = ((0.2, 10.0), (0.5, 4.0), (1.0, 3.0), (2.0, 2.0), (3.0, 2.0))
_UPRIGHT = (0.2, 0.3)
_STEPS = (0.3, 0.45, 0.6, 0.6)  # s of thrust above and below hover, each up and down again
_REST = 1.0  # s between sines and steps
_RAMP = 0.06  # s from one thrust to the next
_POINTS = 10  # of a period, between which the path is quintic


def excitation(certificate: Certificate, start: ArrayLike) -> Trajectory:
    """Return the path, from rest at a place and back to it, within a box of 2 m around it.

    Args:
        certificate: with which it is flown, whose limits it keeps.
        start: (3,) m, world frame.

    Raises:
        FlatsatError: its limits leave no room for thrust steps of STEP_LEAST.
    """
    radius = certificate.limits.inner_radius
    step = min(_UPWARD * radius, _MOST)
    if step < STEP_LEAST:
        raise refusal(
            "largest thrust step within the limits",
            step,
            "m/s^2",
            f"at least {STEP_LEAST:.3g} m/s^2: allow more thrust",
        )
    times, motion = _sines(min(_SHARE * radius, _MOST))
    later, upright = _thrust_steps(step)
    steps = np.zeros((3, len(later), 3))
    steps[:, :, 2] = upright
    place, velocity, acceleration = np.concatenate([motion, steps], axis=1)
    times = np.concatenate([times, times[-1] + _REST + later])
    path = Trajectory.through(times, finite_array("start", start, 3) + place, velocity, acceleration)
    path.require_margin(certificate.limits)
    return path


def _sines(size: float) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) and position, velocity and acceleration (3, n, 3) of the sines on all axes."""
    x, y = _SLOW_TO_FAST, _SLOW_TO_FAST[::-1]
    ends = [np.cumsum([0.0, *(seconds for _, seconds in parts)]) for parts in (x, y)]
    pieces = [np.array([0.0])]
    for begin, end in itertools.pairwise(np.unique(ends)):
        here = [int(np.searchsorted(each, begin, side="right")) - 1 for each in ends]
        fastest = max(x[here[0]][0], y[here[1]][0])
        pieces.append(np.linspace(begin, end, math.ceil((end - begin) * _POINTS * fastest) + 1)[1:])
    times = np.concatenate(pieces)
    half = float(times[-1]) / 2.0
    z = tuple((frequency, int(half * frequency) / frequency) for frequency in _UPRIGHT)
    begins = (ends[0][:-1], ends[1][:-1], np.array([0.0, half]))
    motion = np.zeros((3, len(times), 3))
    for axis, parts in enumerate((x, y, z)):
        for begin, (frequency, seconds) in zip(begins[axis], parts, strict=True):
            inside = (times >= begin) & (times <= begin + seconds)
            motion[:, inside, axis] = _sine(times[inside] - begin, frequency, seconds, size)
    return times, motion


def _sine(time: FloatArray, frequency: float, seconds: float, size: float) -> FloatArray:
    """Return position, velocity and acceleration (3, n) of a sine under a window sin^2, of a largest acceleration."""

    def motion(t: FloatArray) -> FloatArray:
        turn, slow = 2.0 * np.pi * frequency, 2.0 * np.pi / seconds
        wave = np.stack([np.sin(turn * t), turn * np.cos(turn * t), -(turn**2) * np.sin(turn * t)])
        window = 0.5 * np.stack([1.0 - np.cos(slow * t), slow * np.sin(slow * t), slow**2 * np.cos(slow * t)])
        return np.stack(
            [
                wave[0] * window[0],
                wave[1] * window[0] + wave[0] * window[1],
                wave[2] * window[0] + 2.0 * wave[1] * window[1] + wave[0] * window[2],
            ]
        )

    largest = np.abs(motion(np.linspace(0.0, seconds, 2001))[2]).max()
    return np.asarray(motion(time) * (size / largest))


def _thrust_steps(size: float) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) and position, velocity and acceleration (3, n) of a ladder of thrusts around hover."""
    times, accelerations = [0.0], [0.0]
    for hold in _STEPS:
        # up and back down: as much thrust above hover as below, ramps included
        for level, seconds in ((size, hold), (-size, 2.0 * hold + _RAMP), (size, hold), (0.0, hold)):
            times += [times[-1] + _RAMP, times[-1] + _RAMP + seconds]
            accelerations += [level, level]
    t, a = np.array(times), np.array(accelerations)
    span, jerk = np.diff(t), np.diff(a) / np.diff(t)
    v = np.concatenate([[0.0], np.cumsum(span * (a[:-1] + a[1:]) / 2.0)])
    p = np.concatenate([[0.0], np.cumsum(span * v[:-1] + span**2 * a[:-1] / 2.0 + span**3 * jerk / 6.0)])
    return t, np.stack([p, v, a])


def message_text(path: Trajectory) -> str:
    """Return a path as the YAML text of a trajectory_msgs/MultiDOFJointTrajectory, a line for each point."""
    lines = ["header: {frame_id: world}", "joint_names: [base_link]", "points:"]
    for time in path.times:
        place, velocity, acceleration = (
            ", ".join(f"{axis}: {value:.7f}" for axis, value in zip("xyz", part, strict=True))
            for part in path.sample(float(time)).reshape(3, 3)
        )
        seconds, rest = divmod(round(float(time) * 1e9), 10**9)
        lines.append(
            f"- {{transforms: [{{translation: {{{place}}}}}], velocities: [{{linear: {{{velocity}}}}}], "
            f"accelerations: [{{linear: {{{acceleration}}}}}], time_from_start: {{sec: {seconds}, nanosec: {rest}}}}}"
        )
    return "\n".join(lines) + "\n"
