"""The loop that flies: its matrices against a simulation in absolute coordinates, and figures found independently."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from scipy.linalg import expm

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.enclosures import exponential
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant, split
from flatsat_ros.certificate.flight_tube import Assumptions

PERIOD = 0.02
OBSERVER = (0.671, 17.82, 40.55)

first_orders = st.builds(
    lambda delay, lag, gain, drag: Plant(delay, lag, gain=gain, drag=drag),
    st.one_of(st.just(0.0), st.just(0.02), st.floats(0.0, 0.06)),
    st.one_of(st.just(0.0), st.floats(0.03, 0.3)),
    st.floats(0.7, 1.3),
    st.floats(0.0, 0.5),
)
second_orders = st.builds(
    lambda delay, frequency, damping, gain, tilt, drag: Plant(
        delay, frequency=frequency, damping=damping, gain=gain, tilt=tilt, drag=drag
    ),
    st.floats(0.0, 0.06),
    st.floats(8.0, 25.0),
    st.floats(0.3, 0.9),
    st.floats(0.6, 1.1),
    st.floats(-0.4, 0.4),
    st.floats(0.0, 0.5),
)
plants = st.one_of(first_orders, second_orders)


@dataclass(frozen=True)
class Reference:
    """What the drone is to do, and what is asked of it for that: r = a_ref + (drag + tilt of the model) v_ref."""

    position: Polynomial
    model: Plant

    @property
    def asked(self) -> Polynomial:
        return self.position.deriv(2) + (self.model.drag + self.model.tilt) * self.position.deriv()

    def ahead(self, t: float) -> float:
        """Return f of the tick t: r + lead r' in the middle of the period in which the command acts."""
        at = t + self.model.delay + PERIOD / 2.0
        return float(self.asked(at) + self.model.lead * self.asked.deriv()(at))

    def needed(self, plant: Plant) -> Polynomial:
        """The command with which a plant of its lag and tilt follows, but for the gain and what is constant."""
        lag = 1.0 / plant.frequency**2 if plant.frequency else 0.0
        needed = self.asked + plant.lead * self.asked.deriv() + lag * self.asked.deriv(2)
        tilted = plant.lead * self.position.deriv(2) + lag * self.position.deriv(3)
        return needed - plant.tilt / plant.gain * tilted


def pieces(begin: float, delay: float) -> list[tuple[float, float, int]]:
    """A period from `begin` cut where the delayed command changes: from, to, and how many periods old it is."""
    whole, rest = split(delay, PERIOD)
    cut = begin + rest
    return ([(begin, cut, whole + 1)] if rest else []) + [(cut, begin + PERIOD, whole)]


def flown(
    design: Design, plant: Plant, gains: np.ndarray, reference: Reference, disturbance: Polynomial, noise: np.ndarray
) -> np.ndarray:
    """Return e at the ticks, from a plant, an estimator, a predictor and a law in absolute coordinates."""
    model, p_ref = design.model, reference.position
    v_ref, a_ref = p_ref.deriv(), p_ref.deriv(2)
    (A, B, E), (A0, B0, E0) = plant.system, model.system

    def moved(system: tuple, x: np.ndarray, begin: float, end: float, u: float, d: Polynomial | float) -> np.ndarray:
        """Solve x' = A x + B u + E d(t) by Runge's and Kutta's method."""
        A, B, E = system
        slope = lambda t, x: A @ x + B * u + E * (d(t) if isinstance(d, Polynomial) else d)  # noqa: E731
        h = (end - begin) / 4
        for t in begin + h * np.arange(4):
            k1 = slope(t, x)
            k2 = slope(t + h / 2, x + h / 2 * k1)
            k3 = slope(t + h / 2, x + h / 2 * k2)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + h, x + h * k3))
        return x

    # at rest on the reference at time 0, had the constant part of the disturbance always been known
    d0 = float(disturbance(0.0))
    rest = -d0 / plant.gain
    x, x_hat, d_hat = np.zeros(plant.size), np.zeros(model.size), -rest
    x[:2] = x_hat[:2] = p_ref(0.0), v_ref(0.0)
    for body, state, gain in ((plant, x, plant.gain), (model, x_hat, 1.0)):
        if body.size > 2:
            state[2] = gain * (reference.asked(0.0) + rest) - body.tilt * v_ref(0.0)
        if body.size > 3:
            state[3] = gain * reference.asked.deriv()(0.0) - body.tilt * a_ref(0.0)
    sent = [(rest + reference.ahead(-i * PERIOD), reference.ahead(-i * PERIOD)) for i in range(1, 10)][::-1]
    errors = []
    for j, (k, n) in enumerate(zip(gains, noise, strict=True)):
        t = j * PERIOD
        # prediction of the deviation from the reference, with the commands under way beyond what the reference needs
        ahead = x_hat.copy()
        ahead[:2] -= p_ref(t), v_ref(t)
        if model.size > 2:
            ahead[2] -= reference.asked(t) - model.tilt * v_ref(t)
        if model.size > 3:
            ahead[3] -= reference.asked.deriv()(t) - model.tilt * a_ref(t)
        elapsed = 0.0
        while design.horizon - elapsed > 1e-12:
            age = math.ceil((model.delay - elapsed) / PERIOD - 1e-9)
            until = min(model.delay - (age - 1) * PERIOD, design.horizon)
            u, f = sent[-age]
            ahead = moved(model.system, ahead, elapsed, until, u - f, d_hat)
            elapsed = until
        v = ahead[1]
        if model.lag:
            v += model.lead * (ahead[2] + d_hat)
        if model.frequency:
            v += model.lead * (ahead[2] + d_hat) + ahead[3] / model.frequency**2
        v0 = -design.stiffness * ahead[0] - design.rate * v
        f = reference.ahead(t)
        sent.append((f - d_hat + k * v0, f))
        for begin, end, age in pieces(t, plant.delay):
            x = moved((A, B, E), x, begin, end, plant.gain * sent[-1 - age][0], disturbance)
        for begin, end, age in pieces(t, model.delay):
            x_hat = moved((A0, B0, E0), x_hat, begin, end, sent[-1 - age][0], d_hat)
        innovation = x[0] + n - x_hat[0]
        x_hat[:2] += np.array(design.observer[:2]) * innovation
        d_hat += design.observer[2] * innovation
        errors.append(x[0] - p_ref(t + PERIOD))
    return np.array(errors)


def modelled(
    design: Design, plant: Plant, gains: np.ndarray, reference: Reference, disturbance: Polynomial, noise: np.ndarray
) -> np.ndarray:
    """Return e at the ticks from the loop's matrices and its four inputs."""
    loop, model = FlightLoop(design, plant), design.model
    unknown = model.drag + model.tilt - plant.drag - plant.tilt
    rate = disturbance.deriv() + (plant.gain - 1.0) * reference.asked.deriv() + unknown * reference.position.deriv(2)
    d0 = (plant.gain - 1.0) * reference.asked(0.0) + unknown * reference.position.deriv()(0.0)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    # the start of `flown` is at rest against the disturbance alone
    z = np.zeros(loop.size)
    if plant.size > 2:
        z[2] += d0
    if model.size > 2:
        z[plant.size + 2] += d0 / plant.gain
    z[plant.size + model.size :] += d0 / plant.gain
    errors = []
    for j, (k, n) in enumerate(zip(gains, noise, strict=True)):
        t = j * PERIOD
        z = loop.matrix(k) @ z + loop.noise_input * n
        for body, column in ((plant, loop.drive_input), (model, loop.model_drive_input)):
            for begin, end, age in pieces(t, body.delay):
                f = reference.ahead((j - age) * PERIOD)
                for node, weight in zip(nodes, weights, strict=True):
                    at = (begin + end + node * (end - begin)) / 2.0
                    impulse = weight * (end - begin) / 2.0
                    z = z + body.gain * impulse * (f - reference.needed(body)(at)) * column(t + PERIOD - at)
        for node, weight in zip(nodes, weights, strict=True):
            at = t + PERIOD * (1.0 + node) / 2.0
            z = z + weight * PERIOD / 2.0 * rate(at) * loop.rate_input(t + PERIOD - at)
        errors.append(z[0])
    return np.array(errors)


@settings(max_examples=10)
@given(plant=plants, model=plants, seed=st.integers(0, 2**32 - 1))
def test_the_loop_is_what_flies_in_absolute_coordinates(plant: Plant, model: Plant, seed: int) -> None:
    random = np.random.default_rng(seed)
    model = Plant(model.delay, model.lag, model.frequency, model.damping, 1.0, model.tilt, model.drag)
    design = Design.predicting(PERIOD, model, OBSERVER, 4.0, 2.0)
    gains, noise = random.uniform(1.0, 2.0, 9), 1e-3 * random.standard_normal(9)
    reference = Reference(Polynomial(random.standard_normal(6)), model)
    disturbance = Polynomial(random.standard_normal(3))
    arguments = (design, plant, gains, reference, disturbance, noise)
    np.testing.assert_allclose(modelled(*arguments), flown(*arguments), rtol=1e-7, atol=1e-9)


@settings(max_examples=30)
@given(one=plants, other=plants, model=plants, seed=st.integers(0, 2**32 - 1))
def test_what_references_do_to_the_loop_is_bounded(one: Plant, other: Plant, model: Plant, seed: int) -> None:
    random = np.random.default_rng(seed)
    if (one.frequency > 0.0) != (other.frequency > 0.0) or (one.lag > 0.0) != (other.lag > 0.0):
        other = one
    names = [figure.name for figure in fields(Plant)]
    low, high = (Plant(*(pick(getattr(one, n), getattr(other, n)) for n in names)) for pick in (min, max))
    plant = Plant(*(getattr(low, n) + random.uniform() * (getattr(high, n) - getattr(low, n)) for n in names))
    model = Plant(model.delay, model.lag, model.frequency, model.damping, 1.0, model.tilt, model.drag)
    reference = Reference(Polynomial(random.standard_normal(6)), model)
    times = np.linspace(-0.5, 0.5, 1001)
    largest = [float(np.abs(reference.position.deriv(order)(times)).max()) for order in (2, 3, 4)]
    assumptions = Assumptions(0.0, 0.0, *largest)
    within = np.linspace(0.0, PERIOD, 21)[:-1]
    errors = reference.ahead(0.0) - reference.needed(plant)(plant.delay + within)
    ripple = (within - PERIOD / 2.0) * reference.asked.deriv()(plant.delay + PERIOD / 2.0)
    assert np.abs(errors + ripple).max() <= assumptions.drive(model, PERIOD, low, high) * (1.0 + 1e-9)
    assert np.abs(reference.asked.deriv()(times)).max() <= assumptions.ripple(model) * (1.0 + 1e-9)
    unknown = model.drag + model.tilt - plant.drag - plant.tilt
    rate = (plant.gain - 1.0) * reference.asked.deriv() + unknown * reference.position.deriv(2)
    assert np.abs(rate(times)).max() <= assumptions.rate(model, low, high) * (1.0 + 1e-9)


def l1(loop: FlightLoop, gain: float, column: np.ndarray) -> float:
    """Sum of |e| at the ticks after an impulse, gain held."""
    A, z, total = loop.matrix(gain), column, 0.0
    for _ in range(3000):
        total += abs(z[0])
        z = A @ z
    return total


@pytest.mark.parametrize(
    ("model", "radii", "gains"),
    [
        (Plant(), (0.9873892, 0.9790445), (0.62559, 1.80966)),
        (Plant(0.03, 0.08), (0.9864865, 0.9813865), (0.78233, 1.78367)),
    ],
)
def test_figures_of_another_derivation(model: Plant, radii: tuple[float, float], gains: tuple[float, float]) -> None:
    # An estimator that takes commands for instantaneous, and one that knows lag and delay; no prediction. The other
    # derivation had an observer of which three or four digits are given here.
    loop = FlightLoop(Design(PERIOD, model, OBSERVER, 1.25**2 / 2.0, 1.25, 0.0, 0.0), Plant(0.03, 0.08))
    for gain, radius in zip((1.0, 2.0), radii, strict=True):
        assert abs(np.linalg.eigvals(loop.matrix(gain))).max() == pytest.approx(radius, abs=2e-7)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    rate = sum(
        w * PERIOD / 2.0 * loop.rate_input(PERIOD * (1.0 + x) / 2.0) for x, w in zip(nodes, weights, strict=True)
    )
    assert l1(loop, 1.0, rate) == pytest.approx(gains[0], rel=1e-4)
    assert l1(loop, 1.0, loop.noise_input) == pytest.approx(gains[1], rel=1e-4)


@given(plant=plants, model=plants, gain=st.floats(0.0, 3.0))
def test_the_matrix_is_affine_in_the_gain(plant: Plant, model: Plant, gain: float) -> None:
    model = Plant(model.delay, model.lag, model.frequency, model.damping, 1.0, model.tilt, model.drag)
    loop = FlightLoop(Design.predicting(PERIOD, model, OBSERVER, 4.0, 2.0), plant)
    expected = loop.matrix(0.0) + gain * np.outer(loop.command_input, loop.feedback)
    np.testing.assert_allclose(loop.matrix(gain), expected, rtol=1e-12, atol=1e-12)


def test_where_the_model_is_exact_the_error_of_the_estimate_does_not_depend_on_the_gain() -> None:
    plant = Plant(0.03, 0.14)
    loop = FlightLoop(Design.predicting(PERIOD, plant, (0.36, 3.9, 14.2), 42.8, 23.6), plant)
    error = np.zeros((3, loop.size))
    error[0, [0, 3]] = error[1, [1, 4]] = 1.0, -1.0
    error[2, 6] = 1.0
    for gain in (1.0, 1.5, 4.0):
        # autonomous: the rows of the error see nothing but the error and a - m, which is 0
        moved = error @ loop.matrix(gain)
        others = moved - moved[:, [0, 1, 6]] @ error
        others[:, [2, 5]] -= np.outer(moved[:, 2], [1.0, -1.0])
        np.testing.assert_allclose(others, 0.0, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 20.0))
def test_the_exponential(seed: int, scale: float) -> None:
    matrix = scale * np.random.default_rng(seed).standard_normal((5, 5))
    np.testing.assert_allclose(exponential(matrix), expm(matrix), rtol=1e-9, atol=1e-12 * np.exp(scale))


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: Plant(0.03, 0.1, frequency=15.0, damping=0.5), "lag = 0.1 s: must be 0 with a frequency"),
        (lambda: Plant(0.03, frequency=15.0), "damping = 0.0: must be above 0 with a frequency"),
        (lambda: Plant(0.03, 0.1, tilt=0.2), "tilt = 0.2 1/s: must be 0 without a frequency"),
        (lambda: Plant(-0.01), "delay = -0.01 s: must be a number from 0"),
        (lambda: Plant(gain=0.0), "gain = 0.0: must be a number above 0"),
        (lambda: Design(0.02, Plant(gain=0.9), OBSERVER, 1.0, 1.0, 0.0, 0.0), "gain of the model = 0.9: must be 1"),
        (lambda: Design(0.02, Plant(0.03), OBSERVER, 1.0, 1.0, 0.04, 0.0), "horizon = 0.04 s: must be at most 0.03"),
        (lambda: Design(0.02, Plant(0.03), OBSERVER, 1.0, 1.0, 0.0, 0.1), "lead = 0.1 s: must be at most 0 s"),
        (
            lambda: FlightLoop(Design(0.02, Plant(), OBSERVER, 1.0, 1.0, 0.0, 0.0), Plant(0.9)),
            "delay = 0.9 s: must be at most 0.8 s",
        ),
    ],
)
def test_impossible_loops_are_refused(build: Callable[[], object], text: str) -> None:
    with pytest.raises(FlatsatError) as refused:
        build()
    assert text in str(refused.value)
