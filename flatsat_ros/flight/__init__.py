"""One tick of N drones: estimate, reference, law, flight mode, command. Numpy only."""

from flatsat_ros.flight.guarantee import Assessment
from flatsat_ros.flight.pilot import Pilot, Tick
from flatsat_ros.flight.reference import Trajectory
from flatsat_ros.flight.supervisor import Mode, Policy

__all__ = ["Assessment", "Mode", "Pilot", "Policy", "Tick", "Trajectory"]
