"""The log variables of a simulated Crazyflie, by the names and in the units of its firmware.

The estimate is the truth. Pitch is that of the firmware's log: positive nose up, the negative of ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import nearest_name, refusal
from flatsat_ros.sim.fleet import SimulatedFleet

_MILLI = 1000.0
_AXES = "xyz"

Variable = Callable[[SimulatedFleet, int], float]


def _axes(group: str, suffixes: Iterable[str], read: Callable[[SimulatedFleet], FloatArray]) -> dict[str, Variable]:
    """Return the variables of a group that are the columns of one array, (N, ...)."""

    def column(axis: int) -> Variable:
        return lambda fleet, number: float(read(fleet)[number, axis])

    return {f"{group}.{suffix}": column(axis) for axis, suffix in enumerate(suffixes)}


def _degrees(fleet: SimulatedFleet) -> FloatArray:
    """Roll, pitch and yaw as the firmware logs them, (N, 3), deg; yaw within half a turn."""
    roll, pitch, yaw = np.rad2deg(fleet.bodies.angles).T
    return np.stack([roll, -pitch, np.remainder(yaw + 180.0, 360.0) - 180.0], axis=-1)


VARIABLES: dict[str, Variable] = {
    **_axes("stateEstimate", _AXES, lambda fleet: fleet.bodies.position),  # m
    **_axes("stateEstimate", ("vx", "vy", "vz"), lambda fleet: fleet.bodies.velocity),  # m/s, world
    **_axes("stateEstimate", ("roll", "pitch", "yaw"), _degrees),
    **_axes("stateEstimate", ("qx", "qy", "qz", "qw"), lambda fleet: fleet.bodies.quaternion),
    **_axes("stateEstimateZ", _AXES, lambda fleet: np.rint(_MILLI * fleet.bodies.position)),  # mm
    **_axes("stateEstimateZ", ("vx", "vy", "vz"), lambda fleet: np.rint(_MILLI * fleet.bodies.velocity)),  # mm/s
    **_axes("stabilizer", ("roll", "pitch", "yaw"), _degrees),
    **_axes("kalman", ("stateX", "stateY", "stateZ"), lambda fleet: fleet.bodies.position),
    **_axes("kalman", ("statePX", "statePY", "statePZ"), lambda fleet: fleet.bodies.body_velocity),  # m/s, body
    **_axes("acc", _AXES, lambda fleet: fleet.bodies.specific_force),  # g
    **_axes("gyro", _AXES, lambda fleet: np.rad2deg(fleet.bodies.body_rates)),  # deg/s
    "pm.vbat": lambda fleet, number: float(fleet.power.voltage[number]),
    "pm.vbatMV": lambda fleet, number: float(np.rint(_MILLI * fleet.power.voltage[number])),
    "pm.state": lambda fleet, number: 3.0 if fleet.firmware.battery_low[number] else 0.0,  # pm.h PMStates
    "supervisor.info": lambda fleet, number: float(fleet.firmware.info()[number]),
}


def require_variables(names: Iterable[str]) -> None:
    """Refuse log variables that the simulated drone does not have.

    Raises:
        FlatsatError: names the first of them and the nearest that there is.
    """
    for name in names:
        if name not in VARIABLES:
            valid = f"one that the simulated drone has{nearest_name(name, VARIABLES, cutoff=0.0)}"
            raise refusal("log variable", name, "", valid)
