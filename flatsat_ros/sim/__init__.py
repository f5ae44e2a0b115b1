"""The drone that is not there: dynamics, Crazyflie firmware behaviour, motors, wind, motion capture; numpy, no ROS.

Wire-level set-points go in, poses come out:

    fleet   command(...), take_off(...) -> firmware -> power train -> body -> motion capture -> measurements(t)

Modelled: the rules by which the firmware gives and takes away thrust, motor commands in steps, battery, identified
attitude and thrust response, drag, wind with gusts, floor. Left out: ground effect, downwash and collisions between
drones, the drone's own state estimate (what it controls is the true state) and of the high-level commander uploaded
trajectories and spirals.
"""

from flatsat_ros.sim.closed_loop import Observer, fly
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import Battery
from flatsat_ros.sim.sensor import MotionCapture, Sample

__all__ = ["Battery", "MotionCapture", "Observer", "Sample", "SimulatedFleet", "Wind", "fly"]
