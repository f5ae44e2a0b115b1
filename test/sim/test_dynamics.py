"""Laws of the simulated bodies."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import signal

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import AttitudeResponse, Dynamics, VehicleProfile
from flatsat_ros.law.flatness import acceleration_from_input
from flatsat_ros.sim.dynamics import STEP, Bodies, Ideal, IdentifiedResponse, Wind

VEHICLES = Path(__file__).parents[2] / "config" / "vehicles"
# without the tilt into the motion, which has a test of its own: transfer functions are of the command alone
PROFILES = [
    dataclasses.replace(VehicleProfile.load(path).dynamics, velocity_tilt=0.0)
    for path in sorted(VEHICLES.glob("*.yaml"))
]
CF21 = VehicleProfile.load(VEHICLES / "cf21.yaml").dynamics
STILL = np.zeros(3)


def bodies(
    response: Ideal | IdentifiedResponse, *, height: float = 100.0, thrust: float = GRAVITY, yaw: float = 0.0
) -> Bodies:
    return Bodies(response, np.array([[0.0, 0.0, height]]), np.array([yaw]), thrust=thrust, floor=0.0)


def angles(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    return np.array([[roll], [pitch], [yaw]])


inputs = st.tuples(st.floats(5.0, 15.0), st.floats(-0.7, 0.7), st.floats(-0.7, 0.7), st.floats(-3.0, 3.0))


@settings(max_examples=50)
@given(st.lists(st.tuples(inputs, st.integers(1, 20)), min_size=1, max_size=10))
def test_ideal_model_is_the_exact_double_integrator(
    commands: list[tuple[tuple[float, float, float, float], int]],
) -> None:
    body = bodies(Ideal())
    position, velocity = body.position[0].copy(), body.velocity[0].copy()
    for (thrust, roll, pitch, yaw), steps in commands:
        for _ in range(steps):
            body.step(np.array([thrust]), angles(roll, pitch, yaw), STILL)
        v, t = acceleration_from_input((thrust, roll, pitch), yaw), steps * STEP
        position, velocity = position + velocity * t + 0.5 * v * t * t, velocity + v * t
        assert_allclose(body.velocity[0], velocity, atol=1e-12)
        assert_allclose(body.position[0], position, atol=1e-12)


@pytest.mark.parametrize("dynamics", PROFILES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_attitude_step_response_is_that_of_the_transfer_function(dynamics: Dynamics, axis: int) -> None:
    response, gain = (dynamics.yaw, 1.0) if axis == 2 else (dynamics.attitude, dynamics.attitude_gain)
    wn, zeta, tau = response.natural_frequency, response.damping, response.actuator_lag
    denominator = np.trim_zeros([tau, 1.0, 2.0 * zeta * wn, wn * wn], "f")
    numerator = np.array([gain * wn**2])
    if response.integral_pole:
        numerator = np.polymul(numerator, [1.0 / response.integral_zero, 1.0])
        denominator = np.polymul(denominator, [1.0 / response.integral_pole, 1.0])
    _, expected = signal.step((numerator, denominator), T=STEP * np.arange(501))

    body = bodies(IdentifiedResponse(dynamics))
    command = np.zeros((3, 1))
    command[axis] = 0.3
    reached = []
    for _ in range(500):
        body.step(np.full(1, GRAVITY), command, STILL)
        reached.append(body.attitude[axis, 0, 0])
    assert_allclose(reached, 0.3 * expected[1:], atol=1e-11)


def test_the_firmwares_pid_answers_a_step_as_it_was_measured() -> None:
    plus = VehicleProfile.load(VEHICLES / "cf21_plus.yaml").dynamics
    body, reached = bodies(IdentifiedResponse(plus)), []
    for _ in range(1000):
        body.step(np.full(1, GRAVITY), angles(roll=0.1), STILL)
        reached.append(body.attitude[0, 0, 0] / 0.1)
    response, time = np.array(reached), plus.dead_time + STEP * np.arange(1, 1001)
    assert time[np.argmax(response > 1.0 - np.exp(-1.0))] == pytest.approx(0.123, abs=0.002)
    assert time[np.argmax(response > 0.9)] == pytest.approx(0.314, abs=0.003)
    assert response.max() == pytest.approx(1.07, abs=0.005)

    body, turned = bodies(IdentifiedResponse(plus)), []
    for step in range(1000):
        body.step(np.full(1, GRAVITY), angles(yaw=0.5 * STEP * (step + 1)), STILL)
        turned.append(body.attitude[2, 0, 1] / 0.5)
    assert time[np.argmax(np.array(turned) > 1.0 - np.exp(-1.0))] == pytest.approx(0.236, abs=0.004)


@pytest.mark.parametrize("dynamics", PROFILES)
def test_thrust_lags_by_its_own_time_up_and_down(dynamics: Dynamics) -> None:
    body = bodies(IdentifiedResponse(dynamics), thrust=8.0)
    for _ in range(50):
        body.step(np.full(1, 12.0), angles(), STILL)
    goal = 12.0 * dynamics.thrust_gain
    peak = goal + (8.0 - goal) * np.exp(-50 * STEP / dynamics.thrust_lag_up)
    assert_allclose(body.thrust, peak, rtol=1e-12)
    for _ in range(50):
        body.step(np.full(1, 5.0), angles(), STILL)
    goal = 5.0 * dynamics.thrust_gain
    assert_allclose(body.thrust, goal + (peak - goal) * np.exp(-50 * STEP / dynamics.thrust_lag_down), rtol=1e-12)


def test_a_falling_drone_reaches_its_terminal_velocity() -> None:
    body = bodies(IdentifiedResponse(CF21), height=1000.0, thrust=0.0)
    for step in range(1, 8001):
        body.step(np.zeros(1), angles(), STILL)
        if step == 500:  # v' = -g - D v from rest, after one second
            terminal, gone = -GRAVITY / CF21.drag_z, -np.expm1(-CF21.drag_z)
            assert_allclose(body.velocity[0, 2], terminal * gone, rtol=1e-12)
            assert_allclose(body.position[0, 2], 1000.0 + terminal * (1.0 - gone / CF21.drag_z), rtol=1e-12)
    assert_allclose(body.velocity[0], (0.0, 0.0, -GRAVITY / CF21.drag_z), rtol=2e-3, atol=1e-12)
    assert_allclose(body.specific_force[0], (0.0, 0.0, 1.0), rtol=2e-3, atol=1e-12)  # carried by the air


def test_a_hovering_drone_drifts_with_the_wind() -> None:
    body = bodies(IdentifiedResponse(CF21))
    for _ in range(8000):
        body.step(np.full(1, GRAVITY), angles(), np.array([1.0, -2.0, 0.0]))
    assert_allclose(body.velocity[0], (1.0, -2.0, 0.0), atol=2e-3)


def test_without_drag_energy_is_conserved_in_free_fall() -> None:
    body = bodies(Ideal(), height=50.0)
    body.velocity[0] = (3.0, -1.0, 4.0)
    energy = 0.5 * body.velocity[0] @ body.velocity[0] + GRAVITY * body.position[0, 2]
    for _ in range(1000):
        body.step(np.zeros(1), angles(), STILL)
    assert_allclose(0.5 * body.velocity[0] @ body.velocity[0] + GRAVITY * body.position[0, 2], energy, rtol=1e-12)


@pytest.mark.parametrize("response", [Ideal(), IdentifiedResponse(CF21)])
def test_hover_is_an_equilibrium(response: Ideal | IdentifiedResponse) -> None:
    body = bodies(response, height=1.0, yaw=0.7)
    for _ in range(2000):
        body.step(np.full(1, GRAVITY), angles(yaw=0.7), STILL)
    assert_allclose(body.position[0], (0.0, 0.0, 1.0), atol=1e-9)
    assert_allclose(body.angles[0], (0.0, 0.0, 0.7), atol=1e-9)


@pytest.mark.parametrize("response", [Ideal(), IdentifiedResponse(CF21)])
def test_on_the_floor_a_drone_neither_sinks_nor_slides_nor_tilts(response: Ideal | IdentifiedResponse) -> None:
    body = bodies(response, height=0.0, thrust=0.0, yaw=0.7)
    for _ in range(1000):
        body.step(np.full(1, 0.9 * GRAVITY), angles(0.3, -0.2, 2.0), np.array([3.0, 0.0, 0.0]))
    assert_allclose(body.position[0], 0.0, atol=0.0)
    assert_allclose(body.angles[0], (0.0, 0.0, 0.7), atol=0.0)
    assert_allclose(body.attitude[:, 0, 1:], 0.0, atol=0.0)
    assert_allclose(body.specific_force[0], (0.0, 0.0, 1.0), atol=0.0)


@pytest.mark.parametrize("response", [Ideal(), IdentifiedResponse(CF21)])
def test_a_drone_takes_off_exactly_when_thrust_exceeds_weight(response: Ideal | IdentifiedResponse) -> None:
    body = bodies(response, height=0.0, thrust=0.0)
    for _ in range(2000):
        body.step(np.full(1, 1.01 * GRAVITY), angles(), STILL)
        assert body.grounded[0] == (body.thrust[0] <= GRAVITY)
    assert body.position[0, 2] > 0.1


def test_a_drone_that_lands_upside_down_stays_there() -> None:
    body = bodies(Ideal(), height=0.1)
    for _ in range(1000):
        body.step(np.full(1, 1.5 * GRAVITY), angles(roll=np.pi), STILL)
    assert body.capsized[0]
    assert body.position[0, 2] == 0.0
    assert_allclose(body.specific_force[0], (0.0, 0.0, -1.0), atol=1e-12)


def test_an_axis_that_nobody_controls_turns_over() -> None:
    body = bodies(IdentifiedResponse(CF21))
    for _ in range(500):
        body.step(np.full(1, GRAVITY), angles(pitch=np.nan), STILL)
    assert abs(body.angles[0, 1]) > np.pi / 3
    assert body.angles[0, 0] == 0.0


@given(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0), st.floats(0.0, 20.0))
def test_the_quaternion_points_the_thrust_and_the_accelerometer_reads_it(
    roll: float, pitch: float, yaw: float, thrust: float
) -> None:
    body = bodies(Ideal())
    body.step(np.array([thrust]), angles(roll, pitch, yaw), STILL)
    x, y, z, w = body.quaternion[0]
    up = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert_allclose(np.linalg.norm(body.quaternion), 1.0, rtol=1e-14)
    assert_allclose(thrust * up - (0.0, 0.0, GRAVITY), body.acceleration[0], atol=1e-12)
    assert_allclose(body.specific_force[0], (0.0, 0.0, thrust / GRAVITY), atol=1e-12)


def test_gusts_have_the_promised_variance_and_correlation() -> None:
    wind = Wind(gust=0.5, gust_time=0.1)
    generator = np.random.default_rng(0)
    gust, gusts = np.zeros(3), []
    for _ in range(50_000):
        gust = wind.next_gust(gust, generator)
        gusts.append(gust)
    series = np.array(gusts)[1000:]
    lag = round(0.1 / STEP)
    assert_allclose(series.std(axis=0), 0.5, rtol=0.1)
    assert_allclose((series[lag:] * series[:-lag]).mean() / (series**2).mean(), np.exp(-1.0), rtol=0.15)


@pytest.mark.parametrize("change", [{"mean": (np.nan, 0.0, 0.0)}, {"mean": (1.0,)}, {"gust": -1.0}, {"gust_time": 0.0}])
def test_impossible_wind_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(FlatsatError, match=next(iter(change))):
        dataclasses.replace(Wind(), **change)


def test_a_second_order_response_is_the_limit_of_a_small_actuator_lag() -> None:
    def step_response(actuator_lag: float) -> float:
        attitude = AttitudeResponse(natural_frequency=20.0, damping=0.7, actuator_lag=actuator_lag)
        body = bodies(IdentifiedResponse(dataclasses.replace(CF21, attitude=attitude)))
        for _ in range(50):
            body.step(np.full(1, GRAVITY), angles(roll=0.3), STILL)
        return float(body.angles[0, 0])

    assert step_response(1e-5) == pytest.approx(step_response(0.0), abs=1e-4)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_a_tilt_into_the_motion_of_drag_over_g_is_what_keeps_the_velocity(yaw: float) -> None:
    tilt = CF21.drag_xy / GRAVITY  # small angles: T = g, and g k v balances D v
    begin = np.array([1.0, -0.5])
    for share in (1.0, 0.5):
        body = bodies(IdentifiedResponse(dataclasses.replace(CF21, velocity_tilt=share * tilt)), yaw=yaw)
        body.velocity[0, :2] = begin
        for _ in range(500):
            body.step(np.full(1, GRAVITY), angles(yaw=yaw), STILL)
        left_over = (1.0 - share) * CF21.drag_xy
        lagging = np.exp(-share * CF21.drag_xy * CF21.attitude.mean_delay)  # drag before the tilt is there
        assert_allclose(body.velocity[0, :2], np.exp(-left_over * 500 * STEP) * lagging * begin, rtol=0.02)
        cos, sin = np.cos(yaw), np.sin(yaw)
        ahead, left = np.array([[cos, sin], [-sin, cos]]) @ body.velocity[0, :2]
        roll, pitch, _ = body.angles[0]
        assert_allclose([roll, pitch], [-share * tilt * left, share * tilt * ahead], atol=0.003)
