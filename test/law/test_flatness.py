"""The flatness map: there and back for every yaw, its signs, its singular point, and what it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.law.flatness import acceleration_from_input, input_from_acceleration
from flatsat_ros.law.input_set import InputSet

Map = Callable[..., np.ndarray]

yaws = st.floats(-10.0, 10.0)
accelerations = st.tuples(*[st.floats(-50.0, 50.0)] * 3)
inputs = st.tuples(st.floats(1e-3, 50.0), st.floats(-1.57, 1.57), st.floats(-3.14, 3.14))


def rotation(axis: int, angle: float) -> np.ndarray:
    """Right-handed rotation about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = math.cos(angle)
    matrix[j, i], matrix[i, j] = math.sin(angle), -math.sin(angle)
    return matrix


@given(v=accelerations, yaw=yaws)
def test_acceleration_to_input_and_back(v: tuple[float, ...], yaw: float) -> None:
    u = input_from_acceleration(v, yaw)
    thrust = np.linalg.norm(np.add(v, (0.0, 0.0, GRAVITY)))
    np.testing.assert_allclose(acceleration_from_input(u, yaw), v, rtol=0.0, atol=1e-14 * (thrust + GRAVITY))


@given(u=inputs, yaw=yaws)
def test_input_to_acceleration_and_back(u: tuple[float, ...], yaw: float) -> None:
    again = input_from_acceleration(acceleration_from_input(u, yaw), yaw)
    # the acceleration's rounding, seen from the tip of the thrust vector
    assert again[0] == pytest.approx(u[0], abs=1e-14 * (u[0] + GRAVITY))
    sharpness = math.cos(u[1]) * u[0] / (u[0] + GRAVITY)
    np.testing.assert_allclose(again[1:], u[1:], rtol=0.0, atol=1e-14 / sharpness)


@given(u=inputs, yaw=yaws)
def test_thrust_points_along_the_body_z_axis_of_zyx_euler_angles(u: tuple[float, ...], yaw: float) -> None:
    thrust, roll, pitch = u
    body_z = rotation(2, yaw) @ rotation(1, pitch) @ rotation(0, roll) @ (0.0, 0.0, 1.0)
    expected = thrust * body_z - (0.0, 0.0, GRAVITY)
    np.testing.assert_allclose(acceleration_from_input(u, yaw), expected, rtol=0.0, atol=1e-13)


def test_positive_roll_accelerates_toward_minus_y_and_positive_pitch_toward_plus_x() -> None:
    rolled = acceleration_from_input((GRAVITY, 0.1, 0.0), 0.0)
    assert rolled == pytest.approx([0.0, -GRAVITY * math.sin(0.1), GRAVITY * (math.cos(0.1) - 1.0)])
    pitched = acceleration_from_input((GRAVITY, 0.0, 0.1), 0.0)
    assert pitched == pytest.approx([GRAVITY * math.sin(0.1), 0.0, GRAVITY * (math.cos(0.1) - 1.0)])
    assert input_from_acceleration((0.0, -1.0, 0.0), 0.0)[1] > 0.0
    assert input_from_acceleration((1.0, 0.0, 0.0), 0.0)[2] > 0.0


def test_yaw_turns_the_commands_with_the_body() -> None:
    # the nose points along +y: forward is +y, left is -x
    quarter = math.pi / 2
    assert acceleration_from_input((GRAVITY, 0.0, 0.1), quarter)[:2] == pytest.approx([0.0, GRAVITY * math.sin(0.1)])
    assert acceleration_from_input((GRAVITY, 0.1, 0.0), quarter)[:2] == pytest.approx([GRAVITY * math.sin(0.1), 0.0])


def test_hover_is_level_at_gravity_whatever_the_yaw() -> None:
    u = input_from_acceleration(np.zeros((7, 3)), np.linspace(-4.0, 4.0, 7))
    np.testing.assert_allclose(u, np.tile([GRAVITY, 0.0, 0.0], (7, 1)), atol=1e-15)


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_free_fall_is_defined_as_zero_thrust_and_level(yaw: float) -> None:
    assert input_from_acceleration((0.0, 0.0, -GRAVITY), yaw).tolist() == [0.0, 0.0, 0.0]
    # what saturation straight down gives is free fall up to rounding, and rounding has no direction
    rounding = input_from_acceleration((3e-16, -2e-16, -GRAVITY * (1.0 - 1e-16)), yaw)
    assert rounding.tolist() == [0.0, 0.0, 0.0]
    assert acceleration_from_input((0.0, 0.0, 0.0), yaw).tolist() == pytest.approx([0.0, 0.0, -GRAVITY])


def test_near_the_singular_point_the_direction_is_still_right() -> None:
    u = input_from_acceleration((1e-6, 0.0, 1e-6 - GRAVITY), 0.0)
    assert u == pytest.approx([math.sqrt(2.0) * 1e-6, 0.0, math.pi / 4], rel=1e-8)


@given(v=accelerations, yaw=yaws, thrust=st.floats(1.01, 3.0), tilt=st.floats(0.02, 1.5))
def test_whatever_lies_in_the_input_set_respects_thrust_roll_and_pitch_limits(
    v: tuple[float, ...], yaw: float, thrust: float, tilt: float
) -> None:
    limits = InputSet(thrust * GRAVITY, tilt)
    u = input_from_acceleration(limits.saturate(v), yaw)
    assert 0.0 <= u[0] <= limits.thrust_max * (1.0 + 1e-12)
    if u[0] > 1e-3:
        assert abs(u[1]) <= tilt + 1e-11
        assert abs(u[2]) <= tilt + 1e-11


@given(st.lists(st.tuples(accelerations, yaws), min_size=1, max_size=5))
def test_batch_equals_loop(rows: list[tuple[tuple[float, ...], float]]) -> None:
    v, yaw = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    u = input_from_acceleration(v, yaw)
    np.testing.assert_array_equal(u, [input_from_acceleration(a, b) for a, b in rows])
    single = [acceleration_from_input(a, b) for a, b in zip(u, yaw, strict=True)]
    np.testing.assert_array_equal(acceleration_from_input(u, yaw), single)


def test_one_yaw_serves_many_accelerations() -> None:
    v = np.arange(12.0).reshape(2, 2, 3)
    assert input_from_acceleration(v, 0.3).shape == (2, 2, 3)
    np.testing.assert_array_equal(input_from_acceleration(v, 0.3)[1, 0], input_from_acceleration(v[1, 0], 0.3))


@pytest.mark.parametrize("function", [input_from_acceleration, acceleration_from_input])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(function: Map, bad: float) -> None:
    with pytest.raises(FlatsatError, match=str(bad)):
        function((1.0, bad, 0.0), 0.0)
    with pytest.raises(FlatsatError, match=f"an entry of yaw = {bad}"):
        function((1.0, 0.0, 0.0), bad)


@pytest.mark.parametrize("function", [input_from_acceleration, acceleration_from_input])
@pytest.mark.parametrize("shape", [(), (2,), (3, 4)])
def test_wrong_shapes_are_refused(function: Map, shape: tuple[int, ...]) -> None:
    with pytest.raises(FlatsatError, match="shape"):
        function(np.zeros(shape), 0.0)
