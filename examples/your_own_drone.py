"""A drone of your own: from its profile to a certificate, and from the certificate to a flight.

Writes my_drone.yaml and my_drone_50hz.yaml, which the controller takes as well:

    ros2 run flatsat_ros controller --ros-args -p vehicle:=my_drone.yaml -p certificate:=my_drone_50hz.yaml
"""

import math
from dataclasses import replace
from pathlib import Path

import yaml

from flatsat_ros import InputSet, Pilot, Policy, SimulatedFleet, Trajectory, Tuning, fly, load_certificate, load_vehicle
from flatsat_ros.crazyflie.vehicle import profile_document
from flatsat_ros.synthesis import synthesize

# The profile: begin with that of the nearest drone and write down what you know better. `identify` finds
# the thrust in the log of a hover, and more in those of other flights.
vehicle = replace(load_vehicle("cf21"), name="my_drone", mass=0.033)  # kg, with a deck more
Path("my_drone.yaml").write_text(yaml.safe_dump(profile_document(vehicle), sort_keys=False), encoding="utf-8")

# The certificate: 90 % of what it lifts, 12 degrees of tilt, 50 Hz, the lag of the profile, and beside the delay of the
# profile 30 ms for motion capture, computation and radio.
limits = InputSet(thrust_max=0.9 * vehicle.thrust_max, tilt_max=math.radians(12.0))
delay = vehicle.delay + 0.03  # s
proved = synthesize(limits, rate=1.25, period=0.02, name="my_drone_50hz", lag=vehicle.lag, delay=delay)
proved.save("my_drone_50hz.yaml")

# The flight, with files as the controller reads them: one metre up, in a drone that lifts 3 % less than promised.
vehicle, certificate = load_vehicle("my_drone.yaml"), load_certificate("my_drone_50hz.yaml")
tuning = Tuning(adaptation_rate=2.0, threshold=0.05, gain_initial=1.0, gain_max=certificate.gain_max)
pilot = Pilot(certificate, tuning, Policy(disturbance_max=0.8), count=1)
fleet = SimulatedFleet(vehicle, count=1, thrust_scale=0.97)
pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
fly(pilot, fleet, vehicle, until=8.0)

print(f"certified for gains up to {certificate.gain_max:.2f}, within errors of V <= {certificate.level:.3f}")
print(f"hovers at z = {fleet.poses()[0][0, 2]:.3f} m; written to my_drone.yaml and my_drone_50hz.yaml")
