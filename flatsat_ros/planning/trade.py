"""What speed costs: references with larger bounds are shorter, and their certified tubes larger."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.planning.mission import Mission
from flatsat_ros.plans.tubes import promise

_FACTORS = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0)  # of the mission's acceleration, up to 1, jerk and snap


class Choice(NamedTuple):
    """One choice of bounds.

    Attributes:
        acceleration_max: m/s^2; None for no bound. More than the mission's is never proved.
        jerk_max, snap_max: m/s^3, m/s^4.
        tube: m, what the certificate proves then; None for nothing.
        bound: s; no plan with these bounds is shorter. None if nothing can be planned, or none is known.
        refused: why not; empty where something can.
    """

    acceleration_max: float | None
    jerk_max: float
    snap_max: float
    tube: float | None
    bound: float | None
    refused: str = ""


def trade(mission: Mission, certificate: Certificate) -> Iterator[Choice]:
    """Yield tube and duration for several bounds of a mission, up to fifteen seconds of computation.

    Raises:
        FlatsatError: the certificate proves no tubes, or the mission's times are given.
    """
    from flatsat_ros.planning.improvement import bound_of  # scipy and the solver take a while to import

    if certificate.flight is None:
        raise FlatsatError(f"certificate {certificate.name!r} has no flight section: it proves no tubes to choose from")
    if mission.times is not None:
        raise FlatsatError("the times of the way-points are given: larger bounds make no plan shorter")
    for factor in _FACTORS:
        own, radius = mission.bounds, None
        most = None if own.acceleration_max is None else min(factor, 1.0) * own.acceleration_max
        figures = most, factor * own.jerk_max, factor * own.snap_max
        try:
            bounds, tube = promise(
                certificate, own.lower, own.upper, downwash=mission.downwash, acceleration_max=figures[0],
                jerk_max=figures[1], snap_max=figures[2], speed_max=own.speed_max,
            )  # fmt: skip
            radius = tube.radius
            asked = replace(mission, bounds=bounds, tube=tube)
            yield Choice(*figures, radius, bound_of(asked))
        except FlatsatError as error:
            yield Choice(*figures, radius, None, str(error))
