"""The pilot: set-point flight on the ideal drone, lost poses, garbage, and the clock set back."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.certificate.certificate import Certificate
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.pilot import Pilot
from flatsat_ros.flight.policy import GoalMode, Policy, YawSource
from flatsat_ros.flight.tick import Tick
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.flatness import acceleration_from_input
from flatsat_ros.law.gain import Tuning

CERTIFICATE = Certificate.load(Path(__file__).parents[2] / "config" / "paper_experiment.yaml")
LIMITS = CERTIFICATE.limits
POLICY = Policy(
    pose_timeout=0.3,
    level_time=0.5,
    unlock_time=0.3,
    level_thrust=0.95,
    goal_mode=GoalMode.STEP,
    walls=(-1e3, -1e3, 1e3, 1e3),
)
GOAL = [0.6, 0.6, 0.8]


def tuning(mu: float = 2.0) -> Tuning:
    return Tuning(mu, 0.05, 1.0, CERTIFICATE.gain_max)


def require_within_limits(tick: Tick) -> None:
    """Every command is finite and inside the limits of thrust, roll and pitch, whatever the mode."""
    assert np.isfinite(tick.input).all()
    assert np.isfinite(tick.yaw_rate).all()
    assert (tick.input[:, 0] >= 0.0).all()
    assert (tick.input[:, 0] <= LIMITS.thrust_max * (1.0 + 1e-12)).all()
    assert (np.abs(tick.input[:, 1:]) <= LIMITS.tilt_max * (1.0 + 1e-9)).all()
    assert (np.abs(tick.yaw_rate) <= 1.0).all()
    assert not tick.input[np.isin(tick.mode, [Mode.IDLE, Mode.UNLOCK, Mode.CUT])].any()


class World:
    """Ideal drones on a floor at z = 0 with motion capture at 100 Hz and the pilot at 10 Hz."""

    def __init__(
        self,
        count: int = 1,
        mu: float = 2.0,
        start: tuple[float, ...] = (-0.6, -0.6, 0.0),
        policy: Policy = POLICY,
    ) -> None:
        self.pilot = Pilot(CERTIFICATE, tuning(mu), policy, count)
        self.x = np.tile([*start, 0.0, 0.0, 0.0], (count, 1))
        self.yaw = np.zeros(count)
        self.blind = np.zeros(count, dtype=bool)
        self.held = self.unoriented = False
        self.missing = 0.0  # of the thrust, m/s^2
        self.steps = 0
        self.offset = 0.0
        self.ticks: list[Tick] = []

    @property
    def now(self) -> float:
        return self.offset + 0.01 * self.steps

    def fly(self, seconds: float) -> list[Tick]:
        """Let time pass; return its ticks."""
        ticks = []
        for _ in range(round(100 * seconds)):
            for i in np.flatnonzero(~self.blind):
                half = float(self.yaw[i]) / 2.0
                quaternion = (0.0, 0.0, math.sin(half), math.cos(half))
                if self.unoriented:
                    quaternion = (math.nan,) * 4
                self.pilot.measure(int(i), self.now, tuple(self.x[i, :3]), quaternion, self.now)
            if self.steps % 10 == 0:
                ticks.append(self.pilot.tick(self.now))
                require_within_limits(ticks[-1])
                self.v = acceleration_from_input(ticks[-1].input, self.yaw)
                self.v[ticks[-1].mode == Mode.IDLE] = 0.0  # somebody else holds it
                self.rate = ticks[-1].yaw_rate
            v = np.zeros_like(self.v) if self.held else self.v - (0.0, 0.0, self.missing)
            self.x[:, :3] += 0.01 * self.x[:, 3:] + 0.01**2 / 2.0 * v
            self.x[:, 3:] += 0.01 * v
            self.x[(self.x[:, 2] <= 0.0) & (self.x[:, 5] <= 0.0), 2:] *= 0.0
            self.yaw += 0.01 * self.rate
            self.steps += 1
        return ticks


def modes(ticks: list[Tick]) -> list[Mode]:
    """The modes of drone 0, repetitions removed."""
    sequence = [Mode(int(tick.mode[0])) for tick in ticks]
    return [mode for mode, before in zip(sequence, [None, *sequence], strict=False) if mode is not before]


def airborne(count: int = 1, policy: Policy = POLICY, yaw: float = 0.0) -> World:
    """Drones hovering at 1 m, with a yaw, rad."""
    world = World(count, start=(0.0, 0.0, 1.0), policy=policy)
    world.yaw[:] = yaw
    for i in range(count):
        world.pilot.set_reference(i, Trajectory.hold([0.0, 0.0, 1.0], yaw))
    world.fly(1.0)
    assert (world.pilot.mode == Mode.FLY).all()
    return world


@pytest.mark.parametrize("mu", [0.0, 1.0, 2.0])
def test_the_papers_set_point_flight_arrives(mu: float) -> None:
    world = World(mu=mu)
    assert modes(world.fly(0.5)) == [Mode.IDLE]
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    ticks = world.fly(12.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.FLY]
    assert np.linalg.norm(world.x[0, :3] - GOAL) < 0.01
    assert ticks[-1].output.lyapunov[0] < 0.05
    gains = [float(tick.output.gain[0]) for tick in ticks]
    assert all(b >= a for a, b in itertools.pairwise(gains))
    assert (gains[-1] > 2.0) == (mu > 0.0)


def test_a_drone_without_reference_or_without_poses_is_left_alone() -> None:
    world = World()
    assert modes(world.fly(1.0)) == [Mode.IDLE]
    world.blind[:] = True
    world.fly(1.0)
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(2.0)) == [Mode.IDLE]
    world.blind[:] = False
    assert modes(world.fly(1.0))[-1] is Mode.FLY


def test_a_drone_in_the_air_is_taken_over_without_a_motor_cut() -> None:
    world = World(start=(0.0, 0.0, 1.0))
    world.fly(0.3)
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
    assert modes(world.fly(0.5)) == [Mode.FLY]


@given(goal=st.floats(-math.pi, math.pi), start=st.floats(-math.pi, math.pi))
@settings(max_examples=20)
def test_a_yaw_angle_goes_the_shorter_way_and_leads_the_drone_by_a_limited_angle(goal: float, start: float) -> None:
    world = airborne(yaw=start)
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0], goal))
    for _ in range(40):
        (tick,) = world.fly(0.1)
        assert -math.pi <= tick.yaw[0] <= math.pi
        # the drone has turned on since the tick, by 0.1 rad at most
        lead = math.remainder(float(tick.yaw[0] - world.yaw[0]), 2.0 * math.pi)
        assert abs(lead) <= 2.0 / 3.0 + 0.1
        assert lead * float(tick.yaw_rate[0]) >= -1e-12
    assert math.cos(float(tick.yaw[0]) - goal) == pytest.approx(1.0, abs=1e-12)


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


def test_the_velocity_is_right_because_the_pilot_knows_its_own_commands() -> None:
    world = airborne()
    world.pilot.set_reference(0, Trajectory.hold([0.5, 0.0, 1.2]))
    world.blind[:] = True
    for _ in range(20):  # one pose in each tick is all there is
        world.pilot.measure(0, world.now, tuple(world.x[0, :3]), (0.0, 0.0, 0.0, 1.0), world.now)
        world.fly(0.1)
        np.testing.assert_allclose(world.pilot.estimator.estimate(world.now)[0, :6], world.x[0], rtol=0.0, atol=1e-3)
    sinking = world.fly(0.35)
    assert modes(sinking)[-1] is Mode.LEVEL
    world.pilot.measure(0, world.now, tuple(world.x[0, :3]), (0.0, 0.0, 0.0, 1.0), world.now)
    np.testing.assert_allclose(world.pilot.estimator.estimate(world.now)[0, :6], world.x[0], rtol=0.0, atol=1e-3)


def test_gains_rest_while_a_drone_is_not_flying_and_start_anew_after_a_cut() -> None:
    world = airborne()
    world.pilot.retune(Tuning(2.0, 0.05, 1.0, CERTIFICATE.gain_max, restart=False))
    world.pilot.set_reference(0, Trajectory.hold([0.8, 0.0, 1.0]))
    world.fly(2.0)
    gain = float(world.pilot.memory.gain[0])
    assert gain > 1.5
    world.blind[:] = True
    resting = [float(t.output.gain[0]) for t in world.fly(15.0) if t.mode[0] in (Mode.LEVEL, Mode.DESCEND)]
    assert len(set(resting)) == 1
    assert gain <= resting[0] < gain + 0.1
    world.blind[:] = False
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 0.1]))
    ticks = world.fly(0.7)
    assert next(tick.output.gain[0] for tick in ticks if tick.mode[0] == Mode.FLY) == 1.0


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


@pytest.mark.parametrize(("start", "goal"), [(0.0, 1.0), (0.0, -1.0), (3.0, -3.0), (-3.0, 3.0)])
def test_the_yaw_turns_the_shorter_way_while_the_position_is_held(start: float, goal: float) -> None:
    world = World(start=(0.0, 0.0, 1.0))
    world.yaw[:] = start
    world.fly(0.2)
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0], goal))
    world.fly(4.0)
    way = (goal - start + math.pi) % (2.0 * math.pi) - math.pi
    assert world.yaw[0] == pytest.approx(start + way, abs=0.02)
    assert np.linalg.norm(world.x[0, :3] - [0.0, 0.0, 1.0]) < 0.01


def test_a_reference_that_leaves_no_margin_is_refused_and_the_old_one_stays() -> None:
    world, zero = airborne(), np.zeros((2, 3))
    with pytest.raises(FlatsatError, match="fly it slower"):
        world.pilot.set_reference(0, Trajectory.through([0.0, 0.5], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], zero, zero))
    world.fly(2.0)
    assert np.linalg.norm(world.x[0, :3] - [0.0, 0.0, 1.0]) < 0.01


def test_a_new_tuning_acts_on_the_next_tick_and_a_bad_one_leaves_the_old() -> None:
    world = airborne(2)
    with pytest.raises(FlatsatError):
        world.pilot.retune(Tuning(1.0, 0.05, 1.0, 100.0))
    for i in range(2):
        world.pilot.set_reference(i, Trajectory.hold([0.8, 0.0, 1.0]))
    world.pilot.retune(Tuning([0.0, 5.0], 0.05, 1.0, CERTIFICATE.gain_max))
    world.fly(1.0)
    assert world.pilot.memory.gain[0] == 1.0
    assert world.pilot.memory.gain[1] > 1.5
    world.pilot.retune(Tuning(0.0, 0.05, 1.0, 1.2))
    assert world.pilot.memory.gain.tolist() == [1.0, 1.2]


@pytest.mark.parametrize("step", [-100.0, -1.0, 100.0])
def test_a_stepping_clock_levels_the_drone_for_a_moment_only(step: float) -> None:
    world = airborne()
    world.pilot.set_reference(0, Trajectory.through(*[[world.now + 1.0, world.now + 9.0]], *ROUTE))
    world.fly(3.0)
    world.offset += step
    ticks = world.fly(1.0)
    assert modes(ticks)[-1] is Mode.FLY
    assert len([tick for tick in ticks if tick.mode[0] != Mode.FLY]) <= 5


ROUTE = ([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], np.zeros((2, 3)), np.zeros((2, 3)))


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


def test_arming_on_the_ground_opens_the_thrust_lock_and_is_silent_again() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.arm(0, True)
    ticks = world.fly(1.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.IDLE]
    assert not np.array([tick.input for tick in ticks]).any()
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    assert modes(world.fly(1.0)) == [Mode.UNLOCK, Mode.FLY]


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
    assert modes(world.fly(12.0)) == [Mode.FLY]
    assert np.linalg.norm(world.x[0, :3] - GOAL) < 0.01


def test_a_take_off_is_given_up_if_nobody_takes_its_commands_for_seconds() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.note_link(0, False)
    world.pilot.take_off(0, 0.5)
    ticks = world.fly(7.0)
    assert modes(ticks) == [Mode.UNLOCK, Mode.IDLE]
    assert "nobody takes" in next(made.reason for tick in ticks for made in tick.transitions if made.after is Mode.IDLE)


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
    assert modes(world.fly(0.3))[-1] is Mode.UNLOCK
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


def test_a_tick_tells_every_transition_and_why() -> None:
    world = World()
    world.fly(0.5)
    world.pilot.set_reference(0, Trajectory.hold(GOAL))
    told = [t for tick in world.fly(3.0) for t in tick.transitions]
    world.pilot.hand_over(0)
    told += [t for tick in world.fly(0.2) for t in tick.transitions]
    assert [(t.drone, t.before, t.after) for t in told] == [
        (0, Mode.IDLE, Mode.UNLOCK), (0, Mode.UNLOCK, Mode.FLY), (0, Mode.FLY, Mode.IDLE),
    ]  # fmt: skip
    assert [t.reason for t in told] == [
        "a reference is there and the drone stands on the ground", "the thrust lock is open", "handed over",
    ]  # fmt: skip


def test_what_a_tick_has_given_never_changes_afterwards() -> None:
    world = airborne(2)
    tick = world.fly(0.1)[0]
    memory = world.pilot.memory
    kept = {name: np.array(getattr(tick, name)) for name in ("mode", "input", "yaw_rate", "yaw", "reference")}
    kept |= {"gain": memory.gain.copy(), "thrust_scale": tick.thrust_scale.copy()}
    world.blind[0] = True
    world.fly(4.0)
    world.blind[0] = False
    world.pilot.set_reference(0, Trajectory.hold([0.3, 0.0, 1.0], 1.0))
    world.fly(1.0)
    for name, value in kept.items():
        np.testing.assert_array_equal(memory.gain if name == "gain" else getattr(tick, name), value)


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
