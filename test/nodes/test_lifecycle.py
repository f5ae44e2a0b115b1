"""The life-cycle services over DDS."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest
from std_srvs.srv import SetBool, Trigger

from flatsat_ros.flight.supervisor import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab


@pytest.mark.parametrize("who", ["cf1", interfaces.ALL])
def test_a_drone_is_disarmed_armed_flown_and_landed_by_services(lab: Lab, who: str) -> None:
    poses, telemetry = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    controller = lab.fly("cf1", takeoff_height=0.4)
    lab.wait(lambda: poses and telemetry, "poses and telemetry")

    def mode() -> Mode:
        return Mode(int(telemetry[-1].data[FIELDS.index("mode")]))

    refused = lab.ask(Trigger, interfaces.service_of(who, "land"))
    assert not refused.success
    assert "cf1: land refused: the drone is in IDLE: only one in FLY or LEVEL can land" in refused.message
    assert lab.ask(SetBool, interfaces.service_of(who, "arm"), data=False).success
    assert "disarmed: arm it first" in lab.ask(Trigger, interfaces.service_of(who, "takeoff")).message
    assert lab.ask(SetBool, interfaces.service_of(who, "arm"), data=True).success
    # refused until the controller, too, has seen enough poses
    lab.wait(lambda: lab.ask(Trigger, interfaces.service_of(who, "takeoff")).success, "the take-off")
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.4), 0.15)
    assert "land it first" in lab.ask(SetBool, interfaces.service_of(who, "arm"), data=False).message
    assert lab.ask(Trigger, interfaces.service_of(who, "land")).success
    lab.wait(lambda: mode() is Mode.REST, "the touch-down")
    assert poses[-1].pose.position.z < 0.02
    lab.wait(lambda: mode() is Mode.IDLE, "the end of the rest")
    commands = lab.watch(interfaces.COMMAND, "cf1")
    lab.listen(0.5)
    # by now somebody else may fly the drone
    assert controller.stop(signal.SIGINT) == 0
    lab.listen(0.5)
    assert commands == []


def test_a_drone_handed_over_gets_no_last_command_and_is_not_disarmed(lab: Lab) -> None:
    poses, telemetry = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    controller = lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.5))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.5), 0.15)
    assert lab.ask(Trigger, interfaces.service_of("cf1", "hand_over")).success
    lab.wait(lambda: telemetry[-1].data[FIELDS.index("mode")] == Mode.IDLE, "silence")
    commands = lab.watch(interfaces.COMMAND, "cf1")
    refused = lab.ask(SetBool, interfaces.service_of("cf1", "arm"), data=False)
    assert not refused.success
    assert "flown by somebody else: land it first" in refused.message
    assert controller.stop(signal.SIGINT) == 0
    lab.listen(0.5)
    assert commands == []
