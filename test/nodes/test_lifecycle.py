"""The life-cycle services over DDS."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

from std_srvs.srv import SetBool, Trigger

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab


def test_drones_are_disarmed_armed_flown_and_landed_by_services_of_one_and_of_all(lab: Lab) -> None:
    robots, everybody = ("cf1", "cf2"), interfaces.ALL
    poses = {robot: lab.watch(interfaces.POSE, robot) for robot in robots}
    telemetry = {robot: lab.watch(interfaces.TELEMETRY, robot) for robot in robots}
    lab.start("sim_drone", robot_names=list(robots))
    controller = lab.fly(*robots, takeoff_height=0.4)
    # who is armed before the controller knows where it is, is not unlocked by that
    lab.wait(lambda: all(len(poses[robot]) > 50 and telemetry[robot] for robot in robots), "poses and telemetry")

    def modes_of(robot: str, since: int) -> set[Mode]:
        return {Mode(int(row.data[FIELDS.index("mode")])) for row in telemetry[robot][since:]}

    def modes() -> set[Mode]:
        return set().union(*(modes_of(robot, -1) for robot in robots))

    def trigger(who: str, name: str) -> Any:
        return lab.ask(Trigger, interfaces.service_of(who, name))

    def arm(who: str, wanted: bool) -> Any:
        return lab.ask(SetBool, interfaces.service_of(who, "arm"), data=wanted)

    for who, named in (("cf1", ("cf1",)), (everybody, robots)):
        lab.wait(lambda: modes() == {Mode.IDLE}, "the end of the unlocking that arming begins")
        refused = trigger(who, "land")
        assert not refused.success
        for robot in named:
            assert (
                f"{robot}: land refused: the drone is in IDLE: only one in FLY or LEVEL or DESCEND can land"
                in refused.message
            )
        assert arm(who, False).success
        assert "disarmed: arm it first" in trigger(who, "takeoff").message
        seen = {robot: len(telemetry[robot]) for robot in named}
        assert arm(who, True).success
        lab.wait(lambda seen=seen: all(Mode.UNLOCK in modes_of(robot, seen[robot]) for robot in seen), "the unlocking")
    # refused until the controller, too, has seen enough poses
    for who in ("cf1", everybody):
        lab.wait(lambda who=who: trigger(who, "takeoff").success, f"the take-off of {who}")
    for number, robot in enumerate(robots):
        lab.wait_for_flight(robot, poses[robot], (float(number), 0.0, 0.4))
    assert "land it first" in arm("cf1", False).message
    assert "land it first" in arm(everybody, False).message
    assert trigger("cf1", "land").success
    assert trigger(everybody, "land").success
    lab.wait(lambda: modes() == {Mode.REST}, "the touch-down")
    assert max(seen[-1].pose.position.z for seen in poses.values()) < 0.02
    lab.wait(lambda: modes() == {Mode.IDLE}, "the end of the rest")
    commands = lab.watch(interfaces.COMMAND, "cf1")
    lab.listen(0.5)
    # by now somebody else may fly the drones
    assert controller.stop(signal.SIGINT) == 0
    lab.listen(0.5)
    assert commands == []


def test_a_drone_handed_over_gets_no_last_command_and_is_not_disarmed(lab: Lab) -> None:
    poses, telemetry = lab.watch(interfaces.POSE, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    lab.start("sim_drone", robot_names=["cf1"])
    controller = lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.5))
    lab.wait_for_flight("cf1", poses, (0.0, 0.0, 0.5))
    refused = lab.ask(Trigger, interfaces.service_of("cf1", "hand_over"))
    if not refused.success:  # without crazyflie_interfaces nobody is there to hold it
        assert "nobody is there to take over" in refused.message
        assert telemetry[-1].data[FIELDS.index("mode")] == Mode.FLY
        lab.set_parameters({"hand_over_force": True})
        assert lab.ask(Trigger, interfaces.service_of("cf1", "hand_over")).success
    lab.wait(lambda: telemetry[-1].data[FIELDS.index("mode")] == Mode.IDLE, "silence")
    commands = lab.watch(interfaces.COMMAND, "cf1")
    refused = lab.ask(SetBool, interfaces.service_of("cf1", "arm"), data=False)
    assert not refused.success
    assert "flown by somebody else: land it first" in refused.message
    assert controller.stop(signal.SIGINT) == 0
    lab.listen(0.5)
    assert commands == []
