"""Estimator and predictor of flight certificates: what flies is the loop of which they speak."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.certificate.flight_loop import FlightLoop
from flatsat_ros.certificate.flight_plant import Design, Plant, split
from flatsat_ros.flight.predictor import Predictor
from flatsat_ros.flight.preview import Preview
from flatsat_ros.flight.references import References
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.planning.spline import gentle_spline_through

PERIOD = 0.02
COUNT = 2

drags = st.sampled_from([0.0, 0.4])
delays = st.one_of(st.just(0.0), st.just(0.02), st.floats(0.001, 0.06))
first_orders = st.builds(
    lambda delay, lag, gain, drag: Plant(delay, lag, gain=gain, drag=drag),
    delays, st.one_of(st.just(0.0), st.floats(0.03, 0.3)), st.floats(0.8, 1.2), drags,
)  # fmt: skip
second_orders = st.builds(
    lambda delay, frequency, damping, gain, tilt, drag: Plant(
        delay, frequency=frequency, damping=damping, gain=gain, tilt=tilt, drag=drag
    ),
    delays, st.floats(8.0, 25.0), st.floats(0.3, 0.9), st.floats(0.6, 1.1), st.floats(0.0, 0.4), drags,
)  # fmt: skip
plants = st.one_of(first_orders, second_orders)


def nominal(plant: Plant) -> Plant:
    """The same plant with a gain of 1."""
    return Plant(plant.delay, plant.lag, plant.frequency, plant.damping, 1.0, plant.tilt, plant.drag)


class Drones:
    """Exact plants, three axes each, under commands that arrive late and constant disturbances."""

    def __init__(
        self, plants: list[Plant], position: FloatArray, velocity: FloatArray, disturbance: FloatArray
    ) -> None:
        self.plants, self.disturbance = plants, disturbance
        self.states = [np.zeros((plant.size, COUNT)) for plant in plants]
        for axis, state in enumerate(self.states):
            state[0], state[1] = position[:, axis], velocity[:, axis]
        self.sent = [np.zeros((COUNT, 3)) for _ in range(10)]

    @property
    def position(self) -> FloatArray:
        return np.array([state[0] for state in self.states]).T

    def fly(self, command: FloatArray) -> None:
        """Send a command and let a period pass."""
        self.sent.append(command)
        for axis, plant in enumerate(self.plants):
            whole, rest = split(plant.delay, PERIOD)
            for age, span in ((whole + 1, rest), (whole, PERIOD - rest)):
                phi, drive, push = plant.hold(span)
                self.states[axis] = (
                    phi @ self.states[axis]
                    + plant.gain * np.outer(drive, self.sent[-1 - age][:, axis])
                    + np.outer(push, self.disturbance[:, axis])
                )


def accustomed(design: Design, acceleration: FloatArray, needed: FloatArray) -> Predictor:
    """A predictor to which the same was commanded for long, at time 0."""
    predictor = Predictor(design, design, COUNT, pose_age=0.05)
    for j in range(-9, 1):
        predictor.advance(j * PERIOD, np.full(COUNT, -np.inf), np.zeros((COUNT, 3)))
        predictor.command(acceleration, needed)
    return predictor


def command(predictor: Predictor, designs: list[Design], reference: FloatArray, gain: float) -> FloatArray:
    """The law at the predicted state."""
    ahead = predictor.ahead(reference)
    xi = predictor.state + ahead - reference[:, :6]
    stiffness, rate = (np.array([getattr(d, name) for d in designs]) for name in ("stiffness", "rate"))
    return np.asarray(-predictor.disturbance - gain * (stiffness * xi[:, :3] + rate * xi[:, 3:]))


@settings(max_examples=25)
@given(sides=plants, upright=plants, flown=plants, seed=st.integers(0, 2**32 - 1))
def test_what_flies_is_the_loop_of_the_certificate(sides: Plant, upright: Plant, flown: Plant, seed: int) -> None:
    random = np.random.default_rng(seed)
    observer = (0.36, 3.9, 14.2)
    designs = [Design.predicting(PERIOD, nominal(model), observer, 4.0, 2.5) for model in (sides, sides, upright)]
    real = [sides, flown, upright]  # y is a plant that the model does not know
    place, speed, disturbance = (random.standard_normal((COUNT, 3)) for _ in range(3))
    drones = Drones(real, place, speed, disturbance)
    predictor = Predictor(designs[0], designs[2], COUNT, pose_age=0.05)
    goal = np.concatenate([random.standard_normal((COUNT, 3)), np.zeros((COUNT, 6))], axis=1)
    loops = [FlightLoop(design, plant) for design, plant in zip(designs, real, strict=True)]
    states = []
    for axis, loop in enumerate(loops):
        n, y = loop.plant.size, loop.design.model.size
        z = np.zeros((loop.size, COUNT))
        share = disturbance[:, axis] / loop.plant.gain
        for begin in (0, n):
            z[begin], z[begin + 1] = place[:, axis] - goal[:, axis], speed[:, axis]
        if n > 2:
            z[2] = disturbance[:, axis]
        if y > 2:
            z[n + 2] = share
        z[n + y :] = share
        states.append(z)
    for j in range(12):
        now = j * PERIOD
        if j == 0:
            predictor.advance(now, np.full(COUNT, -np.inf), np.zeros((COUNT, 3)))
            predictor.restart(np.ones(COUNT, bool), np.hstack([place, speed, np.zeros((COUNT, 3))]), now)
        else:
            predictor.advance(now, np.full(COUNT, now), drones.position)
        k = random.uniform(1.0, 2.0)
        u = command(predictor, designs, goal, k)
        drones.fly(u)
        predictor.command(u, np.zeros((COUNT, 3)))
        for axis, loop in enumerate(loops):
            states[axis] = loop.matrix(k) @ states[axis]
            scale = 1.0 + np.abs(states[axis]).max()
            np.testing.assert_allclose(
                drones.position[:, axis] - goal[:, axis], states[axis][0], rtol=0.0, atol=1e-10 * scale
            )


def test_without_lag_and_delay_the_law_acts_on_the_estimate() -> None:
    design = Design.predicting(PERIOD, Plant(), (0.36, 3.9, 14.2), 4.0, 2.5)
    predictor = Predictor(design, design, COUNT, pose_age=0.05)
    random = np.random.default_rng(1)
    predictor.restart(np.ones(COUNT, bool), random.standard_normal((COUNT, 9)), 0.0)
    predictor.command(random.standard_normal((COUNT, 3)), random.standard_normal((COUNT, 3)))
    assert not predictor.ahead(random.standard_normal((COUNT, 9))).any()


@settings(max_examples=20)
@given(plant=plants, seed=st.integers(0, 2**32 - 1))
def test_a_reference_of_constant_acceleration_is_followed_without_an_error(plant: Plant, seed: int) -> None:
    random = np.random.default_rng(seed)
    # drag and tilt would ask for more than a constant
    plant = Plant(plant.delay, plant.lag, plant.frequency, plant.damping)
    design = Design.predicting(PERIOD, plant, (0.36, 3.9, 14.2), 4.0, 2.5)
    coefficients = np.zeros((1, 8, 3))
    coefficients[0, :3] = random.standard_normal((3, 3))
    references = References(COUNT, 1.0)
    for index in range(COUNT):
        references.assign(index, Trajectory(np.array([-1.0, 9.0]), coefficients), 1.0)
    preview = Preview(references, design, design)
    start = references.sample(0.0)
    drones = Drones([plant] * 3, start[:, :3], start[:, 3:6], np.zeros((COUNT, 3)))
    for state, axis in zip(drones.states, range(3), strict=True):
        state[2:3] = start[:, 6 + axis]
    drones.sent = [start[:, 6:] for _ in range(10)]
    predictor = accustomed(design, start[:, 6:], start[:, 6:])
    predictor.restart(np.ones(COUNT, bool), np.hstack([start[:, :6], np.zeros((COUNT, 3))]), 0.0)
    for j in range(8):
        now = j * PERIOD
        reference = references.sample(now)
        if j:
            predictor.advance(now, np.full(COUNT, now), drones.position)
            np.testing.assert_allclose(drones.position, reference[:, :3], atol=1e-12)
        needed = preview.needed(now)
        np.testing.assert_allclose(needed, reference[:, 6:], atol=1e-12)
        u = needed + command(predictor, [design] * 3, reference, 1.5)
        drones.fly(u)
        predictor.command(u, needed)


@settings(max_examples=20)
@given(lag=st.sampled_from([0.0, 0.1]), delay=delays, seed=st.integers(0, 2**32 - 1))
def test_poses_of_any_age_of_a_drone_that_moves_as_the_model_say_nothing_new(
    lag: float, delay: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    design = Design.predicting(PERIOD, Plant(delay, lag), (0.36, 3.9, 14.2), 4.0, 2.5)
    place, speed, push = random.standard_normal((3, COUNT, 3))

    def truth(t: FloatArray) -> FloatArray:
        return np.asarray(place + t[:, np.newaxis] * (speed + t[:, np.newaxis] / 2.0 * push))

    predictor = accustomed(design, push, np.zeros((COUNT, 3)))
    predictor.restart(np.ones(COUNT, bool), np.hstack([place, speed, np.zeros((COUNT, 3))]), 0.0)
    now = 0.0
    stamps = np.full(COUNT, -np.inf)
    for j in range(1, 15):
        predictor.command(push, np.zeros((COUNT, 3)))
        now = j * PERIOD + random.uniform(-1e-3, 1e-3)  # ticks are not even
        new = random.random(COUNT) < 0.8
        stamps = np.where(new, np.maximum(stamps, now - random.uniform(0.0, min(0.05, now), COUNT)), stamps)
        predictor.advance(now, stamps, truth(np.maximum(stamps, 0.0)))
        np.testing.assert_allclose(predictor.state[:, :3], truth(np.full(COUNT, now)), atol=1e-12)
        np.testing.assert_allclose(predictor.innovation, 0.0, atol=1e-12)


def test_a_pose_that_stays_the_newest_is_used_until_it_is_too_old() -> None:
    design = Design.predicting(PERIOD, Plant(0.03, 0.1), (0.36, 3.9, 14.2), 4.0, 2.5)
    predictor = Predictor(design, design, 1, pose_age=0.05)
    predictor.restart(np.ones(1, bool), np.zeros((1, 9)), 0.0)
    predictor.advance(0.0, np.full(1, -np.inf), np.zeros((1, 3)))
    seen = []
    for j in range(1, 6):
        predictor.advance(j * PERIOD, np.full(1, PERIOD), np.array([[0.01, 0.0, 0.0]]))
        seen.append(float(predictor.innovation[0, 0]))
    # each time less what was corrected before
    np.testing.assert_allclose(seen, [0.01, 0.64 * 0.01, 0.64**2 * 0.01, 0.0, 0.0], atol=1e-15)
    assert predictor.age[0] == pytest.approx(0.08)


def test_velocities_are_better_than_finite_differences() -> None:
    # 120 Hz, three axes of the swap, one drone for each noise; of differences over any time the best
    h, noises = 1.0 / 120.0, np.array([3e-4, 5e-4, 1e-3])
    plant, model = Plant(0.024, 0.155, drag=0.42), Plant(0.028, 0.141, drag=0.456)
    design = Design.predicting(h, model, (0.185, 2.25, 10.0), 22.7, 12.45)
    path = gentle_spline_through([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0], [0.0, -0.6, 1.0]], 4.4)
    count, random = len(noises), np.random.default_rng(5)
    references = References(count, 1.0)
    for index in range(count):
        references.assign(index, path, 1.0)
    preview, predictor = Preview(references, design, design), Predictor(design, design, count, pose_age=0.02)
    start = references.sample(0.0)
    state = np.zeros((plant.size, count, 3))
    state[0] = start[:, :3]
    sent = [np.zeros((count, 3)) for _ in range(9)]
    whole, rest = split(plant.delay, h)
    parts = [(plant.hold(span), age) for span, age in ((rest, whole + 1), (h - rest, whole))]
    predictor.advance(0.0, np.full(count, -np.inf), np.zeros((count, 3)))
    predictor.restart(np.ones(count, bool), np.hstack([start[:, :6], np.zeros((count, 3))]), 0.0)
    measured, true, estimated = [], [], []
    for j in range(round(path.times[-1] / h)):
        now = j * h
        reference = references.sample(now)
        pose = state[0] + noises[:, np.newaxis] * random.standard_normal((count, 3))
        if j:
            predictor.advance(now, np.full(count, now), pose)
        measured.append(pose)
        true.append(state[1])
        estimated.append(predictor.state[:, 3:])
        needed = preview.needed(now)
        u = needed + command(predictor, [design] * 3, reference, 1.0)
        predictor.command(u, needed)
        sent.append(u)
        for (phi, drive, push), age in parts:
            state = (
                np.tensordot(phi, state, 1)
                + np.multiply.outer(drive, sent[-1 - age])
                + np.multiply.outer(push, np.full((count, 3), 0.1))  # it is blown at, and settles against that
            )
    late = slice(120, None)
    places, velocities = np.array(measured), np.array(true)
    ours = np.sqrt(np.square(np.array(estimated) - velocities)[late].mean(axis=(0, 2)))
    best = np.full(count, np.inf)
    for ticks in range(1, 60):
        difference = (places[ticks:] - places[:-ticks]) / (ticks * h)
        off = difference[120 - ticks :] - velocities[late]
        best = np.minimum(best, np.sqrt(np.square(off).mean(axis=(0, 2))))
    assert (ours < 0.7 * best).all(), (ours, best)
