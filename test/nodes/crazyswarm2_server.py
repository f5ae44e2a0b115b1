"""The controller on crazyswarm2's own Python server, and simulated drones behind that: `make test-crazyswarm2`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from crtp_endpoint import heights, setpoints, state
from geometry_msgs.msg import Point, TransformStamped
from std_srvs.srv import Empty, SetBool, Trigger
from udp_server import Server

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.flight.modes import Mode
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.sim.dynamics import Wind
from flatsat_ros.sim.state_machine import State

if TYPE_CHECKING:
    from conftest import Lab, Process

capture = pytest.importorskip("motion_capture_tracking_interfaces.msg", reason="PACKAGES: the server needs them")
services = pytest.importorskip("crazyflie_interfaces.srv")


@pytest.fixture
def serve(lab: Lab, tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """How to start a server and its drones."""
    servers: list[Server] = []

    def make(*places: Sequence[float], **settings: Any) -> Server:
        named = {f"cf{number + 1}": place for number, place in enumerate(places or ((0.0, 0.0, 0.0),))}
        servers.append(Server(lab, tmp_path, named, **settings))
        return servers[-1]

    yield make
    for server in servers:
        server.drones.close()


def fly(lab: Lab, server: Server, **parameters: object) -> Process:
    """Start the controller for the drones, with the certificate for their rate if no other is given."""
    given: dict[str, object] = {"certificate": "cf21_50hz", **parameters}
    controller = lab.fly(*server.robots, **given)
    for robot in server.robots:
        lab.wait(lambda robot=robot: f"{robot}: backend cflib" in controller.output, f"the back end of {robot}")
    return controller


def take_off(lab: Lab, server: Server, *robots: str) -> None:
    """Send drones up, as soon as the controller agrees."""
    for robot in robots or server.robots:
        name = interfaces.service_of(robot, "takeoff")
        lab.wait(lambda name=name: lab.ask(Trigger, name).success, f"{robot} to take off")


def test_take_off_goals_landing_and_a_second_flight(lab: Lab, serve: Callable[..., Server]) -> None:
    server = serve(yaw=0.7)
    controller = fly(lab, server, takeoff_height=0.6)
    assert "cf1: backend cflib: cf1/add_logging is offered" in controller.output
    assert "cf1: poses from cf1/pose" in controller.output
    assert server.drones.drones[0].parameters == {"stabilizer.controller": 1, "flightmode.stabModeYaw": 0}
    for goal in ((0.5, -0.4, 0.8), (-0.3, 0.2, 0.5)):
        take_off(lab, server)
        server.wait_until_near((*server.drones.fleet.bodies.position[0, :2], 0.6), near=0.15)
        lab.go_to("cf1", goal)
        server.wait_until_near(goal)
        lab.land("cf1")
        assert heights(server.drones)[0] < 0.02
        lab.listen(3.0)
        assert state(server.drones) not in (State.LOCKED, State.CRASHED)


def test_a_drone_is_handed_over_in_the_air_and_taken_back(lab: Lab, serve: Callable[..., Server]) -> None:
    server = serve()
    controller = fly(lab, server, takeoff_height=0.8)
    take_off(lab, server)
    server.wait_until_near((0.0, 0.0, 0.8))
    begin = len(server.poses["cf1"])
    assert lab.ask(Trigger, interfaces.service_of("cf1", "hand_over")).success
    lab.wait(lambda: "/cf1/go_to: hold the place" in controller.output, "the hand-over")
    lab.listen(4.0)  # longer than the watchdogs wait
    sent = len(setpoints(server.drones))
    assert server.mode() is Mode.IDLE
    lab.ask(services.GoTo, "cf1/go_to", goal=Point(x=0.4, z=0.8), duration=Duration(sec=2))
    server.wait_until_near((0.4, 0.0, 0.8), near=0.1)
    assert len(setpoints(server.drones)) == sent, "the drone is its own commander's"
    lab.go_to("cf1", (0.0, 0.0, 0.8))
    server.wait_until_near((0.0, 0.0, 0.8))
    assert min(pose.pose.position.z for pose in server.poses["cf1"][begin:]) > 0.6
    lab.land("cf1")
    lab.ask(services.Takeoff, "cf1/takeoff", height=0.5, duration=Duration(sec=2))
    server.wait_until_near((*server.drones.fleet.bodies.position[0, :2], 0.5), near=0.1)


def test_two_drones_fly_at_the_same_time(lab: Lab, serve: Callable[..., Server]) -> None:
    server = serve((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    fly(lab, server)
    take_off(lab, server)
    goals = {"cf1": (0.8, 0.0, 0.7), "cf2": (-0.8, 1.0, 1.0)}
    for robot, goal in goals.items():
        lab.go_to(robot, goal)
    for robot, goal in goals.items():
        server.wait_until_near(goal, robot)
    lab.land(*goals)
    assert (heights(server.drones) < 0.02).all()


def test_after_an_emergency_a_restart_of_the_server_and_a_power_cycle_nothing_starts_unasked(
    lab: Lab, serve: Callable[..., Server]
) -> None:
    server = serve()
    controller = fly(lab, server)
    take_off(lab, server)
    server.wait_until_near((0.0, 0.0, 0.5))
    lab.ask(Empty, "all/emergency")
    lab.wait(lambda: state(server.drones) is State.LOCKED, "the motors to stop")
    lab.wait(lambda: heights(server.drones)[0] < 0.02, "the fall")
    server.stop()
    lab.wait(lambda: "cf1: nobody takes its set-points any more: its link has ended" in controller.output, "the notice")
    sent = len(setpoints(server.drones))
    server.power_cycle()
    server.start()
    lab.listen(6.0)
    assert server.thrusts(sent) <= {0}
    assert heights(server.drones)[0] < 0.02
    assert "motors stopped until armed" in controller.output
    lab.ask(SetBool, interfaces.service_of("cf1", "arm"), data=True)
    take_off(lab, server)
    server.wait_until_near((*server.drones.fleet.bodies.position[0, :2], 0.5))


@pytest.mark.parametrize("flying", [False, True])
def test_a_server_that_restarts_starts_no_motors_and_loses_no_take_off(
    lab: Lab, serve: Callable[..., Server], flying: bool
) -> None:
    server = serve()
    controller = fly(lab, server)
    if flying:
        take_off(lab, server)
        server.wait_until_near((0.0, 0.0, 0.5))
    server.stop()
    lab.wait(lambda: "its link has ended" in controller.output, "the notice")
    if flying:
        lab.wait(lambda: state(server.drones) is State.LOCKED, "the firmware to give up")
        server.power_cycle()
    sent = len(setpoints(server.drones))
    server.start()
    lab.wait(lambda: controller.output.count("cf1: backend cflib") == 2, "the back end of the new server")
    lab.listen(4.0)
    assert server.thrusts(sent) <= {0}
    if flying:
        lab.ask(SetBool, interfaces.service_of("cf1", "arm"), data=True)
    take_off(lab, server)
    server.wait_until_near((*server.drones.fleet.bodies.position[0, :2], 0.5))


def test_after_a_power_cycle_no_drone_takes_off_until_the_server_is_restarted(
    lab: Lab, serve: Callable[..., Server]
) -> None:
    """The server does not ask the drone for poses again."""
    server = serve()
    fly(lab, server)
    server.power_cycle()
    lab.listen(2.0)
    answer = lab.ask(Trigger, interfaces.service_of("cf1", "takeoff"))
    assert "fresh poses" in answer.message
    server.stop()
    server.start()
    take_off(lab, server)
    lab.wait(lambda: heights(server.drones)[0] > 0.3, "the take-off")


def test_a_brushless_drone_stays_until_it_is_armed_then_takes_off(lab: Lab, serve: Callable[..., Server]) -> None:
    server = serve(vehicle="brushless")
    controller = fly(lab, server, vehicle="brushless", certificate="paper_experiment", lift_off_time=2.0)
    take_off(lab, server)
    lab.wait(lambda: "FALLEN: not seen to leave" in controller.output, "the end of the attempt")
    assert "its status says that it is not armed: call cf1/flatsat/arm" in controller.output
    assert not server.drones.fleet.firmware.armed[0]
    assert heights(server.drones)[0] < 0.02
    arm = interfaces.service_of("cf1", interfaces.ARM)
    lab.wait(lambda: "/cf1/arm asked to arm" in lab.ask(SetBool, arm, data=True).message, "the arming")
    take_off(lab, server)
    server.wait_until_near((0.0, 0.0, 0.5), near=0.1)
    lab.land("cf1")
    assert heights(server.drones)[0] < 0.02


def test_poses_at_the_servers_default_of_10_hz_fly(lab: Lab, serve: Callable[..., Server]) -> None:
    server = serve(rate=10)
    fly(lab, server, certificate="paper_experiment")
    take_off(lab, server)
    server.wait_until_near((0.0, 0.0, 0.5), near=0.1)
    lab.go_to("cf1", (0.5, 0.0, 0.8))
    server.wait_until_near((0.5, 0.0, 0.8), near=0.1)
    lab.land("cf1")
    assert heights(server.drones)[0] < 0.02


def test_a_wrong_back_end_is_noticed_before_the_drone_has_gone_far(
    lab: Lab, serve: Callable[..., Server], column: Callable[..., FloatArray]
) -> None:
    # in still air a drone that begins exactly at its goal may hover on a wrong sign for ever
    server = serve(wind=Wind(gust=0.05))
    controller = lab.fly("cf1", certificate="cf21_50hz", backend="cpp")
    take_off(lab, server)
    lab.wait(lambda: server.mode() is Mode.DESCEND, "the controller to notice")
    modes, *error = (column(server.telemetry["cf1"], name) for name in ("mode", "error_x", "error_y"))
    away = np.hypot(*error)[np.flatnonzero(modes == Mode.DESCEND)[0] - 1]
    lab.wait(lambda: heights(server.drones)[0] < 0.02, "the landing")
    print(f"noticed {away:.2f} m away")
    assert away < 0.3
    assert "it does not move as commanded" in controller.output


@pytest.mark.parametrize("source", ["poses", "tf"])
def test_a_second_sender_about_a_drone_on_motion_captures_topics_is_noticed(lab: Lab, source: str) -> None:
    """One of another drone, on the same topic, is none."""
    kind = {"poses": ("motion_capture_tracking_interfaces.msg", "NamedPoseArray"), "tf": ("tf2_msgs.msg", "TFMessage")}
    message = getattr(pytest.importorskip(kind[source][0]), kind[source][1])

    def about(robot: str) -> Any:
        if source == "poses":
            seen = message()
            seen.poses = [capture.NamedPose(name=robot)]
            seen.header.stamp = lab.node.get_clock().now().to_msg()
            return seen
        transform = TransformStamped(child_frame_id=robot)
        transform.header.stamp = lab.node.get_clock().now().to_msg()
        return message(transforms=[transform])

    controller = lab.fly("cf1", "cf2", pose_source=source)
    first, second = (lab.node.create_publisher(message, f"/{source}", 10) for _ in range(2))
    timers = [
        lab.node.create_timer(0.02, lambda: first.publish(about("cf1"))),
        lab.node.create_timer(0.02, lambda: second.publish(about("cf2"))),
    ]
    lab.wait(lambda: all(f"{robot}: poses from /{source}" in controller.output for robot in ("cf1", "cf2")), "poses")
    lab.listen(5.0)
    assert "more than one sends" not in controller.output
    timers.append(lab.node.create_timer(0.05, lambda: second.publish(about("cf1"))))
    lab.wait(lambda: f"cf1: no take-off: more than one sends /{source} about cf1" in controller.output, "the notice")
    answer = lab.ask(Trigger, interfaces.service_of("cf1", "takeoff"))
    assert f"more than one sends /{source} about cf1, of its publishers /observer, /observer" in answer.message
    assert "cf2: no take-off" not in controller.output
    for timer in timers:
        timer.cancel()
