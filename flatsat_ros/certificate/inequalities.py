"""The inequalities of the ideal loop: the law on a drone that knows its state, with its lag and delay."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from flatsat_ros.certificate import lyapunov
from flatsat_ros.certificate.enclosures import decimal
from flatsat_ros.certificate.exact import definite, inner_radius, integers, rationals, semidefinite, signed, spare

if TYPE_CHECKING:
    from flatsat_ros.certificate.certificate import Certificate

# Smallest eigenvalue, relative to the largest, of a matrix that counts as positive definite: below, the rounding of
# the controller's floating-point numbers would matter.
_DEFINITE = Fraction(1, 10**12)


def ideal_margins(certificate: Certificate) -> dict[str, float]:
    """Return by how much, relatively, each inequality holds; negative ones and NaN fail. Their signs are exact."""
    timing, robust = certificate.timing, certificate.robust
    axes = list(zip(certificate.blocks, certificate.loops, (" for x, y", " for z"), strict=True))
    if robust is None and certificate.block_vertical is None and certificate.loop_vertical is None:
        axes = [(certificate.block, certificate.loops[0], "")]
    margins = {}
    for block, loop, axis in axes:
        for name, matrix in (("P", block), ("W", loop))[: 1 if timing.immediate else 2]:
            values = np.linalg.eigvalsh(matrix)
            largest = float(abs(values).max())
            slack = float(values[0]) / largest - float(_DEFINITE) if largest > 0.0 else 0.0
            holds = definite(rationals(matrix), _DEFINITE)
            margins[f"{name} is positive definite{axis}"] = signed(slack, holds)
    if min(margins.values()) <= 0.0:
        return margins
    ball, level = decimal(certificate.ball), decimal(certificate.level)
    radius = inner_radius(certificate.limits)
    margins |= {
        "the ball |v|^2 <= rho lies in the input set": signed(
            1.0 - math.sqrt(certificate.ball) / float(radius), ball <= radius**2
        ),
        "gain_min <= 1": 1.0 - certificate.gain_min,
        "1 <= gain_max": certificate.gain_max - 1.0,
    }
    for number, (block, loop, axis) in enumerate(axes):
        exact, rate, h = rationals(block), decimal(certificate.rate), decimal(certificate.period)
        margins[f"A'P + P A - 2 P B B'P + alpha P <= 0{axis}"] = signed(
            -lyapunov.decay_residual(block, certificate.rate), semidefinite(-lyapunov.decay_matrix(exact, rate))
        )
        for name, matrix in (("V", block), ("W", loop))[: 1 if timing.immediate else 2]:
            row = timing.feedback(exact)[0] if matrix is loop else exact[1]
            margins[f"{name} <= eps implies |B'P xi|^2 <= rho{axis}"] = signed(
                1.0 - certificate.level * lyapunov.feedback_slope(matrix, block) / certificate.ball,
                semidefinite(ball * rationals(matrix) - level * np.outer(row, row)),
            )
        for gain, name in ((certificate.gain_min, "gain_min"), (certificate.gain_max, "gain_max")):
            if timing.immediate:
                # over what decays in a period: however short that is, growth must not pass for rounding
                growth = lyapunov.hold_growth(block, certificate.period, gain) / (certificate.rate * certificate.period)
                powers, _ = integers(lyapunov.hold_powers(exact, h, decimal(gain)))
                holds = all(semidefinite(-each) for each in lyapunov.hold_matrices(powers))
                margins[f"V does not grow during a period at {name}{axis}"] = signed(-growth, holds)
            else:
                growth = timing.contraction(loop, block, gain) - 1.0
                holds = timing.falls(loop, block, gain)
                margins[f"W does not grow over a period at {name}{axis}"] = signed(-growth, holds)
            if robust is not None:
                growth = robust.growth(timing, number, loop, block, gain)
                holds = robust.holds(timing, number, loop, block, gain)
                margins[f"disturbed, V <= max(V, s) after a period at {name}{axis}"] = signed(-growth, holds)
    if robust is not None:
        margins |= robust.margins(certificate.limits, certificate.blocks)
        margins["s <= eps"] = spare(decimal(robust.floor), level)
    return margins
