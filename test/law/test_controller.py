"""The law: its theorems on random states, and the paper's first simulation study."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.falsification.loops import runge_kutta
from flatsat_ros.law.controller import Controller, Memory, Output
from flatsat_ros.law.flatness import acceleration_from_input
from flatsat_ros.law.gain import Tuning

CERTIFICATE = Certificate.load(Path(__file__).parents[2] / "config" / "paper_simulation.yaml")
LIMITS = CERTIFICATE.limits
P = CERTIFICATE.matrix

states = st.tuples(*[st.floats(-4.0, 4.0)] * 6)
gains = st.floats(1.0, 16.0)


def controller(count: int = 1, mu: float | list[float] = 0.0) -> Controller:
    tuning = Tuning(np.broadcast_to(mu, (count,)), 0.05, 1.0, CERTIFICATE.gain_max)
    return Controller(CERTIFICATE, tuning)


def inside(v: np.ndarray, tolerance: float = 0.0) -> bool:
    """Membership in the input set by its definition."""
    thrust, radius = math.hypot(v[0], v[1], v[2] + LIMITS.gravity), math.hypot(v[0], v[1])
    reach = math.tan(LIMITS.tilt_max) * (v[2] + LIMITS.gravity)
    return bool(thrust <= LIMITS.thrust_max * (1.0 + tolerance) and radius <= reach + tolerance)


@given(x=states, gain=gains)
def test_the_command_is_the_saturated_gradient_and_stays_in_the_set(x: tuple[float, ...], gain: float) -> None:
    _, output = controller().step(Memory(np.array([gain])), [x], [0.0], np.zeros((1, 9)))
    v0 = -(P @ x)[3:]
    np.testing.assert_allclose(output.acceleration[0], LIMITS.saturate(gain * v0), rtol=1e-11, atol=1e-12)
    assert inside(output.acceleration[0], 1e-12)
    assert output.applied_gain[0] <= gain
    assert output.saturated[0] == (output.applied_gain[0] < gain)


@given(x=states, gain=gains)
def test_the_applied_gain_is_at_least_one_exactly_where_the_nominal_input_is_admissible(
    x: tuple[float, ...], gain: float
) -> None:
    v0 = -(P @ x)[3:]
    assume(inside(v0 * (1.0 - 1e-9)) == inside(v0 * (1.0 + 1e-9)))
    _, output = controller().step(Memory(np.array([gain])), [x], [0.0], np.zeros((1, 9)))
    assert (output.applied_gain[0] >= 1.0) == inside(v0)


@given(x=states, gain=gains, depth=st.floats(1e-6, 1.0))
def test_v_decays_at_the_certified_rate_all_over_the_invariant_set(
    x: tuple[float, ...], gain: float, depth: float
) -> None:
    direction = np.array(x)
    assume(direction @ P @ direction > 1e-6)
    xi = direction * math.sqrt(depth * CERTIFICATE.level / (direction @ P @ direction))
    _, output = controller().step(Memory(np.array([gain])), [xi], [0.0], np.zeros((1, 9)))
    flow = np.concatenate([xi[3:], output.acceleration[0]])
    assert output.applied_gain[0] >= 1.0 - 1e-12
    assert 2.0 * xi @ P @ flow <= (-CERTIFICATE.rate + 1e-9) * (xi @ P @ xi)
    assert output.lyapunov[0] == pytest.approx(xi @ P @ xi, rel=1e-12)


@given(x=states, gain=gains, direction=states, depth=st.floats(0.0, 0.99))
def test_about_a_reference_the_command_stays_in_the_set_and_the_gain_is_the_largest(
    x: tuple[float, ...], gain: float, direction: tuple[float, ...], depth: float
) -> None:
    v_ref = depth * LIMITS.saturate(np.multiply(10.0, direction[:3]))
    reference = np.concatenate([direction[3:], (1.0, 2.0, 3.0), v_ref])
    _, output = controller().step(Memory(np.array([gain])), [x], [0.0], [reference])
    v, k = output.acceleration[0], float(output.applied_gain[0])
    xi = np.array(x) - reference[:6]
    np.testing.assert_allclose(output.error[0], xi)
    np.testing.assert_allclose(v, v_ref - k * (P @ xi)[3:], rtol=1e-12, atol=1e-12)
    assert inside(v, 1e-11)
    assert k == gain or not inside(v_ref - k * (1.0 + 1e-6) * (P @ xi)[3:])


@given(x=states, yaw=st.floats(-7.0, 7.0))
def test_the_input_produces_the_acceleration_whatever_the_yaw(x: tuple[float, ...], yaw: float) -> None:
    _, output = controller().step(Memory(np.array([3.0])), [x], [yaw], np.zeros((1, 9)))
    np.testing.assert_allclose(acceleration_from_input(output.input, [yaw]), output.acceleration, atol=1e-12)


# just short of free fall, where roll and pitch are those of a vector of a millionth of a m/s^2
FALLING = [
    ((3.7, 1.8, 0.3, -2.21999999, -1.08, 3.4908329), 2.0, 0.0, 0.0),
    ((0.1, -3.1, 1.0, -0.05999999, 1.86, 3.9041663), 2.0, 0.0, 0.0),
]


@given(rows=st.lists(st.tuples(states, gains, st.floats(-3.0, 3.0), st.floats(0.0, 5.0)), min_size=1, max_size=5))
@example(rows=FALLING)
def test_batch_equals_loop(rows: list[tuple[tuple[float, ...], float, float, float]]) -> None:
    x, gain, yaw, mu = (np.array(column) for column in zip(*rows, strict=True))
    reference = np.zeros((len(rows), 9))
    reference[:, 8] = np.linspace(-1.0, 1.0, len(rows))
    memory, output = controller(len(rows), list(mu)).step(Memory(gain), x, yaw, reference)
    for i in range(len(rows)):
        row = slice(i, i + 1)
        alone_memory, alone = controller(1, mu[i]).step(Memory(gain[row]), x[row], yaw[row], reference[row])
        np.testing.assert_allclose(memory.gain[row], alone_memory.gain, rtol=1e-14)
        for name, several, other in zip(Output._fields, output, alone, strict=True):
            a, b = several[row], other
            if name == "input":  # an angle is known as well as the thrust vector over its length
                weight = np.hstack([[[1.0]], alone.input[:, [0, 0]]])
                a, b = weight * a, weight * b
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13, err_msg=name)


def test_a_step_changes_nothing_it_was_given() -> None:
    law = controller(2, 2.0)
    memory, x, yaw, reference = law.start(), np.ones((2, 6)), np.ones(2), np.zeros((2, 9))
    first = law.step(memory, x, yaw, reference)
    assert memory.gain.tolist() == [1.0, 1.0]
    assert (x == 1.0).all()
    second = law.step(memory, x, yaw, reference)
    np.testing.assert_array_equal(first[0].gain, second[0].gain)
    np.testing.assert_array_equal(first[1].acceleration, second[1].acceleration)
    assert first[1].gain.tolist() == [1.0, 1.0]
    assert (first[0].gain > 1.0).all()


def test_the_gain_may_not_outgrow_the_certificate() -> None:
    with pytest.raises(FlatsatError, match=r"gain_max = 16\.6: must be at most the certificate's 16\.5388"):
        Controller(CERTIFICATE, Tuning(1.0, 0.05, 1.0, [16.0, 16.6]))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("argument", ["gain", "state", "yaw", "reference"])
def test_what_is_not_finite_never_becomes_a_command(argument: str, bad: float) -> None:
    for entry in range({"state": 6, "reference": 9}.get(argument, 1)):
        values = {"gain": np.ones(1), "state": np.ones((1, 6)), "yaw": np.zeros(1), "reference": np.zeros((1, 9))}
        values[argument].ravel()[entry] = bad
        memory = Memory(values["gain"])
        if argument == "gain" and bad == math.inf:
            continue  # an infinite gain is saturated like any other
        with pytest.raises(FlatsatError, match=r"an entry of \w+ = (nan|inf): must be a finite number"):
            controller().step(memory, values["state"], values["yaw"], values["reference"])


def test_wrong_shapes_and_references_outside_the_set_are_refused() -> None:
    law, memory = controller(), Memory(np.ones(1))
    with pytest.raises(FlatsatError, match="shape of state = "):
        law.step(memory, np.zeros((1, 5)), np.zeros(1), np.zeros((1, 9)))
    with pytest.raises(FlatsatError, match="shape of reference = "):
        law.step(memory, np.zeros((1, 6)), np.zeros(1), np.zeros((1, 6)))
    with pytest.raises(FlatsatError, match=r"base = .* m/s\^2: must be inside the input set, it is"):
        law.step(memory, np.zeros((1, 6)), np.zeros(1), [[0, 0, 0, 0, 0, 0, 0, 0, 6.0]])


def test_the_papers_first_simulation_study() -> None:
    """Runge-Kutta through the law, with the gain as one more state: the continuous closed loop of the paper."""
    adaptation = np.array([0.0, 1.0, 3.0, 5.0])
    law, yaw, rest = controller(4), np.zeros(4), np.zeros((4, 9))
    step, samples = 2e-3, []

    def slope(part: int, y: np.ndarray) -> np.ndarray:
        _, output = law.step(Memory(y[:, 6]), y[:, :6], yaw, rest)
        if part == 0:
            samples.append(output.lyapunov)
        growth = adaptation * np.maximum(output.lyapunov - 0.05, 0.0)
        return np.hstack([y[:, 3:6], output.acceleration, growth[:, np.newaxis]])

    y = np.tile([1.05, 1.04, 0.85, -0.02, -1.39, -0.42, 1.0], (4, 1))
    for _ in range(1800):
        y = runge_kutta(slope, y, step)
    history = np.array(samples)
    first = (history > 0.05).sum(axis=0)
    above, below = history[first - 1, range(4)], history[first, range(4)]
    settling = step * (first - 1 + (above - 0.05) / (above - below))

    np.testing.assert_allclose(history[0], 2.4159984, atol=1e-7)
    np.testing.assert_allclose(history[500], [0.727685, 0.415455, 0.346866, 0.344557], atol=1e-4)
    np.testing.assert_allclose(history[1000], [0.219174, 0.081646, 0.085215, 0.091984], atol=1e-4)
    np.testing.assert_allclose(history[1500], [0.066014, 0.015578, 0.021411, 0.024879], atol=1e-4)
    np.testing.assert_allclose(settling, [3.231537, 2.301256, 2.385407, 2.465958], atol=1e-4)
    np.testing.assert_allclose(y[:, 6], [1.0, 2.289760, 4.423301, 6.656436], atol=1e-4)
