"""What every reference of a plan keeps at all times, and its proof with integers.

A derivative of a reference lies, between two knots, in the convex hull of its Bezier control points, and all limits are
convex sets: what holds at these points holds at all times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import LARGEST, refusal, require, require_fields, require_positive
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.curve import UNIT, Curve, Exact

_ON_FACE = UNIT // 10**6  # 1 um: start and goal may lie on a face of the box, and rounding moves points

NAMES = ("acceleration", "jerk", "snap", "speed", "box")


class Claim(NamedTuple):
    """One limit of one reference.

    Attributes:
        name: what is limited, of NAMES, and where it matters the limit.
        slack: what is left at the worst control point, in the limit's unit; negative where the proof fails.
        unit: of the slack.
        time: at which the span with that control point begins, s.
    """

    name: str
    slack: float
    unit: str
    time: float


@dataclass(frozen=True, eq=False)
class Bounds:
    """The limits of all references of a plan.

    Attributes:
        margin: distance that accelerations keep from the boundary of the input set, m/s^2.
        jerk_max: m/s^3.
        snap_max: m/s^4.
        lower, upper: (3,) m, corners of the box that the references stay in, to 1 um.
        speed_max: m/s; None for no limit.
        acceleration_max: m/s^2, within what the margin leaves; None for no limit beside.

    Raises:
        FlatsatError: a value is not finite or not above 0, or the box is empty.
    """

    margin: float
    jerk_max: float
    snap_max: float
    lower: FloatArray
    upper: FloatArray
    speed_max: float | None = None
    acceleration_max: float | None = None

    def __post_init__(self) -> None:
        require_fields(self, require_positive, margin="m/s^2", jerk_max="m/s^3", snap_max="m/s^4")
        for name, unit in (("speed_max", "m/s"), ("acceleration_max", "m/s^2")):
            if getattr(self, name) is not None:
                require_fields(self, require_positive, **{name: unit})
        for name in ("lower", "upper"):
            corner = finite_array(name, getattr(self, name), 3)
            require(corner.shape == (3,), f"shape of {name}", corner.shape, "", "(3,)")
            require(float(np.abs(corner).max()) <= LARGEST, name, corner.tolist(), "m", f"within {LARGEST:g} m")
            object.__setattr__(self, name, corner)
        for axis, low, high in zip("xyz", self.lower.tolist(), self.upper.tolist(), strict=True):
            require(low < high, f"upper {axis} of the box", high, "m", f"above the lower one, {low} m")

    def within(self, limits: InputSet) -> None:
        """Refuse a margin that leaves no acceleration.

        Raises:
            FlatsatError: it does not fit the input set.
        """
        if not self.margin < limits.inner_radius:
            radius = f"below {limits.inner_radius:.6g} m/s^2, the radius of the ball around hover in the input set"
            raise refusal("margin", self.margin, "m/s^2", radius)

    def claims(self, curve: Curve, limits: InputSet) -> Iterator[Claim]:
        """Yield what is proved about one reference; where a proof fails, with a negative slack.

        Args:
            curve: the reference.
            limits: the input set V_c.
        """
        starts = np.array(curve.knots[:-1]) / 1e6
        yield from _accelerations(_wide(curve, 2), limits, self.margin, starts)
        for order, bound, name, unit in (
            (1, self.speed_max, "speed", "m/s"),
            (2, self.acceleration_max, "acceleration, acceleration_max", "m/s^2"),
            (3, self.jerk_max, "jerk", "m/s^3"),
            (4, self.snap_max, "snap", "m/s^4"),
        ):
            if bound is not None:
                squares = ((abs(_wide(curve, order)) + 1) ** 2).sum(axis=2)
                most = int(Fraction(bound) * UNIT)
                yield _claim(name, most * most - squares, _least(bound, squares), unit, starts)
        points = _wide(curve, 0)
        for axis, (low, high) in enumerate(zip(self.lower.tolist(), self.upper.tolist(), strict=True)):
            for name, room in (
                ("lower", points[..., axis] - 1 - math.ceil(Fraction(low) * UNIT)),
                ("upper", math.floor(Fraction(high) * UNIT) - points[..., axis] - 1),
            ):
                yield _claim(f"box, {name} {'xyz'[axis]}", room + _ON_FACE, (room + _ON_FACE) / UNIT, "m", starts)


def _wide(curve: Curve, order: int) -> Exact:
    """Return fixed-point control points as integers that do not overflow; each is off by at most 1/2."""
    return curve.fixed(order).astype(object)


def _least(bound: float, squares: Exact) -> FloatArray:
    return np.asarray(bound - np.sqrt(squares.astype(np.float64)) / UNIT)


def _accelerations(points: Exact, limits: InputSet, margin: float, starts: FloatArray) -> Iterator[Claim]:
    """Prove that control points (M, 4, 3) keep the margin: cone, ball and half-space of the input set."""
    gravity, most, left = (Fraction(value) * UNIT for value in (limits.gravity, limits.thrust_max, margin))
    # of sine and cosine, correct to their last digit or two, less favourable multiples of 2^-40
    sine, cosine = (math.floor(math.sin(limits.tilt_max) * 2**40) - 1, math.ceil(math.cos(limits.tilt_max) * 2**40) + 1)
    up = points[..., 2] - 1 + math.floor(gravity)
    across = ((abs(points[..., :2]) + 1) ** 2).sum(axis=2)
    room = up * sine - math.ceil(left * 2**40)
    slack = room / 2**40 - np.sqrt(across.astype(np.float64)) * (cosine / 2**40)
    yield _claim(
        "acceleration, tilt_max", _sign(room) * room * room - across * cosine * cosine, slack / UNIT, "m/s^2", starts
    )
    thrust = across + (up + 3) ** 2
    bound = math.floor(most - left)
    slack = bound - np.sqrt(thrust.astype(np.float64))
    yield _claim("acceleration, thrust_max", bound * abs(bound) - thrust, slack / UNIT, "m/s^2", starts)
    room = up - math.ceil(Fraction(limits.thrust_min) * UNIT + left)
    yield _claim("acceleration, thrust_min", room, room / UNIT, "m/s^2", starts)


def _sign(values: Exact) -> Exact:
    return np.where(values < 0, -1, 1).astype(object)


def _claim(name: str, exact: Exact, slack: Exact | FloatArray, unit: str, starts: FloatArray) -> Claim:
    """Return the claim of the worst control point; the integers `exact` decide its sign, `slack` gives its size."""
    worst = np.unravel_index(int(np.argmin(exact)), exact.shape)
    size = abs(float(slack[worst]))
    return Claim(name, size if exact[worst] >= 0 else -max(size, math.ulp(0.0)), unit, float(starts[worst[0]]))
