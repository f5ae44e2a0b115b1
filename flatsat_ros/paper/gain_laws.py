"""Beyond the paper: what becomes of the gain over repeated set-points and under a lasting disturbance, by gain law."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.colours import LIMIT
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.certificate.sampled_loop import Timing
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.demo.scenario import VEHICLE
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.controller import Controller
from flatsat_ros.law.gain import Tuning
from flatsat_ros.paper.studies import POSE_NOISE, run_sampled
from flatsat_ros.sim.closed_loop import fly
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.sensor import MotionCapture, Sample
from flatsat_ros.synthesis.gain_cap import gain_cap

MU, V_INF, LEAK = 3.0, 0.05, 0.15
LAWS = ("the paper's", "with the cap of the real loop", "leaky", "restarting")
LEGS, LEG_TIME, DISTANCE = 4, 8.0, 1.6  # number, s, m
_CLIMB = 6.0  # s
_LINK_DELAY = 0.03  # s, besides the vehicle's lag
_DISTURBED_SECONDS = 300.0


@dataclass(frozen=True, eq=False)
class GainRuns:
    """What came out; columns are LAWS, of the disturbance the first and the third.

    Attributes:
        time: (M,) s.
        gain: (M, 4) gamma over repeated set-points.
        tilt: (M, 4) commanded tilt, rad.
        cap: gain that is proved for this loop.
        disturbed_time: (K,) s.
        disturbed_gain: (K, 2) gamma under a constant drift of the position.
    """

    time: FloatArray
    gain: FloatArray
    tilt: FloatArray
    cap: float
    disturbed_time: FloatArray
    disturbed_gain: FloatArray


def run_gain_laws(certificate: Certificate) -> GainRuns:
    """Fly four simulated Crazyflies, one a gain law, to and fro; and disturb the double integrator."""
    vehicle, count = load_vehicle(VEHICLE), len(LAWS)
    timing = Timing(certificate.period, vehicle.lag, _LINK_DELAY)
    cap = gain_cap(timing, certificate.block).gain_max
    most = certificate.gain_max
    tuning = Tuning(MU, V_INF, 1.0, [most, cap, most, most], [0.0, 0.0, LEAK, 0.0], [False, False, False, True])
    pilot = Pilot(certificate, tuning, Policy(goal_mode=GoalMode.STEP), count)
    places = np.stack([np.zeros(count), 2.0 * np.arange(count), np.zeros(count)], axis=1)
    fleet = SimulatedFleet(
        vehicle, count, start=places, capture=MotionCapture(noise=POSE_NOISE), command_delay=_LINK_DELAY - vehicle.delay
    )
    time, gain, tilt = [], [], []

    def observe(now: float, _samples: list[Sample], tick: Tick, _sent: dict[int, WireSetpoint]) -> None:
        time.append(now)
        gain.append(tick.output.gain)
        tilt.append(np.arccos(np.cos(tick.input[:, 1]) * np.cos(tick.input[:, 2])))

    now = 0.0
    for leg in range(-1, LEGS):
        end = _CLIMB + (leg + 1) * LEG_TIME
        for i, place in enumerate(places):
            side = DISTANCE * (leg >= 0) * (leg + 1) % (2.0 * DISTANCE)
            pilot.set_reference(i, Trajectory.hold(place + [side, 0.0, 1.0]))
        now = fly(pilot, fleet, vehicle, end, observe, start=now)
    return GainRuns(np.array(time), np.array(gain), np.array(tilt), cap, *_disturbed(certificate))


def _disturbed(certificate: Certificate) -> tuple[FloatArray, FloatArray]:
    """Return times and gains of the sampled double integrator whose position drifts with twice what V_inf forgives.

    Whatever the gain, V cannot settle below alpha w^2: with w^2 = 4 V_inf / alpha it stays above the threshold.
    """
    tuning = Tuning(MU, V_INF, 1.0, certificate.gain_max, [0.0, LEAK], False)
    law, drift = Controller(certificate, tuning), 2.0 * math.sqrt(V_INF / certificate.rate)
    history = run_sampled(law, np.zeros((2, 6)), _DISTURBED_SECONDS, Timing(certificate.period), (drift, 0.0, 0.0))
    return history.time, history.gain


def draw_gain_laws(runs: GainRuns) -> Figure:
    """Draw gains and tilts over four set-points, and gains under the drift."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    gain, tilt, disturbed = figure.subplots(3, 1)
    for i, name in enumerate(LAWS):
        gain.plot(runs.time, runs.gain[:, i], label=name)
        tilt.plot(runs.time, np.degrees(runs.tilt[:, i]), linewidth=0.9)
    for leg in range(LEGS):
        for axes in (gain, tilt):
            axes.axvline(_CLIMB + leg * LEG_TIME, color="0.7", linewidth=0.8)
    gain.axhline(runs.cap, **LIMIT)
    gain.set(ylabel=r"$\gamma$", title=f"four set-points, {DISTANCE:g} m apart (dashed: cap of this loop)")
    gain.legend(loc="upper left", ncols=2, fontsize="small")
    tilt.set(ylabel="tilt, °", xlabel="time, s")
    for column, name in ((0, LAWS[0]), (1, LAWS[2])):
        disturbed.plot(runs.disturbed_time, runs.disturbed_gain[:, column], color=f"C{2 * column}", label=name)
    disturbed.set(ylabel=r"$\gamma$", xlabel="time, s", title="a lasting drift of the position, double integrator")
    disturbed.legend()
    return figure
