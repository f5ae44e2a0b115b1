"""Set-points as a radio sends them to a simulated drone: one after the other."""

from __future__ import annotations

from flatsat_ros.sim.fleet import SimulatedFleet


def stream(fleet: SimulatedFleet, seconds: float, thrust: float, roll: float = 0.0, yaw_rate: float = 0.0) -> None:
    """Send a set-point to drone 0 every 10 ms: thrust in PWM, roll in degrees, yaw rate in degrees a second."""
    start = fleet.time
    for k in range(round(seconds * 100)):
        fleet.command(0, roll, 0.0, yaw_rate, thrust)
        fleet.advance_to(start + (k + 1) / 100)
