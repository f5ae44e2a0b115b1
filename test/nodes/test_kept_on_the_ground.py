"""The controller as a process, on simulated time: what keeps drones on the ground, or ends their take-off."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from room import Room, rooms
from std_srvs.srv import SetBool

from flatsat_ros.flight.modes import Mode
from flatsat_ros.nodes.crazyswarm import SETTLING_TIME
from flatsat_ros.nodes.rivals import Ear, Heard
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.diagnostics import Level

pytestmark = pytest.mark.in_process


@pytest.fixture
def room() -> Iterator[Callable[..., Room]]:
    """How to make a room; it is left after the test."""
    with rooms() as make:
        yield make


def transitions(capfd: pytest.CaptureFixture[str]) -> list[str]:
    """The lines of the log about changes of flight modes."""
    return [line for line in capfd.readouterr().err.splitlines() if " -> " in line]


def blind_before_take_off(room: Callable[..., Room]) -> Room:
    """Return a room whose drone cf1 is not seen any more while its lock is opened for a take-off."""
    lab = room("-p", "unlock_time:=0.6")  # longer than the poses need to be stale
    lab.run(0.5)
    assert lab.ask("cf1/flatsat/takeoff").success
    lab.run(0.1)
    lab.blind = {0}
    return lab


def test_a_take_off_whose_poses_pause_is_carried_out_and_every_transition_is_logged(
    room: Callable[..., Room], capfd: pytest.CaptureFixture[str]
) -> None:
    lab = blind_before_take_off(room)
    lab.run(4.0)
    assert lab.modes[0] is Mode.UNLOCK, "it waits for poses that pause"
    lab.blind = set()
    lab.run(3.0)
    assert lab.fleet.bodies.position[0, 2] > 0.3
    lines = transitions(capfd)
    assert [line.split(": ")[2] for line in lines] == ["IDLE -> UNLOCK", "UNLOCK -> FLY"]
    assert not [line for line in lines if "ERROR" in line]


def test_a_take_off_that_ends_before_it_begins_is_told_as_an_error(
    room: Callable[..., Room], capfd: pytest.CaptureFixture[str]
) -> None:
    lab = blind_before_take_off(room)
    lab.run(8.0)
    assert lab.modes[0] is Mode.IDLE
    lines = transitions(capfd)
    assert [line.split(": ")[2] for line in lines] == ["IDLE -> UNLOCK", "UNLOCK -> IDLE"]
    assert ["ERROR" in line for line in lines] == [False, True]
    assert "the take-off is given up: no usable pose" in lines[1]


@pytest.mark.parametrize("taken_after", [0.0, 0.1, 0.29, 2.0])
def test_a_drone_whose_commands_arrive_a_while_after_somebody_takes_them_is_unlocked_and_takes_off(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], taken_after: float
) -> None:
    """Who takes commands learns of their sender later than the sender of it: what is sent between is lost."""
    lab = room()
    lab.run(0.5)
    link = {"taken": False, "heard": False}
    wire = lab.wires[0]
    monkeypatch.setattr(wire, "get_subscription_count", lambda: int(link["taken"]))
    take = wire._take
    monkeypatch.setattr(wire, "_take", lambda setpoint: take(setpoint) if link["heard"] else None)
    assert lab.ask("cf1/flatsat/takeoff").success
    lab.run(taken_after)
    link["taken"] = True
    lab.run(0.6)
    link["heard"] = True
    lab.run(6.0)
    assert lab.fleet.bodies.position[0, 2] > 0.3
    assert [line.split(": ")[2] for line in transitions(capfd)] == ["IDLE -> UNLOCK", "UNLOCK -> FLY"]


def test_a_drone_that_is_found_when_a_recorder_takes_its_commands_already_is_unlocked_and_takes_off(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """So is one whose simulator was killed, which stays listed for a while, and started again."""
    lab = room()
    lab.run(0.5)
    wire, takers, heard = lab.wires[0], [1], []
    monkeypatch.setattr(wire, "get_subscription_count", lambda: takers[0])
    take = wire._take
    monkeypatch.setattr(wire, "_take", lambda setpoint: take(setpoint) if heard else None)
    assert lab.ask("cf1/flatsat/takeoff").success
    lab.run(0.7)
    takers[0] = 2
    lab.run(0.5)
    heard.append(True)
    lab.run(6.0)
    assert lab.fleet.bodies.position[0, 2] > 0.3
    assert [line.split(": ")[2] for line in transitions(capfd)] == ["IDLE -> UNLOCK", "UNLOCK -> FLY"]


def test_who_takes_the_newest_command_alone_and_is_late_by_a_second_gets_a_zero(room: Callable[..., Room]) -> None:
    lab = room()
    for _ in range(2):  # from IDLE, and once more when nothing has been sent for a while
        lab.run(0.5)
        sent = len(lab.wires[0].sent)
        assert lab.ask("cf1/flatsat/takeoff").success
        lab.run(0.98)
        thrusts = [setpoint.thrust for setpoint in lab.wires[0].sent[sent:]]
        assert len(thrusts) >= 48
        assert not any(thrusts)
        lab.run(5.0)
        assert lab.fleet.bodies.position[0, 2] > 0.3
        assert lab.ask("cf1/flatsat/land").success
        lab.run(12.0)
        assert lab.modes[0] is Mode.IDLE


def test_who_arms_a_drone_is_told_when_others_may_fly_it(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.blind = {0}
    lab.run(0.5)
    told = [lab.ask(f"cf{number}/flatsat/arm", SetBool, data=True).message for number in (1, 2)]
    assert ["its place is not known: once it is, arm it again" in text for text in told] == [True, False], told
    lab.blind = set()
    lab.run(0.5)
    subscribers = [0]
    monkeypatch.setattr(lab.wires[0], "get_subscription_count", lambda: subscribers[0])
    told = lab.ask("cf1/flatsat/arm", SetBool, data=True).message
    assert told.endswith("the thrust lock opens once somebody takes the commands of cf1"), told
    subscribers[0] = 1
    told = lab.ask("cf1/flatsat/arm", SetBool, data=True).message
    assert "let others fly the drone after" in told
    seconds = float(told.split(" after ")[1].split()[0])
    lab.run(seconds)
    assert lab.modes[0] is Mode.IDLE
    assert not lab.fleet.firmware.thrust_locked[0]


@pytest.mark.parametrize("certificate", ["cf21_tight_10hz", "cf21_adaptive_50hz", "cf21_adaptive_100hz"])
def test_who_arms_a_drone_is_told_a_time_at_which_its_link_knows_that_no_set_points_follow(
    room: Callable[..., Room], certificate: str
) -> None:
    lab = room("-p", f"certificate:={certificate}")
    for _ in range(3):
        lab.run(0.5)
        told = lab.ask("cf1/flatsat/arm", SetBool, data=True).message
        lab.run(float(told.split(" after ")[1].split()[0]) - SETTLING_TIME)
        assert lab.modes[0] is Mode.IDLE


def test_who_arms_a_drone_that_is_about_to_take_off_is_not_told_to_let_others_fly_it(room: Callable[..., Room]) -> None:
    lab = room()
    lab.run(0.5)
    assert lab.ask("cf1/flatsat/takeoff").success
    lab.run(0.2)
    assert "others" not in lab.ask("cf1/flatsat/arm", SetBool, data=True).message
    lab.run(1.5)
    assert lab.modes[0] is Mode.FLY


def test_while_another_sends_set_points_or_poses_no_drone_takes_off(
    room: Callable[..., Room], capfd: pytest.CaptureFixture[str]
) -> None:
    """Over DDS, but for the clock: who only publishes and is silent keeps nobody on the ground for long."""
    lab = room()
    rivals = lab.node._rivals
    lab.run(0.5)
    other = rclpy.create_node("rival", namespace="/lab")
    command, first, second = (
        other.create_publisher(t.kind, f"/{t.of('cf1')}", 10)
        for t in (interfaces.COMMAND, interfaces.POSE, interfaces.POSE)
    )

    def look(until: Callable[[], object]) -> None:
        for _ in range(200):
            rivals.look_around()
            if until():
                return
            rclpy.spin_once(other, timeout_sec=0.05)
        pytest.fail("nothing is heard")

    def refusal() -> str:
        answer = lab.ask("cf1/flatsat/takeoff")
        return "" if answer.success else str(answer.message)

    look(lambda: len(rivals._ears) == 2 and "is known after 2 s" in refusal())
    lab.run(2.5)
    look(lambda: not lab.node._pilot.clearance._reasons)

    for message in (Twist(), Twist()):
        command.publish(message)
    for publisher in (first, second, first, second):
        publisher.publish(PoseStamped())
    look(lambda: "cmd_vel_legacy" in rivals.of(0) and "pose" in rivals.of(0))
    answer = lab.ask("all/flatsat/takeoff")
    assert not answer.success
    assert (
        "cf1: takeoff refused: more than one sends cf1/cmd_vel_legacy, of its publishers /flatsat_controller, "
        "/lab/rival; more than one sends cf1/pose, of its publishers /lab/rival, /lab/rival: stop all but one"
    ) in answer.message
    assert "cf2" not in answer.message
    lab.goal("cf1", 0.0, 0.0, 1.0)
    assert "stop all but one" in lab.node.faults.newest("cf1")
    lab.run(1.5)
    assert lab.modes == [Mode.IDLE, Mode.FLY]
    status, _ = lab.node._report(0)
    assert status.level is Level.ERROR
    assert status.text.startswith("IDLE: more than one sends cf1/cmd_vel_legacy")

    lab.run(2.5)
    first.publish(PoseStamped())
    rclpy.spin_once(other, timeout_sec=0.2)
    look(lambda: not rivals.of(0))
    assert refusal() == "", "listed, but silent"
    for publisher in (command, first, second):
        other.destroy_publisher(publisher)
    look(lambda: not rivals._ears)
    other.destroy_node()
    said = capfd.readouterr().err
    assert said.count("cf1: no take-off: more than one sends") == 1
    assert "cf1: one controller and one source of poses again" in said


@pytest.mark.parametrize("waits", [True, False])
def test_a_rival_that_appears_before_the_motors_start_calls_the_take_off_off(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], waits: bool
) -> None:
    lab = room()
    rivals: list[str] = []
    monkeypatch.setattr(lab.node, "count_publishers", lambda topic: 2 if topic in rivals else 1)
    monkeypatch.setattr(Ear, "listen", lambda *_, **__: Heard.SEVERAL)
    lab.run(0.5)
    lab.blind = {0} if waits else set()
    lab.run(1.0)
    for robot in ("cf1", "cf2"):
        lab.goal(robot, float(robot == "cf2"), 0.0, 1.0)
    lab.run(0.1)
    assert lab.modes == [Mode.IDLE if waits else Mode.UNLOCK, Mode.UNLOCK]
    rivals.append("cf1/pose")
    lab.node._rivals._openings = 1
    lab.blind = set()
    lab.run(2.0)
    assert lab.modes == [Mode.IDLE, Mode.FLY]
    assert not any(sent.thrust for sent in lab.wires[0].sent)
    said = capfd.readouterr().err
    assert said.count("cf1: its take-off is called off: more than one sends cf1/pose") == 1
    rivals.clear()
    lab.node._look_around()
    lab.run(2.0)
    assert lab.modes[0] is Mode.IDLE, "motors start when somebody asks for it only"
    lab.goal("cf1", 0.0, 0.0, 1.0)
    lab.run(1.5)
    assert lab.modes[0] is Mode.FLY


def test_an_empty_battery_lands_its_drone_and_keeps_it_down(room: Callable[..., Room]) -> None:
    lab = room()
    lab.hover("cf1", "cf2")

    def discharge(voltage: float, seconds: int) -> None:
        for _ in range(seconds):
            lab.deliver("cf1/battery", messages.battery_message(0, voltage))
            lab.run(1.0)

    discharge(3.25, 4)
    assert lab.node._report(0)[0].text == "FLY: battery low"
    discharge(3.1, 4)
    lab.goal("cf1", 0.0, 0.0, 2.0)
    assert "battery = 3.10 V: must be above 3.3 V" in lab.node.faults.newest("cf1")
    lab.run(9.0)
    assert lab.modes == [Mode.IDLE, Mode.FLY]
    assert lab.fleet.bodies.grounded.tolist() == [True, False]
    assert "cf1: takeoff refused: battery = 3.10 V" in lab.ask("cf1/flatsat/takeoff").message
    status, other = lab.node._report(0)
    assert (status.level, status.text, status.values["battery V"]) == (Level.ERROR, "IDLE: battery empty", "3.10")
    assert (other.level, other.values["battery V"]) == (Level.OK, "nan")


def test_crazyswarm2s_status_tells_of_the_battery_and_of_a_drone_that_is_not_armed(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where its interfaces are installed; with a stand-in for the type."""
    monkeypatch.setitem(sys.modules, "crazyflie_interfaces", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "crazyflie_interfaces.msg", SimpleNamespace(Status=Twist))
    lab = room("-p", "lift_off_time:=0.5")
    lab.run(0.5)
    lab.deliver("cf1/status", SimpleNamespace(battery_voltage=3.1, pm_state=0, supervisor_info=3))
    lab.deliver("cf2/status", SimpleNamespace(battery_voltage=4.0, pm_state=0, supervisor_info=1))
    answer = lab.ask("all/flatsat/takeoff")
    assert "cf1: takeoff refused: battery = 3.10 V: must be above 3.3 V" in answer.message
    told = "its status says that it is not armed: call cf2/flatsat/arm"
    assert answer.message.endswith(f"cf2: {told}")
    lab.fleet.firmware.request_emergency(1)  # it does not climb
    lab.run(4.0)
    assert lab.modes[1] is Mode.FALLEN
    lines = transitions(capfd)
    assert sum(told in line for line in lines) == 2
    lab.deliver("cf2/status", SimpleNamespace(battery_voltage=4.0, pm_state=0, supervisor_info=3))
    assert lab.ask("cf2/flatsat/arm", SetBool, data=True).success
    lab.run(1.0)
    assert not lab.ask("cf2/flatsat/takeoff").message
