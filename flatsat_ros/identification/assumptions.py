"""What a flight certificate for a drone may take for granted, as the flights of that drone show it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flatsat_ros.base.errors import FlatsatError, require
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.identification.disturbances import disturbances, shared
from flatsat_ros.identification.identified import Identified
from flatsat_ros.identification.log import FlightLog
from flatsat_ros.identification.validation import between_poses, oldest

COVERAGE = 0.999  # of the samples, if nothing else is asked for


def assumptions(
    identified: Identified, logs: Sequence[FlightLog], vehicle: VehicleProfile, coverage: float = COVERAGE
) -> dict[str, float | list[float]]:
    """Return bounds that a share of the samples keep, and intervals of the figures that a log tells.

    Args:
        identified: what the flights tell.
        logs: of the flights.
        vehicle: for the least delay, that on board.
        coverage: the share, above 0.5 and below 1.

    Returns:
        `disturbance_rate`, m/s^3, `noise`, m, and `pose_age`, s, as `certificate.flight_tube.Assumptions` has them, and
        the ends of the intervals `lag`, s, `delay`, s, and `gain`. A log tells the sum of lag and delay alone: the
        delay is from that on board to the longest that the fit found, the lag whatever the sum leaves for such a delay.

    Raises:
        FlatsatError: the flights do not tell one of them; or the coverage is no such share, or more than the number of
            samples can show.
    """
    require(0.5 < coverage < 1.0, "coverage", coverage, "", "above 0.5 and below 1")
    _, change = disturbances(identified.flights, identified.common)
    for name, count in (("disturbance_rate", len(change)), ("noise", len(identified.noise))):
        least = round(1.0 / (1.0 - coverage))
        enough = f"at least {least} for a coverage of {coverage:g}: more flights, or a smaller one"
        require(count >= least, f"samples of {name}", count, "", enough)
    gain, total = (identified.figures[name].interval for name in ("attitude_gain", "lag_and_delay"))
    if gain is None or total is None:
        raise FlatsatError(
            "the flights do not tell attitude gain, lag and delay: must have more motion, at 0.5 to 3 Hz"
        )
    longest = max(vehicle.delay, float(identified.common.delays.max()))
    delay = vehicle.delay, longest
    lag = max(total[0] - delay[1], 0.0), max(total[1] - delay[0], 0.0)
    return {
        "disturbance_rate": float(np.quantile(shared(change), coverage)),
        "noise": float(np.quantile(shared(identified.noise), coverage)),
        "pose_age": oldest(between_poses(logs), coverage),
        "lag": list(lag),
        "delay": list(delay),
        "gain": list(gain),
    }
