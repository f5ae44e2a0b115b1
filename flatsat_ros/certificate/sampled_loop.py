"""The loop that really runs: sampled, with a lag and a delay between the command and the acceleration.

Per axis, with the command u held for a period h,

    p' = v,   v' = a,   tau a' = u(t - d) - a        (a = u(t - d) without lag),

and u = -k B'P (p, v) with an applied gain k that the saturation and the adaptation move from period to period. The
exact discretisation has the state z = (p, v[, a], u_1, ..., u_m), n entries: u_j is the command that was given j
periods ago and has not yet had all of its effect. A matrix W with M(k)' W M(k) <= W at the ends of a gain interval,
M(k) = F - k G K, proves that z'W z never grows for whatever gains inside the interval, because M(k)' W M(k) is convex
in k.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import require, require_not_negative, require_positive
from flatsat_ros.certificate.enclosures import Numbers, decimal
from flatsat_ros.certificate.exact import Rationals, decaying, product, rationals, semidefinite
from flatsat_ros.certificate.lyapunov import largest_relative_eigenvalue

# A delay this close to whole periods, relative to one, is whole: 0.3 s are three periods of 0.1 s.
_WHOLE = 1e-9

# Commands under way; more make loops that no solver handles and no design is for.
_DEPTH = 40


def require_few_under_way(name: str, delay: float, period: float) -> None:
    """Refuse a delay of more periods, all in s, than commands can be under way; the name is for the text.

    Raises:
        FlatsatError: it is longer.
    """
    most = _DEPTH * period
    require(delay <= most, name, delay, "s", f"at most {most:.6g} s, {_DEPTH} periods")


@dataclass(frozen=True)
class Timing:
    """When a command becomes an acceleration.

    Attributes:
        period: h, s; commands are held in between.
        lag: tau, s, first-order lag of the achieved acceleration; 0 for none.
        delay: d, s, transport delay, any number of periods and parts of one; 0 for none.

    Raises:
        FlatsatError: a value is negative, not finite, or the delay is longer than 40 periods.
    """

    period: float
    lag: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "period", require_positive("period (h)", self.period, "s"))
        for name, symbol in (("lag", "tau"), ("delay", "d")):
            object.__setattr__(self, name, require_not_negative(f"{name} ({symbol})", getattr(self, name), "s"))
        require_few_under_way("delay (d)", self.delay, self.period)
        least = 1e-3 * self.period
        require(
            self.lag == 0.0 or self.lag >= least, "lag (tau)", self.lag, "s", f"0 or at least {least:.6g} s (h/1000)"
        )

    @property
    def immediate(self) -> bool:
        """Whether the acceleration is the held command itself, with neither lag nor delay."""
        return self.lag == 0.0 and self.delay == 0.0

    @property
    def size(self) -> int:
        """Number n of entries of z for one axis."""
        whole, part = self._split()
        return 2 + (self.lag > 0.0) + whole + (part > 0.0)

    def _split(self) -> tuple[int, float]:
        """Return the delay as whole periods and the rest, s."""
        periods = self.delay / self.period
        whole = math.floor(periods + _WHOLE)
        rest = periods - whole
        return whole, rest * self.period if rest > _WHOLE else 0.0

    @cached_property
    def transition(self) -> tuple[FloatArray, FloatArray]:
        """F (n, n) and G (n, 1) with z+ = F z + G u, one axis, to rounding; read-only."""
        whole, part = self._split()
        early, late = (self._hold(time, self.lag, self._gone(time)) for time in (part, self.period - part))
        F, G = self._assembled(whole, part > 0.0, early, late)
        F.setflags(write=False)
        G.setflags(write=False)
        return F, G

    @cached_property
    def corners(self) -> list[tuple[Rationals, Rationals]]:
        """Pairs F and G of fractions in whose convex hull the exact pair is.

        An entry is a linear function of what is left of the lag's answer after the part of the delay, and one of what
        is left after the rest of the period; both are known between two numbers.
        """
        period, lag = decimal(self.period), decimal(self.lag)
        whole, rounded = self._split()
        part = decimal(self.delay) - whole * period if rounded > 0.0 else Fraction(0)
        times = part, period - part
        one = (Fraction(1),)
        left = [decaying(time / lag) if lag and time else one for time in times]
        return [
            self._assembled(
                whole, part > 0, *(self._hold(t, lag, 1 - rest) for t, rest in zip(times, rests, strict=True))
            )
            for rests in itertools.product(*left)
        ]

    def _assembled(
        self, whole: int, parted: bool, first: tuple[Numbers, Numbers], second: tuple[Numbers, Numbers]
    ) -> tuple[Numbers, Numbers]:
        """Return F and G from what happens until the part of the delay is over, and from then on."""
        (early, early_input), (late, late_input) = first, second
        body, size = len(late), self.size
        F, G = np.zeros((size, size), late.dtype), np.zeros((size, 1), late.dtype)
        F[:body, :body] = late @ early
        # acceleration is driven by the command of whole + 1 periods ago until the part is over, then by the next one
        columns = np.hstack([G, F[:, body:]])
        columns[:body, [whole]] += late_input
        if parted:
            columns[:body, [whole + 1]] += late @ early_input
        if size > body:
            columns[body:, : size - body] = np.eye(size - body, dtype=int)
        G, F[:, body:] = columns[:, :1], columns[:, 1:]
        return F, G

    def _gone(self, time: float) -> float:
        """Return the share of the lag's step response that is over."""
        return -math.expm1(-time / self.lag) if self.lag > 0.0 else 1.0

    @staticmethod
    def _hold(time: Numbers, lag: Numbers, gone: Numbers) -> tuple[Numbers, Numbers]:
        """Return the transition of (p, v[, a]) and its input over a time in which the drive is constant."""
        if not lag:
            return np.array([[1, time], [0, 1]]), np.array([[time**2 / 2], [time]])
        late = time - lag * gone
        return (
            np.array([[1, time, lag * late], [0, 1, lag * gone], [0, 0, 1 - gone]]),
            np.array([[time**2 / 2 - lag * late], [late], [gone]]),
        )

    def closed_loop(self, block: FloatArray, gain: float) -> FloatArray:
        """Return M(k) (n, n), z+ = M(k) z, for one axis with u = -k B'P (p, v).

        Args:
            block: P (2, 2) of the axis.
            gain: applied gain k.
        """
        F, G = self.transition
        return np.asarray(F - gain * G @ self.feedback(block))

    def feedback(self, block: Numbers) -> Numbers:
        """Return K (1, n), with u = -k K z: B'P on (p, v), zero on the rest of z; block is P (2, 2) of the axis."""
        return np.concatenate([block[1], np.zeros(self.size - 2, dtype=int)])[np.newaxis]

    def contraction(self, matrix: FloatArray, block: FloatArray, gain: float) -> float:
        """Return the largest z+'W z+ / z'W z over one period at gain k; convex in k.

        Args:
            matrix: W (n, n), positive definite.
            block: P (2, 2).
            gain: applied gain k.
        """
        step = self.closed_loop(block, gain)
        return largest_relative_eigenvalue(step.T @ matrix @ step, matrix)

    def falls(self, matrix: FloatArray, block: FloatArray, gain: float) -> bool:
        """Tell whether z'W z does not grow over one period at gain k, exactly; the arguments are as for `contraction`.

        M'W M is convex in M, so that what holds at the corners holds in between.
        """
        W, row, k = rationals(matrix), self.feedback(rationals(block)), decimal(gain)
        steps = (F - k * product(G, row) for F, G in self.corners)
        return all(semidefinite(W - product(step.T, W, step)) for step in steps)

    def advance(self, z: FloatArray, command: FloatArray) -> FloatArray:
        """Return the state one period later, all three axes.

        Args:
            z: (N, n, 3) position m, velocity m/s, achieved acceleration (if there is a lag) and past commands, m/s^2.
            command: (N, 3) v, m/s^2, given at the beginning of the period.

        Returns:
            (N, n, 3).
        """
        F, G = self.transition
        # Term by term, drones last: as fast as a product of matrices, and the same to the last digit on all processors.
        # Where a loop at the edge of stability goes depends on that digit.
        terms = np.ascontiguousarray(z.transpose(1, 2, 0))
        following = F[:, 0, np.newaxis, np.newaxis] * terms[0]
        for j in range(1, self.size):
            following += F[:, j, np.newaxis, np.newaxis] * terms[j]
        following += G[:, :, np.newaxis] * command.T
        return np.asarray(following.transpose(2, 0, 1))

    def follow(self, rest: FloatArray, command: FloatArray) -> FloatArray:
        """Return what z holds beyond position and velocity, one period later.

        Nothing measures it: it is the model's, driven by the commands that were sent. Starting at zero means hover.

        Args:
            rest: (N, 3 (n - 2)) achieved acceleration (if there is a lag) and past commands, m/s^2, world frame.
            command: (N, 3) v, m/s^2, world frame, given at the beginning of the period.

        Returns:
            (N, 3 (n - 2)); `numpy.hstack([xi, rest])` is what the sets take.
        """
        kept, new = self._rest_transition
        return np.asarray(rest @ kept + command @ new)

    @cached_property
    def _rest_transition(self) -> tuple[FloatArray, FloatArray]:
        """What leads from the rest of z, and from a command, to the rest one period later: rows of all three axes."""
        F, G = self.transition
        kept, new = (np.asarray(np.kron(part.T, np.eye(3)), dtype=np.float64) for part in (F[2:, 2:], G[2:]))
        return kept, new
