"""The demo's pictures: where the drones went, what the gain did, what the motors were asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flatsat_ros.base.colours import LIMIT, PICTURES, colour_of, widths
from flatsat_ros.base.files import replacing
from flatsat_ros.demo.record import FlightRecord
from flatsat_ros.flight.modes import Mode

FILES = ("paths.png", "gain.png", "inputs.png")

_REFERENCE: dict[str, Any] = {"color": "0.1", "linestyle": ":", "linewidth": 1.2, "zorder": 3}


@mpl.rc_context(PICTURES)
def draw(record: FlightRecord, folder: Path) -> list[Path]:
    """Write `FILES` into a folder; return their paths."""
    written = [folder / name for name in FILES]
    for path, figure in zip(written, (_paths(record), _gain(record), _inputs(record)), strict=True):
        with replacing(path) as file:
            figure.savefig(file, dpi=130)
    return written


def _lines(record: FlightRecord) -> dict[str, dict[str, Any]]:
    """Return how the curves of each drone are drawn."""
    wide = widths(len(record.robots))
    return {name: {"color": colour_of(i), "linewidth": wide[i], "label": name} for i, name in enumerate(record.robots)}


def _paths(record: FlightRecord) -> Figure:
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    grid = figure.subplot_mosaic([["top", "x"], ["top", "y"], ["top", "z"]], width_ratios=(1, 1.15))
    begin, end = record.swap
    times = np.linspace(begin, end, 400)
    for name, line in _lines(record).items():
        robot = record.robots[name]
        reference = np.array([robot.reference.sample(t)[:3] for t in times])
        swap = robot.poses[(robot.poses[:, 0] >= begin) & (robot.poses[:, 0] <= end)]
        grid["top"].plot(swap[:, 1], swap[:, 2], **line)
        grid["top"].plot(reference[:, 0], reference[:, 1], **_REFERENCE)
        grid["top"].plot(*swap[0, 1:3], "o", color=line["color"], zorder=4)
        for i, axis in enumerate("xyz"):
            grid[axis].plot(robot.poses[:, 0], robot.poses[:, 1 + i], **line)
            grid[axis].plot(times, reference[:, i], **_REFERENCE)
    grid["top"].set(title="From above (dotted: references)", xlabel="x, m", ylabel="y, m", aspect="equal")
    grid["top"].legend(loc="lower center", bbox_to_anchor=(0.5, -0.22), ncols=len(record.robots))
    grid["x"].set_title("Over time (shaded: the swap)")
    for axis in "xyz":
        grid[axis].set_ylabel(f"{axis}, m")
        _finish(grid[axis], record, last=axis == "z")
    return figure


def _gain(record: FlightRecord) -> Figure:
    """Draw up to the end of the swap: on the floor V only says how far the landing reference has gone on sinking."""
    figure = Figure(figsize=(8, 5.2), layout="constrained")
    gain, lyapunov = figure.subplots(2, 1, sharex=True)
    for name, line in _lines(record).items():
        robot = record.robots[name]
        flying = (robot.column("mode") == Mode.FLY) & (robot.ticks[:, 0] <= record.swap[1])
        gain.plot(robot.ticks[flying, 0], robot.column("gamma")[flying], **line)
        lyapunov.semilogy(robot.ticks[flying, 0], robot.column("V")[flying], **line)
    gain.axhline(record.gain_max, **LIMIT)
    gain.set(ylabel=r"gain $\gamma$", title="Gain and Lyapunov function (dashed: limits; shaded: the swap)")
    gain.legend(loc="center right")
    lyapunov.set_ylim(top=5.0 * max(record.level, *(r.column("V").max() for r in record.robots.values())))
    lyapunov.axhline(record.level, **LIMIT)
    lyapunov.text(0.01, record.level, r" $\varepsilon$", transform=lyapunov.get_yaxis_transform(), va="bottom")
    lyapunov.axhline(record.threshold, **LIMIT)
    lyapunov.text(0.01, record.threshold, r" $V_\infty$", transform=lyapunov.get_yaxis_transform(), va="bottom")
    lyapunov.set_ylabel("$V$")
    _finish(gain, record)
    _finish(lyapunov, record, last=True)
    return figure


def _inputs(record: FlightRecord) -> Figure:
    figure = Figure(figsize=(8, 6.4), layout="constrained")
    rows = figure.subplots(3, 1, sharex=True)
    tilt = np.degrees(record.limits.tilt_max)
    limits = ((record.limits.thrust_min, record.limits.thrust_max), (-tilt, tilt), (-tilt, tilt))
    labels = ("thrust $T$, m/s²", r"roll $\phi$, °", r"pitch $\theta$, °")
    for i, (axes, bounds, label) in enumerate(zip(rows, limits, labels, strict=True)):
        for name, line in _lines(record).items():
            commands = record.robots[name].commands
            values = commands[:, 1] if i == 0 else np.degrees(commands[:, 1 + i])
            axes.step(commands[:, 0], values, where="post", **line)
        for bound in bounds:
            axes.axhline(bound, **LIMIT)
        axes.set_ylabel(label)
        _finish(axes, record, last=i == 2)
    rows[0].set_title("Commands on the wire (dashed: limits; shaded: the swap)")
    rows[0].legend(loc="center", ncols=3)
    return figure


def _finish(axes: Axes, record: FlightRecord, last: bool = False) -> None:
    axes.axvspan(*record.swap, color="0.95", zorder=0)
    if last:
        axes.set_xlabel("time, s")
