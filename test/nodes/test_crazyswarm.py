"""crazyswarm2's own services, with its real interfaces; skipped where crazyflie_interfaces is not installed."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from std_srvs.srv import SetBool, Trigger

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab

services = pytest.importorskip("crazyflie_interfaces.srv")


def height(poses: list[Any]) -> float:
    return float(poses[-1].pose.position.z) if poses else -1.0


def mode(telemetry: list[Any]) -> Mode:
    return Mode(int(telemetry[-1].data[FIELDS.index("mode")]))


@pytest.mark.parametrize("who", ["cf1", interfaces.ALL])
def test_a_users_script_flies_the_simulated_drone(lab: Lab, who: str) -> None:
    poses = lab.watch(interfaces.POSE, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    # a drone that has just been switched on takes no command yet
    lab.wait(lambda: len(poses) > 50, "the drone to have booted")
    lab.ask(services.Takeoff, f"{who}/takeoff", height=0.5, duration=Duration(sec=2))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.5), 0.1)
    lab.ask(services.GoTo, f"{who}/go_to", goal=Point(x=0.4, y=-0.2, z=0.7), yaw=0.5, duration=Duration(sec=2))
    lab.wait_for_flight("cf1", poses, (0.4, -0.2, 0.7), 0.1)
    lab.ask(services.Land, f"{who}/land", height=0.02, duration=Duration(sec=2))
    lab.wait(lambda: height(poses) < 0.01, "the landing")


def test_a_drone_is_armed_taken_over_in_the_air_handed_back_and_landed(lab: Lab) -> None:
    poses, telemetry = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    lab.start("sim_drone", robot_names=["cf1"], vehicle="brushless")
    controller = lab.fly("cf1", vehicle="brushless")
    arm = interfaces.service_of("cf1", interfaces.ARM)
    lab.wait(lambda: "/cf1/arm asked to arm" in lab.ask(SetBool, arm, data=True).message, "the arming")
    # asked several times until the drone's services were found: let the last unlocking end
    lab.listen(1.5)
    assert mode(telemetry) is Mode.IDLE
    assert "/cf1/notify_setpoints_stop: no more set-points" in controller.output
    lab.ask(services.Takeoff, "cf1/takeoff", height=0.6, duration=Duration(sec=2))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.6), 0.1)

    begin = len(poses)
    lab.go_to("cf1", (0.3, 0.0, 0.6))
    lab.wait_for_flight("cf1", poses, (0.3, 0.0, 0.6))
    assert mode(telemetry) is Mode.FLY
    assert lab.ask(Trigger, interfaces.service_of("cf1", "hand_over")).success
    lab.wait(lambda: "/cf1/go_to: hold the place" in controller.output, "the hand-over")
    lab.listen(4.0)  # longer than the watchdogs wait
    assert mode(telemetry) is Mode.IDLE
    assert min(pose.pose.position.z for pose in poses[begin:]) > 0.4
    where = np.array([(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in poses[-100:]])
    assert np.ptp(where, axis=0).max() < 0.05

    lab.ask(services.Land, "cf1/land", height=0.02, duration=Duration(sec=2))
    lab.wait(lambda: height(poses) < 0.01, "the landing")


def test_a_drone_taken_back_at_once_is_not_cut(lab: Lab) -> None:
    poses, telemetry = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.6))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.6))
    begin = len(poses)
    assert lab.ask(Trigger, interfaces.service_of("cf1", "hand_over")).success
    lab.wait(lambda: mode(telemetry) is Mode.IDLE, "silence")
    lab.go_to("cf1", (0.0, 0.0, 0.6))
    lab.listen(2.0)
    assert mode(telemetry) is Mode.FLY
    assert min(pose.pose.position.z for pose in poses[begin:]) > 0.4


@pytest.mark.parametrize("pause", [0.0, 2.0])
def test_the_end_of_the_controller_leaves_a_drone_that_was_handed_over_in_the_air(lab: Lab, pause: float) -> None:
    poses, commands = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.COMMAND, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    controller = lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.8))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.8))
    assert lab.ask(Trigger, interfaces.service_of("cf1", "hand_over")).success
    lab.listen(pause)
    sent = len(commands)
    assert controller.stop(signal.SIGINT) == 0
    lab.listen(4.0)
    assert len(commands) == sent
    assert height(poses) > 0.5


def test_after_a_landing_the_drones_own_commander_may_take_off(lab: Lab) -> None:
    poses, telemetry = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    controller = lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.5))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.5))
    assert lab.ask(Trigger, interfaces.service_of("cf1", "land")).success
    lab.wait(lambda: telemetry and mode(telemetry) is Mode.IDLE, "the end of the rest")
    lab.wait(lambda: "/cf1/notify_setpoints_stop: no more set-points" in controller.output, "the notice")
    lab.listen(0.5)
    lab.ask(services.Takeoff, "cf1/takeoff", height=0.5, duration=Duration(sec=2))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.5), 0.1)


def test_a_drones_status_tells_of_its_battery(lab: Lab) -> None:
    topic = crazyswarm.installed_status_topic()
    assert topic is not None
    lab.fly("cf1")
    takeoff = interfaces.service_of("cf1", "takeoff")

    def is_told() -> bool:
        lab.publish(topic, "cf1", topic.kind(battery_voltage=3.1))
        lab.listen(0.2)
        return "cf1: takeoff refused: battery = 3.10 V: must be above 3.3 V" in lab.ask(Trigger, takeoff).message

    lab.wait(is_told, "the status to arrive")
    told = lab.watch(topic, "cf1")
    lab.start("sim_drone", robot_names=["cf1"], battery_voltage=3.15)
    lab.wait(lambda: told and told[-1].pm_state == topic.kind.PM_STATE_LOW_POWER, "the firmware's own warning")
    assert told[0].pm_state == topic.kind.PM_STATE_BATTERY
    assert told[-1].header.frame_id == "cf1"
    assert told[-1].battery_voltage == pytest.approx(3.15)
    assert "battery = 3.15 V" in lab.ask(Trigger, takeoff).message
