"""The user's crazyflies.yaml: whatever is read has robots that stand somewhere, and addresses that mean something."""

from __future__ import annotations

import math
from contextlib import suppress

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.crazyflies_yaml import Robot, read_crazyflies
from flatsat_ros.crazyflie.link import Address
from fuzzing.damage import damaged
from fuzzing.kind import of_file, require_one_line

EXAMPLE = """
fileversion: 3
robots:
  cf231:
    enabled: true
    uri: radio://0/80/2M/E7E7E7E7E7
    initial_position: [0.0, -0.5, 0]
    type: cf21
    firmware_params: {stabilizer: {controller: 1}}
  cf5: {enabled: false, uri: radio://0/80/2M/E7E7E7E705, initial_position: [0, 0, 0], type: cf21}
  cf6: {uri: "udp://127.0.0.1:19850", type: cf21}
  cf7: {uri: "radio://*/90/1M?safelink=0", type: null}
  visitor: {enabled: true, initial_position: [1, 1, 0], type: person}
robot_types:
  cf21: {motion_capture: {tracking: librigidbodytracker}}
  person: {connection: none}
all: {firmware_logging: {enabled: true}}
"""


def _law(robots: list[Robot]) -> None:
    assert robots
    for robot in robots:
        assert len(robot.position) == 3
        assert all(math.isfinite(value) for value in robot.position)
        assert all(isinstance(text, str) for text in (robot.name, robot.uri, robot.kind))
        with suppress(FlatsatError):
            _address(robot.uri)


def _address(uri: str) -> None:
    try:
        Address.parse(uri)
    except FlatsatError as refused:
        require_one_line(refused)
        raise


CRAZYFLIES = of_file(damaged(EXAMPLE), read_crazyflies, _law, "crazyflies.yaml")
