"""Every fault of the matrix, and those of its rows that are accepted."""

from __future__ import annotations

from flatsat_ros.falsification.faults.clocks import CLOCK_FAULTS
from flatsat_ros.falsification.faults.fault import Fault
from flatsat_ros.falsification.faults.orders import ORDER_FAULTS
from flatsat_ros.falsification.faults.poses import POSE_FAULTS
from flatsat_ros.falsification.faults.vehicle import VEHICLE_FAULTS

FAULTS: dict[str, Fault] = {
    fault.name: fault for fault in (*POSE_FAULTS, *CLOCK_FAULTS, *VEHICLE_FAULTS, *ORDER_FAULTS)
}

# by fault and phase: why a row fails and what a user must do about it
ACCEPTED: dict[tuple[str, str], str] = {}
