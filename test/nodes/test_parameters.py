"""Parameters tell what they mean, in what unit and range, and which of them may change."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from flatsat_ros.identification.recording import COLUMNS

if TYPE_CHECKING:
    from conftest import Lab

# of every rclpy node
COMMON = {"use_sim_time", "start_type_description_service"}
CHANGEABLE = {"plan", "mu", "v_inf", "gamma_0", "gamma_max", "nu", "restart_gain", "hand_over_force"}


@pytest.mark.parametrize(
    ("executable", "node"),
    [("controller", "flatsat_controller"), ("sim_drone", "sim_drone"), ("mocap_player", "mocap_player")],
)
def test_every_parameter_is_described_and_only_the_tuning_may_change(
    lab: Lab, tmp_path: Path, executable: str, node: str
) -> None:
    recording = tmp_path / "recording.csv"
    recording.write_text(",".join(COLUMNS) + "\n0,0,0,0,0,0,0,1\n", encoding="utf-8")
    # nobody listens to its poses: the player waits
    lab.start(executable, **({"file": recording} if executable == "mocap_player" else {}))
    client = lab.parameters_of(node)
    names = set(lab.answer(client.list_parameters([], 0)).result.names) - COMMON
    descriptors = lab.answer(client.describe_parameters(sorted(names))).descriptors
    assert [descriptor.name for descriptor in descriptors] == sorted(names)
    for descriptor in descriptors:
        assert descriptor.description, descriptor.name
        changeable = executable == "controller" and descriptor.name.split(".")[-1] in CHANGEABLE
        assert descriptor.read_only != changeable, descriptor.name
    if executable == "controller":
        (mu,) = lab.answer(client.describe_parameters(["mu"])).descriptors
        assert "[1/s]" in mu.description
        assert (mu.floating_point_range[0].from_value, mu.floating_point_range[0].to_value) == (0.0, 100.0)
        assert "robots.cf1.mu" in names
