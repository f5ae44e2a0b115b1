"""The tube: how far the loop that flies can be from its reference, proved for all plants of a box and all gains.

Per cell of the box, with the loop z+ = A z + B w of the cell's middle at the middle k^ of the gain interval, a bound of
a signal y = C z is sum_i |C A^i B| times that of w, exact for one loop. What separates a plant of the cell from the
middle (`flight_cell`), and (k - k^) v0 of a gain that varies as it likes, are further inputs, bounded by signals of the
loop itself: a small gain argument. To first order in the distances from the middle the answer to them is computed
exactly, as a derivative of the response, and bounded at the vertices of the cell, because a sum of absolute values is
convex; only what is left, of second order, is left to the small gains. docs/mathematics.md has the proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from flatsat_ros.base.errors import FlatsatError, refusal, require_fields, require_not_negative
from flatsat_ros.certificate.flight_bounds import Bounds
from flatsat_ros.certificate.flight_cell import Box, Cell
from flatsat_ros.certificate.flight_loop import Design, Plant


@dataclass(frozen=True)
class Assumptions:
    """What the tube takes for granted; Euclidean norms over the axes that share a loop.

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
        """Return a bound of what f has too much for the reference at the input of any plant between two, m/s^2.

        It is without the ripple that is there because f is held for a period while the reference moves on.

        Args:
            model: the nominal plant, for which f is made.
            period: h, s.
            low: least figures of the plants.
            high: largest figures of the plants.
        """
        jerk, snap = self.ripple(model), self.snap + abs(model.drag + model.tilt) * self.jerk
        second = low.frequency > 0.0
        shortest = 2.0 * low.damping / high.frequency if second else low.lag
        longest = 2.0 * high.damping / low.frequency if second else high.lag
        lag = 1.0 / low.frequency**2 if second else 0.0
        due = model.lead + model.delay  # f is taken ahead by so much, and by half a period
        early = max(abs(due - longest - high.delay), abs(due - shortest - low.delay))
        ahead = max(abs(low.delay - model.delay), abs(high.delay - model.delay)) + period / 2.0
        bend = ahead**2 / 2.0 + model.lead * ahead + lag + period**2 / 4.0
        tilted = max(abs(low.tilt), abs(high.tilt)) / low.gain * (longest * self.acceleration + lag * self.jerk)
        return early * jerk + bend * snap + tilted

    def ripple(self, model: Plant) -> float:
        """Return a bound of how fast f has to change for the reference, m/s^3.

        While f is held it has too little and then too much by this times the distance in time from the middle.

        Args:
            model: the nominal plant.
        """
        return self.jerk + abs(model.drag + model.tilt) * self.acceleration

    def rate(self, model: Plant, low: Plant, high: Plant) -> float:
        """Return a bound of D', m/s^3, on any plant between two: of nature, and of what the loop makes of references.

        Args:
            model: the nominal plant.
            low: least figures of the plants.
            high: largest figures of the plants.
        """
        asked = model.drag + model.tilt
        wrong_gain = max(abs(low.gain - 1.0), abs(high.gain - 1.0))
        unknown = max(abs(asked - low.drag - low.tilt), abs(asked - high.drag - high.tilt))
        return self.disturbance_rate + wrong_gain * self.ripple(model) + unknown * self.acceleration


@dataclass(frozen=True)
class Tube:
    """Bounds of Euclidean norms over the axes, once the loop has forgotten how it began.

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

    def __or__(self, other: Tube) -> Tube:
        """Return the larger of each."""
        return Tube(*(max(getattr(self, f.name), getattr(other, f.name)) for f in fields(Tube)))


def cell_tube(
    design: Design, box: Box, gain_min: float, gain_max: float, assumptions: Assumptions, lag_varies: bool = False
) -> Tube:
    """Return the tube of all plants of a box, as one cell.

    Args:
        design: the controller.
        box: the plants, none of whose delays are separated by a whole period.
        gain_min: smallest applied gain k, which may be another at every tick.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: whether lag, frequency and damping change in flight, within the box; if so the tube is larger.

    Returns:
        Bounds; infinite ones if the small gain argument does not hold for so large a cell.

    Raises:
        FlatsatError: a whole period lies inside the interval of the delay, or the gains are no interval above 0.
    """
    bounds = cell_bounds(design, box, gain_min, gain_max, assumptions.pose_age, lag_varies)
    model, period = design.model, design.period
    rate, error = assumptions.rate(model, box.low, box.high), assumptions.drive(model, period, box.low, box.high)
    cell = bounds.cell
    if not bounds.answers.finite:
        return Tube(math.inf, math.inf, math.inf, math.inf)
    model_drive = assumptions.drive(model, period, model, model)
    inputs = bounds.amplitudes(
        cell.port_gain * error,
        rate=rate,
        noise=assumptions.noise,
        share=cell.share_error * rate,
        model_drive=model_drive,
    )
    ripple = assumptions.ripple(model)
    inputs += bounds.held(cell.port_gain * ripple, ripple)
    most = ripple * period / 2.0
    settled = bounds.settled(
        *bounds.answered(inputs),
        cell.port_gain * (error + most),
        rate,
        model_drive + most,
        assumptions.pose_age / 2.0,
    )
    if settled is None:
        return Tube(math.inf, math.inf, math.inf, math.inf)
    (position, velocity, nominal, disturbance), bend = settled[0].tolist(), settled[1]
    return Tube(position + period * period / 8.0 * bend, velocity, nominal, disturbance)


def cell_bounds(
    design: Design,
    box: Box,
    gain_min: float,
    gain_max: float,
    pose_age: float,
    lag_varies: bool,
    growth: float | None = None,
) -> Bounds:
    """Return the sums of a box as one cell, whose poses are half as old as they may be, having checked that it is one.

    Raises:
        FlatsatError: a whole period lies inside the interval of the delay, the gains are no interval above 0, or poses
            are older than two periods.
    """
    if not pose_age <= 2.0 * design.period:
        raise refusal("pose_age", pose_age, "s", f"at most two periods, {2.0 * design.period:g} s")
    if not box.within_periods(design.period):
        raise FlatsatError(f"delays from {box.low.delay} to {box.high.delay} s: must have no whole period inside")
    if not 0.0 < gain_min <= gain_max:
        raise refusal("gain_min", gain_min, "", f"above 0 and at most gain_max, {gain_max:g}")
    return Bounds(Cell(design, box, pose_age / 2.0), gain_min, gain_max, growth, lag_varies)


def box_tube(
    design: Design,
    box: Box,
    cuts: Sequence[str],
    gain_min: float,
    gain_max: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
) -> Tube:
    """Return the tube of all plants of a box that is cut into cells.

    Args:
        design: the controller.
        box: the plants.
        cuts: for the box and then for the lower and the upper half of whatever is cut, each with its own halves before
            the next: the figure across which it is cut into halves (`Box.halves`), or "" for a cell.
        gain_min: smallest applied gain k.
        gain_max: largest applied gain.
        assumptions: bounds of the inputs.
        lag_varies: as for `cell_tube`; across these figures there must be no cut.

    Raises:
        FlatsatError: as `cell_tube`; or the cuts leave parts over, go on without any, or name no figure of a part.
    """
    tube = Tube(0.0, 0.0, 0.0, 0.0)
    for part in cells(box, cuts, design.period, lag_varies):
        tube |= cell_tube(design, part, gain_min, gain_max, assumptions, lag_varies)
    return tube


def cells(box: Box, cuts: Sequence[str], period: float, lag_varies: bool) -> list[Box]:
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
