"""Stamps on steady time: whoever sets a clock changes nothing about when a pose was measured."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.base.constants import NANOSECONDS
from flatsat_ros.flight.stamps import StampClock

PERIOD = 10_000_000  # ns, of the looks
DELAY = 8_000_000  # ns, from a measurement to its look
EPOCH = 1_700_000_000 * NANOSECONDS


class World:
    """Two machines' clocks beside steady time, ns: ours, and that of a source."""

    def __init__(self, here: int = EPOCH, there: int = EPOCH) -> None:
        self.steady, self.here, self.there = 5 * NANOSECONDS, here, there
        self.clock = StampClock(2, lambda: self.here and self.here + self.steady, lambda: self.steady)
        self.begin = self.steady
        self.jumps: list[float] = []

    def step(self, nanoseconds: int = PERIOD) -> None:
        self.steady += nanoseconds
        self.jumps.append(self.clock.look())

    def error(self, source: int = 0, delay: int = DELAY) -> float:
        """How wrong the time is that a pose measured a moment ago gets, s."""
        stamp = self.there + self.steady - delay
        return self.clock.measured(source, stamp) - (self.steady - delay - self.begin) / NANOSECONDS


def test_a_stamp_of_our_clock_is_as_old_as_it_is() -> None:
    world = World()
    for _ in range(100):
        world.step()
        assert world.error() == pytest.approx(0.0, abs=1e-9)
    assert world.clock.now == pytest.approx(1.0)
    assert not any(world.jumps)
    assert world.clock.origin() == EPOCH + world.begin


# s; a smaller step is followed in half a second, as drift
SETS = st.floats(-1e5, 1e5).filter(lambda s: abs(s) > 0.06)


@given(SETS, st.integers(0, 300_000_000), st.booleans())
def test_a_clock_that_is_set_moves_no_pose_whether_its_source_follows_or_not(
    seconds: float, delay: int, along: bool
) -> None:
    world = World()
    for _ in range(50):
        world.step()
        world.error(delay=delay)
    world.here += round(seconds * NANOSECONDS)
    world.step()
    assert world.jumps[-1] == pytest.approx(seconds)
    assert world.error(delay=delay) == pytest.approx(0.0, abs=1e-6), "stamped before the jump, or on another machine"
    if along:
        world.there = world.here
    for _ in range(20):
        assert world.error(delay=delay) == pytest.approx(0.0, abs=1e-6)
        world.step()
    assert world.jumps.count(0.0) == len(world.jumps) - 1


@given(st.lists(SETS, min_size=2, max_size=5))
def test_it_may_be_set_again_and_again(sets: list[float]) -> None:
    world = World()
    for number, seconds in enumerate(sets):
        for _ in range(50):
            world.step()
            assert abs(world.error()) < 1e-6
        world.here += round(seconds * NANOSECONDS)
        world.there = world.here if number % 2 else world.there


def test_each_source_is_judged_by_itself() -> None:
    world = World()
    for _ in range(50):
        world.step()
        world.error(0)
        world.error(1)
    world.here += 60 * NANOSECONDS
    world.step()
    assert world.error(0) == pytest.approx(0.0, abs=1e-6)
    world.there = world.here
    assert world.error(1) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("rate", [-5e-4, 5e-4])
def test_a_clock_that_is_slewed_is_followed(rate: float) -> None:
    world = World()
    for _ in range(10_000):
        world.here += round(rate * PERIOD)
        world.there = world.here
        world.step()
        assert abs(world.error()) < 1e-3
    assert not any(world.jumps)


def test_a_small_step_is_followed_within_a_few_seconds() -> None:
    world = World()
    world.step()
    world.here = world.there = world.here + 40_000_000
    for _ in range(300):
        world.step()
    assert not any(world.jumps)
    assert abs(world.error()) < 1e-3


def test_a_simulation_whose_time_comes_late_is_no_jump() -> None:
    world = World(here=0)
    for _ in range(10):
        world.step()
    world.here = world.there = 100 * NANOSECONDS
    world.step()
    assert not any(world.jumps)
    assert world.error() == pytest.approx(0.0, abs=1e-9)


def test_a_stamp_of_a_foreign_clock_stays_wrong_by_as_much() -> None:
    world = World(there=EPOCH + 60 * NANOSECONDS)
    world.step()
    assert world.error() == pytest.approx(60.0)
    assert math.isfinite(world.clock.measured(0, 2**62))
