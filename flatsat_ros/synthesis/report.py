"""The certificate as a table for the terminal, beside the paper's figures and the loop's worst case."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.lyapunov import closed_form_block, decay_rate
from flatsat_ros.certificate.sets import Sets
from flatsat_ros.law.input_set import InputSet

# below this cap the adaptation has hardly anything to adapt
SMALL_CAP = 1.5


def paper_sets() -> Sets:
    """Return the sets of the paper's Table I, in continuous time."""
    limits, rate = InputSet(1.45 * GRAVITY, math.radians(10.0)), 1.2
    block = closed_form_block(rate)
    return Sets(limits, block, block, rate, rate, limits.inner_radius**2 / rate, 0.5)


def table(certificate: Certificate, start: FloatArray | None = None) -> str:
    """Return the lines to print.

    Args:
        certificate: a verified one.
        start: (..., 6) start errors that it was asked to cover.
    """
    limits, provenance = certificate.limits, certificate.provenance
    lines = [f"certificate {certificate.name}"]
    lines += _rows(
        ("thrust limit T_max", f"{limits.thrust_max:.6g} m/s^2 ({limits.thrust_max / limits.gravity:.4g} g)"),
        ("tilt limit eps_max", f"{limits.tilt_max:.6g} rad ({math.degrees(limits.tilt_max):.4g} deg)"),
        ("decay rate alpha", f"{certificate.rate:.6g} 1/s"),
        ("P, per axis" if certificate.block_vertical is None else "P of x, y", _matrix(certificate.block)),
    )
    if certificate.block_vertical is not None:
        lines += _rows(("P of z", _matrix(certificate.block_vertical)))
    lines += _rows(
        ("input ball rho", f"{certificate.ball:.7g} m^2/s^4"),
        ("level eps", f"{certificate.level:.7g}"),
    )
    lines += _loop(certificate) + _sets(certificate) + _robust(certificate)
    if start is not None:
        kappa = float(certificate.sets.kappa(start).min())
        rate = min(decay_rate(block, kappa) for block in certificate.blocks)
        lines += _rows(("start errors covered", f"with kappa = {kappa:.4g}; rate at kappa, undelayed: {rate:.4g} 1/s"))
    check = provenance.get("cross_check", {})
    lines += _rows(("solver", f"{provenance.get('solver', 'not stated')}, {check.get('status', 'not stated')}"))
    if "reason" in check:
        lines += _rows(("why not", check["reason"]))
    if "relative_tolerance" in check:
        lines += _rows(("agrees with closed form", f"to {check['relative_tolerance']:.0e}, relative"))
    for claim, share in provenance.get("lowered_for_rounding", {}).items():
        lines += _rows((f"{claim} weaker by", f"{share:.1e}, relative: what rounding did to it"))
    return "\n".join([*lines, *margins(certificate.verify())])


def margins(proved: Mapping[str, float]) -> list[str]:
    """Return the lines with every inequality's margin."""
    return ["  relative margins (0: tight)", *(f"    {value:<10.3g}{name}" for name, value in proved.items())]


def _loop(certificate: Certificate) -> list[str]:
    from flatsat_ros.synthesis.gain_cap import worst_case  # scipy takes half a second to import

    timing, cap = certificate.timing, certificate.gain_max
    worst = min((worst_case(timing, block, cap) for block in certificate.blocks), key=lambda case: case.switching)
    alternation = f"with 1: {worst.high} periods of it, {worst.low} of 1" if worst.low else "to itself: none is worse"
    rows = [
        ("period h, lag, delay", f"{timing.period:.6g} s, {timing.lag:.6g} s, {timing.delay:.6g} s"),
        ("gain interval", f"[{certificate.gain_min:.6g}, {cap:.6g}], proved for gains that change every period"),
        ("unstable alternating", f"from {worst.switching:.6g} on {alternation}"),
        ("unstable constant gain", f"from {worst.constant:.6g} on: no safe cap"),
    ]
    if cap < SMALL_CAP:
        rows.append(("WARNING", f"the cap is below {SMALL_CAP}, close to 1: a smaller rate or a shorter period helps"))
    return _rows(*rows)


def _sets(certificate: Certificate) -> list[str]:
    sets, paper = certificate.sets, paper_sets()
    beyond = max(1.0, 1.0 / certificate.gain_min) ** 6
    rows = [
        ("volume of E", sets.volume_ellipsoid, paper.volume_ellipsoid, "m^6/s^3"),
        ("volume of D", sets.volume_larger, paper.volume_larger, "m^6/s^3"),
        (f"D to kappa = {certificate.gain_min:.4g}", sets.volume_larger * beyond, 64 * paper.volume_larger, "m^6/s^3"),
        ("largest offset from rest", sets.rest_radius, paper.rest_radius, "m"),
        ("rate", certificate.rate, 1.2, "1/s"),
    ]
    lines = ["  from where it is certified" + ("" if certificate.loop is None else ", starting from hover")]
    lines += _rows(("", f"{'here':<11} {'paper':<11} ratio"))
    return lines + _rows(
        *((name, f"{own:<11.4g} {other:<11.4g} {own / other:<9.4g} {unit}") for name, own, other, unit in rows)
    )


def _robust(certificate: Certificate) -> list[str]:
    robust = certificate.robust
    if robust is None:
        matched = certificate.limits.inner_radius / 2.0
        return _rows(("disturbance", f"in continuous time a push of {matched:.4g} m/s^2 cannot move it out of E"))
    spread = np.sqrt(robust.floor / np.array([certificate.block[0, 0], certificate.blocks[1][0, 0]]))
    return _rows(
        ("drift of x and y, of z", "{:.6g}, {:.6g} m/s".format(*robust.drift)),
        ("push on x and y, on z", "{:.6g}, {:.6g} m/s^2".format(*robust.push)),
        ("rate beta", f"{robust.rate:.8g} 1/s"),
        ("box vbar", "{:.6g}, {:.6g} m/s^2".format(*robust.box)),
        ("Q of x, y", _matrix(np.linalg.inv(certificate.block))),
        ("Q of z", _matrix(np.linalg.inv(certificate.blocks[1]))),
        ("never left once inside", f"V <= {robust.floor:.6g} at samples (1 in continuous time, E_w)"),
        ("its reach at rest", "{:.4g} m in x, y; {:.4g} m in z".format(*spread)),
    )


def _matrix(matrix: ArrayLike) -> str:
    return "[[{:.7g}, {:.7g}], [{:.7g}, {:.7g}]]".format(*np.ravel(matrix))


def _rows(*rows: tuple[str, str]) -> list[str]:
    return [f"  {label:<26}{value}" for label, value in rows]
