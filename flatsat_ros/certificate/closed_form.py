"""The certificate that needs no solver: the closed form of the paper's Proposition 1 for the plain hold."""

from __future__ import annotations

from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.lowered import lowered
from flatsat_ros.certificate.lyapunov import closed_form_block, hold_gain_interval
from flatsat_ros.law.input_set import InputSet


def closed_form_certificate(limits: InputSet, rate: float, period: float, name: str) -> Certificate:
    """Return the certificate with P of alpha, rho = r_in^2 and eps = rho/alpha, neither verified nor cross-checked.

    All is tight, so that claims are lowered where rounding makes them too large.

    Args:
        limits: the input set V_c; r_in is the radius of the largest ball around 0 in it.
        rate: alpha, 1/s.
        period: h, s, for which a command is held, without lag and delay.
        name: what the certificate is called.

    Raises:
        FlatsatError: no gain keeps V from growing at this rate and period.
    """
    ball, (low, high) = limits.inner_radius**2, hold_gain_interval(rate, period)
    block = closed_form_block(rate)
    return lowered(Certificate(name, limits, rate, block, ball, ball / rate, period, low, high))[0]
