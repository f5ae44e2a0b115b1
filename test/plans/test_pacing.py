"""At another pace a reference stays on its way, smoothly, and ends where it should."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet
from flatsat_ros.plans import Bounds, Curve
from flatsat_ros.plans.pacing import braked, change_duration, resumed

START, LENGTH = 100.0, 8.0
NANOMETRE = 1e-9
LIMITS = InputSet(thrust_max=100.0, tilt_max=1.2, gravity=40.0)  # room for wild references


@st.composite
def references(draw: st.DrawFn) -> Trajectory:
    """Ten seconds and more through random places about a metre apart."""
    steps = st.lists(st.tuples(*[st.floats(-0.3, 0.3)] * 3), min_size=21, max_size=21)
    points = np.cumsum(np.array(draw(steps)), axis=0)
    points[1:4], points[-4:] = points[0], points[-1]
    return Curve.rounded([round(1e6 * LENGTH * i / 16) for i in range(17)], points).trajectory(0.3).shifted(START)


def law(begin: float, duration: float, times: FloatArray) -> FloatArray:
    """The progress while it slows down, computed as an integral of the pace."""
    u = np.linspace(0.0, 1.0, 20001)
    pace = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    area = np.concatenate([[0.0], np.cumsum((pace[1:] + pace[:-1]) / 2.0 * np.diff(u))])
    shares = np.clip((times - begin) / duration, 0.0, 1.0)
    return np.asarray(np.minimum(times, begin) + duration * np.interp(shares, u, area))


@given(references(), st.floats(-1.0, LENGTH + 1.0), st.floats(1.0, 4.0))
@settings(max_examples=25)
def test_a_braked_reference_stays_on_its_way(reference: Trajectory, at: float, duration: float) -> None:
    begin = START + at
    slowed = braked(reference, begin, duration)
    assert slowed.yaw == reference.yaw
    times = np.linspace(begin - 2.0, begin + duration + 1.0, 101)
    on_the_way = [reference.sample(progress)[:3] for progress in law(begin, duration, times)]
    assert_allclose([slowed.sample(time)[:3] for time in times], on_the_way, rtol=1e-6, atol=5 * NANOMETRE)
    assert slowed.end == pytest.approx(reference.sample(begin + duration / 2.0)[:3], abs=NANOMETRE)


@given(references(), st.floats(0.0, 2.0), st.floats(1.0, 4.0))
@settings(max_examples=10)
def test_a_reference_that_has_ended_stays_there_when_it_is_braked(
    reference: Trajectory, late: float, duration: float
) -> None:
    begin = START + LENGTH + late
    slowed = braked(reference, begin, duration)
    for time in (*slowed.times, *np.linspace(START, begin + duration + 1.0, 200)):
        assert slowed.sample(time) == pytest.approx(reference.sample(time), abs=NANOMETRE)


@given(references(), st.floats(-1.0, LENGTH + 1.0), st.floats(1.0, 4.0), st.floats(0.0, 50.0))
@settings(max_examples=25)
def test_a_resumed_reference_goes_on_as_if_it_had_begun_later(
    reference: Trajectory, at: float, duration: float, pause: float
) -> None:
    stands, begin = START + at, START + at + pause
    going = resumed(reference, stands, begin, duration)
    assert going.sample(begin - 1.0)[:3] == pytest.approx(reference.sample(stands)[:3], abs=NANOMETRE)
    assert not going.sample(begin)[3:].any()
    delay = begin + duration - (stands + duration / 2.0)
    times = np.linspace(begin + duration, START + LENGTH + delay + 1.0, 50)
    later = [reference.sample(time - delay) for time in times]
    assert_allclose([going.sample(time) for time in times], later, rtol=5e-7, atol=5e-9)
    assert going.end == pytest.approx(reference.end, abs=NANOMETRE)


@given(references(), st.floats(0.0, LENGTH))
@settings(max_examples=25)
def test_nothing_jumps_up_to_the_jerk(reference: Trajectory, at: float) -> None:
    begin, duration = START + at, 2.0
    snap = 1.0 + 60.0 * reference.demand().max()  # loose: it shall only not be infinite
    for changed in (braked(reference, begin, duration), resumed(reference, begin, begin, duration)):
        for time in changed.times:
            before, after = changed.sample(time - 1e-7), changed.sample(time + 1e-7)
            assert before == pytest.approx(after, abs=1e-5)
            assert changed.jerk(time - 1e-7) == pytest.approx(changed.jerk(time + 1e-7), abs=1e-4 + 2e-7 * snap)


@pytest.mark.parametrize("stops", [True, False])
@given(reference=references())
@settings(max_examples=5)
def test_a_change_asks_for_hardly_more_than_the_bounds_where_that_can_be_had(
    stops: bool, reference: Trajectory
) -> None:
    def asked(path: Trajectory, times: FloatArray) -> FloatArray:
        values = np.array([np.append(path.sample(t)[3:], path.jerk(t)) for t in times]).reshape(-1, 3, 3)
        v, a, j = values.transpose(1, 0, 2)
        f = a + 0.4 * v + 0.1 * (j + 0.4 * a)
        return np.array([np.linalg.norm(a, axis=1).max(), np.linalg.norm(j, axis=1).max(), -LIMITS.margin(f).min()])

    still = np.linspace(START, START + LENGTH, 200)
    acceleration, jerk, margin = asked(reference, still)
    margin = LIMITS.inner_radius + margin
    wide = {"lower": np.full(3, -90.0), "upper": np.full(3, 90.0), "drag": (0.4, 0.4), "lead": (0.1, 0.1)}
    most = np.maximum([acceleration, jerk, 1.01 * margin], 0.1)
    bounds = Bounds(LIMITS.inner_radius - most[2], most[1], 1e4, acceleration_max=most[0], **wide)
    duration = change_duration([reference], bounds, LIMITS, stops=stops)
    worst = np.zeros(3)
    for begin in np.linspace(START, START + LENGTH, 9):
        changed = braked(reference, begin, duration) if stops else resumed(reference, begin, begin, duration)
        found = asked(changed, begin + np.linspace(0.0, duration, 60))
        worst = np.maximum(worst, found + [0.0, 0.0, LIMITS.inner_radius])
    assert (worst <= 1.13 * most).all() or duration == (6.0 if stops else 12.0)


def test_who_goes_slowly_stops_soon() -> None:
    points = np.linspace(0.0, 1.0, 21)[:, np.newaxis] * np.array([2.0, 0.0, 0.0])
    points[1:4], points[-4:] = points[0], points[-1]
    slow = Curve.rounded([round(1e6 * 20 * i / 16) for i in range(17)], points).trajectory()
    bounds = Bounds(0.5, 2.0, 20.0, np.full(3, -9.0), np.full(3, 9.0), acceleration_max=1.0, drag=(0.4, 0.4))
    for stops in (True, False):
        assert change_duration([slow], bounds, LIMITS, stops=stops) < 2.0
