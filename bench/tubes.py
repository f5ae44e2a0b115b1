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
from flatsat_ros.certificate.flight_cell import Box
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.synthesis.flight_cover import corner_tube, cover

_PERIOD = 0.02  # s
STILL = Assumptions(disturbance_rate=0.35, noise=5e-4, acceleration=0.0, jerk=0.58, snap=0.66)
GUSTS = replace(STILL, disturbance_rate=0.5, noise=1e-3)
_LEANING = replace(
    STILL, acceleration=0.4
)  # of second order: what a drone leans depends on its reference's acceleration
_TILT, _DRAG = -0.26, 0.41  # 1/s, as identified from flights


class Row(NamedTuple):
    """What is known, and a design for it.

    Attributes:
        box: the plants; their gain is over that of the model.
        design: the controller.
        gain_max: largest applied gain.
        assumptions: of the tube.
        target: m, at most.
        lag_varies: whether the lag changes in flight.
        excess: of a cell's tube over that of the worst corner, aimed at.
    """

    box: Box
    design: Design
    gain_max: float
    assumptions: Assumptions
    target: float
    lag_varies: bool = False
    excess: float = 0.1


def _first(gain: tuple[float, float] = (1.0, 1.0), nominal: float = 1.0) -> Box:
    """Return the plants of a `cf21` whose lag and delay are known to 20 %."""
    low, high = gain[0] / nominal, gain[1] / nominal
    return Box(Plant(0.024, 0.1124, gain=low), Plant(0.036, 0.1686, gain=high))


def _upright(nominal: float) -> Box:
    """Return the plants of the vertical axis: thrust to 3 %, its lag between that of falling and of rising."""
    return Box(Plant(0.03, 0.107, gain=0.97 / nominal), Plant(0.03, 0.137, gain=1.03 / nominal))


def _second(
    frequency: tuple[float, float], damping: tuple[float, float], gain: tuple[float, float], nominal: float
) -> Box:
    """Return the plants of an identified drone with 30 to 50 ms of delay."""
    low, high = (
        Plant(delay, 0.0, frequency[i], damping[i], gain[i] / nominal, _TILT, _DRAG)
        for i, delay in enumerate((0.03, 0.05))
    )
    return Box(low, high)


def _lagging(delay: float, lag: float, observer: tuple[float, float, float], stiffness: float, rate: float) -> Design:
    return Design.predicting(_PERIOD, Plant(delay, lag), observer, stiffness, rate)


def _attitude(
    plant: tuple[float, float, float], observer: tuple[float, float, float], stiffness: float, rate: float
) -> Design:
    """Return a controller for a delay, s, a frequency, rad/s, and a damping."""
    delay, frequency, damping = plant
    model = Plant(delay, frequency=frequency, damping=damping, tilt=_TILT, drag=_DRAG)
    return Design.predicting(_PERIOD, model, observer, stiffness, rate)


_NARROW = (12.5, 18.0), (0.44, 0.60), (0.68, 0.82)
_WIDE = (12.0, 20.0), (0.42, 0.62), (0.66, 0.86)
ROWS = {
    "lag and delay": Row(_first(), _lagging(0.018, 0.167, (0.323, 3.13, 10.3), 60.0, 17.8), 1.5, STILL, 0.027),
    "and gain +-8 %": Row(
        _first((0.92, 1.08)), _lagging(0.0252, 0.1535, (0.288, 2.44, 10.3), 44.9, 23.1), 1.5, STILL, 0.035
    ),
    "and gain .8 to 1.1": Row(
        _first((0.8, 1.1), 0.95), _lagging(0.025, 0.16, (0.3571, 3.93, 14.2), 42.8, 23.0), 1.5, STILL, 0.042
    ),
    "and gain +-8 %, gusts": Row(
        _first((0.92, 1.08)), _lagging(0.0269, 0.1595, (0.3125, 2.916, 8.14), 63.9, 20.8), 1.5, GUSTS, 0.065
    ),
    "any gain to 4": Row(_first(), _lagging(0.0278, 0.141, (0.376, 4.41, 10.6), 22.7, 12.45), 4.0, STILL, 0.07),
    "any gain to 4, gusts": Row(
        _first(), _lagging(0.037, 0.147, (0.2535, 1.849, 5.2), 48.2, 19.15), 4.0, GUSTS, 0.10
    ),
    "vertical": Row(
        _upright(1.0), _lagging(0.03331, 0.1187, (0.3376, 3.462, 13.4), 64.92, 28.52), 1.5, STILL, 0.055, True, 0.05
    ),
    "vertical, gusts": Row(
        _upright(1.002), _lagging(0.0323, 0.1197, (0.3377, 3.463, 12.25), 73.26, 31.65), 1.5, GUSTS, 0.085, True, 0.01
    ),
    "identified": Row(
        _second(*_NARROW, 0.8585),
        _attitude((0.03353, 15.64, 0.6404), (0.3396, 3.505, 10.08), 37.79, 18.96), 1.5, _LEANING, 0.05, False, 0.2,
    ),
    "identified, gusts": Row(
        _second(*_NARROW, 0.8478),
        _attitude((0.03415, 15.78, 0.6101), (0.3515, 3.782, 9.154), 35.09, 16.55), 1.5,
        replace(GUSTS, acceleration=0.4), 0.07, False, 0.2,
    ),
    "identified, wider": Row(
        _second(*_WIDE, 0.9232),
        _attitude((0.02891, 16.01, 0.6312), (0.4058, 5.232, 11.77), 26.96, 14.25), 1.5, _LEANING, 0.075, False, 0.3,
    ),
    "identified, wider, gusts": Row(
        _second(*_WIDE, 0.9197),
        _attitude((0.03572, 17.03, 0.5904), (0.3709, 4.267, 10.48), 21.82, 13.26), 1.5,
        replace(GUSTS, acceleration=0.4), 0.10, False, 0.3,
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
        arguments = row.design, row.box, 1.0, row.gain_max, row.assumptions, row.lag_varies
        corners = corner_tube(*arguments)
        line = f"{name:<26}target {100 * row.target:4.1f} cm, corners {100 * corners.position:5.2f} cm"
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
