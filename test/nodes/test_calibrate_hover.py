"""Calibration in flight: the profile it writes is what the simulated drone really lifts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from flatsat_ros.crazyflie.vehicle import VehicleProfile
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab


def test_a_hover_gives_a_profile_with_the_drones_force_and_no_controller_gives_none(lab: Lab, tmp_path: Path) -> None:
    poses, written = lab.watch(interfaces.POSE, "cf1"), tmp_path / "mine.yaml"
    lab.start("sim_drone", robot_names=["cf1"], thrust_scale=0.95)
    lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.6))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.6))

    def calibrate() -> int:
        return lab.start("calibrate_hover", robot_name="cf1", output=written, seconds=3.0).wait()

    # meanwhile: for this one there is no controller
    alone = lab.start("calibrate_hover", robot_name="cf2", output=tmp_path / "other.yaml")
    # a hover that a busy machine disturbs is refused, rightly
    assert 0 in (calibrate() for _ in range(5))
    profile = VehicleProfile.load(written)
    # the motors' steps cost 0.6 % on average
    assert profile.force_max == pytest.approx(0.95 * lab.vehicle.force_max, rel=0.02)
    assert profile.name == "mine"
    again = lab.start("calibrate_hover", robot_name="cf1", output=written)
    assert again.wait() == 2
    assert "exists already" in again.output
    assert alone.wait() == 1
    assert "no telemetry of cf2" in alone.output
