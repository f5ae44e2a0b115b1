"""The pilot: set-point flight on the ideal drone."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pilot_world import CERTIFICATE, GOAL, World, airborne, modes

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.gain import Tuning


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


def test_whatever_is_told_of_a_drone_is_counted_in_the_telemetry_of_its_tick() -> None:
    world = World()
    ticks = world.fly(0.5)
    world.pilot.set_reference(0, Trajectory.hold([0.0, 0.0, 1.0]))
    ticks += world.fly(6.0)
    world.blind[:] = True
    ticks += world.fly(8.0)
    counted = [telemetry.rows(tick)[:, telemetry.FIELDS.index("events")].tolist() for tick in ticks]
    assert counted == [[float(len(tick.transitions) + len(tick.reports))] for tick in ticks]
    assert sum(events for (events,) in counted) >= 5.0


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
    ticks = world.fly(1.5)
    assert next(tick.output.gain[0] for tick in ticks if tick.mode[0] == Mode.FLY) == 1.0


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
