"""What a certificate says about disturbances.

    xi' = A xi + B v + E w,   w'w <= 1,   E = diag(drift, drift, drift_z, push, push, push_z)

The disturbance w is any function of time within the unit ball. Where it acts as the input does, on the acceleration, it
is called matched; E scales it there by `push`, m/s^2. Where no input acts, on the velocity with which the position
moves, it is unmatched; E scales it there by `drift`, m/s.

In continuous time Q A' + A Q - 2 B B' + beta Q + E E'/beta <= 0, Q = P^-1, makes V' <= beta (w'w - V) wherever the
applied gain is at least 1 (arXiv 2308.15177, eq. 32b, whose relation is not printed), so that E_w = { V <= 1 } is never
left and attracts.

The sampled loop gathers over a period an additional d with d d' <= D = h int_0^h e^(As) E E' e^(A's) ds whatever w does
(Cauchy-Schwarz). With M(k) Q M(k)'/(1 - p) + D/(p s) <= Q for some 0 < p < 1 at the ends of the gain interval, and by
convexity inside it, V+ <= max(V, s) at the samples: { V <= s } takes the place of E_w. Because the three axes share p,
V_h+ <= max(V_h, s) and V_v+ <= max(V_v, s) too.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from flatsat_ros.base.arrays import FloatArray, finite_array, require_each
from flatsat_ros.base.errors import LARGEST, SMALLEST, require, require_positive
from flatsat_ros.certificate.enclosures import Numbers, decimal, sine
from flatsat_ros.certificate.exact import product, rationals, semidefinite, signed, spare
from flatsat_ros.certificate.lyapunov import decay_matrix, largest_relative_eigenvalue
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.law.input_set import InputSet


@dataclass(frozen=True, eq=False)
class Robust:
    """The robust part of a certificate; of the pairs the first number is for x and for y, the second for z.

    Attributes:
        rate: beta, 1/s.
        drift: (2,) largest unmatched disturbance, m/s, at least 0: E E' has its square on the positions.
        push: (2,) largest matched disturbance, m/s^2, at least 0: E E' has its square on the velocities.
        box: (2,) vbar, m/s^2: the box |v_1|, |v_2| <= vbar_1, |v_3| <= vbar_3 lies in V_c and contains v0 wherever the
            state is in E_w.
        floor: s, a level of V: the sampled loop never leaves the set V <= s, nor any larger level set up to eps.
        share: p, in (0, 1): the part of the room for growth over a period that is left to the disturbance.

    Raises:
        FlatsatError: a value is negative, not finite, or has the wrong shape.
    """

    rate: float
    drift: FloatArray
    push: FloatArray
    box: FloatArray
    floor: float
    share: float

    def __post_init__(self) -> None:
        for name, unit in (("rate", "1/s"), ("floor", ""), ("share", "")):
            object.__setattr__(self, name, require_positive(f"robust.{name}", getattr(self, name), unit))
        require(self.share < 1.0, "robust.share", self.share, "", "below 1")
        for name, unit in (("drift", "m/s"), ("push", "m/s^2"), ("box", "m/s^2")):
            pair = np.array(finite_array(f"robust.{name}", getattr(self, name), 2))
            require(pair.shape == (2,), f"shape of robust.{name}", pair.shape, "", "(2,)")
            least = SMALLEST if name == "box" else 0.0
            valid = f"from {least:g} to {LARGEST:g}"
            require_each((pair >= least) & (pair <= LARGEST), f"an entry of robust.{name}", pair, unit, valid)
            pair.setflags(write=False)
            object.__setattr__(self, name, pair)

    def margins(self, limits: InputSet, blocks: tuple[FloatArray, FloatArray]) -> dict[str, float]:
        """Return by how much, relatively, each inequality of the continuous loop holds; negative ones fail.

        Args:
            limits: V_c.
            blocks: P (2, 2) of x and y, and of z.
        """
        corners = np.array([(self.box[0], self.box[0], sign * self.box[1]) for sign in (1.0, -1.0)])
        wide, high = rationals(self.box)
        gravity, least = decimal(limits.gravity), sine(decimal(limits.tilt_max)) ** 2
        low = gravity - high
        within = low >= max(decimal(limits.thrust_min), 0) and 2 * wide**2 <= (2 * wide**2 + low**2) * least
        within = within and 2 * wide**2 + (gravity + high) ** 2 <= decimal(limits.thrust_max) ** 2
        slack = 1.0 - float(limits.gauge(corners).max())
        margins = {"the box |v_i| <= vbar_i lies in the input set": signed(slack, within)}
        for axis, (block, name) in enumerate(zip(blocks, ("x, y", "z"), strict=True)):
            slack = -robust_residual(block, self.rate, self.drift[axis], self.push[axis])
            exact = rationals(block), decimal(self.rate), decimal(self.drift[axis]), decimal(self.push[axis])
            holds = semidefinite(-robust_matrix(*exact))
            margins[f"Q A' + A Q - 2 B B' + beta Q + E E'/beta <= 0 for {name}"] = signed(slack, holds)
            reach, most = decimal(block[1, 1]), rationals(self.box)[axis] ** 2
            margins[f"V <= 1 implies v0 in the box for {name}"] = spare(reach, most)
        return margins

    def to_document(self) -> dict[str, Any]:
        """Return the values as plain numbers and lists, the form of the YAML file."""
        pairs = {name: getattr(self, name).tolist() for name in ("drift", "push", "box")}
        return {"rate": self.rate, **pairs, "floor": self.floor, "share": self.share}

    def growth(self, timing: Timing, axis: int, matrix: FloatArray, block: FloatArray, gain: float) -> float:
        """Return the largest eigenvalue of M Q M'/(1 - p) + D/(p s) - Q relative to Q: at most 0 for V+ <= max(V, s).

        Args:
            timing: of the loop.
            axis: 0 for x and y, 1 for z.
            matrix: W (n, n), Q = W^-1.
            block: P (2, 2).
            gain: applied gain k.
        """
        step, spread = timing.closed_loop(block, gain), np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        gathered = gathered_disturbance(timing, self.drift[axis], self.push[axis])
        grown = step @ spread @ step.T / (1.0 - self.share) + gathered / (self.share * self.floor)
        return largest_relative_eigenvalue(grown, spread) - 1.0

    def holds(self, timing: Timing, axis: int, matrix: FloatArray, block: FloatArray, gain: float) -> bool:
        """Tell whether V+ <= max(V, s), exactly; the arguments are those of `growth`.

        M Q M'/(1 - p) + D/(p s) <= Q is, after a congruence with W and by Schur's complement, that

            [[W - W D W/(p s), W M], [M'W, (1 - p) W]]

        is positive semidefinite. It is affine in M, so that what holds at the corners holds in between.
        """
        W, row, k = rationals(matrix), timing.feedback(rationals(block)), decimal(gain)
        share, floor = decimal(self.share), decimal(self.floor)
        gathered = gathered_disturbance(timing, decimal(self.drift[axis]), decimal(self.push[axis]))
        room = W - product(W, gathered, W) * (1 / (share * floor))
        for F, G in timing.corners:
            moved = product(W, F - k * product(G, row))
            if not semidefinite(np.block([[room, moved], [moved.T, (1 - share) * W]])):
                return False
        return True


def robust_matrix(block: Numbers, rate: Numbers, drift: Numbers, push: Numbers) -> Numbers:
    """Return P (Q A' + A Q - 2 B B' + beta Q + E E'/beta) P (2, 2) for one axis; of fractions it is exact.

    Args:
        block: P (2, 2) of the axis, Q = P^-1.
        rate: beta, 1/s.
        drift: unmatched disturbance, m/s.
        push: matched disturbance, m/s^2.
    """
    shaken = drift**2 * np.outer(block[0], block[0]) + push**2 * np.outer(block[1], block[1])
    return decay_matrix(block, rate) + shaken / rate


def robust_residual(block: FloatArray, rate: float, drift: float, push: float) -> float:
    """Return the largest eigenvalue of Q A' + A Q - 2 B B' + beta Q + E E'/beta, relative to beta Q, for one axis.

    The arguments are those of `robust_matrix`.
    """
    return largest_relative_eigenvalue(robust_matrix(block, rate, drift, push), rate * block)


def gathered_disturbance(timing: Timing, drift: Numbers, push: Numbers) -> Numbers:
    """Return D (n, n) of one axis: whatever w does in a period, what it adds to the state, d, has d d' <= D.

    Args:
        timing: of the loop; n entries of its state.
        drift: unmatched disturbance, m/s; D of fractions is exact.
        push: matched disturbance, m/s^2.
    """
    exact = isinstance(drift, Fraction)
    h, e, m = decimal(timing.period) if exact else timing.period, drift**2, push**2
    gathered = np.zeros((timing.size, timing.size), dtype=object if exact else np.float64)
    gathered[:2, :2] = h * np.array([[e * h + m * h**3 / 3, m * h**2 / 2], [m * h**2 / 2, m * h]])
    return gathered
