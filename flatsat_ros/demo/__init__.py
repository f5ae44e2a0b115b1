"""Three drones take off, swap places and land: the choreography, its flights, their records and pictures."""

from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.demo.scenario import Scenario, plan

__all__ = [
    "FlightRecord",
    "RobotRecord",
    "Scenario",
    "plan",
]
