"""A flight without ROS: pilot and simulated fleet, tick by tick on simulated time, as fast as the machine allows."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode, setpoint_from_command
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.tick import Tick
from flatsat_ros.sim.sensor import Sample

Observer = Callable[[float, list[Sample], Tick, dict[int, WireSetpoint]], None]

# A tick closer than this to the end, in periods, is at the end: 0.1 * 3 is more than 0.3.
_ROUNDING = 1e-6


class Fleet(Protocol):
    """What a pilot sees and reaches of the drones: a `SimulatedFleet`, or one behind faults."""

    @property
    def count(self) -> int:
        """Number of drones, N."""

    @property
    def yaw_mode(self) -> YawMode:
        """What the yaw of a set-point means."""

    def advance_to(self, time: float) -> None:
        """Let the drones fly to a time, s."""

    def measurements(self, time: float) -> list[Sample]:
        """Return the pose samples that arrived until a time, s; each is returned once."""

    def command(self, index: int, roll: float, pitch: float, yaw: float, thrust_pwm: float) -> None:
        """Send a set-point to a drone, see `Uplink.command`."""


def fly(
    pilot: Pilot,
    fleet: Fleet,
    vehicle: VehicleProfile,
    until: float,
    observe: Observer | None = None,
    start: float = 0.0,
) -> float:
    """Close the loop for a stretch of simulated time, exactly as the controller and sim_drone nodes do.

    The ticks are at start, start + h, start + 2 h and so on, before until: a flight is continued from the time
    returned, and comes out the same however it is cut into stretches.

    Args:
        pilot: flies; h is the period of its certificate.
        fleet: is flown; its time must be at most start.
        vehicle: thrust map of the command.
        until: s, simulated time before which the last tick is.
        observe: if given, called at every tick with the time (s), the pose samples that arrived, the tick and the
            set-points sent by drone.
        start: s, simulated time of the first tick.

    Returns:
        The time of the next tick, s: the first of start, start + h, ... that is not before until.
    """
    period = pilot.certificate.period
    ticks = max(0, math.ceil((until - start) / period - _ROUNDING))
    for number in range(ticks):
        now = start + number * period
        fleet.advance_to(now)
        samples = fleet.measurements(now)
        for sample in samples:
            pilot.measure(sample.drone, sample.stamp, sample.position.tolist(), sample.quaternion.tolist(), now)
        tick = pilot.tick(now)
        sent = {}
        for index in range(fleet.count):
            command = tick.command(index)
            if command is not None:
                sent[index] = setpoint_from_command(*command, vehicle, yaw_mode=fleet.yaw_mode)
                fleet.command(index, *sent[index])
        if observe is not None:
            observe(now, samples, tick, sent)
    return start + ticks * period
