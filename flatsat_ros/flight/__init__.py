"""One tick of N drones: estimate, reference, law, flight mode, command. Numpy only."""

from flatsat_ros.flight.guarantee import Assessment
from flatsat_ros.flight.pilot import Command, Pilot, Tick
from flatsat_ros.flight.supervisor import Mode, Policy, Transition
from flatsat_ros.flight.trajectory import Trajectory

__all__ = ["Assessment", "Command", "Mode", "Pilot", "Policy", "Tick", "Trajectory", "Transition"]
