"""Log variables, against other ways to compute them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.sim.dynamics import STEP
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.log_variables import VARIABLES, require_variables

CF21 = VehicleProfile.load(Path(__file__).parents[2] / "config" / "vehicles" / "cf21.yaml")
ANGLE, RATE = st.floats(-1.4, 1.4), st.floats(-3.0, 3.0)


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Body -> world."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@settings(max_examples=50)
@given(angles=st.tuples(ANGLE, ANGLE, RATE), rates=st.tuples(RATE, RATE, RATE), velocity=st.tuples(RATE, RATE, RATE))
def test_rates_and_velocities_of_the_body_are_those_that_turn_it_and_move_it(
    angles: tuple[float, ...], rates: tuple[float, ...], velocity: tuple[float, ...]
) -> None:
    fleet = SimulatedFleet(CF21, 1, start=[[0.0, 0.0, 1.0]], flying=True)
    bodies = fleet.bodies
    bodies.attitude[:, 0, 0], bodies.attitude[:, 0, 1] = angles, rates
    bodies.velocity[0] = velocity
    here = rotation(bodies.quaternion[0])
    assert_allclose(here @ bodies.body_velocity[0], velocity, atol=1e-12)
    step = 1e-6
    bodies.attitude[:, 0, 0] += step * np.array(rates)
    turned = here.T @ (rotation(bodies.quaternion[0]) - here) / step  # the cross product with the rates of the body
    bodies.attitude[:, 0, 0] = angles
    assert_allclose(bodies.body_rates[0], (turned[2, 1], turned[0, 2], turned[1, 0]), atol=1e-4)


def test_every_variable_can_be_read_and_a_flight_shows_in_it() -> None:
    fleet = SimulatedFleet(CF21, 2, start=[[0.0, 0.0, 1.0], [1.0, 2.0, 3.0]], flying=True)
    hover = float(CF21.pwm_from_thrust(9.81))
    for _ in range(50):
        fleet.command(1, 5.0, 3.0, -20.0, hover)  # the yaw rate of the wire is clockwise
        fleet.advance_to(fleet.time + 5 * STEP)
    read = {name: variable(fleet, 1) for name, variable in VARIABLES.items()}
    assert all(np.isfinite(value) for value in read.values())
    assert read["stateEstimate.x"] == fleet.bodies.position[1, 0] != fleet.bodies.position[0, 0]
    assert read["stateEstimateZ.z"] == pytest.approx(3000.0, abs=50.0)
    assert read["stabilizer.roll"] > 1.0
    assert read["stabilizer.pitch"] < -1.0, "nose up is positive"
    assert read["gyro.z"] > 5.0
    assert read["acc.z"] == pytest.approx(1.0, abs=0.1)
    assert read["pm.vbatMV"] == pytest.approx(1000.0 * read["pm.vbat"], abs=0.5)


def test_an_unknown_variable_is_refused_with_the_nearest() -> None:
    with pytest.raises(FlatsatError, match=r"log variable = 'stateEstimate.vX': .* the nearest is stateEstimate.v"):
        require_variables(["stateEstimate.x", "stateEstimate.vX"])
