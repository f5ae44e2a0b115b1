"""Parameters tell what they mean, in what unit and range, and which of them may change."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy

from flatsat_ros.identification.recording import COLUMNS
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.mocap_player import MocapPlayer
from flatsat_ros.nodes.ros.runtime import ProgramNode
from flatsat_ros.nodes.sim_drone import SimDrone

pytestmark = pytest.mark.in_process

# of every rclpy node
COMMON = {"use_sim_time", "start_type_description_service"}
CHANGEABLE = {"plan", "mu", "v_inf", "gamma_0", "gamma_max", "nu", "restart_gain", "hand_over_force"}


@pytest.fixture
def node(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[ProgramNode]:
    """A node with the parameters that it has by default."""
    recording = tmp_path / "recording.csv"
    recording.write_text(",".join(COLUMNS) + "\n0,0,0,0,0,0,0,1\n", encoding="utf-8")
    needed = ["--ros-args", "-p", f"file:={recording}"] if request.param is MocapPlayer else []
    rclpy.init(args=needed)
    made: ProgramNode = request.param()
    yield made
    made.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize("node", [ControllerNode, SimDrone, MocapPlayer], indirect=True)
def test_every_parameter_is_described_and_only_the_tuning_may_change(node: ProgramNode) -> None:
    names = set(node.list_parameters([], 0).names) - COMMON
    descriptors = node.describe_parameters(sorted(names))
    assert [descriptor.name for descriptor in descriptors] == sorted(names)
    for descriptor in descriptors:
        assert descriptor.description, descriptor.name
        changeable = isinstance(node, ControllerNode) and descriptor.name.split(".")[-1] in CHANGEABLE
        assert descriptor.read_only != changeable, descriptor.name
    if isinstance(node, ControllerNode):
        (mu,) = node.describe_parameters(["mu"])
        assert "[1/s]" in mu.description
        assert (mu.floating_point_range[0].from_value, mu.floating_point_range[0].to_value) == (0.0, 100.0)
        assert "robots.cf1.mu" in names
