"""sim_server as a node: its parameters, and what they do to the simulated drones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.parameter import Parameter

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.sim_server import SimServer

pytestmark = pytest.mark.in_process

Servers = Callable[..., AbstractContextManager[SimServer]]
YAML = """
fileversion: 3
robots:
  cf231: {enabled: true, uri: "radio://0/80/2M/E7E7E7E7E7", initial_position: [0.0, 0.5, 0.0], type: cf21}
  cf5: {enabled: true, uri: "radio://0/80/2M/E7E7E7E705", initial_position: [0.0, -0.5, 0.0], type: cf21}
"""


@pytest.fixture
def server(tmp_path: Path) -> Servers:
    """How to make a server of two drones with more parameters."""
    (tmp_path / "crazyflies.yaml").write_text(YAML, encoding="utf-8")

    @contextmanager
    def make(**parameters: object) -> Iterator[SimServer]:
        given = {"crazyflies_yaml": tmp_path / "crazyflies.yaml", **parameters}
        rclpy.init(args=["--ros-args", *(part for name, value in given.items() for part in ("-p", f"{name}:={value}"))])
        try:
            node = SimServer()
            try:
                yield node
            finally:
                node.destroy_node()
        finally:
            rclpy.shutdown()

    return make


def value(node: SimServer, name: str) -> Any:
    return node.get_parameter(name).value


def masks(node: SimServer) -> list[int]:
    return [int(drone.fleet.firmware.high_level.group_mask[drone.number]) for drone in node.drones]


def test_what_is_given_for_all_at_the_start_is_each_drones_unless_it_has_its_own(
    server: Servers,
) -> None:
    given = {"all.params.hlCommander.groupmask": 5, "cf5.params.hlCommander.groupmask": 4}
    with server(**given) as node:
        assert masks(node) == [5, 4]
        assert value(node, "cf231.params.hlCommander.groupmask") == 5


def test_scripts_are_told_where_the_drones_are_simulated(
    server: Servers,
) -> None:
    with server(start_positions="[1.0,2.0,0.0,3.0,4.0,0.0]") as node:
        assert list(value(node, "robots.cf5.initial_position")) == [3.0, 4.0, 0.0]
    with (
        pytest.raises(FlatsatError, match=r"robots\.cf5\.initial_position.*: give start_positions"),
        server(**{"robots.cf5.initial_position": "[9.0,0.0,0.0]"}),
    ):
        pass


def test_a_script_reads_where_its_robots_begin_and_their_uris(
    server: Servers,
) -> None:
    with server() as node:
        assert node.get_name() == "crazyflie_server"
        assert value(node, "robots.cf231.initial_position") == [0.0, 0.5, 0.0]
        assert value(node, "robots.cf231.uri") == "radio://0/80/2M/E7E7E7E7E7"
        assert value(node, "robots.cf231.type") == "cf21"


def test_drones_without_a_file_have_numbers_that_scripts_can_know_them_by(
    server: Servers,
) -> None:
    with server(crazyflies_yaml="''", robot_names="[a, b]") as node:
        assert [int(str(value(node, f"robots.{name}.uri"))[-2:], 16) for name in ("a", "b")] == [1, 2]


def test_a_firmware_parameter_is_set_for_one_drone_or_for_all(
    server: Servers,
) -> None:
    with server(**{"cf5.params.hlCommander.groupmask": 4}) as node:
        assert masks(node) == [0, 4]
        (result,) = node.set_parameters([Parameter("cf231.params.hlCommander.groupmask", value=9)])
        assert result.successful
        assert masks(node) == [9, 4]
        (result,) = node.set_parameters([Parameter("all.params.hlCommander.groupmask", value=1)])
        assert result.successful
        assert masks(node) == [1, 1]
        assert value(node, "cf5.params.hlCommander.groupmask") == 1
        assert all(
            result.successful for result in node.set_parameters([Parameter("all.params.led.bitmask", value=128)])
        )
        assert value(node, "cf231.params.led.bitmask") == 128


@pytest.mark.parametrize(
    ("name", "new", "reason"),
    [
        ("cf5.params.stabilizer.controller", 2, "must be 1"),
        ("all.params.flightmode.stabModeYaw", 1, "must be 0"),
        ("cf5.params.hlCommander.groupmask", 256, "groupmask"),
        ("robots.cf5.uri", "radio://0/80/2M/E7E7E7E7E7", "read-only"),
    ],
)
def test_what_no_simulated_drone_can_do_is_refused(server: Servers, name: str, new: object, reason: str) -> None:
    with server() as node:
        before = value(node, name)
        (result,) = node.set_parameters([Parameter(name, value=new)])
        assert not result.successful
        assert reason in result.reason
        assert value(node, name) == before


def test_a_firmware_parameter_that_is_fixed_is_refused_at_the_start(
    server: Servers,
) -> None:
    with (
        pytest.raises(FlatsatError, match=r"all\.params\.stabilizer\.controller = 2: must be 1"),
        server(**{"all.params.stabilizer.controller": 2}),
    ):
        pass
