"""Batteries: what lands a drone, what does not, and what keeps it on the ground, as laws and in flight."""

from __future__ import annotations

import math
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.crazyflie.vehicle import BatteryLimits
from flatsat_ros.flight.battery import HOLD, Batteries, Charge
from flatsat_ros.flight.clearance import Cause
from flatsat_ros.flight.modes import AIRBORNE, Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.tick import Tick
from flatsat_ros.law.flatness import acceleration_from_input
from flatsat_ros.law.gain import Tuning

CERTIFICATE = Certificate.load(Path(__file__).parents[2] / "config" / "paper_experiment.yaml")
LIMITS = BatteryLimits(low_voltage=3.2, critical_voltage=3.0)
GOOD, WEAK, EMPTY = 3.9, 3.25, 3.1
FULL = 4.2

# pauses, s, and readings, V, near the levels and at them
PAUSE = st.sampled_from([0.0, 0.01, 0.4, 1.0, 1.5, HOLD, 10.0]) | st.floats(0.0, 2.0 * HOLD)
READING = st.sampled_from([EMPTY, 3.2, 3.2000001, WEAK, 3.3, 3.3000001, GOOD]) | st.floats(2.9, FULL)
HISTORY = st.lists(st.tuples(PAUSE, READING), min_size=1, max_size=40)
ABSURD = st.sampled_from([math.nan, math.inf, -math.inf, -3.7, 0.0, 1.59, 6.61, 3700.0, 1e300])


def agreed(times: list[float], holds: list[bool]) -> bool:
    """Whether all of the newest readings hold, for as long as levels need."""
    since = len(holds)
    while since > 0 and holds[since - 1]:
        since -= 1
    return since < len(holds) and times[-1] - times[since] >= HOLD


@given(HISTORY)
@example([(0.0, 3.2), (1.0, 3.2), (1.0, 3.2), (1.0, 3.2)])
def test_a_level_is_reached_and_left_when_all_readings_of_the_hold_time_agree_and_never_else(
    history: list[tuple[float, float]],
) -> None:
    batteries, now = Batteries(2), 0.0
    times: list[float] = []
    readings: list[float] = []
    charge = Charge.GOOD
    for pause, voltage in history:
        now += pause
        times.append(now)
        readings.append(voltage)
        before = charge
        finding = batteries.measure(1, voltage, LIMITS, now)
        if agreed(times, [reading <= LIMITS.landing_voltage for reading in readings]):
            charge = Charge.EMPTY
        elif agreed(times, [reading > LIMITS.warning_voltage for reading in readings]):
            charge = Charge.GOOD
        elif agreed(times, [reading <= LIMITS.warning_voltage for reading in readings]):
            charge = max(charge, Charge.LOW)
        assert batteries.charges[1] is charge
        assert batteries.voltages[1] == voltage
        # told once, when it gets worse
        assert (finding is not None) == (charge > before)
        assert finding is None or finding.charge is charge
        # on the ground what counts is the newest reading, after a landing all of the hold time
        assert bool(batteries.refusal(1)) == (charge is Charge.EMPTY or voltage <= LIMITS.warning_voltage)
    assert batteries.charges[0] is Charge.GOOD
    assert math.isnan(batteries.voltages[0])


@given(HISTORY, st.lists(st.tuples(st.integers(0, 40), ABSURD), min_size=1, max_size=10))
def test_what_no_battery_has_is_told_of_once_and_changes_nothing(
    history: list[tuple[float, float]], absurd: list[tuple[int, float]]
) -> None:
    clean, damaged, told = Batteries(1), Batteries(1), []
    now = 0.0
    for number, (pause, voltage) in enumerate(history):
        for where, value in absurd:
            if where % len(history) == number:
                told.append(damaged.measure(0, value, LIMITS, now))
        now += pause
        assert damaged.measure(0, voltage, LIMITS, now) == clean.measure(0, voltage, LIMITS, now)
        assert damaged.charges == clean.charges
        assert damaged.refusal(0) == clean.refusal(0)
    first, *others = told
    assert first is not None
    assert first.charge is Charge.GOOD
    assert "V: must be from 1.6 to 6.6 V: such values are ignored" in first.text
    assert others == [None] * len(others)


class World:
    """Ideal drones, 2 m apart on a floor at z = 0, measured before each tick of their pilot.

    Attributes:
        seen: their poses arrive.
    """

    def __init__(self, count: int = 1) -> None:
        self.pilot = Pilot(CERTIFICATE, Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max), Policy(), count)
        self.state = np.zeros((count, 6))
        self.state[:, 0] = 2.0 * np.arange(count)
        self.now, self.seen = 0.0, True

    def fly(self, seconds: float) -> list[Tick]:
        """Let time pass; return its ticks."""
        ticks, h = [], CERTIFICATE.period
        for _ in range(round(seconds / h)):
            for drone, place in enumerate(self.state[:, :3].tolist() if self.seen else []):
                self.pilot.measure(drone, self.now, place, (0.0, 0.0, 0.0, 1.0), self.now)
            tick = self.pilot.tick(self.now)
            ticks.append(tick)
            v = acceleration_from_input(tick.input, np.zeros(len(self.state)))
            self.state[:, :3] += h * self.state[:, 3:] + h * h / 2.0 * v
            self.state[:, 3:] += h * v
            self.state[(self.state[:, 2] <= 0.0) & (self.state[:, 5] <= 0.0), 2:] *= 0.0
            self.now += h
        return ticks

    def feed(self, voltage: float, seconds: int) -> list[str]:
        """Let time pass while drone 0 reports its battery once a second; return what was told."""
        told = []
        for _ in range(seconds):
            self.pilot.note_battery(0, voltage, LIMITS, self.now)
            told += [report.text for tick in self.fly(1.0) for report in tick.reports]
        return told

    def hover(self) -> None:
        """Take all drones up to 1 m."""
        self.fly(0.5)
        for drone in range(len(self.state)):
            self.pilot.set_goal(drone, [2.0 * drone, 0.0, 1.0])
        self.fly(6.0)
        assert (self.pilot.mode == Mode.FLY).all()
        assert np.abs(self.state[:, 2] - 1.0).max() < 0.1


def test_a_drone_warns_then_lands_and_stays_down_until_its_battery_is_good_again() -> None:
    world = World(2)
    world.hover()
    assert not world.feed(GOOD, 4)
    assert world.feed(WEAK, 6) == ["battery = 3.25 V: at or below 3.3 V for 3 s: the drone lands at 3.2 V"]
    world.pilot.set_goal(0, [0.0, 0.0, 0.9])  # a warning is none but a warning
    assert world.feed(EMPTY, 2) == []
    assert world.feed(WEAK, 4) == [], "the sag of a burst"
    assert (world.pilot.mode == Mode.FLY).all()
    assert world.feed(EMPTY, 5) == ["battery = 3.10 V: at or below 3.2 V for 3 s: it brakes and lands"]
    for ask in (
        lambda: world.pilot.set_goal(0, [0.0, 0.0, 1.0]),
        lambda: world.pilot.hold(0),
    ):
        with pytest.raises(FlatsatError, match=r"battery = 3.10 V: must be above 3.3 V for 3 s"):
            ask()
    assert world.feed(EMPTY, 8) == []
    assert world.pilot.mode.tolist() == [Mode.IDLE, Mode.FLY]
    assert world.state[0, 2] == 0.0
    for voltage in (EMPTY, 3.3):
        world.feed(voltage, 4)
        with pytest.raises(FlatsatError, match=f"battery = {voltage:.2f} V: must be above 3.3 V"):
            world.pilot.take_off(0, 0.5)
    assert not world.feed(GOOD, 4)
    world.pilot.take_off(0, 0.5)
    world.feed(GOOD, 5)
    assert world.pilot.mode.tolist() == [Mode.FLY, Mode.FLY]
    assert abs(world.state[0, 2] - 0.5) < 0.1


def test_an_empty_battery_lands_a_drone_whose_goal_waits_for_another() -> None:
    world = World(2)
    world.hover()
    world.pilot.set_goal(0, [4.0, 0.0, 1.0])
    (told,) = world.feed(GOOD, 1)
    assert "its goal waits" in told
    assert world.feed(EMPTY, 5) == ["battery = 3.10 V: at or below 3.2 V for 3 s: it brakes and lands"]
    world.pilot.set_goal(1, [2.0, 3.0, 1.0])
    assert world.feed(EMPTY, 8) == [], "nor does it set out when the way is clear"
    assert world.pilot.mode.tolist() == [Mode.IDLE, Mode.FLY]
    assert world.state[0, :3] == pytest.approx([0.0, 0.0, 0.0], abs=0.05)


def test_messages_that_cease_change_nothing() -> None:
    world = World()
    world.hover()
    world.feed(EMPTY, 2)
    assert {mode for tick in world.fly(20.0) for mode in tick.mode} == {Mode.FLY}


def test_an_empty_battery_without_poses_lands_when_they_are_back() -> None:
    world = World()
    world.hover()
    world.feed(EMPTY, 3)
    world.seen = False
    world.fly(0.6)
    assert world.pilot.mode[0] == Mode.LEVEL
    world.pilot.note_battery(0, EMPTY, LIMITS, world.now)
    world.seen = True
    world.fly(8.0)
    assert world.pilot.mode[0] == Mode.IDLE
    assert world.state[0, 2] == 0.0


def test_an_empty_battery_on_the_ground_lets_a_waiting_goal_go() -> None:
    world = World()
    world.seen = False
    world.fly(0.5)
    world.pilot.set_goal(0, [0.0, 0.0, 1.0])
    told = world.feed(EMPTY, 4)
    assert told == [
        "its take-off is called off: battery = 3.10 V: must be above 3.3 V before the drone takes off",
        "battery = 3.10 V: at or below 3.2 V for 3 s: it does not take off",
    ]
    world.seen = True
    world.feed(GOOD, 8)
    assert world.pilot.mode[0] == Mode.IDLE, "motors start when somebody asks for it only"


@settings(max_examples=60)
@given(poses=st.integers(0, 15), barred=st.integers(0, 25), freed=st.integers(1, 30))
def test_no_motor_starts_while_something_keeps_the_drone_on_the_ground(poses: int, barred: int, freed: int) -> None:
    """Whenever it appears: before the goal, while that waits for poses, or in UNLOCK. Times in ticks."""
    world, ticks, refused = World(), [], False
    for number in range(60):
        if number in (barred, barred + freed):
            world.pilot.clearance.bar(0, Cause.RIVALS, "somebody else" if number == barred else "")
        if number == 2:
            refused = barred <= number < barred + freed
            with pytest.raises(FlatsatError, match=r"^somebody else$") if refused else nullcontext():
                world.pilot.set_goal(0, [0.0, 0.0, 1.0])
        world.seen = number >= poses
        ticks += world.fly(CERTIFICATE.period)
    during = [Mode(int(tick.mode[0])) for tick in ticks[max(barred - 1, 0) : barred + freed]]
    assert not [after for before, after in pairwise(during) if before not in AIRBORNE and after in AIRBORNE]
    told = [report.text for tick in ticks for report in tick.reports]
    flew = any(tick.mode[0] in AIRBORNE for tick in ticks)
    # it flew, it was refused, or it was called off and that was told
    assert told == ([] if flew or refused else ["its take-off is called off: somebody else"])
