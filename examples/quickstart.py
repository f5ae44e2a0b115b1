"""Quick start: a simulated Crazyflie takes off, hovers, and takes a step of half a metre. Writes quickstart.png."""

from matplotlib.figure import Figure

from flatsat_ros import Pilot, Policy, SimulatedFleet, Trajectory, Tuning, fly, load_certificate, load_vehicle

certificate, vehicle = load_certificate("cf21_adaptive_50hz"), load_vehicle("cf21")
tuning = Tuning(adaptation_rate=2.0, threshold=0.05, gain_initial=1.0, gain_max=certificate.gain_max)
pilot, fleet = Pilot(certificate, tuning, Policy(), count=1), SimulatedFleet(vehicle, count=1, command_delay=0.028)
now, track = 0.0, []  # s; time and position at every tick
for goal in ([0.0, 0.0, 1.0], [0.5, 0.0, 1.0]):  # m
    pilot.set_reference(0, Trajectory.hold(goal))
    now = fly(pilot, fleet, vehicle, now + 8.0, lambda t, *_: track.append([t, *fleet.poses()[0][0]]), start=now)

time, x, _, z = zip(*track, strict=True)
axes = Figure().add_subplot(xlabel="time, s", ylabel="position, m")
axes.plot(time, x, time, z)
axes.legend(["x", "z"])
axes.figure.savefig("quickstart.png")
print(f"at x = {x[-1]:.3f} m, z = {z[-1]:.3f} m after {now:.0f} s; written to quickstart.png")
