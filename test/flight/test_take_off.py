"""The pilot from arming to lift-off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pilot_world import CERTIFICATE, GOAL, POLICY, World, airborne, modes

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.policy import Policy
from flatsat_ros.flight.trajectory import Trajectory


def test_arming_on_the_ground_opens_the_thrust_lock_and_is_silent_again() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.arm(0, True)
    ticks = world.fly(1.5)
    assert modes(ticks) == [Mode.UNLOCK, Mode.IDLE]
    assert not np.array([tick.input for tick in ticks]).any()
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(1.5)) == [Mode.UNLOCK, Mode.FLY]


def test_arming_never_commands_a_drone_in_the_air_or_one_that_is_not_seen() -> None:
    world = World(start=(0.0, 0.0, 1.0))
    world.fly(0.5)
    world.pilot.arm(0, True)
    assert not world.pilot.is_opening(0)
    assert modes(world.fly(1.0)) == [Mode.IDLE]
    unseen = World()
    unseen.blind[:] = True
    unseen.pilot.arm(0, True)
    assert not unseen.pilot.is_opening(0)
    assert modes(unseen.fly(1.0)) == [Mode.IDLE]
    unseen.blind[:] = False
    assert modes(unseen.fly(1.0)) == [Mode.IDLE]


@pytest.mark.parametrize("height", [0.0, 1.0])
def test_an_arming_that_loses_its_poses_is_forgotten_before_somebody_else_flies_the_drone(height: float) -> None:
    world = World()
    world.fly(0.5)
    world.blind[:] = True
    world.fly(0.3)
    world.pilot.arm(0, True)
    assert world.pilot.is_opening(0)
    assert modes(world.fly(2.0)) == [Mode.IDLE]
    world.x[0, 2] = height
    world.blind[:] = False
    assert modes(world.fly(2.0)) == [Mode.IDLE]


def test_arming_twice_opens_the_lock_as_long_as_once() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.arm(0, True)
    once = world.fly(0.2)
    world.pilot.arm(0, True)
    again = world.fly(1.0)
    assert sum(tick.mode[0] == Mode.UNLOCK for tick in once + again) >= POLICY.unlock_time / CERTIFICATE.period


def test_a_drone_that_somebody_else_flies_is_not_disarmed() -> None:
    world = airborne()
    world.pilot.hand_over(0)
    assert modes(world.fly(1.0)) == [Mode.IDLE]
    with pytest.raises(FlatsatError, match=r"z = 1\.00 m, flown by somebody else"):
        world.pilot.arm(0, False)


def test_disarming_withdraws_a_goal() -> None:
    world = World()
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    world.pilot.arm(0, False)
    world.pilot.arm(0, True)
    assert Mode.FLY not in modes(world.fly(2.0))


def test_a_take_off_whose_poses_pause_is_carried_out() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.take_off(0, 0.5)
    world.fly(0.2)
    world.blind[:] = True
    world.fly(0.6)
    world.blind[:] = False
    assert modes(world.fly(12.0)) == [Mode.UNLOCK, Mode.FLY]
    assert abs(world.x[0, 2] - 0.5) < 0.02


def test_a_drone_that_moves_in_the_air_does_not_take_off_by_service() -> None:
    world = World(start=(0.0, 0.0, 5.0))
    world.x[0, 5], world.held = -0.5, True  # somebody else flies it
    world.fly(2.0)
    with pytest.raises(FlatsatError, match=r"in IDLE at z = 4\.\d+ m: only one on the ground takes off"):
        world.pilot.take_off(0, 0.5)


@pytest.mark.parametrize("by_goal", [True, False])
def test_a_goal_and_a_take_off_while_the_lock_opens_are_flown(by_goal: bool) -> None:
    world = World()
    world.fly(0.5)
    world.pilot.arm(0, True)
    world.fly(0.2)
    if by_goal:
        world.pilot.set_reference(0, Trajectory.hold(GOAL))
    else:
        world.pilot.take_off(0, 0.5)
    assert modes(world.fly(1.0)) == [Mode.UNLOCK, Mode.FLY]


def test_a_drone_that_does_not_lift_off_has_fallen_and_flies_again_only_when_a_person_armed_it() -> None:
    world = World()
    world.held = True
    world.fly(0.5)
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    ticks = world.fly(25.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY, Mode.DESCEND, Mode.FALLEN]
    assert max(float(tick.output.gain[0]) for tick in ticks) > 2.0
    assert ticks[-1].output.gain[0] == 1.0
    assert modes(world.fly(3.0)) == [Mode.FALLEN]
    world.held = False
    with pytest.raises(FlatsatError, match=r"has fallen.*arm it again"):
        world.pilot.set_reference(0, Trajectory.hold(GOAL))
    with pytest.raises(FlatsatError, match=r"has fallen.*arm it again"):
        world.pilot.take_off(0, 0.5)
    assert modes(world.fly(3.0)) == [Mode.FALLEN]
    world.pilot.arm(0, True)
    assert modes(world.fly(1.0)) == [Mode.IDLE]
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    ticks = world.fly(12.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY]
    assert next(tick for tick in ticks if tick.mode[0] == Mode.FLY).output.gain[0] < 1.5
    assert np.linalg.norm(world.x[0, :3] - GOAL) < 0.01


def test_a_drone_whose_commands_nobody_takes_waits_with_its_take_off() -> None:
    world = World()
    world.held = True
    world.fly(0.5)
    world.pilot.note_link(0, False)
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(4.0)) == [Mode.UNLOCK]
    world.pilot.note_link(0, True)
    world.held = False
    ticks = world.fly(12.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY]
    assert np.linalg.norm(world.x[0, :3] - GOAL) < 0.01
    assert sum(tick.mode[0] == Mode.UNLOCK for tick in ticks) == 10, "what nobody took opens no lock"


@pytest.mark.parametrize("armed", [False, True])
def test_a_drone_whose_commands_are_taken_now_and_then_gets_enough_zeros_in_a_row(armed: bool) -> None:
    world = World()
    world.fly(0.5)
    world.pilot.note_link(0, False)
    if armed:
        world.pilot.arm(0, True)
    else:
        world.pilot.take_off(0, 0.5)
    world.fly(0.5)
    for _ in range(3):
        world.pilot.note_link(0, True)
        assert modes(world.fly(9 * CERTIFICATE.period)) == [Mode.UNLOCK]
        world.pilot.note_link(0, False)
        assert modes(world.fly(0.1)) == [Mode.UNLOCK]
    world.pilot.note_link(0, True)
    assert modes(world.fly(1.5)) == [Mode.UNLOCK, Mode.IDLE if armed else Mode.FLY]


def test_a_drone_that_is_armed_while_nobody_takes_its_commands_is_not_called_unlocked() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.note_link(0, False)
    world.pilot.arm(0, True)
    ticks = world.fly(7.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.IDLE]
    assert "nobody takes" in next(made.reason for tick in ticks for made in tick.transitions if made.after is Mode.IDLE)


@pytest.mark.parametrize("unlock_time", [0.01, 0.3])
def test_a_slow_controller_sends_ten_zeros_before_it_takes_off(unlock_time: float) -> None:
    world = World(policy=replace(POLICY, unlock_time=unlock_time))
    world.fly(0.5)
    world.pilot.take_off(0, 0.5)
    ticks = world.fly(3.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY]
    # of 20 % lost packets, one take-off in ten million
    assert sum(tick.mode[0] == Mode.UNLOCK for tick in ticks) >= 10


def test_a_take_off_is_given_up_if_nobody_takes_its_commands_for_seconds() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.note_link(0, False)
    world.pilot.take_off(0, 0.5)
    ticks = world.fly(7.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.IDLE]
    assert "nobody takes" in next(made.reason for tick in ticks for made in tick.transitions if made.after is Mode.IDLE)


def test_a_goal_that_is_given_up_since_nobody_takes_commands_is_not_flown_to_when_somebody_does() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.note_link(0, False)
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(20.0)) == [Mode.UNLOCK, Mode.IDLE]
    world.pilot.note_link(0, True)
    assert modes(world.fly(3.0)) == [Mode.IDLE], "motors start when somebody asks for it only"
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(3.0)) == [Mode.UNLOCK, Mode.FLY]


@pytest.mark.parametrize("by_goal", [True, False])
def test_a_drone_that_is_told_to_land_while_its_lock_opens_does_not_take_off(by_goal: bool) -> None:
    world = World()
    world.fly(0.5)
    if by_goal:
        world.pilot.set_reference(0, Trajectory.hold(GOAL))
    else:
        world.pilot.take_off(0, 0.5)
    assert modes(world.fly(0.2)) == [Mode.UNLOCK]
    world.pilot.land(0)
    assert modes(world.fly(3.0)) == [Mode.IDLE]
    world.pilot.take_off(0, 0.5)
    assert modes(world.fly(3.0)) == [Mode.UNLOCK, Mode.FLY]


def test_a_drone_whose_lock_opens_for_others_is_not_told_to_land() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.arm(0, True)
    world.fly(0.1)
    with pytest.raises(FlatsatError, match="in UNLOCK: only one in FLY or LEVEL or DESCEND can land"):
        world.pilot.land(0)
    assert modes(world.fly(1.5)) == [Mode.UNLOCK, Mode.IDLE]


def test_a_drone_that_rests_on_the_ground_by_its_goal_is_not_cut() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.set_reference(0, Trajectory.hold([-0.6, -0.6, 0.0]))
    assert modes(world.fly(10.0)) == [Mode.UNLOCK, Mode.FLY]


@pytest.mark.parametrize(
    ("begin", "carried"), [((0.0, 0.0, 1.0), False), ((1.0, 0.0, 0.0), False), ((0.0, 0.0, 0.3), True)]
)
def test_a_drone_on_the_ground_whose_trajectory_begins_elsewhere_does_not_stay_there_with_its_motors_on(
    begin: tuple[float, float, float], carried: bool
) -> None:
    world = World(start=(0.0, 0.0, 0.0), policy=Policy())
    world.fly(0.5)
    rest = np.zeros((2, 3))
    there = np.array(begin) + [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]
    world.pilot.set_reference(0, Trajectory.through(np.array([2.0, 6.0]), there, rest, rest))
    ticks = world.fly(15.0)
    told = [report.text for tick in ticks for report in tick.reports if "trajectory" in report.text]
    assert told == ([] if carried else ["its trajectory is 1.00 m away: it does not take off"])
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY] + ([] if carried else [Mode.REST, Mode.IDLE])


@pytest.mark.parametrize("goal", [0.7, 2.0])
def test_a_drone_that_was_unlocked_high_up_and_is_off_its_place_is_never_cut(goal: float) -> None:
    world = airborne()
    world.blind[:] = True
    assert modes(world.fly(15.0))[-1] is Mode.CUT
    world.x[0], world.held = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0), True  # in somebody's hand
    world.blind[:] = False
    assert modes(world.fly(1.0))[-1] is Mode.CUT
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, goal]))
    assert modes(world.fly(1.0))[-1] is Mode.UNLOCK
    world.held = False
    world.missing = 0.7  # m/s^2: it asks for more all the time
    ticks = world.fly(15.0)
    assert max(float(tick.output.acceleration[0, 2]) for tick in ticks[-50:]) > 0.5
    assert modes(ticks[1:]) == [Mode.FLY]


def test_of_many_drones_that_take_off_at_once_a_few_set_out_at_each_tick() -> None:
    world = World(11)
    world.fly(0.5)
    for index in range(11):
        world.x[index, 1] = index
    world.fly(0.5)
    for index in range(11):
        world.pilot.take_off(index, 0.5)
    flying = [int((tick.mode == Mode.FLY).sum()) for tick in world.fly(5.0)]
    begun = [after - before for before, after in zip([0, *flying], flying, strict=False) if after != before]
    assert begun == [4, 4, 3]
    assert (np.abs(world.x[:, 2] - 0.5) < 0.05).all()


def test_a_drone_that_has_lifted_off_is_never_cut_however_long_it_asks_for_more() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.set_reference(0, Trajectory.hold([-0.6, -0.6, 1.0]))
    world.missing = 0.7
    ticks = world.fly(20.0)
    assert max(float(tick.output.acceleration[0, 2]) for tick in ticks[-50:]) > 0.5
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY]
