"""One drone's trajectory: position, velocity and acceleration at any time, and how near it comes to the limits.

A trajectory is made of polynomials of degree up to 7. Given by points with position, velocity and acceleration it is
between them the quintic that meets all three at both ends, so a B-spline of degree 5 sampled at its knots comes back
exactly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import refusal, require_number
from flatsat_ros.certificate.lyapunov import bernstein_coefficients
from flatsat_ros.law.input_set import InputSet

# A trajectory must end at rest up to this speed (m/s) and acceleration (m/s^2): its last position is then held.
_REST = 1e-3

# A jerk that changes at once by no more than this, m/s^3, does not jump.
_SMOOTH = 1e-3

# Each segment's polynomials are bounded by the control points of this many pieces.
_PIECES = 8
_EDGES = tuple(np.linspace(0.0, 1.0, _PIECES + 1).tolist())

SIZE = 8  # coefficients of a polynomial, t^0 .. t^7
_POWERS = np.arange(SIZE)
# what differentiating t^1 .. t^7 once multiplies by, t^2 .. t^7 twice, and t^3 .. t^7 three times
_FIRST = np.arange(1.0, SIZE)
_SECOND = _FIRST[1:] * _FIRST[:-1]
_THIRD = _FIRST[2:] * _FIRST[1:-1] * _FIRST[:-2]


class Margin(NamedTuple):
    """How near a path's acceleration comes to the limits.

    Attributes:
        distance: to the boundary of the input set, m/s^2, a lower bound; negative: the set is left, or the bound is too
            coarse to exclude it.
        time: at which the piece that comes so near begins, s.
        limit: the limit it comes near to: tilt_max, thrust_max or thrust_min.
    """

    distance: float
    time: float
    limit: str


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A twice continuously differentiable path of one drone.

    Attributes:
        times: (M,) s, increasing, absolute or relative as the user of the trajectory decides.
        coefficients: (M - 1, 8, 3); the position in segment i is sum_j coefficients[i, j] (t - times[i])^j, m.
        yaw: psi to hold, rad.
    """

    times: FloatArray
    coefficients: FloatArray
    yaw: float = 0.0

    @classmethod
    def through(
        cls, times: ArrayLike, positions: ArrayLike, velocities: ArrayLike, accelerations: ArrayLike, yaw: float = 0.0
    ) -> Trajectory:
        """Join points by quintic segments.

        Args:
            times: (M,) s, strictly increasing, M >= 1.
            positions: (M, 3) m, world frame.
            velocities: (M, 3) m/s.
            accelerations: (M, 3) m/s^2.
            yaw: rad.

        Raises:
            FlatsatError: shapes differ, a value is not finite, times do not increase, or the last point is not at rest.
        """
        t = finite_array("times", times)
        points = [
            finite_array(name, value, 3)
            for name, value in (
                ("positions", positions), ("velocities", velocities), ("accelerations", accelerations),
            )
        ]  # fmt: skip
        if t.ndim != 1 or t.size == 0 or any(p.shape != (t.size, 3) for p in points):
            shapes = (t.shape, *(p.shape for p in points))
            valid = "(M,) and three times (M, 3) with M >= 1"
            raise refusal("shapes of times, positions, velocities and accelerations", shapes, "", valid)
        span = np.diff(t)
        if (span <= 0.0).any():
            index = int(np.argmax(span <= 0.0))
            raise refusal(f"times[{index + 1}]", t[index + 1], "s", f"above the time before it, {t[index]} s")
        for name, point, unit in (("velocity", points[1][-1], "m/s"), ("acceleration", points[2][-1], "m/s^2")):
            if float(np.linalg.norm(point)) > _REST:
                raise refusal(f"{name} of the last point", point.tolist(), unit, f"below {_REST} {unit}, at rest")
        yaw = require_number("yaw", yaw, "rad")
        if not span.size:
            return cls(t, _at_rest(points[0][0]), yaw)
        coefficients = np.zeros((span.size, SIZE, 3))
        coefficients[:, :6] = quintic(span, [p[:-1] for p in points], [p[1:] for p in points])
        return cls(t, coefficients, yaw)

    @classmethod
    def hold(cls, position: ArrayLike, yaw: float = 0.0) -> Trajectory:
        """Return the set-point: stay at a place from any time on.

        Args:
            position: (3,) m, world frame.
            yaw: psi, rad, counter-clockwise.

        Raises:
            FlatsatError: a value is not finite, or position is not (3,).
        """
        return cls.through([0.0], [finite_array("position", position, 3)], np.zeros((1, 3)), np.zeros((1, 3)), yaw)

    def shifted(self, offset: float) -> Trajectory:
        """Return the same path offset seconds later."""
        return Trajectory(self.times + offset, self.coefficients, self.yaw)

    def segment(self, t: float) -> tuple[FloatArray, float, float]:
        """Return the segment active at t: coefficients (8, 3), their time origin, and the time until which it lasts.

        The last one, and the only one of a set-point, lasts for ever.
        """
        if t < self.times[0] and self.times.size > 1:
            return _at_rest(self.coefficients[0, 0])[0], float(self.times[0]), float(self.times[0])
        if self.times.size == 1 or t >= self.times[-1]:
            return _at_rest(self.end)[0], float(self.times[-1]), math.inf
        index = int(np.searchsorted(self.times, t, side="right")) - 1
        return self.coefficients[index], float(self.times[index]), float(self.times[index + 1])

    @property
    def end(self) -> FloatArray:
        """The last position (3,), m, held after the end."""
        if self.times.size == 1:
            return np.asarray(self.coefficients[0, 0])
        return np.asarray(np.power(self.times[-1] - self.times[-2], _POWERS) @ self.coefficients[-1])

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the smallest box (3,), (3,), m, known to hold the path: that of its Bernstein control points."""
        if self.times.size == 1:
            return self.end, self.end
        span = np.diff(self.times)
        powers = self.coefficients.transpose(1, 0, 2) * np.power(span, _POWERS[:, np.newaxis])[..., np.newaxis]
        points = _control_points(powers).reshape(-1, 3)
        return points.min(axis=0), points.max(axis=0)

    def sample(self, t: float) -> FloatArray:
        """Return position, velocity and acceleration (9,) at t; before the start and after the end it rests."""
        coefficients, origin, _ = self.segment(t)
        return np.asarray(evaluate(coefficients[np.newaxis], np.array([t - origin]))[0])

    def jerk(self, t: float) -> FloatArray:
        """Return the jerk (3,), m/s^3, at t; before the start and after the end it rests."""
        coefficients, origin, _ = self.segment(t)
        powers = np.power(t - origin, np.arange(SIZE - 3.0)) if coefficients[3:].any() else np.zeros(SIZE - 3)
        return np.asarray((powers * _THIRD) @ coefficients[3:])

    def margin(self, limits: InputSet) -> Margin:
        """Return a lower bound of the acceleration's distance to the boundary of the input set.

        The acceleration of each piece lies in the convex hull of its Bernstein control points and the distance is a
        concave function, so the smallest over the control points is a bound for all times. With a margin m the law has
        an applied gain of at least 1 wherever |B'P xi| <= m (docs/mathematics.md).

        Args:
            limits: the input set V_c.
        """
        return nearest(self.coefficients[:, 2:] * _SECOND[:, np.newaxis], self.times, limits)

    def demand(self) -> FloatArray:
        """Return upper bounds (3, 2) of acceleration, jerk and snap, m/s^2 and so on, horizontal and vertical.

        Where the jerk jumps, also from rest at the beginning or to rest at the end, the snap is infinite.
        """
        found = np.zeros((3, 2))
        span = np.diff(self.times)
        if span.size == 0 or not self.coefficients[:, 2:].any():
            return found
        derivative = self.coefficients * np.power(span[:, np.newaxis], _POWERS)[..., np.newaxis]
        for order in range(1, 5):
            derivative = derivative[:, 1:] * np.arange(1.0, SIZE - order + 1.0)[:, np.newaxis] / span[:, None, None]
            if order < 2:
                continue
            points = _control_points(derivative.transpose(1, 0, 2))
            sizes = np.hypot(points[..., 0], points[..., 1]).max(), np.abs(points[..., 2]).max()
            found[order - 2] = np.maximum(found[order - 2], sizes)
            if order == 3:
                begin, end = derivative[:, 0], derivative.sum(axis=1)
                jumps = np.abs(np.concatenate([begin[1:], np.zeros((1, 3))]) - end)
                if not self.coefficients[0, 1:3].any():  # it sets out from rest, not from an earlier path's motion
                    jumps = np.concatenate([np.abs(begin[:1]), jumps])
                sides, upright = jumps[:, :2].max() > _SMOOTH, jumps[:, 2].max() > _SMOOTH
                found[2] = np.where([sides, upright], np.inf, 0.0)
        return found

    def require_margin(self, limits: InputSet) -> float:
        """Return the margin, m/s^2, refusing a path that may use up the input set: nothing would be left to steer.

        Args:
            limits: the input set V_c.

        Raises:
            FlatsatError: names the time, the limit and by how much.
        """
        tightest = self.margin(limits)
        if tightest.distance <= 0.0:
            limit = f"{tightest.limit} = {getattr(limits, tightest.limit):.4g} at t = {tightest.time:.4g} s"
            raise refusal(f"the reference's margin to {limit}", tightest.distance, "m/s^2", "above 0: fly it slower")
        return tightest.distance


def nearest(accelerations: FloatArray, times: FloatArray, limits: InputSet) -> Margin:
    """Return a lower bound of the distance of piecewise polynomials to the boundary of the input set, and where it is.

    Args:
        accelerations: (M - 1, n, 3) coefficients of the powers of the time since a segment's beginning, m/s^2.
        times: (M,) s, at which segments begin, and the last one ends; before and after all of them it is 0.
        limits: V_c.
    """
    tightest = Margin(limits.inner_radius, float(times[0]), limits.nearest_limit(np.zeros(3)))
    span = np.diff(times)
    if span.size == 0:
        return tightest
    powers = accelerations.transpose(1, 0, 2)  # of (t - start) / span
    powers = powers * np.power(span, np.arange(float(len(powers)))[:, np.newaxis])[..., np.newaxis]
    points = _control_points(powers)
    distances = limits.margin(points)
    least = piece, _, segment = np.unravel_index(int(distances.argmin()), distances.shape)
    if not distances[least] < tightest.distance:
        return tightest
    time = float(times[segment] + _EDGES[piece] * span[segment])
    return Margin(float(distances[least]), time, limits.nearest_limit(points[least]))


def _control_points(powers: FloatArray) -> FloatArray:
    """Return the Bernstein control points of all pieces of polynomials on [0, 1].

    Args:
        powers: (n + 1, M, 3) coefficients of t^0 .. t^n of M polynomials.

    Returns:
        (pieces, n + 1, M, 3).
    """
    return np.tensordot(_to_control_points(len(powers) - 1), powers, 1)


@cache
def _to_control_points(degree: int) -> FloatArray:
    """Return the matrices (pieces, n + 1, n + 1) from coefficients of powers to control points."""
    basis = np.eye(degree + 1)
    return np.array([bernstein_coefficients(basis, left, right) for left, right in itertools.pairwise(_EDGES)])


def evaluate(coefficients: FloatArray, t: FloatArray) -> FloatArray:
    """Evaluate N polynomials.

    Args:
        coefficients: (N, 8, 3) of t^0 .. t^7, m, m/s, ...
        t: (N,) s.

    Returns:
        (N, 9) position (m), velocity (m/s), acceleration (m/s^2).
    """
    basis = np.zeros((len(t), 3, SIZE))
    powers = basis[:, 0]
    powers[:, 0], powers[:, 1:] = 1.0, t[:, np.newaxis]
    np.multiply.accumulate(powers, axis=1, out=powers)
    np.multiply(powers[:, :-1], _FIRST, out=basis[:, 1, 1:])
    np.multiply(powers[:, :-2], _SECOND, out=basis[:, 2, 2:])
    return np.asarray((basis @ coefficients).reshape(len(t), 9))


def jerks(coefficients: FloatArray, t: FloatArray) -> FloatArray:
    """Return the jerk of N polynomials, (N, 3) m/s^3; the arguments are those of `evaluate`."""
    powers = np.power(t[:, np.newaxis], _POWERS[:-3]) * _THIRD
    return np.asarray((powers[:, np.newaxis] @ coefficients[:, 3:])[:, 0])


def _at_rest(position: FloatArray) -> FloatArray:
    coefficients = np.zeros((1, SIZE, 3))
    coefficients[0, 0] = position
    return coefficients


def quintic(span: FloatArray, start: Sequence[FloatArray], end: Sequence[FloatArray]) -> FloatArray:
    """Return the polynomials of degree 5 that meet values and two derivatives at both ends.

    Args:
        span: (M,) lengths of the segments, s.
        start: value, first and second derivative at the beginning, (M, d) each.
        end: the same at the end.

    Returns:
        (M, 6, d) coefficients of t^0 .. t^5.
    """
    d = span[:, np.newaxis]
    jump_p = end[0] - start[0] - d * start[1] - d**2 / 2.0 * start[2]
    jump_v = end[1] - start[1] - d * start[2]
    jump_a = end[2] - start[2]
    c3 = (10.0 * jump_p - 4.0 * d * jump_v + d**2 / 2.0 * jump_a) / d**3
    c4 = (-15.0 * jump_p + 7.0 * d * jump_v - d**2 * jump_a) / d**4
    c5 = (6.0 * jump_p - 3.0 * d * jump_v + d**2 / 2.0 * jump_a) / d**5
    return np.stack([*np.broadcast_arrays(start[0], start[1], start[2] / 2.0, c3), c4, c5], axis=1)
