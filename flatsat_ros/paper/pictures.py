"""The paper's figures, redrawn from our own runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flatsat_ros.base.colours import LIMIT, PICTURES, colour_of
from flatsat_ros.base.files import replacing
from flatsat_ros.certificate.gain_bounds import continuous_gain_bound
from flatsat_ros.demo import pictures as demo_pictures
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.paper.gain_laws import draw_gain_laws
from flatsat_ros.paper.runs import ADAPTATION_RATES, GAMMA_0, TEST_1_TIMING, V_INF, Runs
from flatsat_ros.paper.studies import History

_OWN = (
    "study1_gain.png", "study1_inputs.png", "study2_plane.png", "study2_inputs.png", "test1_errors.png",
    "test1_gain.png", "test1_inputs.png", "gain_laws.png", "computation_time.png",
)  # fmt: skip
_SWAP = "test2"  # the folder of the flight's own
FILES = (*_OWN, *(f"{_SWAP}/{name}" for name in demo_pictures.FILES))

_INPUTS = ("thrust $T$, m/s²", r"roll $\phi$, °", r"pitch $\theta$, °")
_ACCELERATIONS = ("$v_1$, m/s²", "$v_2$, m/s²", "$v_3$, m/s²")
_TEST_1_SHOWN = 12.0  # s


@mpl.rc_context(PICTURES)
def draw(runs: Runs, folder: Path) -> list[Path]:
    """Write `FILES` into a folder; return their paths."""
    study_labels, test_labels = ([rf"$\mu$ = {mu:g}" for mu in ADAPTATION_RATES[first:]] for first in (0, 1))
    robust_labels = [rf"$\gamma$ = {gain:g}" for gain in runs.study_2]
    one_start = [_only(history, 2) for history in runs.study_2.values()]
    figures = (
        _study_1_gain(runs, study_labels),
        _inputs([runs.study_1], study_labels, runs.simulation.limits, "study 1: input u and v"),
        _study_2_plane(runs),
        _inputs(one_start, robust_labels, runs.robust.limits, "study 2: input u and v from one start"),
        _test_1_errors(runs, test_labels),
        _test_1_gain(runs, test_labels),
        _inputs([runs.test_1], test_labels, runs.experiment.limits, "test 1: input u and v", held=True),
        draw_gain_laws(runs.gain_laws),
        _computation_time(runs),
    )
    for name, figure in zip(_OWN, figures, strict=True):
        with replacing(folder / name) as file:
            figure.savefig(file, dpi=130)
    demo_pictures.draw(runs.flight, folder / _SWAP)
    return [folder / name for name in FILES]


def _only(history: History, index: int) -> History:
    """Return the history of one of its loops."""
    columns = (history.error, history.lyapunov, history.gain, history.applied_gain, history.acceleration, history.input)
    return History(history.time, *(column[:, [index]] for column in columns))


def _colours(labels: Sequence[str]) -> list[str]:
    return [colour_of(i) for i in range(len(labels))]


def _finish(axes: Axes, label: str, last: bool = False) -> None:
    axes.set_ylabel(label)
    if last:
        axes.set_xlabel("time, s")


def _threshold(axes: Axes, level: float, name: str) -> None:
    axes.axhline(level, **LIMIT)
    axes.text(0.995, level, name, transform=axes.get_yaxis_transform(), ha="right", va="bottom")


def _study_1_gain(runs: Runs, labels: list[str]) -> Figure:
    figure = Figure(figsize=(8, 6.4), layout="constrained")
    lyapunov, gain = figure.subplots(2, 1, sharex=True)
    history, rate = runs.study_1, runs.simulation.rate
    start = float(history.lyapunov[0, 0])
    for i, (label, colour) in enumerate(zip(labels, _colours(labels), strict=True)):
        lyapunov.semilogy(history.time, history.lyapunov[:, i], color=colour, label=label)
        gain.plot(history.time, history.gain[:, i], color=colour)
        bound = continuous_gain_bound(GAMMA_0, float(ADAPTATION_RATES[i]), start, V_INF, rate)
        gain.axhline(bound, color=colour, linestyle="--", linewidth=1.0)
    lyapunov.semilogy(history.time, start * np.exp(-rate * history.time), "k:", label=r"$V(0)\,e^{-\alpha t}$")
    _threshold(lyapunov, V_INF, r"$V_\infty$")
    lyapunov.set(title="study 1: Lyapunov function, gain, and the bound of the gain (dashed)", ylim=(1e-3, 4.0))
    lyapunov.legend(ncols=2, fontsize="small")
    _finish(lyapunov, "$V$")
    _finish(gain, r"$\gamma$", last=True)
    return figure


def _inputs(
    histories: Sequence[History], labels: Sequence[str], limits: InputSet, title: str, held: bool = False
) -> Figure:
    """Draw u and v of all loops of all histories; held in between if sampled."""
    style = {"linewidth": 1.0, "drawstyle": "steps-post" if held else "default"}
    figure = Figure(figsize=(11, 6.6), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    tilt = np.degrees(limits.tilt_max)
    bounds = ((limits.thrust_min, limits.thrust_max), (-tilt, tilt), (-tilt, tilt))
    curves = [(h, i) for h in histories for i in range(h.gain.shape[1])]
    for (history, i), label, colour in zip(curves, labels, _colours(labels), strict=True):
        shown = history.time <= _TEST_1_SHOWN
        for row in range(3):
            scale = 1.0 if row == 0 else 180.0 / np.pi
            grid[row, 0].plot(
                history.time[shown], scale * history.input[shown, i, row], color=colour, label=label, **style
            )
            grid[row, 1].plot(history.time[shown], history.acceleration[shown, i, row], color=colour, **style)
    for row in range(3):
        for bound in bounds[row]:
            if row or bound > 0.0:
                grid[row, 0].axhline(bound, **LIMIT)
        _finish(grid[row, 0], _INPUTS[row], last=row == 2)
        _finish(grid[row, 1], _ACCELERATIONS[row], last=row == 2)
    grid[0, 0].legend(ncols=3, fontsize="small")
    figure.suptitle(f"{title} (dashed: limits)")
    return figure


def _study_2_plane(runs: Runs) -> Figure:
    figure = Figure(figsize=(11, 5), layout="constrained")
    columns = figure.subplots(1, 2, sharex=True, sharey=True)
    circle = np.linspace(0.0, 2.0 * np.pi, 400)
    block = runs.robust.block
    edge = np.linalg.solve(np.linalg.cholesky(block).T, [np.cos(circle), np.sin(circle)])
    x = np.array([edge[0].min(), edge[0].max()])
    for axes, (gain, history) in zip(columns, runs.study_2.items(), strict=True):
        axes.fill(*edge, color="0.93")
        axes.plot(*edge, color="0.3", label=r"$E_w$")
        axes.plot(x, -block[1, 0] / block[1, 1] * x, "k:", linewidth=1.0, label=r"$B^\top P_w\xi = 0$")
        for i in range(history.gain.shape[1]):
            (line,) = axes.plot(history.error[:, i, 0], history.error[:, i, 3], linewidth=1.0)
            axes.plot(history.error[0, i, 0], history.error[0, i, 3], "o", color=line.get_color(), markersize=4)
        axes.set(title=rf"study 2, $\gamma$ = {gain:g}", xlabel="x, m", ylim=1.05 * np.array([-1, 1]) * edge[1].max())
    columns[0].set_ylabel(r"$\dot x$, m/s")
    columns[0].legend(loc="upper right")
    return figure


def _test_1_errors(runs: Runs, labels: list[str]) -> Figure:
    figure = Figure(figsize=(8, 6.6), layout="constrained")
    rows = figure.subplots(3, 1, sharex=True)
    history = runs.test_1
    shown = history.time <= _TEST_1_SHOWN
    for row, (axes, name) in enumerate(zip(rows, "xyz", strict=True)):
        for i, (label, colour) in enumerate(zip(labels, _colours(labels), strict=True)):
            axes.plot(history.time[shown], history.error[shown, i, row], color=colour, linewidth=1.2, label=label)
        _finish(axes, f"error $e_{name}$, m", last=row == 2)
    rows[0].legend(ncols=5, fontsize="small")
    rows[0].set_title(f"test 1: set-point errors, {_loop()}")
    return figure


def _test_1_gain(runs: Runs, labels: list[str]) -> Figure:
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, history in enumerate((runs.test_1, runs.test_1_capped)):
        lyapunov, gain = grid[:, column]
        for i, (label, colour) in enumerate(zip(labels, _colours(labels), strict=True)):
            lyapunov.semilogy(history.time, history.lyapunov[:, i], color=colour, linewidth=1.0, label=label)
            gain.plot(history.time, history.gain[:, i], color=colour, label=label)
        _threshold(lyapunov, V_INF, r"$V_\infty$")
        _threshold(gain, runs.cap, "cap")
        _finish(lyapunov, "$V$")
        _finish(gain, r"$\gamma$", last=True)
    grid[0, 0].set(title="test 1, the paper's law", ylim=(1e-6, 6.0))
    grid[0, 1].set_title(rf"the same with $\gamma \leq$ {runs.cap:.2f}")
    grid[1, 1].legend(fontsize="small", ncols=2)
    figure.suptitle(_loop())
    return figure


def _loop() -> str:
    return f"h = {TEST_1_TIMING.period:g} s, lag {TEST_1_TIMING.lag:g} s, delay {TEST_1_TIMING.delay:g} s"


def _computation_time(runs: Runs) -> Figure:
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots()
    upper = 1e3 * max(float(np.quantile(steps, 0.995)) for steps in runs.steps.values())
    for count, steps in runs.steps.items():
        mean = 1e3 * float(steps.mean())
        label = f"{count} drone{'s' if count > 1 else ''}: mean {mean:.3f} ms"
        axes.hist(1e3 * steps, bins=np.linspace(0.0, upper, 80).tolist(), alpha=0.6, label=label)
    axes.set(title="processor time of one step of the controller", xlabel="time, ms", ylabel="steps")
    axes.legend()
    return figure
