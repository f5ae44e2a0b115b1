"""Calibration in flight: the profile it writes is what the simulated drone really lifts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab


def test_a_hover_gives_a_profile_with_the_force_of_this_drone(lab: Lab, tmp_path: Path) -> None:
    poses, written = lab.watch(interfaces.POSE, "cf1"), tmp_path / "mine.yaml"
    lab.start("sim_drone", robot_names=["cf1"], thrust_scale=0.95)
    lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.6))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.6), 0.05)

    def calibrate() -> int:
        return lab.start("calibrate_hover", robot_name="cf1", output=written, seconds=4.0).wait()

    # a hover that a busy machine disturbs is refused, rightly
    assert 0 in (calibrate() for _ in range(5))
    profile = VehicleProfile.load(written)
    # the motors' steps cost 0.6 % on average
    assert profile.force_max == pytest.approx(0.95 * lab.vehicle.force_max, rel=0.02)
    assert profile.name == "mine"
    again = lab.start("calibrate_hover", robot_name="cf1", output=written)
    assert again.wait() == 2
    assert "exists already" in again.output


def test_without_a_controller_it_gives_up(lab: Lab, tmp_path: Path) -> None:
    calibration = lab.start("calibrate_hover", robot_name="cf1", output=tmp_path / "mine.yaml")
    assert calibration.wait() == 1
    assert "no telemetry of cf1" in calibration.output
