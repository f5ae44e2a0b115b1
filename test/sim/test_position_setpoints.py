"""Set-points of position and velocity, one test a rule of crtp_commander_generic.c, commander.c and supervisor.c."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.position_controller import PositionSetpoint, SetpointMode
from flatsat_ros.sim.state_machine import State
from flatsat_ros.sim.trajectories import Piece

CF21 = VehicleProfile.load(Path(__file__).parents[2] / "config" / "vehicles" / "cf21.yaml")
STILL = (0.0, 0.0, 0.0)
START = (0.0, 0.0, 1.0)
PLACE = PositionSetpoint.of(SetpointMode.POSITION, (0.3, -0.2, 1.2), STILL, 0.5)


def airborne(**options: Any) -> SimulatedFleet:
    return SimulatedFleet(CF21, 1, start=[START], flying=True, **options)


def stream(fleet: SimulatedFleet, setpoint: PositionSetpoint, seconds: float) -> None:
    """Send a set-point every 20 ms."""
    start = fleet.time
    for k in range(round(seconds * 50)):
        fleet.command_position(0, setpoint)
        fleet.advance_to(start + (k + 1) / 50)


def wait(fleet: SimulatedFleet, seconds: float) -> None:
    fleet.advance_to(fleet.time + seconds)


@pytest.mark.parametrize("mode", [SetpointMode.POSITION, SetpointMode.FULL_STATE])
def test_a_place_and_a_yaw_are_flown_to(mode: SetpointMode) -> None:
    """positionDecoder, fullStateDecoder."""
    fleet = airborne()
    stream(fleet, PLACE._replace(mode=mode), 8.0)
    assert_allclose(fleet.bodies.position[0], PLACE.place, atol=0.03)
    assert fleet.bodies.angles[0, 2] == pytest.approx(0.5, abs=1e-3)


def test_a_velocity_of_the_world_is_flown_whatever_the_heading() -> None:
    """velocityDecoder; position_controller_pid.c positionController."""
    fleet = airborne(yaw=1.0)
    stream(fleet, PositionSetpoint.of(SetpointMode.VELOCITY, STILL, (0.5, -0.3, 0.2), 0.4), 6.0)
    assert_allclose(fleet.bodies.velocity[0], (0.5, -0.3, 0.2), atol=0.05)
    assert fleet.bodies.attitude[2, 0, 1] == pytest.approx(0.4, abs=0.02)


def test_a_hover_set_point_is_a_velocity_along_the_heading_at_a_height() -> None:
    """hoverDecoder: velocity_body."""
    fleet = airborne(yaw=math.pi / 2)
    stream(fleet, PositionSetpoint.of(SetpointMode.HOVER, (0.0, 0.0, 1.4), (0.4, 0.1, 0.0), 0.0), 8.0)
    assert_allclose(fleet.bodies.velocity[0], (-0.1, 0.4, 0.0), atol=0.05)
    assert fleet.bodies.position[0, 2] == pytest.approx(1.4, abs=0.05)
    stream(fleet, PositionSetpoint.of(SetpointMode.HOVER, (0.0, 0.0, 1.4), STILL, 0.5), 2.0)
    assert fleet.bodies.attitude[2, 0, 1] == pytest.approx(0.5, abs=0.02)


def test_the_thrust_lock_is_not_for_them_and_stays_closed() -> None:
    """crtp_commander_rpyt.c alone has the lock."""
    fleet = SimulatedFleet(CF21, 1)
    wait(fleet, 0.2)
    stream(fleet, PositionSetpoint.of(SetpointMode.POSITION, (0.0, 0.0, 0.5), STILL, 0.0), 2.0)
    assert fleet.bodies.position[0, 2] > 0.3
    assert fleet.firmware.thrust_locked[0]


def test_they_have_the_priority_until_the_notice_that_set_points_stop() -> None:
    """commander.c commanderSetSetpoint, commanderRelaxPriority."""
    fleet = airborne()
    stream(fleet, PLACE, 4.0)
    fleet.go_to(0, (-1.0, 0.0, 1.0), 0.0, 1.0)
    stream(fleet, PLACE, 2.0)
    assert_allclose(fleet.bodies.position[0], PLACE.place, atol=0.05)
    fleet.notify_setpoints_stop(0)
    fleet.go_to(0, (-0.5, 0.0, 1.0), 0.0, 2.0)
    wait(fleet, 6.0)
    assert_allclose(fleet.bodies.position[0], (-0.5, 0.0, 1.0), atol=0.05)


def test_silence_levels_the_drone_out_at_its_height_and_then_cuts_the_motors() -> None:
    """supervisor.c supervisorOverrideSetpoint: "keep Z as it is", COMMANDER_WDT_TIMEOUT_SHUTDOWN."""
    fleet = airborne()
    stream(fleet, PositionSetpoint.of(SetpointMode.HOVER, START, (0.5, 0.0, 0.0), 0.0), 6.0)
    wait(fleet, 1.5)
    assert fleet.firmware.state[0] == State.LEVEL_OUT
    assert fleet.bodies.position[0, 2] == pytest.approx(1.0, abs=0.3)
    assert_allclose(fleet.bodies.angles[0, :2], 0.0, atol=0.01)
    wait(fleet, 1.5)
    assert fleet.firmware.state[0] == State.LOCKED
    assert fleet.power.ratio[0] == 0.0


def test_a_set_point_of_attitude_takes_over_from_them() -> None:
    fleet = airborne()
    stream(fleet, PLACE, 1.0)
    for _ in range(20):
        fleet.command(0, 10.0, 0.0, 0.0, float(CF21.pwm_from_thrust(9.81)))
        wait(fleet, 0.02)
    assert fleet.bodies.angles[0, 0] == pytest.approx(np.deg2rad(10.0), abs=0.02)


@pytest.mark.parametrize("group", [0, 1, 2])
def test_a_trajectory_is_flown_by_the_group_that_it_is_for(group: int) -> None:
    fleet = SimulatedFleet(CF21, 2)
    fleet.firmware.high_level.group_mask[:] = 1, 2
    wait(fleet, 0.2)
    rise = np.zeros((8, 4))
    rise[1, 2] = 0.25
    for drone in range(2):
        fleet.upload_trajectory(drone, 4, 0, [Piece.of(2.0, rise)])
        fleet.start_trajectory(drone, 4, group=group)
    wait(fleet, 3.0)
    assert (fleet.bodies.position[:, 2] > 0.3).tolist() == [group in (0, 1), group in (0, 2)]


def test_a_value_that_is_not_finite_or_a_time_scale_of_zero_is_refused() -> None:
    with pytest.raises(FlatsatError, match="an entry of position = nan"):
        PositionSetpoint.of(SetpointMode.POSITION, (0.0, math.nan, 0.0), STILL, 0.0)
    with pytest.raises(FlatsatError, match="yaw = inf rad/s"):
        PositionSetpoint.of(SetpointMode.HOVER, START, STILL, math.inf)
    with pytest.raises(FlatsatError, match="time_scale = 0"):
        airborne().start_trajectory(0, 0, time_scale=0.0)
