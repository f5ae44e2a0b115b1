"""The law of the paper: flatness map, input set, adaptive gain and, on one page, the controller. Numpy only."""

from flatsat_ros.law.controller import Certified, Controller, Memory, Output
from flatsat_ros.law.flatness import acceleration_from_input, input_from_acceleration
from flatsat_ros.law.gain import Tuning, adapt
from flatsat_ros.law.input_set import InputSet

__all__ = [
    "Certified",
    "Controller",
    "InputSet",
    "Memory",
    "Output",
    "Tuning",
    "acceleration_from_input",
    "adapt",
    "input_from_acceleration",
]
