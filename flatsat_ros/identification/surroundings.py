"""What flights show beside the drone's own figures: how the markers sit, noise of the poses, and disturbances.

Each with an interval for other flights of the same drone in the same room, as `identified` makes those of figures.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flatsat_ros.identification.disturbances import BANDWIDTH, disturbances, shared
from flatsat_ros.identification.fit import Fit
from flatsat_ros.identification.identified import width_between
from flatsat_ros.identification.residuals import ComparedFlight

# unit, and the standard deviation between 54 flights of one Crazyflie 2.1 on several days: of the angles, deg, of the
# others' logarithm
_FRAME = {"marker frame, roll": 1.0, "marker frame, pitch": 0.6}
_SIZES = {
    "pose noise": ("mm", 0.16),
    f"disturbance to {BANDWIDTH:.2g} Hz": ("m/s^2", 0.37),
    f"its rate to {BANDWIDTH:.2g} Hz": ("m/s^3", 0.4),
}


@dataclass(frozen=True)
class Surrounding:
    """One of them.

    Attributes:
        name: in words; of disturbance and rate what 95 % of the samples keep is meant.
        unit: deg, mm, m/s^2 or m/s^3.
        value: mean of the flights; of sizes the geometric one; NaN: not told.
        interval: for other flights.
        flights: number of those that tell it.
    """

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    flights: int


def surroundings(flights: Sequence[ComparedFlight], found: Fit) -> list[Surrounding]:
    """Return what flights show beside the figures of their fit."""
    frames = np.rad2deg([each.frame for each in found.misfits])
    result = [_told(name, "deg", frames[:, k], usual) for k, (name, usual) in enumerate(_FRAME.items())]
    sizes = []
    for flight, misfit in zip(flights, found.misfits, strict=True):
        pushed, change = disturbances([flight], dataclasses.replace(found, misfits=(misfit,)))
        most = [
            float(np.percentile(each, 95.0)) if len(each) else math.nan for each in (_norms(pushed), shared(change))
        ]
        sizes.append([1e3 * flight.motion.samples.pose_noise, *most])
    for column, (name, (unit, usual)) in zip(np.array(sizes).T, _SIZES.items(), strict=True):
        of_log = _told(name, unit, np.log(column), usual)
        low, high = of_log.interval
        result.append(
            dataclasses.replace(of_log, value=math.exp(of_log.value), interval=(math.exp(low), math.exp(high)))
        )
    return result


def _norms(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _told(name: str, unit: str, values: np.ndarray, usual: float) -> Surrounding:
    """Return the mean of values (n,), NaN where a flight does not tell it, with its interval."""
    told = values[np.isfinite(values)]
    value = float(np.mean(told)) if len(told) else math.nan
    width = width_between(told, usual)
    return Surrounding(name, unit, value, (value - width, value + width), len(told))
