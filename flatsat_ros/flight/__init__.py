"""One tick of N drones: estimate, reference, law, flight mode, command. Numpy only."""

from flatsat_ros.flight.guarantee import Assessment
from flatsat_ros.flight.modes import Mode, Transition
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Command, Tick
from flatsat_ros.flight.trajectory import Trajectory

__all__ = ["Assessment", "Command", "Mode", "Pilot", "Policy", "Tick", "Trajectory", "Transition"]
