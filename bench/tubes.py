"""How small tubes get: designs for what is usually known of a drone, and the tubes that are proved for them.

    .venv/bin/python bench/tubes.py [ROW ...]

Each row is a box of plants, a controller and assumptions at 50 Hz; delays, lags or attitudes are unknown within
intervals, and the tube is proved for all of them and for all gains. References are those of a swap of places in 4 s,
poses are fresh, and drag is among the disturbances, but where the attitude is of second order: there drag and the tilt
into the motion are known.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.synthesis.flight_cover import corner_tube, cover, extreme_boxes
from flatsat_ros.synthesis.flight_search import command_noise

_PERIOD = 0.02  # s
_NOISE = 5e-4  # m, for which the noise of commands is stated
STILL = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66)
GUSTS = replace(STILL, disturbance_rate=0.5, noise=1e-3)
# of second order: what a drone leans depends on its reference's acceleration
_LEANING, _LEANING_IN_GUSTS = (replace(air, acceleration=0.4) for air in (STILL, GUSTS))
_TILT, _DRAG = -0.26, 0.41  # 1/s, as identified from flights


class Row(NamedTuple):
    """What is known, and a design for it.

    Attributes:
        box: the plants.
        design: the controller.
        gain_max: largest applied gain.
        assumptions: of the tube.
        target: m, at most.
        nominal: gain by which the controller divides its commands.
        lag_varies: whether the lag changes in flight.
        excess: of a cell's tube over that of the worst corner, aimed at.
    """

    box: PlantBox
    design: Design
    gain_max: float
    assumptions: Assumptions
    target: float
    nominal: float = 1.0
    lag_varies: bool = False
    excess: float = 0.1

    @property
    def relative(self) -> PlantBox:
        """The plants with gains over the nominal one, as the controller meets them."""
        return PlantBox(*(replace(plant, gain=plant.gain / self.nominal) for plant in (self.box.low, self.box.high)))

    @property
    def command_noise(self) -> float:
        """Noise of the commanded tilt, or what that is in thrust, at the worst corner and a gain of 1, degrees."""
        plants = [corner.low for corner in extreme_boxes(self.relative, self.lag_varies)]
        return max(command_noise(self.design, plant, _NOISE) for plant in plants) / self.nominal


def _first(gain: tuple[float, float] = (1.0, 1.0)) -> PlantBox:
    """Return the plants of a `cf21` whose lag and delay are known to 20 %."""
    return PlantBox(Plant(0.024, 0.1124, gain=gain[0]), Plant(0.036, 0.1686, gain=gain[1]))


def _second(frequency: tuple[float, float], damping: tuple[float, float], gain: tuple[float, float]) -> PlantBox:
    """Return the plants of an identified drone with 30 to 50 ms of delay."""
    low, high = (
        Plant(delay, 0.0, frequency[i], damping[i], gain[i], _TILT, _DRAG) for i, delay in enumerate((0.03, 0.05))
    )
    return PlantBox(low, high)


def _lagging(delay: float, lag: float, observer: tuple[float, float, float], stiffness: float, rate: float) -> Design:
    return Design.predicting(_PERIOD, Plant(delay, lag), observer, stiffness, rate)


def _attitude(
    plant: tuple[float, float, float], observer: tuple[float, float, float], stiffness: float, rate: float
) -> Design:
    """Return a controller for a delay, s, a frequency, rad/s, and a damping."""
    delay, frequency, damping = plant
    model = Plant(delay, frequency=frequency, damping=damping, tilt=_TILT, drag=_DRAG)
    return Design.predicting(_PERIOD, model, observer, stiffness, rate)


# the vertical axis: thrust to 3 %, its lag between that of falling and of rising
_UPRIGHT = PlantBox(Plant(0.03, 0.107, gain=0.97), Plant(0.03, 0.137, gain=1.03))
_NARROW = _second((12.5, 18.0), (0.44, 0.60), (0.68, 0.82))
_WIDE = _second((12.0, 20.0), (0.42, 0.62), (0.66, 0.86))
ROWS = {
    "lag and delay": Row(_first(), _lagging(0.018, 0.167, (0.323, 3.13, 10.3), 60.0, 17.8), 1.5, STILL, 0.027),
    "and gain +-8 %": Row(
        _first((0.92, 1.08)), _lagging(0.0252, 0.1535, (0.288, 2.44, 10.3), 44.9, 23.1), 1.5, STILL, 0.035
    ),
    "and gain .8 to 1.1": Row(
        _first((0.8, 1.1)), _lagging(0.04609, 0.1328, (0.3509, 2.563, 6.547), 53.08, 18.75), 1.5, STILL, 0.042, 0.8268
    ),
    "and gain +-8 %, gusts": Row(
        _first((0.92, 1.08)), _lagging(0.0269, 0.1595, (0.3125, 2.916, 8.14), 63.9, 20.8), 1.5, GUSTS, 0.065
    ),
    "any gain to 4": Row(_first(), _lagging(0.0278, 0.141, (0.376, 4.41, 10.6), 22.7, 12.45), 4.0, STILL, 0.07),
    "any gain to 4, gusts": Row(
        _first(), _lagging(0.037, 0.147, (0.2535, 1.849, 5.2), 48.2, 19.15), 4.0, GUSTS, 0.10
    ),
    "vertical": Row(
        _UPRIGHT, _lagging(0.03331, 0.1187, (0.3376, 3.462, 13.4), 64.92, 28.52), 1.5, STILL, 0.055, 1.0, True, 0.05
    ),
    "vertical, gusts": Row(
        _UPRIGHT, _lagging(0.0323, 0.1197, (0.3377, 3.463, 12.25), 73.26, 31.65), 1.5, GUSTS, 0.085, 1.002, True, 0.01
    ),
    "identified": Row(
        _NARROW, _attitude((0.06805, 19.39, 0.5272), (0.3979, 1.748, 4.107), 79.86, 23.57), 1.5,
        _LEANING, 0.05, 0.738,
    ),
    "identified, gusts": Row(
        _NARROW, _attitude((0.05994, 18.37, 0.6022), (0.3929, 2.31, 6.346), 49.69, 21.73), 1.5,
        _LEANING_IN_GUSTS, 0.07, 0.7783,
    ),
    "identified, wider": Row(
        _WIDE, _attitude((0.05627, 15.16, 0.4723), (0.5055, 1.754, 4.678), 58.22, 25.5), 1.5,
        _LEANING, 0.075, 0.7001,
    ),
    "identified, wider, gusts": Row(
        _WIDE, _attitude((0.05784, 15.13, 0.5199), (0.436, 1.568, 4.986), 53.11, 29.39), 1.5,
        _LEANING_IN_GUSTS, 0.10, 0.6924,
    ),
}  # fmt: skip
_CELLS_MAX = 16_000


def main() -> None:
    """Print a line a row: the tube of the corners, and what is proved of all plants, in how many cells."""
    parser = argparse.ArgumentParser()
    parser.add_argument("rows", nargs="*", metavar="ROW", help="by default all; of identified drones minutes each")
    parser.add_argument("--corners", action="store_true", help="the corners alone, in a second")
    given = parser.parse_args()
    for name in given.rows or ROWS:
        row = ROWS[name]
        arguments = row.design, row.relative, 1.0, row.gain_max, row.assumptions, row.lag_varies
        worst = corner_tube(*arguments)
        line = f"{name:<26}target {100 * row.target:4.1f} cm, noise {row.command_noise:.2f} deg"
        line += f", corners {100 * worst.position:5.2f} cm"
        if not given.corners:
            try:
                found = cover(*arguments, row.excess, _CELLS_MAX)
                cells = sum(not cut for cut in found.cuts)
                line += f", proved {100 * found.tube.position:5.2f} cm in {cells} cells, |v0| {found.tube.nominal:.2f}"
            except FlatsatError as error:
                line += f", not proved: {error}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
