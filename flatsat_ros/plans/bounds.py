"""What every reference of a plan keeps at all times, and its proof with integers.

What needs room in the input set is what a reference asks the law for, f = a + drag v + lead (j + drag a), its
acceleration with the drag and the lag of the drones that a certificate is made for (`flight.preview`), or the
acceleration alone where nothing is known of them. It is linear in the control points of the reference, as any
derivative, and lies, between two knots, in the convex hull of its own Bezier control points. All limits are
convex sets: what holds at these points holds at all times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array
from flatsat_ros.base.errors import LARGEST, refusal, require, require_fields, require_not_negative, require_positive
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans.curve import UNIT, Curve, Exact

_ON_FACE = UNIT // 10**6  # 1 um: start and goal may lie on a face of the box, and rounding moves points

_LED_MAX = 10.0  # 1/s and s, of drag and lead

NAMES = ("margin", "acceleration", "jerk", "snap", "speed", "box")


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
        margin: distance that f keeps from the boundary of the input set, m/s^2.
        jerk_max: m/s^3.
        snap_max: m/s^4.
        lower, upper: (3,) m, corners of the box that the references stay in, to 1 um.
        speed_max: m/s; None for no limit.
        acceleration_max: m/s^2, within what the margin leaves; None for no limit beside.
        thrust_max, thrust_min: m/s^2, of the room in the input set that the margin is kept in; None for the set's own.
        drag: 1/s, that f counts with, horizontal and vertical; 0 where it is the acceleration alone.
        lead: s, likewise.

    Raises:
        FlatsatError: a value is not finite or, but for the drag, out of range, or the box is empty.
    """

    margin: float
    jerk_max: float
    snap_max: float
    lower: FloatArray
    upper: FloatArray
    speed_max: float | None = None
    acceleration_max: float | None = None
    thrust_max: float | None = None
    thrust_min: float | None = None
    drag: tuple[float, float] = (0.0, 0.0)
    lead: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_fields(self, require_positive, margin="m/s^2", jerk_max="m/s^3", snap_max="m/s^4")
        for name, unit, check in (
            ("speed_max", "m/s", require_positive), ("acceleration_max", "m/s^2", require_positive),
            ("thrust_max", "m/s^2", require_positive), ("thrust_min", "m/s^2", require_not_negative),
        ):  # fmt: skip
            if getattr(self, name) is not None:
                require_fields(self, check, **{name: unit})
        for name in ("lower", "upper"):
            corner = finite_array(name, getattr(self, name), 3)
            require(corner.shape == (3,), f"shape of {name}", corner.shape, "", "(3,)")
            require(float(np.abs(corner).max()) <= LARGEST, name, corner.tolist(), "m", f"within {LARGEST:g} m")
            object.__setattr__(self, name, corner)
        for name, unit, least in (("drag", "1/s", -_LED_MAX), ("lead", "s", 0.0)):
            pair = finite_array(name, getattr(self, name))
            require(pair.shape == (2,), f"shape of {name}", pair.shape, "", "(2,), horizontal and vertical")
            valid = f"from {least:g} to {_LED_MAX:g} {unit}"
            require(all(least <= value <= _LED_MAX for value in pair), name, pair.tolist(), unit, valid)
            object.__setattr__(self, name, tuple(pair.tolist()))
        for axis, low, high in zip("xyz", self.lower.tolist(), self.upper.tolist(), strict=True):
            require(low < high, f"upper {axis} of the box", high, "m", f"above the lower one, {low} m")

    @cached_property
    def asked(self) -> dict[int, list[Fraction]]:
        """The factors of the derivatives in f, by their order, along x, y and z; all of them 0 are left out."""
        drag, lead = ([Fraction(pair[0])] * 2 + [Fraction(pair[1])] for pair in (self.drag, self.lead))
        mixed = [1 + a * b for a, b in zip(drag, lead, strict=True)]
        return {2: mixed} | {order: each for order, each in ((1, drag), (3, lead)) if any(each)}

    def room(self, limits: InputSet) -> InputSet:
        """Return the part of an input set, limits, in which f keeps the margin."""
        most = limits.thrust_max if self.thrust_max is None else min(self.thrust_max, limits.thrust_max)
        least = limits.thrust_min if self.thrust_min is None else max(self.thrust_min, limits.thrust_min)
        return replace(limits, thrust_max=most, thrust_min=least)

    def within(self, limits: InputSet) -> None:
        """Refuse a margin that leaves no acceleration.

        Args:
            limits: the input set V_c.

        Raises:
            FlatsatError: it does not fit the input set.
        """
        radius = self.room(limits).inner_radius
        if not self.margin < radius:
            valid = f"below {radius:.6g} m/s^2, the radius of the ball around hover in the input set"
            raise refusal("margin", self.margin, "m/s^2", valid)

    def claims(self, curve: Curve, limits: InputSet) -> Iterator[Claim]:
        """Yield what is proved about one reference; where a proof fails, with a negative slack.

        Args:
            curve: the reference.
            limits: the input set V_c.
        """
        starts = np.array(curve.knots[:-1]) / 1e6
        asked = curve.fixed_sum(self.asked, "what is asked of the law").astype(object)
        yield from _margins(asked, self.room(limits), self.margin, starts)
        for order, bound, name, unit in (
            (1, self.speed_max, "speed", "m/s"),
            (2, self.acceleration_max, "acceleration", "m/s^2"),
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


def _margins(points: Exact, limits: InputSet, margin: float, starts: FloatArray) -> Iterator[Claim]:
    """Prove that control points (M, K, 3) of f keep the margin: cone, ball and half-space of the input set."""
    gravity, most, left = (Fraction(value) * UNIT for value in (limits.gravity, limits.thrust_max, margin))
    # of sine and cosine, correct to their last digit or two, less favourable multiples of 2^-40
    sine, cosine = (math.floor(math.sin(limits.tilt_max) * 2**40) - 1, math.ceil(math.cos(limits.tilt_max) * 2**40) + 1)
    up = points[..., 2] - 1 + math.floor(gravity)
    across = ((abs(points[..., :2]) + 1) ** 2).sum(axis=2)
    room = up * sine - math.ceil(left * 2**40)
    slack = room / 2**40 - np.sqrt(across.astype(np.float64)) * (cosine / 2**40)
    yield _claim(
        "margin, tilt_max", _sign(room) * room * room - across * cosine * cosine, slack / UNIT, "m/s^2", starts
    )
    thrust = across + (up + 3) ** 2
    bound = math.floor(most - left)
    slack = bound - np.sqrt(thrust.astype(np.float64))
    yield _claim("margin, thrust_max", bound * abs(bound) - thrust, slack / UNIT, "m/s^2", starts)
    room = up - math.ceil(Fraction(limits.thrust_min) * UNIT + left)
    yield _claim("margin, thrust_min", room, room / UNIT, "m/s^2", starts)


def _sign(values: Exact) -> Exact:
    return np.where(values < 0, -1, 1).astype(object)


def _claim(name: str, exact: Exact, slack: Exact | FloatArray, unit: str, starts: FloatArray) -> Claim:
    """Return the claim of the worst control point; the integers `exact` decide its sign, `slack` gives its size."""
    worst = np.unravel_index(int(np.argmin(exact)), exact.shape)
    size = abs(float(slack[worst]))
    return Claim(name, size if exact[worst] >= 0 else -max(size, math.ulp(0.0)), unit, float(starts[worst[0]]))
