"""What is particular to Crazyflies: vehicle profiles, units on the wire, crazyflies.yaml, addresses, queues."""

from flatsat_ros.crazyflie.crazyflies_yaml import Robot, read_crazyflies
from flatsat_ros.crazyflie.intervals import Intervals
from flatsat_ros.crazyflie.vehicle import (
    AttitudeResponse,
    BatteryLimits,
    Dynamics,
    Motors,
    VehicleProfile,
    load_vehicle,
)
from flatsat_ros.crazyflie.wire import Backend, WireSetpoint, YawMode, input_from_setpoint, setpoint_from_command

__all__ = [
    "AttitudeResponse",
    "Backend",
    "BatteryLimits",
    "Dynamics",
    "Intervals",
    "Motors",
    "Robot",
    "VehicleProfile",
    "WireSetpoint",
    "YawMode",
    "input_from_setpoint",
    "load_vehicle",
    "read_crazyflies",
    "setpoint_from_command",
]
