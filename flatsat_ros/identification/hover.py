"""Hover thrust: how much force the motors really give, from the commands of a drone that hovers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from flatsat_ros.base.arrays import finite_array, float_array, require_each
from flatsat_ros.base.errors import LARGEST, SMALLEST, FlatsatError, refusal, require_positive
from flatsat_ros.flight.modes import Mode
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
        FlatsatError: too few rows, rows of different lengths, the drone did not fly all the time, it moved too much for
            a hover, or what was asked for is not a thrust.
    """
    table = float_array("telemetry", rows)
    if table.ndim != 2 or table.shape[1] != len(FIELDS) or len(table) < _TICKS:
        raise refusal("shape of telemetry", table.shape, "", f"(M, {len(FIELDS)}) with M >= {_TICKS}")
    column = dict(zip(FIELDS, table.T, strict=True))
    if (column["mode"] != Mode.FLY).any():
        raise FlatsatError("the drone did not fly all the time: hover at a set-point while measuring")
    with np.errstate(over="ignore"):  # such a drift is refused
        drift = float(np.sqrt(np.mean(column["error_vx"] ** 2 + column["error_vy"] ** 2 + column["error_vz"] ** 2)))
    if not drift <= _DRIFT:
        raise refusal("mean velocity", drift, "m/s", f"at most {_DRIFT} m/s: hover at a set-point")
    used = ("T", "thrust_scale", "phi", "theta")
    thrust, scale, phi, theta = (finite_array(f"{name} of the telemetry", column[name]) for name in used)
    require_each(scale >= SMALLEST, "thrust_scale of the telemetry", scale, "", f"at least {SMALLEST:g}")
    require_each((thrust >= 0.0) & (thrust <= LARGEST), "T of the telemetry", thrust, "m/s^2", f"from 0 to {LARGEST:g}")
    upward = thrust / scale * np.cos(phi) * np.cos(theta)
    mean = require_positive("mean vertical thrust", float(upward.mean()), "m/s^2")
    return gravity / mean, gravity / mean**2 * float(upward.std()) / math.sqrt(len(upward))
