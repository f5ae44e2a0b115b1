"""The way back into the tube: how fast a drone returns from any start.

By linearity the distance to the reference is the sum of two: that of a drone that started on the reference, which is in
the tube, and the response to the start alone. Multiplied by e^(rate t) this response obeys the same loop with A
replaced by e^(rate h) A; what bounds it is the largest of its values, not their sum. The rows C A^i are those of the
tube, so both are computed at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.enclosures import UP, decimal, exponential_above
from flatsat_ros.certificate.flight_bounds import CellBounds, Drives
from flatsat_ros.certificate.flight_cell import PlantBox
from flatsat_ros.certificate.flight_plant import Design
from flatsat_ros.certificate.flight_tube import Assumptions, AxisTube, cell_bounds, cells, tubes_of

# About the largest ratio of coarse bounds to close ones; and the longest period, s, of loops for which coarse bounds
# save time. What is proved does not depend on either.
_NEAR, _LONG = 1.03, 0.05

_NO_TUBE = AxisTube(math.inf, math.inf, math.inf, math.inf)


@dataclass(frozen=True)
class Return:
    """Bounds of what a start (e, e') adds to the tube t seconds later; Euclidean norms over the axes.

    The start is at a tick at which the estimate has settled, with attitude and commands as the reference needs them.

    Attributes:
        rate: 1/s, of the decay.
        position: |e| is above its tube by at most position |e(0)| e^(-rate t), at all times.
        position_velocity: s; and by position_velocity |e'(0)| e^(-rate t).
        nominal: 1/s^2, the same of what |v0| and |D/g - d^| are together, at the ticks.
        nominal_velocity: 1/s.
    """

    rate: float
    position: float
    position_velocity: float
    nominal: float
    nominal_velocity: float

    def __or__(self, other: Return) -> Return:
        """Return the larger of each."""
        return Return(*(max(getattr(self, f.name), getattr(other, f.name)) for f in fields(Return)))


def cell_claims(
    design: Design,
    boxes: Sequence[PlantBox],
    gain_min: float,
    gain_max: float,
    rate: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
    coarse: bool = False,
) -> list[tuple[AxisTube, Return]]:
    """Return the tube and the way back of each of some boxes, taken as one cell each; infinite where none is shown.

    Args:
        design: the controller.
        boxes: the plants; no whole period lies between the delays of a box.
        gain_min: smallest applied gain k, which may change at every tick.
        gain_max: largest applied gain.
        rate: 1/s.
        assumptions: bounds of the inputs; of the way back only the age of poses.
        lag_varies: whether lag, frequency and damping change in flight, within the box.
        coarse: whether the bounds may be some hundredths too large, which takes half of the time.

    Raises:
        FlatsatError: as `cell_tubes`.
    """
    h, pose_age = decimal(design.period), assumptions.pose_age
    faster = exponential_above(decimal(rate) * h)
    later = exponential_above(decimal(rate) * (decimal(pose_age) + h)) * UP  # what a pose sees has decayed less
    found = [(_NO_TUBE, Return(rate, math.inf, math.inf, math.inf, math.inf))] * len(boxes)
    for places, bounds in cell_bounds(design, boxes, gain_min, gain_max, pose_age, lag_varies, faster, coarse):
        tubes = tubes_of(bounds, [boxes[place] for place in places], assumptions)
        returns = _returns(bounds.growing(), rate, faster, later)
        for place, tube, back in zip(places, tubes, returns, strict=True):
            found[place] = tube, back
    return found


def _returns(bounds: CellBounds, rate: float, faster: float, later: float) -> list[Return]:
    """Return how plants return, from bounds of signals that grow.

    Args:
        bounds: of the cells.
        rate: 1/s.
        faster: by how much signals grow in a period.
        later: and from the oldest pose to the tick after.
    """
    none = np.zeros(len(bounds.sums))
    tracked, bend = bounds.settled(*bounds.started(), Drives(none, none, 0.0, bounds.pose_age * later))
    # from tick to tick: the tick before has decayed by one period less
    positions = faster * (tracked[..., 0] + bounds.cells.period**2 / 8.0 * bend) * UP
    nominals = (tracked[..., 2] + tracked[..., 3]) * UP
    columns = np.stack([*positions, *nominals], axis=-1)
    return [Return(rate, *claims) for claims in columns.tolist()]


def box_claims(
    design: Design,
    box: PlantBox,
    cuts: Sequence[str],
    gain_min: float,
    gain_max: float,
    rate: float,
    assumptions: Assumptions,
    lag_varies: bool = False,
) -> tuple[AxisTube, Return]:
    """Return the tube and the way back of all plants of a box that is cut into cells; arguments as of `box_tube`.

    Args:
        design: the controller.
        box: the plants.
        cuts: of the box into cells.
        gain_min: smallest applied gain k.
        gain_max: largest applied gain.
        rate: 1/s, of the way back.
        assumptions: bounds of the inputs.
        lag_varies: whether lag, frequency and damping change in flight.
    """
    parts = cells(box, cuts, design.period, lag_varies)

    def claims(some: Sequence[PlantBox], coarse: bool) -> FloatArray:
        """Return those of some cells, (cells, 8): of the tubes four, and of the ways back four."""
        found = cell_claims(design, some, gain_min, gain_max, rate, assumptions, lag_varies, coarse)
        return np.array([astuple(tube) + astuple(back)[1:] for tube, back in found])

    # the coarse bounds of most cells are below the close ones of another cell: these cells need no close bounds
    coarse = design.period <= _LONG
    bounds, close = claims(parts, coarse), np.full(len(parts), not coarse)
    largest = bounds.max(axis=0, where=np.isfinite(bounds), initial=0.0) / _NEAR
    while (unsure := ~close & ~(bounds <= largest).all(axis=1)).any():
        bounds[unsure] = claims([parts[i] for i in np.flatnonzero(unsure)], coarse=False)
        close |= unsure
        largest = bounds[close].max(axis=0)
    whole = bounds.max(axis=0).tolist()
    return AxisTube(*whole[:4]), Return(rate, *whole[4:])
