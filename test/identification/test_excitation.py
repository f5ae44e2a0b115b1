"""The excitation flight: what it asks for, and that a log of it tells all figures of a drone, on to a certificate."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from flatsat_ros import Pilot, Policy, SimulatedFleet, Trajectory, Tuning, fly, load_certificate, load_vehicle
from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.tick import Tick
from flatsat_ros.identification.excitation import STEP_LEAST, excitation, message_text
from flatsat_ros.identification.identified import Identified, identify, profile_of
from flatsat_ros.identification.log import FlightLog, angles_of
from flatsat_ros.identification.screening import screen
from flatsat_ros.identification.validation import CONTRADICTS, SUPPORTS, validate
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.sim.sensor import MotionCapture, Sample
from flatsat_ros.synthesis import synthesize

CERTIFICATE = load_certificate("cf21_50hz")
BASE = load_vehicle("cf21")
DELAY, LATENCY = 0.02, 0.01  # s, of the commands and of the poses
HIDDEN = dataclasses.replace(
    BASE,
    mass=0.033,
    thrust_slope=0.85,
    dynamics=dataclasses.replace(
        BASE.dynamics,
        attitude=dataclasses.replace(BASE.dynamics.attitude, natural_frequency=18.0, damping=0.7, actuator_lag=0.0),
        attitude_gain=0.9,
        velocity_tilt=0.015,
        thrust_lag_up=0.08,
        thrust_lag_down=0.08,
        drag_xy=0.35,
    ),
)


@settings(max_examples=3)
@given(st.floats(1.07, 3.0), st.floats(4.0, 30.0))
def test_the_path_stays_in_its_box_and_its_limits_and_steps_the_thrust(thrust: float, tilt: float) -> None:
    limits = InputSet(thrust * GRAVITY, math.radians(tilt), GRAVITY)
    path = excitation(dataclasses.replace(CERTIFICATE, limits=limits), (1.0, 2.0, 3.0))
    low, high = path.bounds()
    assert (low > (0.0, 1.0, 2.0)).all()
    assert (high < (2.0, 3.0, 4.0)).all()
    assert path.margin(limits).distance > 0.08 * limits.inner_radius
    for time in (path.times[0], path.times[-1]):
        assert_allclose(path.sample(float(time)), [1.0, 2.0, 3.0] + [0.0] * 6, atol=1e-9)
    steps = [path.sample(float(time))[8] for time in path.times[path.times > 22.0]]
    assert min(steps) == -max(steps)
    assert max(steps) >= STEP_LEAST


def test_each_axis_is_moved_at_half_a_hertz_to_three() -> None:
    path = excitation(CERTIFICATE, (0.0, 0.0, 1.0))
    time = np.arange(0.0, 21.0, 0.01)
    moved = np.array([path.sample(float(t))[6:8] for t in time])
    power = np.abs(np.fft.rfft(moved, axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(time), 0.01)
    for wanted in (0.5, 1.0, 2.0, 3.0):
        near = np.abs(frequency - wanted) < 0.25
        assert (power[near].sum(axis=0) > 0.03 * power.sum(axis=0)).all(), wanted


def test_limits_without_room_for_steps_of_thrust_are_refused() -> None:
    with pytest.raises(FlatsatError, match=r"largest thrust step within the limits = 0.441.*: must be at least 0.49"):
        excitation(dataclasses.replace(CERTIFICATE, limits=InputSet(1.05 * GRAVITY, 0.2, GRAVITY)), (0.0, 0.0, 1.0))


def test_the_message_is_the_path() -> None:
    path = excitation(CERTIFICATE, (0.0, 0.0, 1.0))
    text = message_text(path)
    assert len(text) < 128 * 1024, "what a shell takes as one argument"
    points = yaml.safe_load(text)["points"]

    def vectors(name: str, part: str) -> list[list[float]]:
        return [[point[name][0][part][axis] for axis in "xyz"] for point in points]

    stamps = [point["time_from_start"] for point in points]
    read = Trajectory.through(
        [stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps],
        vectors("transforms", "translation"),
        vectors("velocities", "linear"),
        vectors("accelerations", "linear"),
    )
    assert_allclose(read.times, path.times, atol=1e-9)
    assert read.margin(CERTIFICATE.limits).distance == pytest.approx(path.margin(CERTIFICATE.limits).distance, abs=0.01)


@pytest.fixture(scope="module")
def log() -> FlightLog:
    """The flight of a drone that the controller takes for a cf21."""
    tuning = Tuning(adaptation_rate=2.0, threshold=0.05, gain_initial=1.0, gain_max=CERTIFICATE.gain_max)
    pilot = Pilot(CERTIFICATE, tuning, Policy(disturbance_max=0.8, thrust_error_max=0.2), count=1)
    fleet = SimulatedFleet(HIDDEN, 1, command_delay=DELAY, capture=MotionCapture(noise=3e-4, latency=LATENCY))
    poses, commands, modes = [], [], set()

    def observe(now: float, samples: list[Sample], tick: Tick, sent: dict[int, tuple[float, ...]]) -> None:
        poses.extend((each.stamp + LATENCY, *each.position, *each.quaternion) for each in samples)
        commands.extend((now, *sent[index]) for index in sent)
        modes.add(int(tick.mode[0]))

    path = excitation(CERTIFICATE, (0.0, 0.0, 1.0))
    pilot.set_reference(0, Trajectory.hold((0.0, 0.0, 1.0)))
    flown = fly(pilot, fleet, BASE, 5.0, observe)
    pilot.set_reference(0, path.shifted(flown + 0.1))
    fly(pilot, fleet, BASE, flown + path.times[-1] + 0.5, observe, flown)
    assert modes == {0, 1, 2}, "it stood, was unlocked and flew by the law to the end"
    pose, sent = np.array(poses, dtype=float), np.array(commands, dtype=float)
    command = np.column_stack([np.deg2rad(sent[:, 1:3]), sent[:, 4]])
    nothing = np.empty(0)
    return FlightLog(
        "excited", pose[:, 0], pose[:, 1:4], angles_of(pose[:, 4:].T), sent[:, 0], command, nothing, nothing
    )


@pytest.fixture(scope="module")
def found(log: FlightLog) -> Identified:
    return identify([screen(log)], BASE)


def test_one_excitation_flight_tells_all_figures(found: Identified) -> None:
    dynamics = HIDDEN.dynamics
    truth = {
        "attitude_gain": 0.9,
        "natural_frequency": 18.0,
        "damping": 0.7,
        "lag_and_delay": dynamics.attitude.mean_delay + dynamics.dead_time + DELAY + LATENCY,
        "velocity_tilt": 0.015,
        "thrust_slope": 0.85,
        "thrust_lag": 0.08,
        "drag_xy": 0.35,
        "drag_z": dynamics.drag_z,
        "thrust_available": HIDDEN.thrust_max,
    }
    assert found.unknown == ("thrust_voltage",)  # this log has no voltage
    assert truth.keys() == found.figures.keys() - {"thrust_voltage"}
    for name, value in truth.items():
        figure = found.figures[name]
        assert figure.interval is not None
        assert figure.interval[0] <= value <= figure.interval[1], name
        if name != "velocity_tilt":
            assert figure.value == pytest.approx(value, rel=0.03), name


def test_a_certificate_made_of_what_it_tells_is_not_contradicted(found: Identified, log: FlightLog) -> None:
    mine = profile_of(found, BASE, "mine")
    thrust, total = found.figures["thrust_available"].interval, found.figures["lag_and_delay"].interval
    assert thrust is not None
    assert total is not None
    limits = InputSet(thrust[0], math.radians(10.0), GRAVITY)
    lag = mine.dynamics.attitude.mean_delay
    made = synthesize(limits, rate=1.0, period=0.02, name="mine_50hz", lag=lag, delay=total[1] - lag)
    made.verify()
    verdicts = {each.assumption: each.verdict for each in validate(made, found, [log], mine)}
    assert CONTRADICTS not in verdicts.values()
    assert verdicts["thrust available"] == verdicts["lag plus delay"] == verdicts["pose gaps"] == SUPPORTS
    shipped = {each.assumption: each.verdict for each in validate(CERTIFICATE, found, [log])}
    assert shipped["thrust available"] == CONTRADICTS
