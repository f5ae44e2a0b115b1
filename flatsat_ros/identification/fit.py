"""The figures of a drone that fit its flights best, by output-error least squares, and how well they are known.

The cost is robust (soft L1), the covariance that of blocks of BLOCK seconds, since the residuals are disturbances that
last. Figures that nothing in the flights excites are not fitted: they keep the value they had.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.identification.residuals import ComparedFlight, Misfit, misfit
from flatsat_ros.identification.response import Figures
from flatsat_ros.identification.screening import STEP

BLOCK = 2.0  # s, longer than the disturbances are correlated
# of each figure: bounds and a step that matters, in its unit
BOUNDS = {
    "attitude_gain": (0.3, 1.6, 0.1),
    "natural_frequency": (5.0, 60.0, 3.0),
    "damping": (0.2, 3.0, 0.2),
    "velocity_tilt": (-0.1, 0.1, 0.01),
    "thrust_slope": (0.3, 2.0, 0.1),
    "thrust_lag": (0.01, 0.4, 0.03),
    "thrust_voltage": (-3.0, 4.0, 0.2),
    "drag_xy": (0.0, 2.0, 0.1),
    "drag_z": (0.0, 3.0, 0.2),
    "delay": (0.0, 0.3, 0.02),
}
COMMON = tuple(BOUNDS)[:-1]  # the delay, that of clocks included, is each flight's own
_ATTITUDE = ("attitude_gain", "natural_frequency", "damping", "velocity_tilt", "delay")
_THRUST = ("thrust_slope", "thrust_lag")
_TILTED = math.radians(1.0)  # rad, least standard deviation of commanded tilts
_THRUSTED = 0.01  # least standard deviation of the commanded thrust over its mean
_DISCHARGED = 0.005  # least standard deviation of the logarithm of the voltage
_MOVED = 0.15  # m/s, least standard deviation of a velocity, for drag and tilt with it
_STARTS: tuple[dict[str, float], ...] = (
    {},
    {"natural_frequency": 12.0, "damping": 0.5},
    {"natural_frequency": 25.0, "damping": 1.0},
)
_SCALES = (0.02, 0.01)  # rad and m, of the residuals to begin with
_ROUNDS = 2  # fits, each with the scales of the residuals that the one before left


@dataclass(frozen=True, eq=False)
class Fit:
    """What was found.

    Attributes:
        figures: the best; the delay is the mean of those of the flights.
        delays: (n,) of each flight, s.
        free: names of the figures that were fitted; the others kept their value.
        misfits: of each flight.
        scales: standard deviations of the bulk of the residuals, rad and m.
        covariance: (len(free common) + n, same) of the free figures without delay, then of the delays where it is free.
    """

    figures: Figures
    delays: FloatArray
    free: tuple[str, ...]
    misfits: tuple[Misfit, ...]
    scales: tuple[float, float]
    covariance: FloatArray

    def of(self, flight: int) -> Figures:
        """Return the figures with the delay of one flight."""
        return dataclasses.replace(self.figures, delay=float(self.delays[flight]))

    def deviation(self, gradient: dict[str, float]) -> float:
        """Return the standard deviation of a function of the figures with these derivatives, as the residuals tell."""
        common = [name for name in self.free if name != "delay"]
        row = [gradient.get(name, 0.0) for name in common]
        count = len(self.covariance) - len(common)
        row += [gradient.get("delay", 0.0) / count] * count if count else []
        return math.sqrt(max(float(np.array(row) @ self.covariance @ np.array(row)), 0.0)) if row else 0.0


def excited(flights: Sequence[ComparedFlight]) -> tuple[str, ...]:
    """Return the names of the figures on which the flights depend enough to be told."""
    names: set[str] = set()
    for flight in flights:
        samples, motion = flight.motion.samples, flight.motion
        use = samples.usable
        if samples.command[use, :2].std(axis=0).max() > _TILTED:
            names.update(_ATTITUDE[:-2] + ("delay",))
        if samples.command[use, 2].std() > _THRUSTED * samples.command[use, 2].mean():
            names.update(_THRUST)
        if len(samples.voltage) and np.log(samples.voltage[use]).std() > _DISCHARGED:
            names.add("thrust_voltage")
        speed = motion.velocity[use].std(axis=0)
        if speed[:2].max() > _MOVED:
            names.add("drag_xy")
            if "attitude_gain" in names:
                names.add("velocity_tilt")
        if speed[2] > _MOVED:
            names.add("drag_z")
    return tuple(name for name in BOUNDS if name in names)


def fit(
    flights: Sequence[ComparedFlight],
    begin: Figures,
    free: Sequence[str],
    *,
    starts: int = len(_STARTS),
    advance: Callable[[], None] = lambda: None,
) -> Fit:
    """Fit figures to flights.

    Args:
        flights: of one drone.
        begin: where to start, and what the figures that are not free keep.
        free: names of those to be found.
        starts: number of attitude responses to start from.
        advance: called after each of `starts + 1` parts of the work.

    Raises:
        FlatsatError: a flight has no time that can be compared.
    """
    for flight in flights:
        if len(flight.position_at) < 20:
            name = flight.motion.samples.name
            raise FlatsatError(f"{name}: the usable pieces of flight are shorter than 0.5 s: nothing to compare")
    problem = _Problem(flights, begin, tuple(free))
    scales, solutions = _SCALES, []
    for changes in _STARTS[: max(1, starts)]:
        changed = {name: value for name, value in changes.items() if name in free}
        solutions.append(problem.solve(problem.vector(dataclasses.replace(begin, **changed)), scales, 10))
        advance()
    best = min(solutions, key=lambda found: found[1])[0]
    for _ in range(_ROUNDS - 1):
        scales = problem.scales(best)
        best = problem.solve(best, scales)[0]
    advance()
    figures = problem.figures(best)
    delays = np.array([each.delay for each in figures])
    return Fit(
        dataclasses.replace(figures[0], delay=float(delays.mean())),
        delays,
        tuple(free),
        tuple(misfit(*pair) for pair in zip(flights, figures, strict=True)),
        problem.scales(best),
        problem.covariance(best, scales),
    )


class _Problem:
    """Least squares over the free figures: those in common, then a delay for each flight."""

    def __init__(self, flights: Sequence[ComparedFlight], begin: Figures, free: tuple[str, ...]) -> None:
        self._flights, self._begin = flights, begin
        self._names = [name for name in COMMON if name in free]
        self._delays = "delay" in free
        names = self._names + ["delay"] * (len(flights) if self._delays else 0)
        table = np.array([BOUNDS[name] for name in names]).reshape(-1, 3)
        self._low, self._high, self._step = table.T

    def vector(self, figures: Figures) -> FloatArray:
        """Return the free figures as a vector inside the bounds."""
        names = self._names + ["delay"] * (len(self._flights) if self._delays else 0)
        values = np.array([getattr(figures, name) for name in names])
        return np.asarray(np.clip(values, self._low + 1e-3 * self._step, self._high - 1e-3 * self._step))

    def figures(self, vector: FloatArray) -> list[Figures]:
        """Return the figures of each flight."""
        common = dict(zip(self._names, map(float, vector), strict=False))
        shared = dataclasses.replace(self._begin, **common)
        delays = vector[len(self._names) :] if self._delays else [self._begin.delay] * len(self._flights)
        return [dataclasses.replace(shared, delay=float(delay)) for delay in delays]

    def scales(self, vector: FloatArray) -> tuple[float, float]:
        """Return the standard deviations of the bulk of attitude and position residuals, rad and m."""
        found = [misfit(*pair) for pair in zip(self._flights, self.figures(vector), strict=True)]
        attitude, position = (
            np.concatenate([getattr(each, name).ravel() for each in found]) for name in ("attitude", "position")
        )
        bulk = [max(1.4826 * float(np.median(np.abs(part))), 1e-5) for part in (attitude, position)]
        return bulk[0], bulk[1]

    def solve(self, begin: FloatArray, scales: tuple[float, float], most: int = 40) -> tuple[FloatArray, float]:
        """Return the best vector from one start after at most so many steps, and its cost."""
        if len(begin) == 0:
            return begin, 0.0
        found = least_squares(
            lambda x: np.concatenate(self._residuals(x, scales)),
            begin,
            jac=lambda x: self._jacobian(x, scales),
            bounds=(self._low, self._high),
            x_scale=self._step,
            loss="soft_l1",
            xtol=1e-5,
            ftol=1e-6,
            max_nfev=most,
        )
        return np.asarray(found.x), float(found.cost)

    def covariance(self, vector: FloatArray, scales: tuple[float, float]) -> FloatArray:
        """Return the covariance of the free figures from the scatter of the gradient between blocks."""
        if len(vector) == 0:
            return np.zeros((0, 0))
        jacobian, parts = self._jacobian(vector, scales), self._residuals(vector, scales)
        residuals = np.concatenate(parts)
        weight = 1.0 / np.sqrt(1.0 + residuals**2)
        curvature = jacobian.T @ (weight[:, None] * jacobian)
        gradient = (weight * residuals)[:, None] * jacobian
        labels, count = [], 0
        for flight in self._flights:
            for at, width in ((flight.attitude_at, 2), (flight.position_at, 3)):
                labels.append(count + np.repeat(at, width) // round(BLOCK / STEP))
            count = int(max(labels[-1].max(), labels[-2].max())) + 1
        blocks = np.zeros((count, len(vector)))
        np.add.at(blocks, np.concatenate(labels), gradient)
        used = int(np.count_nonzero(np.abs(blocks).sum(axis=1)))
        inverse = np.linalg.pinv(curvature, hermitian=True)
        return np.asarray(inverse @ (blocks.T @ blocks) @ inverse * (used / max(used - len(vector), 1)))

    def _residuals(self, vector: FloatArray, scales: tuple[float, float]) -> list[FloatArray]:
        pairs = zip(self._flights, self.figures(vector), strict=True)
        return [misfit(*pair).vector(*scales) for pair in pairs]

    def _jacobian(self, vector: FloatArray, scales: tuple[float, float]) -> FloatArray:
        """Return the derivatives by forward differences; a flight depends on its own delay alone."""
        base, shared = self._residuals(vector, scales), len(self._names)
        rows = [np.zeros((len(part), len(vector))) for part in base]
        steps = np.where(vector + 0.01 * self._step <= self._high, 0.01, -0.01) * self._step
        for k in range(shared):
            moved = vector.copy()
            moved[k] += steps[k]
            for row, after, before in zip(rows, self._residuals(moved, scales), base, strict=True):
                row[:, k] = (after - before) / steps[k]
        if self._delays:
            moved = vector.copy()
            moved[shared:] += steps[shared:]
            for k, (row, after, before) in enumerate(zip(rows, self._residuals(moved, scales), base, strict=True)):
                row[:, shared + k] = (after - before) / steps[shared + k]
        return np.concatenate(rows)
