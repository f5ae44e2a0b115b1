"""How late drones follow their commands is found from innovations, whatever the observer, and noise is no lateness."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.resources import config_path
from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.assumptions import Seen
from flatsat_ros.flight.lateness import Lateness

FLYING = Certificate.from_document(read_yaml(config_path("cf21_tight_50hz"))).flight  # not proved again here
PERIOD = 0.02


def swaying(t: float) -> tuple[FloatArray, FloatArray]:
    """Return acceleration, m/s^2, and velocity, m/s, of a drone that sways in x and in y."""
    acceleration = np.array([0.8 * np.sin(1.5 * t), 0.6 * np.cos(1.1 * t)])
    return acceleration, np.array([0.8 / 1.5 * -np.cos(1.5 * t), 0.6 / 1.1 * np.sin(1.1 * t)])


def to_and_fro(t: float) -> tuple[FloatArray, FloatArray]:
    """Return acceleration, m/s^2, and velocity, m/s, of a drone that goes 0.9 m, rests and goes back, 4.5 s each."""
    part = (t % 4.5) / 3.9
    way = 0.9 * (-1.0 if t % 9.0 >= 4.5 else 1.0) * (part < 1.0) * np.array([1.0, 0.0])
    rate = 60.0 * part - 180.0 * part**2 + 120.0 * part**3
    return way * rate / 3.9**2, way * (30.0 * part**2 - 60.0 * part**3 + 30.0 * part**4) / 3.9


def slow_eight(t: float, lasts: float = 15.0) -> tuple[FloatArray, FloatArray]:
    """Return acceleration, m/s^2, and velocity, m/s, of a drone that flies a figure eight, 1 m wide, in so long, s."""
    rate = 2.0 * np.pi / lasts
    acceleration = np.array([-0.5 * rate**2 * np.sin(rate * t), -(rate**2) * np.sin(2.0 * rate * t)])
    return acceleration, np.array([0.5 * rate * np.cos(rate * t), 0.5 * rate * np.cos(2.0 * rate * t)])


def looks(
    late: float,
    noise: float,
    seed: int,
    fed: float = 0.0,
    gust: float = 0.0,
    motion: Callable[[float], tuple[FloatArray, FloatArray]] = swaying,
    drag: float = 0.0,
) -> Iterator[Seen]:
    """Yield 6 s of a motion in which one drone is late, and another one stands still.

    Commands answer to innovations by `fed` 1/s^2, as those of a law do that believes them. Gusts push the late drone by
    an acceleration with the standard deviation `gust`, m/s^2, and a correlation time of 1 s. It has so much more drag,
    1/s, than its model.
    """
    assert FLYING is not None
    random = np.random.default_rng(seed)
    h, observer = PERIOD, np.array(FLYING.horizontal.design.observer)
    F = np.array([[1.0, h, h * h / 2.0], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    error = np.zeros((3, 2))  # of position, velocity and disturbance, in x and in y
    believed, push, kept = np.zeros((2, 2)), gust * random.standard_normal(2), np.exp(-h)
    for tick in range(300):
        t = tick * h
        acceleration, velocity = motion(t)
        innovation = error[0] + noise * random.standard_normal(2)
        shown = np.zeros((4, 2, 9))  # of both drones
        shown[0, :, :2], shown[0, 1, :2] = innovation, noise * random.standard_normal(2)
        believed = 0.9 * believed + shown[0, :, :2]
        shown[1, 0, :2], shown[2, 0, 3:5], shown[2, 0, 6:8] = acceleration, velocity, acceleration
        shown[1, :, :2] -= fed * believed
        rows, none = np.zeros((2, 3)), np.zeros(2)
        yield Seen(shown[3, :, :6], shown[2], none, shown[0, :, :3], rows, none, rows, shown[1, :, :3])
        # the late drone has the acceleration of some time ago
        off = motion(t + h / 2 - late)[0] - motion(t + h / 2)[0] + push - drag * motion(t + h / 2 - late)[1]
        error = F @ (error - np.outer(observer, innovation)) + np.outer([h * h / 2.0, h, 0.0], off)
        if gust:
            push = kept * push + gust * np.sqrt(1.0 - kept * kept) * random.standard_normal(2)


def seen(late: float, noise: float, seed: int, fed: float = 0.0) -> Lateness:
    """Return the fit after `looks`."""
    assert FLYING is not None
    lateness = Lateness(FLYING.horizontal, 2)
    for look in looks(late, noise, seed, fed):
        lateness.note(look, np.array([True, True]))
    return lateness


@given(late=st.floats(-0.15, 0.15))
@settings(max_examples=15)
def test_only_a_lateness_outside_the_interval_is_one_and_a_large_one_always(late: float) -> None:
    lateness = seen(late, 0.0, 0)
    assert FLYING is not None
    axis = FLYING.horizontal
    own = axis.design.model.delay + axis.design.model.lead
    ends = axis.box.low.delay + axis.box.low.lag - own, axis.box.high.delay + axis.box.high.lag - own
    assert lateness.bound == pytest.approx((ends[1] - ends[0]) / 2.0)
    if ends[0] <= late <= ends[1]:
        assert lateness.excess[0] <= lateness.bound
    if late < ends[0] - 0.06 or late > ends[1] + 0.06:
        assert lateness.excess[0] > lateness.bound
    assert lateness.excess[1] == 0.0


def test_noise_is_no_lateness_and_hides_none_that_is_large() -> None:
    for seed in range(10):
        calm, late = (seen(s, 3e-4, seed) for s in (0.0, 0.12))
        assert calm.excess.max() <= calm.bound
        assert late.excess[0] > late.bound
        assert late.excess[1] == 0.0


def test_noise_that_the_commands_answer_to_makes_nobody_early() -> None:
    for seed in range(5):
        found = seen(0.0, 5e-4, seed, fed=12.0)
        assert found.excess.max() <= 0.2 * found.bound
    assert seen(0.12, 5e-4, 0, fed=12.0).excess[0] > 0.095


@pytest.mark.parametrize("drag", [-0.0456, 0.0456])
@pytest.mark.parametrize(
    ("late", "lasts"),
    [(-0.03, 15.0), (0.03, 15.0), *((late, lasts) for lasts in (7.0, 9.0, 11.0, 13.0) for late in (-0.02, 0.0, 0.02))],
)
def test_drag_inside_the_interval_makes_nobody_late_who_moves_slowly(late: float, drag: float, lasts: float) -> None:
    assert FLYING is not None
    lateness = Lateness(FLYING.horizontal, 2)
    for look in looks(late, 1e-4, 0, motion=partial(slow_eight, lasts=lasts), drag=drag):
        lateness.note(look, np.array([True, True]))
        assert lateness.excess.max() <= lateness.bound


def first_told(late: float, seed: int, gust: float) -> float:
    """Return when, s, a drone that goes to and fro is told to be late or early; inf: never."""
    assert FLYING is not None
    lateness = Lateness(FLYING.horizontal, 2)
    for number, look in enumerate(looks(late, 1e-4, seed, gust=gust, motion=to_and_fro), 1):
        lateness.note(look, np.array([True, True]))
        if lateness.excess[0] > lateness.bound:
            return number * PERIOD
    return np.inf


def test_gusts_that_change_faster_than_is_assumed_make_nobody_late_and_who_is_late_in_still_air_is_told_soon() -> None:
    for seed in range(16, 36):
        assert first_told(0.03, seed, 0.05) == np.inf, seed
    for late in (0.045, 0.055, -0.05):
        assert first_told(late, 0, 0.0) <= 5.0


@given(begin=st.integers(1, 100), length=st.integers(1, 60))
@settings(max_examples=10)
def test_who_was_not_steered_begins_anew_and_disturbs_nobody(begin: int, length: int) -> None:
    assert FLYING is not None
    both, other, late = (Lateness(FLYING.horizontal, 2) for _ in range(3))
    for tick, look in enumerate(looks(0.12, 3e-4, 1)):
        paused = begin <= tick < begin + length
        both.note(look, np.array([not paused, True]))
        other.note(look, np.array([True, True]))
        late.note(look, np.array([tick >= begin + length, False]))
    assert other.excess[0] > 0.0
    assert both.excess[1] == other.excess[1]
    assert both.excess[0] == pytest.approx(late.excess[0], abs=1e-12)
    assert both.excess[0] != other.excess[0]
