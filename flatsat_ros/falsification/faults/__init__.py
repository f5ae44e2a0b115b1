"""The matrix of faults: everything that goes wrong around a controller, in every phase of a flight, and what it may do.

    table (what goes wrong, what is allowed) -> phases (when) -> scene (fleet, faults, pilot) -> criteria -> results

A row is one fault in one phase of flight on simulated time. Its bounds are data that were written before it was flown.
"""

from flatsat_ros.falsification.faults.criteria import Criteria, End
from flatsat_ros.falsification.faults.fault import Fault
from flatsat_ros.falsification.faults.phases import Phase
from flatsat_ros.falsification.faults.rows import Row, fly_row, fly_rows, replay
from flatsat_ros.falsification.faults.table import FAULTS

__all__ = ["FAULTS", "Criteria", "End", "Fault", "Phase", "Row", "fly_row", "fly_rows", "replay"]
