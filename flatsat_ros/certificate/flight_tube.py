"""The tube: how far the loop that flies can be from its reference, proved for all plants of a box and all gains.

Per cell of the box, with the loop z+ = A z + B w of the cell's middle at the middle k^ of the gain interval, a bound of
a signal y = C z is sum_i |C A^i B| times that of w, exact for one loop. The differences between a plant of the cell and
the middle (`flight_cell`), and (k - k^) v0 for a gain that varies arbitrarily, are further inputs, bounded by signals
of the loop itself: a small gain argument. To first order in these differences the response to them is computed exactly,
as a derivative, and bounded at the vertices of the cell, because a sum of absolute values is convex; only the
remainder, of second order, is bounded by small gains. docs/mathematics.md has the proof.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction

import numpy as np

from flatsat_ros.base.errors import FlatsatError, refusal, require_fields, require_not_negative
from flatsat_ros.certificate.enclosures import UP, decimal, upper
from flatsat_ros.certificate.flight_batch import side_by_side
from flatsat_ros.certificate.flight_bounds import CellBounds, Drives
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design, Plant
from flatsat_ros.certificate.sampled_loop import require_few_under_way


@dataclass(frozen=True)
class Assumptions:
    """The assumptions of the tube: bounds of Euclidean norms over the axes that share a loop.

    Attributes:
        disturbance_rate: of the acceleration by which nature disturbs, m/s^3.
        noise: of measured positions, m.
        acceleration: of the reference, m/s^2; only drag and tilt need it.
        jerk: of the reference, m/s^3.
        snap: of the reference, m/s^4.
        pose_age: of the newest pose at a tick, s; at every tick the estimator has one that is no older.

    Raises:
        FlatsatError: a value is negative or not finite.
    """

    disturbance_rate: float
    noise: float
    acceleration: float
    jerk: float
    snap: float
    pose_age: float = 0.0

    def __post_init__(self) -> None:
        require_fields(self, require_not_negative, disturbance_rate="m/s^3", noise="m", acceleration="m/s^2")
        require_fields(self, require_not_negative, jerk="m/s^3", snap="m/s^4", pose_age="s")

    def drive(self, model: Plant, period: float, low: Plant, high: Plant) -> float:
        """Return a bound of the difference between f and what the reference needs at the input of any plant, m/s^2.

        The ripple that comes from holding f for a period while the reference moves on is not included, see `ripple`.

        Args:
            model: the nominal plant, for which f is made.
            period: h, s.
            low: least figures of the plants.
            high: largest figures of the plants.
        """
        jerk = self._ripple(model)
        snap = decimal(self.snap) + abs(decimal(model.drag) + decimal(model.tilt)) * decimal(self.jerk)
        nominal, lead, h = decimal(model.delay), _leads(model, model)[0], decimal(period)
        shortest, longest = _leads(low, high)
        lag = 1 / decimal(low.frequency) ** 2 if low.frequency > 0.0 else 0
        earliest, latest = decimal(low.delay), decimal(high.delay)
        due = lead + nominal  # f is taken ahead by so much, and by half a period
        early = max(abs(due - longest - latest), abs(due - shortest - earliest))
        ahead = max(abs(earliest - nominal), abs(latest - nominal)) + h / 2
        bend = ahead**2 / 2 + lead * ahead + lag + h**2 / 4
        leaning = max(abs(decimal(plant.tilt)) for plant in (low, high)) / decimal(low.gain)
        tilted = leaning * (longest * decimal(self.acceleration) + lag * decimal(self.jerk))
        return upper(early * jerk + bend * snap + tilted)

    def ripple(self, model: Plant) -> float:
        """Return a bound of how fast f has to change for the reference, m/s^3.

        While f is held, its difference to what is needed is this times the time from the middle of the period.

        Args:
            model: the nominal plant.
        """
        return upper(self._ripple(model))

    def _ripple(self, model: Plant) -> Fraction:
        return decimal(self.jerk) + abs(decimal(model.drag) + decimal(model.tilt)) * decimal(self.acceleration)

    def rate(self, model: Plant, low: Plant, high: Plant) -> float:
        """Return a bound of D', m/s^3, on any plant between two: of nature, and of what the loop makes of references.

        Args:
            model: the nominal plant.
            low: least figures of the plants.
            high: largest figures of the plants.
        """
        acceleration = decimal(self.acceleration)
        asked = decimal(model.drag) + decimal(model.tilt)
        wrong_gain = max(abs(decimal(plant.gain) - 1) for plant in (low, high))
        unknown = max(abs(asked - decimal(plant.drag) - decimal(plant.tilt)) for plant in (low, high))
        made = wrong_gain * self._ripple(model) + unknown * acceleration
        return upper(decimal(self.disturbance_rate) + made)


def _leads(low: Plant, high: Plant) -> tuple[Fraction, Fraction]:
    """Return the shortest and the longest lead of plants between two, s."""
    if low.frequency > 0.0:
        shortest = 2 * decimal(low.damping) / decimal(high.frequency)
        return shortest, 2 * decimal(high.damping) / decimal(low.frequency)
    return decimal(low.lag), decimal(high.lag)


@dataclass(frozen=True)
class AxisTube:
    """Bounds of Euclidean norms over the axes, when the response to the beginning has decayed.

    Attributes:
        position: |e|, m, at all times.
        velocity: |e'|, m/s, at the ticks.
        nominal: |v0|, m/s^2.
        disturbance: |D/g - d^|, m/s^2, at the ticks.
    """

    position: float
    velocity: float
    nominal: float
    disturbance: float

    def __or__(self, other: AxisTube) -> AxisTube:
        """Return the larger of each."""
        return AxisTube(*(max(getattr(self, f.name), getattr(other, f.name)) for f in fields(AxisTube)))


def cell_tubes(
    design: Design,
    boxes: Sequence[PlantBox],
    gain_min: float,
    gain_max: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
) -> list[AxisTube]:
    """Return the tube of all plants of each of some boxes, as one cell each.

    Args:
        design: the controller.
        boxes: the plants; no whole period lies between the delays of a box.
        gain_min: smallest applied gain k, which may change at every tick.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: whether lag, frequency and damping change in flight, within the box; if so the tube is larger.

    Returns:
        Bounds; infinite ones if the small gain argument does not hold for so large a cell.

    Raises:
        FlatsatError: a whole period lies inside the interval of the delay, or the gains are no interval above 0.
    """
    tubes = [AxisTube(math.inf, math.inf, math.inf, math.inf)] * len(boxes)
    for places, bounds in cell_bounds(design, boxes, gain_min, gain_max, assumptions.pose_age, lag_varies):
        for place, tube in zip(places, tubes_of(bounds, [boxes[place] for place in places], assumptions), strict=True):
            tubes[place] = tube
    return tubes


def tubes_of(bounds: CellBounds, boxes: Sequence[PlantBox], assumptions: Assumptions) -> list[AxisTube]:
    """Return the tube of each of some boxes, which are cells of one structure.

    Args:
        bounds: of the cells.
        boxes: the plants of each.
        assumptions: bounds of the inputs.
    """
    design, cells = bounds.cells.loop.design, bounds.cells
    model = design.model
    model_drive, ripple = assumptions.drive(model, design.period, model, model), assumptions.ripple(model)
    most = ripple * design.period / 2.0 * UP
    rate = np.array([assumptions.rate(model, box.low, box.high) for box in boxes])
    error = np.array([assumptions.drive(model, design.period, box.low, box.high) for box in boxes])
    inputs = bounds.amplitudes(
        cells.port_gain * error,
        rate=rate,
        noise=assumptions.noise,
        share=cells.share_error * rate,
        model_drive=model_drive,
    )
    inputs += bounds.held(cells.port_gain * ripple, ripple)
    drives = Drives(cells.port_gain * (error + most) * UP, rate, model_drive + most, bounds.pose_age)
    found, bend = bounds.settled(*bounds.answered(inputs), drives)
    found[:, 0] += cells.period**2 / 8.0 * bend
    return [AxisTube(*values) for values in (found * UP).tolist()]


def cell_bounds(
    design: Design,
    boxes: Sequence[PlantBox],
    gain_min: float,
    gain_max: float,
    pose_age: float,
    lag_varies: bool,
    faster: float | None = None,
    coarse: bool = False,
) -> Iterator[tuple[list[int], CellBounds]]:
    """Yield the sums of boxes as one cell each, whose poses are half as old as they may be, with the boxes' places.

    With `faster` they have those of `CellBounds.growing`, too; `coarse` is as for `Cells`.

    Raises:
        FlatsatError: a whole period lies inside the interval of a delay or it is longer than 40 periods, the gains are
            no interval above 0, or poses are older than two periods.
    """
    if not pose_age <= 2.0 * design.period:
        raise refusal("pose_age", pose_age, "s", f"at most two periods, {2.0 * design.period:g} s")
    for delay in (design.model.delay, *(box.high.delay for box in boxes)):
        require_few_under_way("delay", delay, design.period)
    for box in boxes:
        if not box.within_periods(design.period):
            raise FlatsatError(f"delays from {box.low.delay} to {box.high.delay} s: must have no whole period inside")
    if not 0.0 < gain_min <= gain_max:
        raise refusal("gain_min", gain_min, "", f"above 0 and at most gain_max, {gain_max:g}")
    for places, cells in side_by_side(design, boxes, decimal(pose_age) / 2, coarse):
        yield places, CellBounds(cells, gain_min, gain_max, lag_varies, faster)


def box_tube(
    design: Design,
    box: PlantBox,
    cuts: Sequence[str],
    gain_min: float,
    gain_max: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
) -> AxisTube:
    """Return the tube of all plants of a box that is cut into cells.

    Args:
        design: the controller.
        box: the plants.
        cuts: for the box and then for the lower and the upper half of whatever is cut, each with its own halves before
            the next: the figure across which it is cut into halves (`PlantBox.halves`), or "" for a cell.
        gain_min: smallest applied gain k.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: as for `cell_tubes`; across these figures there must be no cut.

    Raises:
        FlatsatError: as `cell_tubes`; or the cuts leave parts over, go on without any, or name no figure of a part.
    """
    tube = AxisTube(0.0, 0.0, 0.0, 0.0)
    parts = cells(box, cuts, design.period, lag_varies)
    for part in cell_tubes(design, parts, gain_min, gain_max, assumptions, lag_varies):
        tube |= part
    return tube


def cells(box: PlantBox, cuts: Sequence[str], period: float, lag_varies: bool) -> list[PlantBox]:
    """Return the cells into which a box is cut; the arguments are those of `box_tube`."""
    found, waiting = [], [box]
    for name in cuts:
        if not waiting:
            raise refusal("number of cuts", len(cuts), "", "no more than there are parts")
        part = waiting.pop()
        if not name:
            found.append(part)
            continue
        possible = part.constants(lag_varies)
        if name not in possible:
            raise refusal("a cut", name, "", f"one of {', '.join(possible)}, the figures to cut its part across")
        waiting.extend(reversed(part.halves(name, period)))
    if waiting:
        raise refusal("number of cuts", len(cuts), "", f"more, {len(waiting)} parts are left")
    return found
