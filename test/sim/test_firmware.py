"""The firmware's rules, one test each, named after the rule; the source is a file and function of crazyflie-firmware.

Sources are those of release 2026.08. Times are those of a real drone: the supervisor looks every 40 ms.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from setpoint_stream import stream

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.crazyflie.wire import YawMode
from flatsat_ros.sim.firmware import SUPERVISOR_PERIOD, Firmware
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.power import Battery
from flatsat_ros.sim.state_machine import TRANSITIONS, State

VEHICLES = Path(__file__).parents[2] / "config" / "vehicles"
CF21 = VehicleProfile.load(VEHICLES / "cf21.yaml")
BRUSHLESS = VehicleProfile.load(VEHICLES / "brushless.yaml")
HOVER = float(CF21.pwm_from_thrust(GRAVITY))
TAKE_OFF = 1.1 * HOVER
BOOT = 0.2  # s: four looks of the supervisor make the drone ready


def grounded(profile: VehicleProfile = CF21, **options: Any) -> SimulatedFleet:
    return SimulatedFleet(profile, 1, dynamics="ideal", **options)


def flying(height: float = 50.0, **options: Any) -> SimulatedFleet:
    return SimulatedFleet(CF21, 1, dynamics="ideal", start=[[0.0, 0.0, height]], flying=True, **options)


def silence(fleet: SimulatedFleet, seconds: float) -> None:
    fleet.advance_to(fleet.time + seconds)


def stand(firmware: Firmware, since: float, seconds: float) -> None:
    """Let the supervisor look at drones that stand still with their motors at rest, without simulating them."""
    count = len(firmware.state)
    for now in range(round(since * 1000), round((since + seconds) * 1000), SUPERVISOR_PERIOD):
        firmware.supervise(now, np.tile((0.0, 0.0, 1.0), (count, 1)), np.zeros(count), np.full(count, 4.0))


def state(fleet: SimulatedFleet) -> State:
    return State(fleet.firmware.state[0])


def thrust(fleet: SimulatedFleet) -> float:
    """Return the achieved thrust in units of gravity."""
    return float(fleet.bodies.thrust[0] / GRAVITY)


def took_off(fleet: SimulatedFleet) -> bool:
    return bool(fleet.poses()[0][0, 2] > 0.0)


def test_thrust_is_locked_from_boot_until_a_packet_with_thrust_zero() -> None:
    """crtp_commander_rpyt.c crtpCommanderRpytDecodeSetpoint, thrustLocked."""
    fleet = grounded()
    stream(fleet, 1.0, TAKE_OFF)
    assert not took_off(fleet)
    stream(fleet, 0.01, 0.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet)


@pytest.mark.parametrize(("sent", "unlocks"), [(0.9, True), (1.0, False), (999.0, False)])
def test_only_a_thrust_that_is_zero_in_the_packet_unlocks(sent: float, unlocks: bool) -> None:
    """crtp_commander_rpyt.c crtpCommanderRpytDecodeSetpoint; CommanderCrtpLegacyValues.thrust is a uint16_t."""
    fleet = grounded()
    stream(fleet, 0.5, sent)
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet) == unlocks


@pytest.mark.parametrize(
    ("sent", "acted_on"), [(999.0, 0.0), (1000.0, 1000.0), (60000.0, 60000.0), (60001.0, 60000.0), (65535.0, 60000.0)]
)
def test_thrust_below_1000_is_zero_and_above_60000_is_clipped(sent: float, acted_on: float) -> None:
    """crtp_commander_rpyt.c MIN_THRUST, MAX_THRUST."""
    fleet = flying()
    stream(fleet, 0.1, sent)
    assert fleet.bodies.thrust[0] == pytest.approx(CF21.thrust_from_pwm(acted_on), rel=1e-12)


def test_a_zero_thrust_packet_in_the_air_cuts_the_motors() -> None:
    """controller_pid.c controllerPid: thrust 0 zeroes everything."""
    fleet = flying()
    stream(fleet, 0.02, 0.0)
    assert thrust(fleet) == 0.0
    stream(fleet, 0.02, HOVER)
    assert thrust(fleet) == pytest.approx(1.0)


def test_roll_and_pitch_are_angles_in_degrees() -> None:
    """crtp_commander_rpyt.c stabilizationModeRoll, stabilizationModePitch: ANGLE."""
    fleet = flying()
    fleet.command(0, 10.0, -20.0, 0.0, HOVER)
    silence(fleet, 0.1)
    np.testing.assert_allclose(np.rad2deg(fleet.bodies.angles[0]), (10.0, -20.0, 0.0), atol=1e-12)
    assert fleet.bodies.velocity[0, 1] < 0.0  # positive roll toward -y
    assert fleet.bodies.velocity[0, 0] < 0.0  # negative pitch toward -x


def test_yaw_is_a_rate_positive_clockwise() -> None:
    """crtp_commander_rpyt.c: "legacy rate input is inverted"; controller_pid.c integrates attitudeDesired.yaw."""
    fleet = flying()
    stream(fleet, 1.0, HOVER, yaw_rate=30.0)
    assert np.rad2deg(fleet.bodies.angles[0, 2]) == pytest.approx(-30.0, abs=0.1)


def test_with_stabmodeyaw_1_yaw_is_an_angle_positive_counter_clockwise_the_shorter_way() -> None:
    """crtp_commander_rpyt.c stabilizationModeYaw ANGLE is not inverted; pid.c pidUpdate isYawAngle."""
    fleet = flying(yaw_mode=YawMode.ANGLE, yaw=np.deg2rad(170.0))
    stream(fleet, 0.1, HOVER, yaw_rate=-170.0)
    assert np.rad2deg(fleet.bodies.angles[0, 2]) == pytest.approx(190.0)


def test_without_thrust_the_desired_yaw_is_the_present_one() -> None:
    """controller_pid.c controllerPid: thrust 0 resets attitudeDesired.yaw."""
    fleet = grounded()
    stream(fleet, 2.0, 0.0, yaw_rate=90.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert fleet.bodies.angles[0, 2] == pytest.approx(0.0)


def test_after_half_a_second_of_silence_the_drone_levels_out_and_keeps_its_thrust() -> None:
    """supervisor.c COMMANDER_WDT_TIMEOUT_STABILIZE, supervisorOverrideSetpoint: level, "Keep Z as it is"."""
    fleet = flying()
    stream(fleet, 1.0, 0.9 * HOVER, roll=20.0, yaw_rate=45.0)
    silence(fleet, 0.49)
    assert fleet.bodies.angles[0, 0] == pytest.approx(np.deg2rad(20.0))
    silence(fleet, 0.06)  # seen at 0.54 s on a real drone
    assert state(fleet) == State.LEVEL_OUT
    assert fleet.bodies.angles[0, 0] == 0.0
    yaw = fleet.bodies.angles[0, 2]
    silence(fleet, 1.0)
    assert thrust(fleet) == pytest.approx(0.9)
    assert fleet.bodies.angles[0, 2] == yaw


def test_a_packet_after_level_out_regains_control() -> None:
    """supervisor_state_machine.c transitionsWarningLevelOut; seen after 1.1 s of silence on a real drone."""
    fleet = flying()
    stream(fleet, 1.0, HOVER)
    silence(fleet, 1.1)
    stream(fleet, 0.06, HOVER, roll=10.0)
    assert state(fleet) == State.FLYING
    assert fleet.bodies.angles[0, 0] == pytest.approx(np.deg2rad(10.0))


def test_after_two_seconds_of_silence_the_motors_stop_until_reboot() -> None:
    """supervisor.c COMMANDER_WDT_TIMEOUT_SHUTDOWN; supervisor_state_machine.c transitionsLocked."""
    fleet = flying()
    stream(fleet, 1.0, HOVER)
    silence(fleet, 1.99)
    assert thrust(fleet) == pytest.approx(1.0)
    silence(fleet, 0.06)  # seen at 2.02 s on a real drone
    assert thrust(fleet) == 0.0
    stream(fleet, 3.0, 0.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert state(fleet) == State.LOCKED
    assert not took_off(fleet)
    fleet.reboot(0)
    stream(fleet, BOOT, 0.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet)


@pytest.mark.parametrize(("zeros", "locked"), [(0.5, True), (1.5, True), (1.8, False), (2.5, False)])
def test_a_landing_must_end_in_more_than_one_and_a_half_seconds_of_zero_thrust(zeros: float, locked: bool) -> None:
    """supervisor.c IS_FLYING_HYSTERESIS_THRESHOLD against the watchdogs: flying ends 2 s after the last thrust."""
    fleet = grounded()
    stream(fleet, BOOT, 0.0)
    stream(fleet, 1.0, 0.9 * HOVER)
    stream(fleet, zeros, 0.0)
    silence(fleet, 3.0)
    assert (state(fleet) == State.LOCKED) == locked


def test_silence_on_the_ground_locks_nothing() -> None:
    """supervisor_state_machine.c: only flying states have watchdog transitions."""
    fleet = grounded()
    stream(fleet, 1.0, 0.0)
    silence(fleet, 4.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet)


def test_after_notify_setpoints_stop_null_setpoints_cut_the_motors_but_lock_nothing() -> None:
    """crtp_commander.c notifySetpointsStopDecoder; crtp_commander_high_level.c sends nullSetpoint."""
    fleet = flying()
    stream(fleet, 1.0, HOVER)
    fleet.firmware.notify_setpoints_stop(0)
    silence(fleet, 0.01)
    assert thrust(fleet) == 0.0
    silence(fleet, 3.0)
    assert state(fleet) != State.LOCKED
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet)


def test_emergency_latches_until_reboot() -> None:
    """crtp_supervisor.c handleSupervisorCommand CMD_EMERGENCY_STOP, isEmergencyStopRequested is never cleared."""
    fleet = flying()
    stream(fleet, 1.0, HOVER)
    fleet.firmware.request_emergency(0)
    stream(fleet, 0.06, HOVER)
    assert thrust(fleet) == 0.0
    stream(fleet, 3.0, 0.0)
    stream(fleet, 3.0, TAKE_OFF)
    assert state(fleet) == State.LOCKED
    fleet.reboot(0)
    stream(fleet, BOOT, 0.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet)


@pytest.mark.parametrize("resting", [State.PREFLIGHT_PASSED, State.READY_TO_FLY])
def test_emergency_on_the_ground_locks(resting: State) -> None:
    """supervisor_state_machine.c transitionsPreFlChecksPassed, transitionsReadyToFly."""
    fleet = grounded(BRUSHLESS if resting == State.PREFLIGHT_PASSED else CF21)
    silence(fleet, BOOT)
    assert state(fleet) == resting
    fleet.firmware.request_emergency(0)
    silence(fleet, 0.1)
    assert state(fleet) == State.LOCKED


def test_less_than_half_a_g_for_a_second_is_a_tumble() -> None:
    """supervisor.c isTumbledCheck: acc.z below 0.5 g for 1 s, here by flying at a third of hover thrust."""
    fleet = flying(200.0)
    stream(fleet, 1.0, HOVER / 3.0)
    assert state(fleet) == State.FLYING
    stream(fleet, 0.1, HOVER / 3.0)
    assert state(fleet) == State.CRASHED
    assert thrust(fleet) == 0.0


def test_free_fall_is_no_tumble() -> None:
    """supervisor.c isTumbledCheck: "Falling is OK, reset"."""
    fleet = flying(500.0)
    stream(fleet, 1.9, 0.0)
    stream(fleet, 0.1, HOVER)
    assert thrust(fleet) == pytest.approx(1.0)


def test_upside_down_on_the_floor_stops_the_motors() -> None:
    """supervisor.c isTumbledCheck: acc.z below -0.2 g for 0.1 s; transitionsFlying: crashed."""
    fleet = flying(0.05)
    stream(fleet, 0.3, HOVER, roll=180.0)
    assert fleet.bodies.capsized[0]
    assert state(fleet) == State.CRASHED
    assert fleet.power.ratio[0] == 0.0


def test_a_crashed_drone_flies_again_only_after_a_reboot() -> None:
    """supervisor_state_machine.c transitionsCrashed: only a recovery, which nobody asks for here, leads out."""
    fleet = flying(0.05)
    stream(fleet, 0.3, HOVER, roll=180.0)
    fleet.bodies.set_upright(0)
    stream(fleet, 1.0, 0.0)
    stream(fleet, 1.0, TAKE_OFF)
    assert not took_off(fleet)
    fleet.reboot(0)
    stream(fleet, BOOT, 0.0)
    stream(fleet, 0.5, TAKE_OFF)
    assert took_off(fleet)


def test_a_nan_angle_is_not_checked_and_crashes_the_drone() -> None:
    """crtp_commander_rpyt.c checks nothing; pid.c pidUpdate keeps a NaN integral, so one packet is enough."""
    fleet = flying(1.0)
    stream(fleet, 0.5, HOVER)
    stream(fleet, 0.01, HOVER, roll=math.nan)
    stream(fleet, 3.0, HOVER)
    assert fleet.bodies.capsized[0] or fleet.bodies.grounded[0]
    assert state(fleet) == State.CRASHED


def test_a_zero_thrust_packet_resets_the_controller_after_nan() -> None:
    """controller_pid.c controllerPidReinitialize at thrust 0."""
    fleet = flying()
    stream(fleet, 0.1, HOVER, yaw_rate=math.nan)
    assert fleet.bodies.attitude[2, 0, 1] > 0.0
    stream(fleet, 0.01, 0.0)
    stream(fleet, 1.0, HOVER)
    np.testing.assert_allclose(fleet.bodies.attitude[:, 0, 1:], 0.0)
    assert np.isfinite(fleet.bodies.angles).all()


def test_a_brushless_drone_flies_only_after_arming() -> None:
    """src/modules/src/Kconfig MOTORS_REQUIRE_ARMING; supervisor.c supervisorRequestArming."""
    fleet, take_off = grounded(BRUSHLESS), 1.1 * float(BRUSHLESS.pwm_from_thrust(GRAVITY))
    assert not fleet.firmware.request_arming(0, True)  # not before the pre-flight checks have passed
    stream(fleet, 1.0, 0.0)
    stream(fleet, 1.0, take_off)
    assert not took_off(fleet)
    assert fleet.firmware.request_arming(0, True)
    stream(fleet, 0.5, take_off)
    assert took_off(fleet)


def test_disarming_in_the_air_stops_the_motors() -> None:
    """supervisor_state_machine.c transitionsFlying: not armed, reset."""
    fleet = flying()
    stream(fleet, 0.5, HOVER)
    assert fleet.firmware.request_arming(0, False)
    stream(fleet, 0.06, HOVER)
    assert thrust(fleet) == 0.0


def test_an_armed_drone_that_does_not_fly_disarms_after_30_seconds() -> None:
    """platform_defaults.h PREFLIGHT_TIMEOUT_MS."""
    firmware = Firmware(BRUSHLESS, 1)
    stand(firmware, 0.0, BOOT)
    assert firmware.request_arming(0, True)
    stand(firmware, BOOT, 29.9)
    assert firmware.armed[0]
    stand(firmware, BOOT + 29.9, 0.3)
    assert not firmware.armed[0]


def test_a_landed_drone_disarms_after_3_seconds() -> None:
    """platform_defaults.h LANDING_TIMEOUT_MS, counted from the end of flying, 2 s after the last thrust."""
    fleet = grounded(BRUSHLESS)
    silence(fleet, BOOT)
    fleet.firmware.request_arming(0, True)
    stream(fleet, BOOT, 0.0)
    stream(fleet, 1.0, 0.5 * float(BRUSHLESS.pwm_from_thrust(GRAVITY)))
    stream(fleet, 4.9, 0.0)
    assert state(fleet) == State.LANDED
    assert fleet.firmware.armed[0]
    stream(fleet, 0.3, 0.0)
    assert not fleet.firmware.armed[0]


def test_a_brushed_drone_arms_itself_again() -> None:
    """supervisor.c postTransitionActions, AUTO_ARMING."""
    firmware = Firmware(CF21, 1)
    stand(firmware, 0.0, 31.0)
    assert firmware.armed[0]
    assert firmware.state[0] == State.READY_TO_FLY


def test_an_armed_brushless_drone_idles() -> None:
    """power_distribution_quadrotor.c powerDistributionCap; idling is not flying (supervisor.c isFlyingCheck)."""
    fleet = SimulatedFleet(BRUSHLESS, 1)
    silence(fleet, BOOT)
    assert fleet.power.ratio[0] == 0.0
    fleet.firmware.request_arming(0, True)
    silence(fleet, BOOT)
    assert fleet.power.ratio[0] == pytest.approx(7000 / 65535)
    assert state(fleet) == State.READY_TO_FLY


def test_a_low_battery_warns_and_a_critical_battery_switches_off_after_5_seconds() -> None:
    """pm_stm32f4.c pmTask, DEFAULT_BAT_LOW_DURATION_TO_TRIGGER_SEC; only a warning until the critical voltage."""
    low = flying(battery=Battery(voltage=3.1))
    stream(low, 4.9, HOVER)
    assert not low.firmware.battery_low[0]
    stream(low, 5.0, HOVER)
    assert low.firmware.battery_low[0]
    assert thrust(low) == pytest.approx(1.0)
    critical = flying(battery=Battery(voltage=2.9))
    stream(critical, 4.9, HOVER)
    assert thrust(critical) == pytest.approx(1.0)
    stream(critical, 0.2, HOVER)
    assert thrust(critical) == 0.0
    assert not critical.firmware.powered[0]


def test_supervisor_info_is_the_bit_field_of_the_log_variable() -> None:
    """supervisor.c updateLogData: can arm, armed, auto-arm, can fly, flying, tumbled, locked, crashed."""
    fleet = grounded()
    assert fleet.firmware.info()[0] == 0b00000100
    stream(fleet, BOOT, 0.0)
    assert fleet.firmware.info()[0] == 0b00001110
    stream(fleet, 0.1, TAKE_OFF)
    assert fleet.firmware.info()[0] == 0b00011110
    silence(fleet, 3.0)
    assert fleet.firmware.info()[0] == 0b01000100
    brushless = grounded(BRUSHLESS)
    silence(brushless, BOOT)
    assert brushless.firmware.info()[0] == 0b00000001


def test_every_state_but_locked_can_be_left() -> None:
    """supervisor_state_machine.c transitionLists."""
    assert {origin for origin, _, _ in TRANSITIONS} == set(State) - {State.LOCKED}
