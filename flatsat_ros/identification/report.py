"""What was identified, in lines for people, and a page of pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flatsat_ros.base.colours import PICTURES
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.files import replacing
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.identification.disturbances import BANDWIDTH, disturbances, shared
from flatsat_ros.identification.identified import Identified
from flatsat_ros.identification.residuals import REACH, ComparedFlight
from flatsat_ros.identification.residuals import Misfit as Residuals
from flatsat_ros.identification.response import respond
from flatsat_ros.identification.screening import STEP, Samples
from flatsat_ros.identification.surroundings import surroundings

_WORDS = {
    "attitude_gain": ("attitude gain", 1.0, ""),
    "natural_frequency": ("natural frequency wn", 1.0, "rad/s"),
    "damping": ("damping zeta", 1.0, ""),
    "lag_and_delay": ("lag plus delay", 1e3, "ms"),
    "thrust_lag": ("thrust lag", 1e3, "ms"),
    "velocity_tilt": ("tilt into the motion", 1.0, "rad s/m"),
    "thrust_slope": ("thrust slope", 1.0, ""),
    "thrust_voltage": ("thrust over voltage", 1.0, ""),
    "drag_xy": ("horizontal drag", 1.0, "1/s"),
    "drag_z": ("vertical drag", 1.0, "1/s"),
    "thrust_available": ("thrust at pwm_max", 1.0 / GRAVITY, "g"),
}
_SHOWN = 4  # flights on the page


def screening_lines(samples: Samples) -> Iterator[str]:
    """Yield what of a log is used and what was wrong with it."""
    faults = "; ".join(f"{count} rows {name}" for name, count in samples.faults.items())
    yield f"{samples.name}: {samples.seconds:.1f} s of flight usable{'; masked: ' + faults if faults else ''}"
    for note in samples.notes:
        yield f"{samples.name}: {note}"


def lines(identified: Identified, base: VehicleProfile) -> Iterator[str]:
    """Yield the figures, a line each, and what the flights do not tell."""
    count = len(identified.flights)
    for name, (words, factor, unit) in _WORDS.items():
        figure = identified.figures[name]
        if figure.interval is None:
            continue
        low, high = (factor * end for end in figure.interval)
        support = f"{figure.flights} of {count} flights"
        yield f"  {words:22s} {factor * figure.value:9.4g}  [{low:.4g}, {high:.4g}] {unit:8s} {support}"
    for each in surroundings(identified.flights, identified.common):
        if each.flights:
            interval = "[{:.4g}, {:.4g}]".format(*each.interval)
            yield f"  {each.name:22s} {each.value:9.4g}  {interval} {each.unit:8s} {each.flights} of {count} flights"
    degrees = np.rad2deg([each.frame for each in identified.common.misfits])
    for flight, (roll, pitch) in zip(identified.flights, degrees, strict=True):
        yield f"  marker frame of {flight.motion.samples.name}: roll {roll:.2f} deg, pitch {pitch:.2f} deg"
    pushed, change = disturbances(identified.flights, identified.common)
    for name, unit, values in (
        ("disturbance", "m/s^2", np.linalg.norm(pushed, axis=1)),
        ("its rate", "m/s^3", shared(change)),
    ):
        half, most, all_but = np.percentile(values, (50.0, 95.0, 99.0))
        yield f"  {name} up to {BANDWIDTH:.2g} Hz: {half:.2g} / {most:.2g} / {all_but:.2g} {unit} (50 / 95 / 99 %)"
    yield "  no log tells: mass apart from force (the base's mass stays), rising apart from falling thrust lag,"
    yield "  delay on board apart from that of link, motion capture and clocks (the base's dead_time stays)"
    if identified.unknown:
        words = ", ".join(_WORDS[name][0] for name in identified.unknown)
        yield f"  not told by these flights, as in {base.name}: {words}"
    if count == 1:
        yield "  one flight does not show how others of this drone differ: the intervals have the usual spread"


@mpl.rc_context(PICTURES)
def draw(identified: Identified, target: Path) -> None:
    """Draw measured and simulated attitude and what the commands do not explain, and the figures with intervals.

    Raises:
        FlatsatError: the file cannot be written.
    """
    shown = list(zip(identified.flights, identified.common.misfits, strict=True))[:_SHOWN]
    figure = Figure(figsize=(14.0, 3.0 * len(shown) + 3.5), layout="constrained")
    rows = figure.subplots(len(shown) + 1, 3, squeeze=False)
    for number, (flight, found) in enumerate(shown):
        _flight(rows[number], flight, found, identified, number)
    for axes, name in zip(rows[-1][:2], ("attitude", "position"), strict=True):
        _histogram(axes, identified, name)
    _intervals(rows[-1][2], identified)
    with replacing(target) as file:
        figure.savefig(file, dpi=110)


def _flight(row: np.ndarray, flight: ComparedFlight, found: Residuals, identified: Identified, number: int) -> None:
    """Roll, pitch, and the unexplained acceleration of a flight."""
    samples = flight.motion.samples
    tilt, _ = respond(flight.motion, identified.common.of(number))
    time = np.arange(len(tilt)) * STEP
    for axis, word in enumerate(("roll", "pitch")):
        measured = np.where(samples.usable, samples.angles[:, axis] - found.frame[axis], np.nan)
        row[axis].plot(time, np.rad2deg(samples.command[:, axis]), "0.7", lw=0.8, label="commanded")
        row[axis].plot(time, np.rad2deg(measured), "C0", lw=1.0, label="measured")
        row[axis].plot(time, np.rad2deg(tilt[:, axis]), "C1", lw=1.0, label="simulated")
        row[axis].set(title=f"{samples.name}: {word}", xlabel="time, s", ylabel=f"{word}, °")
    row[0].legend(fontsize="small")
    row[2].plot(flight.position_at * STEP, found.position / (REACH * STEP) ** 2, ".", ms=2, label=list("xyz"))
    row[2].set(title="acceleration not explained", xlabel="time, s", ylabel="m/s²")
    row[2].legend(fontsize="small", markerscale=4.0, ncols=3)


def _histogram(axes: Axes, identified: Identified, name: str) -> None:
    """Residuals of all flights beside a normal distribution of their bulk."""
    scale = identified.common.scales[0 if name == "attitude" else 1]
    values = np.concatenate([getattr(each, name).ravel() for each in identified.common.misfits]) / scale
    grid = np.linspace(-6.0, 6.0, 121)
    axes.hist(np.clip(values, -6.0, 6.0), grid[::2].tolist(), density=True, color="C0", alpha=0.6)
    axes.plot(grid, np.exp(-0.5 * grid**2) / np.sqrt(2.0 * np.pi), "C1")
    shown = f"{np.rad2deg(scale):.3g}°" if name == "attitude" else f"{1e3 * scale:.3g} mm"
    axes.set(title=f"{name} residuals and a normal distribution", xlabel=f"in units of {shown}", ylabel="density")
    axes.set(yscale="log", ylim=(1e-4, 2.0))


def _intervals(axes: Axes, identified: Identified) -> None:
    """Each known figure's interval and the estimates of the flights, over its value."""
    known = [(name, figure) for name, figure in identified.figures.items() if figure.interval is not None]
    for place, (_, figure) in enumerate(known):
        assert figure.interval is not None
        size = abs(figure.value) or 1.0
        axes.plot(np.array(figure.interval) / size, [place, place], "C0-", lw=3, alpha=0.5)
        axes.plot(np.array(figure.estimates) / size, [place] * len(figure.estimates), "C1|")
    axes.set_yticks(range(len(known)), [_WORDS[name][0] for name, _ in known])
    axes.set(title="intervals and flights, over the value", xlim=(-1.0, 3.0))
