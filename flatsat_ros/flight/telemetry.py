"""What is reported of every drone at every tick, in one row of floats."""

from __future__ import annotations

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.tick import Tick

# the entries of a row, in order; units in docs/interfaces.md
FIELDS = (
    "V", "V/eps", "gamma", "k", "T", "phi", "theta", "v_x", "v_y", "v_z",
    "error_x", "error_y", "error_z", "error_vx", "error_vy", "error_vz", "mode", "tick_us",
    "set", "kappa", "guaranteed", "d_x", "d_y", "d_z", "thrust_scale",
    "tube", "tube_z", "assumption", "events",
)  # fmt: skip


def rows(tick: Tick) -> FloatArray:
    """Return the telemetry (N, len(FIELDS)) of one tick.

    T, phi, theta are what is commanded in the present mode; V, k, v and the error are the law's, used in FLY only.

    Args:
        tick: of N drones.
    """
    out, where = tick.output, tick.assessment
    table = np.empty((len(tick.mode), len(FIELDS)))
    table[:, 0], table[:, 1], table[:, 2], table[:, 3] = (
        out.lyapunov, where.relative_level, out.gain, out.applied_gain,
    )  # fmt: skip
    table[:, 4:7], table[:, 7:10], table[:, 10:16] = tick.input, out.acceleration, tick.error
    table[:, 16], table[:, 17] = tick.mode, tick.duration * 1e6
    flying = tick.mode == Mode.FLY.value
    table[:, 18], table[:, 19], table[:, 20] = where.place, where.kappa, where.guaranteed & flying
    table[:, 21:24], table[:, 24] = tick.disturbance, tick.thrust_scale
    table[:, 25:27] = np.nan if where.tube is None else where.tube
    table[:, 27] = 0.0 if where.broken is None else where.broken
    table[:, 28] = 0.0
    for drone in [made.drone for made in tick.transitions] + [report.drone for report in tick.reports]:
        table[drone, 28] += 1.0
    return table
