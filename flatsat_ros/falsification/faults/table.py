"""Every fault of the matrix, and every row that there is."""

from __future__ import annotations

from flatsat_ros.falsification.faults.clocks import CLOCK_FAULTS
from flatsat_ros.falsification.faults.fault import Fault
from flatsat_ros.falsification.faults.live_table import LIVE_FAULTS
from flatsat_ros.falsification.faults.orders import ORDER_FAULTS
from flatsat_ros.falsification.faults.poses import POSE_FAULTS
from flatsat_ros.falsification.faults.vehicle import VEHICLE_FAULTS

FAULTS: dict[str, Fault] = {
    fault.name: fault for fault in (*POSE_FAULTS, *CLOCK_FAULTS, *VEHICLE_FAULTS, *ORDER_FAULTS)
}

LIVE = "live"  # the phase of rows that real processes fly
# fault and phase of every row, in the order of the page
EXISTING = [(name, phase.value) for name, fault in FAULTS.items() for phase in fault.phases]
EXISTING += [(name, LIVE) for name in LIVE_FAULTS]
