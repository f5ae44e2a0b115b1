"""The simulated drone's own services, as crazyswarm2's server names them, and its battery."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from std_srvs.srv import Empty, SetBool, Trigger

from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab


def test_an_emergency_stops_one_flying_drone_or_all_until_reboot(lab: Lab) -> None:
    robots = ("cf1", "cf2")
    poses = {robot: lab.watch(interfaces.POSE, robot) for robot in robots}
    battery, status = lab.watch(interfaces.BATTERY, "cf1"), lab.watch_diagnostics("sim_drone: cf1")
    lab.start("sim_drone", robot_names=list(robots))
    controller = lab.fly(*robots)

    def height(robot: str) -> float:
        return float(poses[robot][-1].pose.position.z) if poses[robot] else -1.0

    for number, robot in enumerate(robots):
        lab.go_to(robot, (float(number), 0.0, 0.5))
    lab.wait(lambda: min(map(height, robots)) > 0.3, "the climb")
    lab.ask(Empty, "cf1/emergency")
    lab.wait(lambda: height("cf1") < 0.01, "the fall")
    assert height("cf2") > 0.3, "the other one flies on"
    lab.ask(Empty, "all/emergency")
    lab.wait(lambda: height("cf2") < 0.01, "the fall of the other one")
    lab.listen(1.0)
    assert max(map(height, robots)) < 0.01, "latched, whatever the controller sends"
    lab.ask(SetBool, interfaces.service_of("cf1", interfaces.ARM), data=True)
    lab.wait(lambda: "cf1: arming refused in state LOCKED" in controller.output, "the refusal of the drone itself")
    lab.wait(lambda: "cf1: FALLEN -> IDLE: flatsat/arm was called" in controller.output, "what that leaves")
    assert lab.ask(Trigger, "cf1/reboot").success
    lab.wait(lambda: status[-1].message != "motors off until reboot", "the reboot")
    assert battery[-1].voltage == pytest.approx(4.0, abs=0.5)
    assert battery[-1].present


def test_a_brushless_drone_flies_only_when_armed_through_the_controller(lab: Lab) -> None:
    poses = lab.watch(interfaces.POSE, "cf1")
    lab.start("sim_drone", robot_names=["cf1"], vehicle="brushless")
    controller = lab.fly("cf1", vehicle="brushless", lift_off_time=1.0)
    lab.go_to("cf1", (0.0, 0.0, 0.5))
    lab.wait(lambda: "cf1: DESCEND -> FALLEN: not seen to leave" in controller.output, "the end")
    assert poses[-1].pose.position.z < 0.01
    help_ = "drones of its kind fly only when they are armed: call cf1/flatsat/arm"
    assert controller.output.count(help_) == 2, "as it sinks, and at the end"
    arm = interfaces.service_of("cf1", interfaces.ARM)
    lab.wait(lambda: "/cf1/arm asked to arm" in lab.ask(SetBool, arm, data=True).message, "the arming")
    lab.listen(0.5)
    assert poses[-1].pose.position.z < 0.01, "armed, it does not leap"
    lab.go_to("cf1", (0.0, 0.0, 0.5))
    lab.wait(lambda: poses[-1].pose.position.z > 0.3, "the climb")


def test_a_controller_alone_says_that_it_could_not_ask_the_drone(lab: Lab) -> None:
    lab.fly("cf1")
    answer = lab.ask(SetBool, interfaces.service_of("cf1", interfaces.ARM), data=True)
    assert answer.success
    told = "its place is not known: once it is, arm it again to open its thrust lock"
    assert answer.message == f"cf1: the drone itself was not asked: no service cf1/arm; {told}"
