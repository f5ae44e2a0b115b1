"""The figures of simulated drones come out of their logs, what logs cannot tell does not."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from flown import fly
from numpy.testing import assert_allclose

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile, load_vehicle, profile_document
from flatsat_ros.identification.disturbances import disturbances
from flatsat_ros.identification.fit import BOUNDS, excited, fit
from flatsat_ros.identification.identified import Identified, identify, profile_of
from flatsat_ros.identification.log import FlightLog
from flatsat_ros.identification.report import lines
from flatsat_ros.identification.residuals import REACH, ComparedFlight, misfit, twice_integrated
from flatsat_ros.identification.response import Figures
from flatsat_ros.identification.screening import STEP, screen
from flatsat_ros.identification.surroundings import surroundings

CF21 = load_vehicle("cf21")


def truth(profile: VehicleProfile) -> dict[str, float]:
    """The figures of a simulated drone as its logs show them."""
    dynamics = profile.dynamics
    return {
        "natural_frequency": dynamics.attitude.natural_frequency,
        "damping": dynamics.attitude.damping,
        "attitude_gain": dynamics.attitude_gain,
        "lag_and_delay": dynamics.attitude.mean_delay + 0.03,
        "thrust_lag": dynamics.thrust_lag_up,
        "velocity_tilt": dynamics.velocity_tilt,
        "thrust_slope": profile.thrust_slope,
        "drag_xy": dynamics.drag_xy,
        "drag_z": dynamics.drag_z,
        "thrust_available": 0.9 * profile.thrust_max,
    }


def test_what_the_logs_tell_is_true(found: Identified, weak: VehicleProfile) -> None:
    expected = truth(weak)
    assert found.figures.keys() == expected.keys() | {"thrust_voltage"}
    for name, value in expected.items():
        figure = found.figures[name]
        if figure.interval is not None:
            assert figure.interval[0] <= value <= figure.interval[1], (name, figure)
    for name in ("attitude_gain", "lag_and_delay", "thrust_slope", "thrust_available", "drag_xy", "natural_frequency"):
        figure = found.figures[name]
        assert figure.interval is not None, name
        assert figure.value == pytest.approx(expected[name], rel=0.06), name
    assert found.pose_noise == pytest.approx(3e-4, rel=0.15)
    for each in found.common.misfits:
        assert_allclose(each.frame, (0.01, -0.02), atol=0.002)
        assert np.abs(each.trim).max() < 0.05
    pushed, _ = disturbances(found.flights, found.common)
    assert np.percentile(np.linalg.norm(pushed, axis=1), 95.0) < 0.1


def test_what_is_beside_the_drone_has_an_interval_that_holds_it(found: Identified) -> None:
    expected = {"marker frame, roll": np.rad2deg(0.01), "marker frame, pitch": np.rad2deg(-0.02), "pose noise": 0.3}
    both = surroundings(found.flights, found.common)
    one = surroundings(found.flights[:1], replace(found.common, misfits=found.common.misfits[:1]))
    for many, few in zip(both, one, strict=True):
        assert (many.flights, few.flights) == (2, 1)
        low, high = many.interval
        assert low < few.value < high
        assert low < expected.get(many.name, many.value) < high
    samples = replace(found.flights[0].motion.samples, noise=np.empty((0, 3)))
    rare = replace(found.flights[0], motion=replace(found.flights[0].motion, samples=samples))
    told = surroundings([rare], replace(found.common, misfits=found.common.misfits[:1]))
    assert [each.flights for each in told] == [1, 1, 0, 1, 1]


def test_the_profile_of_it_loads_and_flies_as_it_did(found: Identified, weak: VehicleProfile, tmp_path: Path) -> None:
    profile = profile_of(found, CF21, "mine")
    assert profile.name == "mine"
    assert profile.mass == CF21.mass
    assert profile.thrust_max == pytest.approx(0.9 * weak.thrust_max, rel=0.01)
    assert profile.dynamics.dead_time == CF21.dynamics.dead_time
    assert profile.dynamics.yaw == CF21.dynamics.yaw
    assert profile.dynamics.thrust_gain == 1.0
    assert profile.dynamics.attitude.actuator_lag == 0.0
    (path := tmp_path / "mine.yaml").write_text(yaml.safe_dump(profile_document(profile)))
    assert VehicleProfile.load(path) == profile


def test_a_hover_tells_the_thrust_and_leaves_the_rest(weak: VehicleProfile) -> None:
    hovering = screen(fly(weak, range(7, 8), seconds=8.0, noise=1e-4, amplitude=0.0, weight=0.9)[0])
    found = identify([hovering], CF21)
    assert set(found.unknown) == set(found.figures) - {"thrust_available"}
    # the slope is the base's, from hover to full thrust
    hover = float(replace(weak, force_max=0.9 * weak.force_max).pwm_from_thrust(GRAVITY))
    profile = profile_of(found, CF21, "mine")
    assert float(profile.pwm_from_thrust(GRAVITY)) == pytest.approx(hover, rel=0.01)
    assert profile.thrust_slope == 1.0
    assert profile.dynamics == CF21.dynamics


def test_flights_with_a_battery_that_empties_tell_thrust_over_voltage(weak: VehicleProfile) -> None:
    exponent = 0.8
    drone = replace(weak, thrust_voltage=exponent, voltage=3.9)
    logs = fly(drone, range(2), seconds=8.0, noise=1e-4, weight=0.9, voltages=(3.8, 3.5))
    found = identify([screen(log) for log in logs], CF21)
    figure, profile = found.figures["thrust_voltage"], profile_of(found, CF21, "mine")
    assert figure.flights == 2
    assert figure.interval is not None
    assert figure.interval[0] <= exponent <= figure.interval[1]
    assert figure.value == pytest.approx(exponent, abs=0.05)
    assert profile.thrust_voltage == figure.value
    assert profile.voltage == pytest.approx(3.64, abs=0.01)  # the mean, for which the force is meant
    expected = 0.9 * drone.thrust_max * (profile.voltage / 3.9) ** exponent
    assert profile.thrust_max == pytest.approx(expected, rel=0.02)


def test_without_a_voltage_in_the_logs_thrust_over_voltage_stays_the_bases(found: Identified) -> None:
    base = replace(CF21, thrust_voltage=0.3, voltage=3.8)
    assert "thrust_voltage" in found.unknown
    profile = profile_of(found, base, "mine")
    assert (profile.thrust_voltage, profile.voltage) == (0.3, 3.8)
    assert any("thrust over voltage" in line and "not told" in line for line in lines(found, CF21))


def test_a_drone_that_does_not_lift_itself_makes_no_profile(found: Identified) -> None:
    figure = replace(found.figures["thrust_available"], value=0.99 * GRAVITY)
    tired = replace(found, figures={**found.figures, "thrust_available": figure})
    with pytest.raises(FlatsatError, match=r"makes no profile: mass = 0.029 kg: must be below 0.0287"):
        profile_of(tired, CF21, "tired")


def test_a_flight_that_is_there_twice_is_refused(logs: list[FlightLog]) -> None:
    with pytest.raises(FlatsatError, match="log = 'copy': must be a flight of its own: it has the poses of flight 0"):
        identify([screen(logs[0]), screen(replace(logs[0], name="copy"))], CF21)


def test_one_flight_is_fitted_from_far_away_and_the_residuals_are_noise(logs: list[FlightLog]) -> None:
    flight = ComparedFlight.of(screen(logs[0]))
    far = Figures(1.2, 40.0, 2.5, 0.0, 1.4, 0.3, 1.0, 1.0, 0.1)
    result = fit([flight], far, excited([flight]), starts=2)
    assert excited([flight]) == tuple(name for name in BOUNDS if name != "thrust_voltage")
    assert result.figures.attitude_gain == pytest.approx(0.8, rel=0.03)
    assert result.figures.lag_and_delay == pytest.approx(2.0 * 0.753 / 22.04 + 0.03, rel=0.03)
    assert result.misfits[0].attitude.std() == pytest.approx(3e-3, rel=0.15)  # noise of the angles
    assert result.misfits[0].position.std() == pytest.approx(math.sqrt(6.0) * 3e-4, rel=0.3)  # of p - 2 p + p
    worse = misfit(flight, replace(result.figures, delay=result.figures.delay + 0.02)).vector(*result.scales)
    assert np.sum(worse**2) > 1.2 * np.sum(result.misfits[0].vector(*result.scales) ** 2)


def test_second_differences_are_the_triangle_over_the_acceleration() -> None:
    time = np.arange(300) * STEP
    at = np.arange(REACH, 300 - REACH, 7)
    acceleration = np.stack([np.ones_like(time), time, np.cos(3.0 * time)], axis=-1)
    place = np.stack([time**2 / 2.0, time**3 / 6.0, -np.cos(3.0 * time) / 9.0], axis=-1)
    second = place[at + REACH] - 2.0 * place[at] + place[at - REACH]
    assert_allclose(twice_integrated(acceleration, at), second, atol=3e-5)
