"""The pilot where poses, orientations or ticks are missing, are garbage, or come while the clock is set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pilot_world import CERTIFICATE, GOAL, POLICY, World, airborne, modes, require_within_limits, tuning

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import Policy, YawSource
from flatsat_ros.flight.trajectory import Trajectory

ROUTE = ([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], np.zeros((2, 3)), np.zeros((2, 3)))


def test_a_drone_without_reference_or_without_poses_is_left_alone() -> None:
    world = World()
    assert modes(world.fly(1.0)) == [Mode.IDLE]
    world.blind[:] = True
    world.fly(1.0)
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(2.0)) == [Mode.IDLE]
    world.blind[:] = False
    assert modes(world.fly(1.5))[-1] is Mode.FLY


def test_a_drone_whose_orientation_is_not_seen_is_not_turned_and_lands_unless_its_yaw_is_assumed() -> None:
    for source in YawSource:
        world = airborne(policy=replace(POLICY, yaw_source=source))
        world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0], 2.0))
        world.fly(0.3)
        world.unoriented = True
        ticks = world.fly(2.5)
        assert all(tick.yaw_rate[0] == 0.0 for tick in ticks[7:])
        assert {float(tick.yaw[0]) for tick in ticks[7:]} == {float(ticks[7].yaw[0])}
        assert abs(world.x[0, 2] - 1.0) < 0.05
        ticks += world.fly(9.0)
        lands = source is YawSource.MEASURED
        assert (modes(ticks)[-1] in (Mode.REST, Mode.IDLE)) is lands
        told = [report.text for tick in ticks for report in tick.reports]
        assert ("its orientation is not seen and yaw_source is measured: it lands" in told) is lands


def test_level_without_poses_a_drone_keeps_its_heading() -> None:
    world = airborne()
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0], 1.0))
    heading = world.fly(4.0)[-1].yaw[0]
    assert heading == pytest.approx(1.0)
    world.blind[:] = True
    ticks = world.fly(2.0)
    assert ticks[-1].mode[0] == Mode.DESCEND
    assert {float(tick.yaw[0]) for tick in ticks[-10:]} == {float(ticks[0].yaw[0])}


@pytest.mark.parametrize("known", [False, True])
def test_without_poses_it_sinks_level_until_it_is_down_and_only_a_new_reference_flies_again(known: bool) -> None:
    world = airborne()
    world.fly(6.0 if known else 0.0)
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0], yaw=2.0))
    world.blind[:] = True
    ticks, speed = [], 0.0
    for _ in range(80):
        height, climb = world.x[0, [2, 5]]
        ticks += world.fly(0.1)
        speed = max(speed, -float(climb)) if height > 0.05 else speed
    assert modes(ticks) == [Mode.FLY, Mode.LEVEL, Mode.DESCEND, Mode.CUT]
    assert sum(tick.mode[0] == Mode.LEVEL for tick in ticks) == 5
    assert world.x[0, 2] == 0.0
    assert speed < (0.6 if known else 1.05)
    for tick in ticks:
        if tick.mode[0] in (Mode.LEVEL, Mode.DESCEND):
            assert tick.input[0, 1:].tolist() == [0.0, 0.0]
            assert tick.yaw_rate[0] == 0.0
            assert known or tick.input[0, 0] == 0.95 * GRAVITY
    world.blind[:] = False
    assert modes(world.fly(2.0)) == [Mode.CUT]
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
    assert modes(world.fly(6.0)) == [Mode.UNLOCK, Mode.FLY]
    assert abs(world.x[0, 2] - 1.0) < 0.05


def test_poses_that_come_back_in_time_let_it_fly_on() -> None:
    world = airborne()
    world.blind[:] = True
    assert modes(world.fly(0.7)) == [Mode.FLY, Mode.LEVEL]
    world.blind[:] = False
    assert modes(world.fly(6.0)) == [Mode.LEVEL, Mode.FLY]
    assert np.linalg.norm(world.x[0, :3] - [0.0, 0.0, 1.0]) < 0.05


def test_one_drone_in_trouble_does_not_disturb_the_others() -> None:
    alone, both = airborne(1), airborne(2)
    for world in (alone, both):
        world.pilot.set_reference(0, Trajectory.hold([0.5, 0.0, 1.2]))
    both.blind[1] = True
    for a, b in zip(alone.fly(5.0), both.fly(5.0), strict=True):
        np.testing.assert_allclose(a.input[0], b.input[0], rtol=1e-9, atol=1e-12)
        assert a.mode[0] == b.mode[0]
    assert both.pilot.mode.tolist() == [Mode.FLY, Mode.CUT]
    assert both.pilot.last_command(0) == (0.95 * GRAVITY, 0.0, 0.0, 0.0, 0.0)
    assert both.pilot.last_command(1) == (0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("step", [-100.0, -1.0, 100.0])
def test_a_stepping_clock_levels_the_drone_for_a_moment_only(step: float) -> None:
    world = airborne()
    world.pilot.set_reference(0, Trajectory.through(*[[world.now + 1.0, world.now + 9.0]], *ROUTE))
    world.fly(3.0)
    world.offset += step
    ticks = world.fly(1.0)
    assert modes(ticks)[-1] is Mode.FLY
    assert len([tick for tick in ticks if tick.mode[0] != Mode.FLY]) <= 5


def test_without_poses_a_clock_set_back_does_not_prolong_the_level_descent() -> None:
    world = airborne()
    world.blind[:] = True
    world.fly(0.6)
    assert world.pilot.mode[0] == Mode.LEVEL
    world.offset -= 1000.0
    world.fly(0.6)
    assert world.pilot.mode[0] == Mode.DESCEND
    world.fly(20.0)
    assert world.pilot.mode[0] == Mode.CUT


anything = st.one_of(st.floats(-3.0, 3.0), st.floats())
garbage = st.tuples(
    st.integers(0, 1),  # drone
    st.one_of(st.floats(0.0, 0.2), st.floats(-5.0, 5.0)),  # how far the clock moves
    st.one_of(st.just(0.0), st.floats(-0.2, 0.2), st.floats()),  # how far the stamp is off
    st.tuples(anything, anything, anything),
    st.tuples(anything, anything, anything, anything),
)


@settings(max_examples=60)
@given(stream=st.lists(garbage, min_size=1, max_size=40))
def test_no_garbage_makes_a_command_beyond_the_limits(stream: list[tuple]) -> None:
    world = airborne(2)
    now = world.now
    for index, move, late, position, quaternion in stream:
        now += move
        world.pilot.measure(index, now + late, position, quaternion, now)
        tick = world.pilot.tick(now)
        require_within_limits(tick)
        assert (tick.output.gain <= CERTIFICATE.gain_max).all()
        fresh = now - world.pilot.estimator.newest <= POLICY.pose_timeout
        assert fresh[tick.mode == Mode.FLY].all()


@pytest.mark.parametrize("by_goal", [True, False])
def test_poses_that_come_back_start_a_drone_that_has_a_goal_but_no_take_off_of_before(by_goal: bool) -> None:
    world = World()
    world.pilot = Pilot(CERTIFICATE, tuning(), Policy(unlock_time=1.0), 1)
    world.fly(0.5)
    if by_goal:
        world.pilot.set_reference(0, Trajectory.hold(GOAL))
    else:
        world.pilot.take_off(0, 0.5)
    assert modes(world.fly(0.2))[-1] is Mode.UNLOCK
    world.blind[:] = True
    assert modes(world.fly(5.0)) == [Mode.UNLOCK], "a pause of the poses does not end it"
    told = [t.reason for tick in world.fly(3.0) for t in tick.transitions]
    assert told == ["the take-off is given up: no usable pose"]
    world.blind[:] = False
    assert (Mode.FLY in modes(world.fly(3.0))) == by_goal


def test_an_estimated_thrust_never_makes_a_blind_drone_climb() -> None:
    pilot = Pilot(CERTIFICATE, tuning(), Policy(thrust_error_max=0.5, disturbance_max=0.8), 1)
    world = World()
    world.pilot = pilot
    world.fly(0.5)
    pilot.set_reference(0, Trajectory.hold([-0.6, -0.6, 1.0]))
    world.missing = 3.0
    ticks = world.fly(20.0)
    assert ticks[-1].thrust_scale[0] < 0.9
    world.blind[:] = True
    z = float(world.x[0, 2])
    ticks = world.fly(2.0)
    assert ticks[-1].mode[0] == Mode.DESCEND
    assert world.x[0, 2] < z


@pytest.mark.parametrize(("pause", "told"), [(0.1, False), (0.19, False), (0.25, True), (1.0, True)])
def test_a_pause_of_the_ticks_is_told_of_the_drones_in_the_air(pause: float, told: bool) -> None:
    pilot = Pilot(CERTIFICATE, tuning(), POLICY, 2)
    tick = None
    for step in range(20):
        now = 0.1 * step + (pause - 0.1) * (step == 19)
        pilot.measure(0, now, [0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0], now)
        if step == 5:
            pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
        assert tick is None or not any("no tick for" in report.text for report in tick.reports)
        tick = pilot.tick(now)
    found = [report for report in tick.reports if "no tick for" in report.text]
    assert [report.drone for report in found] == [0] * told
    assert all(f"no tick for {pause:.2f} s" in report.text for report in found)
