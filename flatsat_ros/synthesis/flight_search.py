"""Search of the controller of a flight certificate: Nelder and Mead on the tube of the worst corner of the plants.

What is searched is the law's stiffness and rate, the estimator's noise densities and the delay and lag, or frequency
and damping, of the model. Beside the tube the cost holds |v0| to what tilt leaves room for, and the commands' noise to
what motors and ears stand. Nothing is proved here: the result is, by `flight_design`.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube, cell_tubes
from flatsat_ros.synthesis.flight_design import AxisDesign
from flatsat_ros.synthesis.flight_wishes import Plants

# Standard deviation of a measured position for which the estimator's noise densities are stated, m.
_DEVIATION = 1e-3

# Peak to peak over the standard deviation of noise in some seconds of flight.
_PEAKS = 8.0

# Largest noise of commanded tilt, degrees, for half a millimetre of noise; and the largest stiffness, 1/s^2.
NOISE_MAX_DEG = 4.0
_STIFFNESS_MAX = 80.0

# Cost of one degree of noise, one m/s^2 of |v0|, and one unit of stiffness beyond their bounds, cm.
_COSTS = (4.0, 10.0, 0.5)

# Width of the boxes at the corners whose tube counts, relative to that of all plants.
_CELL = 0.1

# By how much, relatively, the tube of all plants may be above that of the worst corner; less needs more cells.
EXCESS = 0.3

# A tube beyond this, m, is none.
_ABSURD = 1.0

_START = {"q": 1e-4, "r": 2e-3}
_LAWS = ((60.0, 20.0), (22.0, 12.0), (12.0, 9.0), (6.0, 6.0))  # where it begins, the first that has a tube
_STEPS = {"stiffness": 0.2, "rate": 0.2, "q": 0.5, "r": 0.5, "delay": 0.004}
_ROUNDS, _EVALUATIONS = 3, 250


def observer(period: float, q: float, r: float) -> tuple[float, float, float]:
    """Return L of the Kalman filter of white acceleration of density q, (m/s^2)^2/Hz, and d' of density r."""
    h = period
    F = np.array([[1.0, h, h * h / 2.0], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    N = q * np.array([[h**3 / 3.0, h * h / 2.0, 0.0], [h * h / 2.0, h, 0.0], [0.0, 0.0, 0.0]])
    N += r * np.array(
        [
            [h**5 / 20.0, h**4 / 8.0, h**3 / 6.0],
            [h**4 / 8.0, h**3 / 3.0, h * h / 2.0],
            [h**3 / 6.0, h * h / 2.0, h],
        ]
    )
    variance = _DEVIATION**2
    covariance = solve_discrete_are(F.T, np.array([[1.0], [0.0], [0.0]]), N, np.array([[variance]]))
    gains = covariance[:, 0] / (covariance[0, 0] + variance)
    return float(gains[0]), float(gains[1]), float(gains[2])


def command_noise(design: Design, plant: Plant, noise: float, gain: float = 1.0) -> float:
    """Return the noise of the commanded tilt, degrees peak to peak, for white noise of the position, m."""
    loop = FlightLoop(design, plant)
    matrix, row = loop.matrix(gain), loop.compensation + gain * loop.feedback
    state, total = loop.noise_input, 0.0
    for _ in range(math.ceil(16.0 / design.period)):
        total += float(row @ state) ** 2
        state = matrix @ state
    return math.degrees(_PEAKS * noise * math.sqrt(total) / GRAVITY)


def corner_boxes(plants: Plants, share: float = _CELL) -> list[PlantBox]:
    """Return small boxes at the corners of the plants, of the size of a cell, so that few cells cover what is found.

    Their drag is all of its interval, and so is a lag that changes in flight.

    Args:
        plants: all of them.
        share: width of the boxes relative to that of the plants; 0 for the corners themselves.
    """
    box, names = plants.box, [name for name in plants.box.constants(plants.lag_varies) if name != "drag"]
    ends = []
    for name in names:
        low, high = box.spread[name]
        width = (high - low) * share
        ends.append(((low, low + width), (high - width, high)))
    corners = []
    for pick in itertools.product(*ends):
        least, most = ({name: pair[i] for name, pair in zip(names, pick, strict=True)} for i in (0, 1))
        corners.append(PlantBox(replace(box.low, **least), replace(box.high, **most)))
    return corners


@dataclass(frozen=True)
class Goal:
    """What a search is after.

    Attributes:
        period: h, s.
        gain_max: largest applied gain.
        nominal_max: room for |v0|, m/s^2.
        assumptions: of the tube.
    """

    period: float
    gain_max: float
    nominal_max: float
    assumptions: Assumptions

    def worst(self, design: Design, plants: Plants, boxes: list[PlantBox]) -> AxisTube:
        """Return the tube of the worst corner."""
        tube = AxisTube(0.0, 0.0, 0.0, 0.0)
        for corner in cell_tubes(design, boxes, 1.0, self.gain_max, self.assumptions, plants.lag_varies):
            tube |= corner
        return tube

    def cost(self, design: Design, plants: Plants, boxes: list[PlantBox]) -> float:
        """Return the tube in cm, with what is paid for noise, |v0| and stiffness beyond their bounds."""
        tube = self.worst(design, plants, boxes)
        if not tube.position < _ABSURD:
            return math.inf
        noise = max(command_noise(design, box.low, _DEVIATION / 2.0) for box in boxes)
        beyond = noise - NOISE_MAX_DEG, tube.nominal - self.nominal_max, design.stiffness - _STIFFNESS_MAX
        # the ideal loop has its block of P for a stiffness below half of the square of the rate
        beyond_all = [c * max(0.0, b) for c, b in zip(_COSTS, beyond, strict=True)]
        return 100.0 * tube.position + sum(beyond_all) + 100.0 * max(0.0, 2.0 * design.stiffness / design.rate**2 - 1.0)


def search(goal: Goal, plants: Plants, progress: Callable[[str], None], seconds: float = math.inf) -> AxisDesign:
    """Return the design with the smallest cost that is found.

    Args:
        goal: what is wanted.
        plants: what is flown.
        progress: told of every better one.
        seconds: after which the best found is taken.

    Raises:
        FlatsatError: none has a bounded tube.
    """
    boxes, steps = corner_boxes(plants), dict(_STEPS)
    start = {"stiffness": _LAWS[0][0], "rate": _LAWS[0][1], **_START, "delay": plants.model.delay}
    if plants.model.frequency > 0.0:
        start |= {"frequency": plants.model.frequency, "damping": plants.model.damping}
        steps |= {"frequency": 0.08, "damping": 0.08}
    else:
        start["lag"], steps["lag"] = plants.model.lag, 0.06
    logarithmic = [name != "delay" for name in start]
    end, best = time.monotonic() + seconds, (math.inf, np.array(list(start.values())))
    best[1][logarithmic] = np.log(best[1][logarithmic])

    def design_of(point: FloatArray) -> Design:
        """Return the design at a point of the search, with figures of four digits."""
        values = np.where(logarithmic, np.exp(np.where(logarithmic, point, 0.0)), point)
        figures = dict(zip(start, (float(f"{value:.4g}") for value in values), strict=True))
        gains = observer(goal.period, figures.pop("q"), figures.pop("r"))
        law = figures.pop("stiffness"), figures.pop("rate")
        rounded = tuple(float(f"{gain:.4g}") for gain in gains)
        model = replace(plants.model, **figures)
        return Design.predicting(goal.period, model, (rounded[0], rounded[1], rounded[2]), *law)

    def cost(point: FloatArray) -> float:
        nonlocal best
        if time.monotonic() > end:
            raise StopIteration
        try:
            found = goal.cost(design_of(point), plants, boxes)
        except FlatsatError:  # a negative delay, say
            return math.inf
        if found < best[0]:
            best = found, point.copy()
            progress(f"tube {found:.2f} cm")
        return found

    sizes = np.array([steps[name] for name in start])
    try:
        for law in _LAWS:
            point = best[1].copy()
            point[:2] = np.log(law)
            if cost(point) < math.inf:
                break
        for number in range(_ROUNDS):
            simplex = np.vstack([best[1], best[1] + np.diag(sizes) * (-1.0) ** number])
            options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3, "maxfev": _EVALUATIONS}
            with np.errstate(invalid="ignore"):  # differences of infinite costs
                minimize(cost, best[1], method="Nelder-Mead", options=options)
    except StopIteration:
        pass
    if not math.isfinite(best[0]):
        raise FlatsatError("tube of every design that was tried = inf: must be bounded, ask for less")
    return AxisDesign(plants.box, plants.lag_varies, design_of(best[1]), EXCESS)
