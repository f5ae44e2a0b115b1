"""What a flight certificate for a drone may take for granted, as the flights of that drone show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from flatsat_ros.base.errors import FlatsatError, require
from flatsat_ros.certificate.flight_tube import Assumptions
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.identification.disturbances import disturbances, shared
from flatsat_ros.identification.fit import BOUNDS
from flatsat_ros.identification.identified import Identified
from flatsat_ros.identification.log import FlightLog, ages
from flatsat_ros.identification.validation import oldest

COVERAGE = 0.999  # of the samples, if nothing else is asked for
_LAG_LEAST = 2.0 * BOUNDS["damping"][0] / BOUNDS["natural_frequency"][1]  # s, of what a fit may find


def require_coverage(coverage: float) -> None:
    """Refuse what is no share of samples to be covered.

    Raises:
        FlatsatError: it is not above 0.5 and below 1.
    """
    require(0.5 < coverage < 1.0, "--coverage", coverage, "", "above 0.5 and below 1")


def assumptions(
    identified: Identified,
    logs: Sequence[FlightLog],
    vehicle: VehicleProfile,
    reference: Assumptions,
    coverage: float = COVERAGE,
) -> dict[str, float | list[float]]:
    """Return bounds that a share of the samples keep, and intervals of the figures that a log tells.

    Args:
        identified: what the flights tell.
        logs: of the flights.
        vehicle: for the least delay, that on board.
        reference: whose acceleration, jerk and snap are taken over, which no log tells.
        coverage: the share, above 0.5 and below 1.

    Returns:
        The fields of `Assumptions`, and the ends of the intervals `lag`, s, `delay`, s, `gain` and, where they are
        told, `frequency`, rad/s, and `damping`. A log tells the sum of lag and delay alone: the delay is from that on
        board to the longest that the fit found, the lag whatever the sum leaves for such a delay.

    Raises:
        FlatsatError: the flights do not tell one of them; or the coverage is no such share, or more than the number of
            samples can show.
    """
    require_coverage(coverage)
    _, change = disturbances(identified.flights, identified.common)
    for name, count in (("disturbance_rate", len(change)), ("noise", len(identified.noise))):
        least = round(1.0 / (1.0 - coverage))
        enough = f"at least {least} for a coverage of {coverage}: more flights, or a smaller one"
        require(count >= least, f"samples of {name}", count, "", enough)
    gain, total = (identified.figures[name].interval for name in ("attitude_gain", "lag_and_delay"))
    if gain is None or total is None:
        raise FlatsatError(
            "the flights do not tell attitude gain, lag and delay: must have more motion, at 0.5 to 3 Hz"
        )
    longest = max(vehicle.delay, float(identified.common.delays.max()))
    delay = vehicle.delay, longest
    lag = max(total[0] - delay[1], _LAG_LEAST), max(total[1] - delay[0], _LAG_LEAST)
    told = {"gain": gain}
    for name, figure in (("frequency", "natural_frequency"), ("damping", "damping")):
        interval = identified.figures[figure].interval
        if interval is not None:
            told[name] = interval
    bounds = replace(
        reference,
        disturbance_rate=float(np.quantile(shared(change), coverage)),
        noise=float(np.quantile(shared(identified.noise), coverage)),
        pose_age=oldest(np.concatenate([ages(log) for log in logs]), coverage),
    )
    return asdict(bounds) | {name: list(ends) for name, ends in ({"lag": lag, "delay": delay} | told).items()}
