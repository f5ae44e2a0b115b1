"""Hover thrust: how much force the motors really give, from the commands of a drone that hovers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.errors import FlatsatError, refusal
from flatsat_ros.flight.supervisor import Mode
from flatsat_ros.flight.telemetry import FIELDS

# largest root mean square velocity of a hover, m/s, and the smallest number of ticks to measure over
_DRIFT = 0.15
_TICKS = 20


def thrust_scale(rows: ArrayLike, gravity: float) -> tuple[float, float]:
    """Return actual thrust over commanded thrust, from the telemetry of a hover at a set-point.

    While the height does not change, the vertical part of the actual thrust balances gravity. So the ratio is
    g / mean(T cos(phi) cos(theta)), for the thrust T that was asked for on the wire.

    Args:
        rows: (M, len(FIELDS)) telemetry, one row a tick, as `flatsat_ros.flight.telemetry.rows` makes it.
        gravity: g, m/s^2.

    Returns:
        The ratio and its standard error, both dimensionless.

    Raises:
        FlatsatError: too few rows, the drone did not fly all the time, or it moved too much for a hover.
    """
    table = np.asarray(rows, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != len(FIELDS) or len(table) < _TICKS:
        raise refusal("shape of telemetry", table.shape, "", f"(M, {len(FIELDS)}) with M >= {_TICKS}")
    column = dict(zip(FIELDS, table.T, strict=True))
    if (column["mode"] != Mode.FLY).any():
        raise FlatsatError("the drone did not fly all the time: hover at a set-point while measuring")
    drift = float(np.sqrt(np.mean(column["error_vx"] ** 2 + column["error_vy"] ** 2 + column["error_vz"] ** 2)))
    if not drift <= _DRIFT:
        raise refusal("mean velocity", drift, "m/s", f"at most {_DRIFT} m/s: hover at a set-point")
    asked = column["T"] / column["thrust_scale"]
    upward = asked * np.cos(column["phi"]) * np.cos(column["theta"])
    mean = float(upward.mean())
    return gravity / mean, gravity / mean**2 * float(upward.std()) / math.sqrt(len(upward))
