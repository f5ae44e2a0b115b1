"""The simulated Crazyflie: firmware, motors, body, wind and motion capture of N drones. Numpy only.

A `SimulatedFleet` takes set-points as the radio carries them, and high-level commands, and gives poses:

    command(...), take_off(...) -> firmware -> power train -> body -> motion capture -> measurements(t)

Modelled are the rules by which the firmware gives and takes away thrust, motor commands in steps, the battery, the
identified response of attitude and thrust, drag, wind with gusts, the floor and, where asked for, ground effect and
downwash. Left out are collisions between drones, the drone's own state estimate (it controls the true state), and of
the high-level commander compressed trajectories and spirals.
"""

from flatsat_ros.sim.closed_loop import Observer, fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import Battery
from flatsat_ros.sim.proximity import Proximity
from flatsat_ros.sim.sensor import MotionCapture, Sample

__all__ = ["Battery", "MotionCapture", "Observer", "Proximity", "Sample", "SimulatedFleet", "Wind", "fly"]
