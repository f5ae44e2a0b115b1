"""One page about a certificate: the input set, the sets in the state space, the gain cap over h, the contraction."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from flatsat_ros.base.colours import LIMIT, PICTURES, widths
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.files import replacing
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.lyapunov import hold_growth
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.certificate.sets import Sets
from flatsat_ros.synthesis.gain_cap import circle_limit, gain_cap
from flatsat_ros.synthesis.report import paper_sets

_LAGS = (0.0, 0.05, 0.1, 0.15)  # s
_PERIODS = np.geomspace(0.005, 0.2, 16)  # s
_RAYS = 721
_BESIDE = 4.0  # times as large as the sets


@mpl.rc_context(PICTURES)
def draw(certificate: Certificate, target: Path) -> None:
    """Draw the page.

    Args:
        certificate: a verified one.
        target: PNG, PDF or SVG file to write.

    Raises:
        FlatsatError: the file cannot be written.
    """
    figure = Figure(figsize=(14.0, 9.0), layout="constrained")
    axes = figure.subplots(2, 3)
    figure.suptitle(f"certificate {certificate.name}")
    _input_set(axes[0, 0], certificate)
    _slice(axes[0, 1], certificate, 0, "x")
    _slice(axes[0, 2], certificate, 2, "z")
    _starts(axes[1, 0], certificate)
    _caps(axes[1, 1], certificate)
    _contraction(axes[1, 2], certificate)
    with replacing(target) as file:
        figure.savefig(file, dpi=120)


def _curves(sets: Sets) -> list[tuple[float, str, str]]:
    """Return the scales of D to draw, with label and style."""
    curves = [(1.0, "D", "C0-")]
    if sets.gain_min < 0.999:
        curves.append((1.0 / sets.gain_min, rf"$\kappa$ = {sets.gain_min:.3g}", "C0:"))
    return curves


def _input_set(axes: Axes, certificate: Certificate) -> None:
    """V_c in the plane of v_1 and v_3, with the images of the sets under v0."""
    limits, sets = certificate.limits, certificate.sets
    angle = np.linspace(0.0, 2.0 * math.pi, _RAYS)
    ray = np.stack([np.cos(angle), np.zeros(_RAYS), np.sin(angle)], axis=1)
    edge = ray / limits.gauge(ray)[:, np.newaxis]
    axes.fill(edge[:, 0], edge[:, 2], color="0.9", label="$V_c$")
    top = min(limits.gravity - limits.thrust_min, limits.thrust_max - limits.gravity)
    b = np.concatenate([np.linspace(-top, top, _RAYS), np.linspace(top, -top, _RAYS)])
    a = sets.width(np.abs(b)) * np.repeat([1.0, -1.0], _RAYS)
    axes.plot(a, b, "C0-", label="image of D")
    reach = math.sqrt(sets.level)
    axes.plot(
        reach * math.sqrt(sets.slope_horizontal) * ray[:, 0],
        reach * math.sqrt(sets.slope_vertical) * ray[:, 2],
        "C1-",
        label="image of E",
    )
    axes.set(xlabel="$v_1$, m/s²", ylabel="$v_3$, m/s²", title="input set", aspect="equal")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, fontsize="small")


def _slice(axes: Axes, certificate: Certificate, axis: int, name: str) -> None:
    """The sets in the plane of one position and its velocity, everything else 0."""
    angle = np.linspace(0.0, 2.0 * math.pi, _RAYS)
    states = np.zeros((_RAYS, 6))
    states[:, axis], states[:, axis + 3] = np.cos(angle), np.sin(angle)
    _rays(axes, certificate.sets, states, (axis, axis + 3))
    hover = "" if certificate.loop is None else ", from hover"
    axes.set(xlabel=f"{name}, m", ylabel=rf"$\dot {name}$, m/s", title=f"sets along {name}{hover}")
    axes.legend(loc="upper right", fontsize="small")


def _starts(axes: Axes, certificate: Certificate) -> None:
    """Positions from which a drone at rest starts inside the sets."""
    angle = np.linspace(0.0, 2.0 * math.pi, _RAYS)
    states = np.zeros((_RAYS, 6))
    states[:, 0], states[:, 2] = np.cos(angle), np.sin(angle)
    _rays(axes, certificate.sets, states, (0, 2))
    axes.set(xlabel="x, m", ylabel="z, m", title="starts at rest")


def _rays(axes: Axes, sets: Sets, states: np.ndarray, shown: tuple[int, int]) -> None:
    """Draw where rays leave the sets, and the paper's ellipsoid unless these would be too small to see beside it."""
    for scale, label, style in _curves(sets):
        edge = states * (scale / sets.scale_larger(states))[:, np.newaxis]
        axes.plot(edge[:, shown[0]], edge[:, shown[1]], style, label=label)
    axes.locator_params(axis="x", nbins=6)
    own, printed = (states / which.scale_ellipsoid(states)[:, np.newaxis] for which in (sets, paper_sets()))
    axes.plot(own[:, shown[0]], own[:, shown[1]], "C1-", label="E")
    if np.abs(printed).max() < _BESIDE * np.abs(own).max():
        axes.plot(printed[:, shown[0]], printed[:, shown[1]], "C7--", label="E, paper's Table I")


def _caps(axes: Axes, certificate: Certificate) -> None:
    """The gain cap over the period for several lags, at the certificate's delay."""

    def cap(period: float, lag: float) -> float:
        try:
            timing = Timing(period, lag, certificate.delay)
            if timing.immediate:
                return gain_cap(timing, certificate.block).gain_max
            return circle_limit(timing, certificate.block)
        except FlatsatError:
            return math.nan

    for lag in _LAGS:
        caps = [cap(float(period), lag) for period in _PERIODS]
        label = f"lag {1e3 * lag:.0f} ms" if lag or certificate.delay else "no lag, by V itself"
        axes.loglog(_PERIODS, caps, label=label)
    axes.plot(certificate.period, certificate.gain_max, "ko", label="this certificate")
    title = f"largest provable gain, delay {1e3 * certificate.delay:.3g} ms"
    axes.set(xlabel="period h, s", ylabel=r"$\gamma_\mathrm{max}$", title=title)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")


def _contraction(axes: Axes, certificate: Certificate) -> None:
    """What a period leaves of V, or of W, over the applied gain."""
    timing, low, high = certificate.timing, certificate.gain_min, certificate.gain_max
    gains = np.geomspace(0.7 * low, 1.2 * high, 200)
    styles = zip(certificate.blocks, certificate.loops, ("x, y", "z"), ("C0-", "C2--"), widths(2), strict=True)
    for block, loop, name, style, width in styles:
        left = [timing.contraction(loop, block, float(gain)) for gain in gains]
        axes.plot(gains, left, style, lw=width, label=f"at the end of a period, {name}")
        if timing.immediate:
            left = [1.0 + hold_growth(block, timing.period, float(gain)) for gain in gains]
            axes.plot(gains, left, style, lw=width, alpha=0.4, label=f"bound within a period, {name}")
    axes.axhline(1.0, **LIMIT)
    axes.axvspan(low, high, color="C4", alpha=0.2, label="certified gains")
    axes.set(xlabel="applied gain k", ylabel="share of V" if timing.immediate else "share of W", title="contraction")
    axes.set_ylim(min(axes.get_ylim()[0], 0.9), 1.2)
    axes.legend(fontsize="small")
