"""Flight by the high-level commander and the hand-over to and from it, one test a rule, named after it.

Sources are files and functions of crazyflie-firmware, release 2026.08.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from setpoint_stream import stream

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.high_level import HIGH_LEVEL_PERIOD
from flatsat_ros.sim.state_machine import State

VEHICLES = Path(__file__).parents[2] / "config" / "vehicles"
CF21 = VehicleProfile.load(VEHICLES / "cf21.yaml")
BRUSHLESS = VehicleProfile.load(VEHICLES / "brushless.yaml")
HOVER = float(CF21.pwm_from_thrust(GRAVITY))
BOOT = 0.2  # s: four looks of the supervisor make the drone ready
SETTLED = 6.0  # s after a goal is reached: the integrals have found the thrust of hover


def booted(profile: VehicleProfile = CF21, **options: Any) -> SimulatedFleet:
    """Return a drone that stands on the floor ready to fly, armed if it has to be."""
    fleet = SimulatedFleet(profile, 1, **options)
    wait(fleet, BOOT)
    if profile.motors.arming_required:
        fleet.firmware.request_arming(0, True)
        wait(fleet, BOOT)
    return fleet


def hovering(**options: Any) -> SimulatedFleet:
    """Return a drone that hovers at 1 m by its high-level commander."""
    fleet = booted(**options)
    fleet.take_off(0, 1.0, 2.0)
    wait(fleet, 2.0 + SETTLED)
    return fleet


def streamed(height: float = 3.0) -> SimulatedFleet:
    """Return a drone that has been flown by set-points for a second."""
    fleet = SimulatedFleet(CF21, 1, start=[[0.0, 0.0, height]], flying=True)
    stream(fleet, 1.0, HOVER)
    return fleet


def wait(fleet: SimulatedFleet, seconds: float) -> None:
    fleet.advance_to(fleet.time + seconds)


def heights(fleet: SimulatedFleet, seconds: float) -> np.ndarray:
    """Return the heights of the next seconds, m, every 10 ms."""
    start, found = fleet.time, []
    for k in range(round(seconds * 100)):
        fleet.advance_to(start + (k + 1) / 100)
        found.append(height(fleet))
    return np.array(found)


def height(fleet: SimulatedFleet) -> float:
    return float(fleet.bodies.position[0, 2])


def state(fleet: SimulatedFleet) -> State:
    return State(fleet.firmware.state[0])


def off(fleet: SimulatedFleet) -> bool:
    return bool(fleet.power.ratio[0] == 0.0)


@pytest.mark.parametrize("profile", [CF21, BRUSHLESS], ids=lambda profile: profile.name)
@pytest.mark.parametrize("duration", [2.5, 4.0])
def test_a_take_off_reaches_the_height_in_its_time_and_hovers(profile: VehicleProfile, duration: float) -> None:
    """planner.c plan_takeoff; position_controller_pid.c overshoots until its integrals have found the thrust."""
    fleet = booted(profile)
    fleet.take_off(0, 1.0, duration)
    climb = heights(fleet, duration)
    assert climb[-1] == pytest.approx(1.0, abs=0.08)
    assert heights(fleet, SETTLED) == pytest.approx(1.0, abs=0.1)
    assert height(fleet) == pytest.approx(1.0, abs=0.03)
    assert_allclose(fleet.bodies.position[0, :2], 0.0, atol=1e-9)


def test_a_take_off_turns_to_the_yaw_asked_for_or_keeps_the_present_one() -> None:
    """crtp_commander_high_level.c takeoff2, useCurrentYaw; planner.c: the shorter way round."""
    for asked, reached in ((None, 3.0), (-3.0, 2.0 * math.pi - 3.0)):
        fleet = booted(yaw=3.0)
        fleet.take_off(0, 1.0, 2.0, asked)
        wait(fleet, 4.0)
        assert fleet.bodies.angles[0, 2] == pytest.approx(reached, abs=1e-3)


@pytest.mark.parametrize("yaw_mode", YawMode)
def test_go_to_flies_to_a_place_and_yaw_of_the_world_or_relative_to_the_present(yaw_mode: YawMode) -> None:
    """planner.c plan_go_to_from; the planner's yaw is an angle whatever flightmode.stabModeYaw is."""
    fleet = hovering(yaw_mode=yaw_mode)
    fleet.go_to(0, [1.0, 0.5, 1.2], math.pi / 2, 3.0)
    wait(fleet, 3.0 + SETTLED)
    assert_allclose(fleet.bodies.position[0], (1.0, 0.5, 1.2), atol=0.03)
    assert fleet.bodies.angles[0, 2] == pytest.approx(math.pi / 2, abs=1e-3)
    fleet.go_to(0, [0.5, 0.0, -0.2], math.pi / 4, 2.0, relative=True)  # along the world's axes, not the drone's
    wait(fleet, 2.0 + SETTLED)
    assert_allclose(fleet.bodies.position[0], (1.5, 0.5, 1.0), atol=0.03)
    assert fleet.bodies.angles[0, 2] == pytest.approx(0.75 * math.pi, abs=1e-3)


def test_a_landing_ends_with_the_motors_off_on_the_floor_and_the_drone_not_locked() -> None:
    """planner.c plan_current_goal; null set-points are fresh, so flying ends by itself (supervisor.c)."""
    fleet = hovering()
    fleet.land(0, 0.03, 2.5)
    wait(fleet, 2.4)
    assert not off(fleet)
    wait(fleet, 0.15)
    assert off(fleet)
    assert height(fleet) < 0.1
    seen = set()
    for _ in range(200):
        wait(fleet, 0.04)
        seen.add(state(fleet))
    assert height(fleet) == 0.0
    assert not fleet.bodies.capsized[0]
    assert {State.LANDED, State.RESET, State.READY_TO_FLY} <= seen
    assert State.LOCKED not in seen
    fleet.take_off(0, 0.5, 2.0)
    wait(fleet, 4.0)
    assert height(fleet) == pytest.approx(0.5, abs=0.1)


def test_a_drone_that_its_commander_flies_is_never_silent() -> None:
    """stabilizer.c stabilizerTask: every accepted high-level set-point has a new time."""
    fleet = hovering()
    wait(fleet, 5.0)
    assert state(fleet) == State.FLYING
    assert height(fleet) == pytest.approx(1.0, abs=0.02)


def test_handed_over_at_once_the_drone_stays_in_the_air() -> None:
    """commander.c commanderRelaxPriority: no null set-point when a command comes before the commander's next turn."""
    fleet = streamed()
    before = height(fleet)
    fleet.notify_setpoints_stop(0)
    fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
    after = heights(fleet, 8.0)
    # the controller starts at PID_VEL_THRUST_BASE, 7 % below hover: it sinks until the integrals know
    assert 0.03 < before - after.min() < 0.08
    assert after[-1] == pytest.approx(before, abs=0.02)
    assert state(fleet) == State.FLYING


def test_each_moment_between_notify_and_the_command_costs_height() -> None:
    """crtp_commander_high_level.c nullSetpoint: until the command the motors are off."""
    lost = []
    for pause in (0.0, 0.02, 0.1, 0.2):
        fleet = streamed()
        before = height(fleet)
        fleet.notify_setpoints_stop(0)
        wait(fleet, pause)
        fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
        lost.append(before - heights(fleet, 4.0).min())
    assert lost == sorted(lost)
    assert lost[1] < 0.1
    assert lost[3] > 0.4


def test_notified_without_a_command_the_drone_falls_but_is_not_locked() -> None:
    """crtp_commander_high_level.c crtpCommanderHighLevelGetSetpoint: a stopped planner sends null set-points."""
    fleet = streamed()
    fleet.notify_setpoints_stop(0)
    wait(fleet, 0.03)
    assert off(fleet)
    wait(fleet, 5.0)
    assert height(fleet) == 0.0
    assert state(fleet) != State.LOCKED


def test_a_command_without_notify_is_not_heard_and_silence_locks_the_drone() -> None:
    """commander.c commanderSetSetpoint: the priority stays that of the last streamed set-point, which gets old."""
    fleet = streamed(40.0)
    fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
    wait(fleet, 0.6)
    assert fleet.firmware.high_level.following[0]
    assert state(fleet) == State.LEVEL_OUT
    wait(fleet, 1.6)
    assert state(fleet) == State.LOCKED
    assert off(fleet)
    assert not fleet.firmware.high_level.following[0]  # stabilizer.c crtpCommanderBlock


def test_a_hand_over_out_of_level_out_saves_the_drone() -> None:
    """supervisor_state_machine.c transitionsWarningLevelOut: a fresh set-point ends it."""
    fleet = streamed()
    wait(fleet, 1.0)
    assert state(fleet) == State.LEVEL_OUT
    fleet.notify_setpoints_stop(0)
    fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
    before = height(fleet)
    assert heights(fleet, 8.0).min() > before - 0.2
    assert state(fleet) == State.FLYING


def test_a_command_among_streamed_set_points_is_forgotten_with_the_next_one() -> None:
    """commander.c commanderSetSetpoint: a set-point of higher priority stops the planner."""
    fleet = streamed()
    fleet.go_to(0, [1.0, 0.0, 3.0], 0.0, 1.0)
    wait(fleet, 0.004)
    assert fleet.firmware.high_level.following[0]
    stream(fleet, 0.02, HOVER)
    assert not fleet.firmware.high_level.following[0]
    fleet.notify_setpoints_stop(0)
    wait(fleet, 0.03)
    assert off(fleet)


def test_after_an_unlocking_packet_the_commander_is_heard_only_when_notified() -> None:
    """commander.c commanderSetSetpoint, priorities; unheard it plans on, so the goal is high up when it is heard."""
    fleet = booted()
    stream(fleet, 0.01, 0.0)
    fleet.take_off(0, 1.0, 2.0)
    wait(fleet, 3.0)
    assert height(fleet) == 0.0
    fleet.notify_setpoints_stop(0)
    wait(fleet, 1.5)
    assert height(fleet) > 0.5


@pytest.mark.parametrize("unlocked", [True, False])
def test_streamed_set_points_take_over_at_once_but_with_thrust_only_if_it_was_unlocked(unlocked: bool) -> None:
    """commander.c commanderSetSetpoint; crtp_commander_rpyt.c thrustLocked, which no high-level flight opens."""
    fleet = booted()
    if unlocked:
        stream(fleet, 0.01, 0.0)
        fleet.notify_setpoints_stop(0)
    fleet.take_off(0, 1.0, 2.0)
    wait(fleet, 6.0)
    assert height(fleet) == pytest.approx(1.0, abs=0.1)
    before = height(fleet)
    stream(fleet, 0.3, HOVER, roll=10.0, yaw_rate=90.0)
    assert off(fleet) != unlocked
    if unlocked:
        assert height(fleet) == pytest.approx(before, abs=0.05)
        assert fleet.bodies.angles[0, 0] == pytest.approx(np.deg2rad(10.0), rel=0.1)
        assert -27.0 < np.rad2deg(fleet.bodies.angles[0, 2]) < -9.0  # a rate again
    else:
        assert height(fleet) < before - 0.05


def test_stop_cuts_the_motors_and_locks_nothing() -> None:
    """crtp_commander_high_level.c stop, planner.c plan_stop."""
    fleet = hovering()
    fleet.firmware.high_level.stop(0)
    wait(fleet, 0.03)
    assert off(fleet)
    wait(fleet, 4.0)
    assert height(fleet) == 0.0
    assert state(fleet) != State.LOCKED


def test_stop_leaves_streamed_set_points_alone() -> None:
    """commander.c commanderSetSetpoint: the null set-point of the stopped planner has the lower priority."""
    fleet = streamed()
    fleet.firmware.high_level.stop(0)
    stream(fleet, 0.1, HOVER)
    assert not off(fleet)


def test_a_drone_that_may_not_fly_refuses_and_does_not_remember() -> None:
    """crtp_commander_high_level.c isBlocked, set by stabilizer.c unless supervisorCanFly."""
    fleet = SimulatedFleet(BRUSHLESS, 1)
    wait(fleet, BOOT)
    fleet.take_off(0, 1.0, 2.0)
    wait(fleet, BOOT)
    fleet.firmware.request_arming(0, True)
    wait(fleet, 3.0)
    assert height(fleet) == 0.0
    fleet.take_off(0, 1.0, 2.0)
    wait(fleet, 3.0)
    assert height(fleet) > 0.5


def test_a_trajectory_ends_when_the_supervisor_forbids_flight() -> None:
    """crtp_commander_high_level.c crtpCommanderBlock stops the planner: nothing resumes after arming again."""
    fleet = hovering(profile=BRUSHLESS)
    fleet.firmware.request_arming(0, False)
    wait(fleet, 3.0)
    assert height(fleet) == 0.0
    assert fleet.firmware.request_arming(0, True)
    wait(fleet, 2.0)
    assert height(fleet) == 0.0


def test_a_change_of_control_resets_the_controller_after_nan() -> None:
    """controller_pid.c setpointModeChanged, controllerPidReinitialize."""
    fleet = streamed()
    fleet.command(0, math.nan, 0.0, 0.0, HOVER)
    wait(fleet, 0.01)
    fleet.notify_setpoints_stop(0)
    fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
    wait(fleet, 6.0)
    assert state(fleet) == State.FLYING
    assert_allclose(fleet.bodies.position[0, :2], 0.0, atol=0.05)


def test_one_streamed_set_point_empties_the_integrals() -> None:
    """controller_pid.c setpointModeChanged: the thrust of hover has to be found again."""
    fleet = hovering()
    before = height(fleet)
    fleet.command(0, 0.0, 0.0, 0.0, HOVER)
    fleet.notify_setpoints_stop(0)
    fleet.go_to(0, [0.0, 0.0, 0.0], 0.0, 1.0, relative=True)
    assert 0.03 < before - heights(fleet, 2.0).min() < 0.1


@pytest.mark.parametrize(("profile", "base"), [(CF21, 36000.0), (BRUSHLESS, 30000.0)])
def test_the_first_thrust_is_the_base_of_the_platform(profile: VehicleProfile, base: float) -> None:
    """platform_defaults_cf2.h, platform_defaults_cf21bl.h PID_VEL_THRUST_BASE."""
    fleet = booted(profile, dynamics="ideal")
    fleet.take_off(0, 1.0, 2.0)
    wait(fleet, 0.02)
    assert fleet.power.ratio[0] * 65535 == pytest.approx(base, abs=10.0)


def test_a_reboot_forgets_the_trajectory() -> None:
    """planner.c plan_init, commander.c commanderInit."""
    fleet = hovering()
    fleet.reboot(0)
    wait(fleet, 3.0)
    assert height(fleet) == 0.0


def test_a_batch_is_the_drones_one_by_one() -> None:
    start = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    ends = []
    for members in ([0, 1, 2], [0], [1], [2]):
        fleet = SimulatedFleet(CF21, len(members), start=[start[i] for i in members], yaw=0.3)
        wait(fleet, BOOT)
        for index, member in enumerate(members):
            fleet.take_off(index, 0.5 + 0.2 * member, 1.0 + member)
        wait(fleet, 1.5)
        for index, member in enumerate(members):
            if member == 0:
                fleet.go_to(index, [0.3, 0.3, 0.3], 1.0, 1.0, relative=True)
            elif member == 1:
                fleet.land(index, 0.0, 1.0)
            else:
                fleet.command(index, 0.0, 0.0, 0.0, 0.0)
        wait(fleet, 2.0)
        ends += list(fleet.bodies.position)
    assert_allclose(ends[:3], ends[3:], rtol=0, atol=1e-12)


def test_the_commander_turns_at_a_hundred_hertz() -> None:
    """stabilizer_types.h RATE_HL_COMMANDER: the last set-point stays in force until its next turn."""
    fleet = SimulatedFleet(CF21, 1, dynamics="ideal", start=[[0.0, 0.0, 9.0]], flying=True)
    fleet.advance_to(0.102)
    fleet.notify_setpoints_stop(0)
    fleet.advance_to(0.1 + HIGH_LEVEL_PERIOD * 1e-3)
    assert not off(fleet)
    wait(fleet, 0.002)
    assert off(fleet)
