"""Way-points: a smooth path through a list of places, flown by a simulated Crazyflie."""

import numpy as np

from flatsat_ros import Pilot, Policy, SimulatedFleet, Tuning, fly, load_certificate, load_vehicle
from flatsat_ros.planning import spline_through

certificate, vehicle = load_certificate("cf21_adaptive_50hz"), load_vehicle("cf21")
path = spline_through([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1.5], [0, 0, 1]], leg_time=3.0)  # m, s
pilot = Pilot(certificate, Tuning(2.0, 0.05, 1.0, certificate.gain_max), Policy(), count=1)
pilot.set_reference(0, path.shifted(1.0))
fleet, errors = SimulatedFleet(vehicle, 1, command_delay=0.028), []  # delay of the link, s; distances, m
fly(pilot, fleet, vehicle, 14.0, lambda t, poses, tick, _: errors.append(tick.output.error[0, :3]))
print(f"flew the path; never more than {np.linalg.norm(errors, axis=1).max():.3f} m away from it")
