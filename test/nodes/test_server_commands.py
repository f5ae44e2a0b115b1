"""What sim_server takes and tells in the words of crazyswarm2's packages, with stand-ins for their messages."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import crazyflie_standins
import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Quaternion, TransformStamped, Vector3

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.nodes.ros import interfaces, server_messages
from flatsat_ros.nodes.ros.faults import Faults
from flatsat_ros.nodes.server_commands import Drone, ServerCommands
from flatsat_ros.nodes.server_logging import ServerLogging
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.position_controller import SetpointMode

pytestmark = pytest.mark.in_process


class Node:
    """A node that keeps what it is told to offer; no ROS beneath.

    Attributes:
        services: callbacks by name, in the order of their offer.
        topics: callbacks of subscriptions by name.
        published: messages by topic, of publishers that are there.
        timers: of (period, callback).
        told: lines of its log.
    """

    def __init__(self) -> None:
        self.services: dict[str, tuple[Any, Callable[[Any, Any], Any]]] = {}
        self.topics: dict[str, tuple[Any, Callable[[Any], Any]]] = {}
        self.published: dict[str, list[Any]] = {}
        self.timers: list[SimpleNamespace] = []
        self.told: list[str] = []
        logger: Any = SimpleNamespace(error=self.told.append, warning=self.told.append, info=self.told.append)
        self.get_logger = lambda: logger
        self.faults = Faults(logger)

    def create_service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> None:
        self.services[name] = kind, callback

    def create_subscription(self, kind: Any, name: str, callback: Callable[[Any], Any], _qos: Any) -> None:
        self.topics[name] = kind, callback

    def create_publisher(self, _kind: Any, name: str, _qos: Any) -> Any:
        sent = self.published.setdefault(name, [])
        return SimpleNamespace(publish=sent.append, name=name)

    def destroy_publisher(self, publisher: Any) -> None:
        del self.published[publisher.name]

    def create_timer(self, period: float, callback: Callable[[], Any]) -> SimpleNamespace:
        self.timers.append(SimpleNamespace(period=period, callback=callback))
        return self.timers[-1]

    def destroy_timer(self, timer: SimpleNamespace) -> None:
        self.timers.remove(timer)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=5_000_000_000))

    def ask(self, name: str, **fields: Any) -> Any:
        """Call a service."""
        kind, callback = self.services[name]
        return callback(kind.Request(**fields), kind.Response())

    def send(self, name: str, **fields: Any) -> None:
        """Let a message come."""
        kind, callback = self.topics[name]
        callback(kind(**fields))


class Room:
    """Two simulated drones and what a server offers for them."""

    def __init__(self, modules: dict[str, ModuleType], vehicle: str = "cf21") -> None:
        self.node, self.modules = Node(), modules
        self.fleet = SimulatedFleet(load_vehicle(vehicle), 2, start=[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        self.drones = [Drone(f"cf{number + 1}", self.fleet, number) for number in range(2)]
        self.advanced = 0
        ServerCommands(self.node, self.drones, self._advance)  # type: ignore[arg-type]
        self.wait(0.2)

    def _advance(self) -> None:
        self.advanced += 1

    def wait(self, seconds: float) -> None:
        self.fleet.advance_to(self.fleet.time + seconds)

    @property
    def places(self) -> np.ndarray:
        return self.fleet.bodies.position

    def piece(self, seconds: int, **polynomials: list[float]) -> Any:
        """A piece of a trajectory; what is not given is 0."""
        full = {f"poly_{axis}": polynomials.get(axis, [0.0] * 8) for axis in ("x", "y", "z", "yaw")}
        return self.modules["crazyflie_interfaces.msg"].TrajectoryPolynomialPiece(
            duration=Duration(sec=seconds), **full
        )


@pytest.fixture
def modules() -> Iterator[dict[str, ModuleType]]:
    with pytest.MonkeyPatch.context() as patch:
        yield crazyflie_standins.install(patch)


@pytest.fixture
def room(modules: dict[str, ModuleType]) -> Room:
    return Room(modules)


def test_scripts_find_all_that_they_wait_for_and_the_emergency_stop_of_all_last(room: Room) -> None:
    own = ("arm", "emergency", "takeoff", "land", "go_to", "upload_trajectory", "start_trajectory")
    expected = {f"{who}/{name}" for who in ("cf1", "cf2", "all") for name in (*own, "notify_setpoints_stop")}
    assert set(room.node.services) == expected
    assert list(room.node.services)[-1] == "all/emergency"
    streams = {
        f"{who}/{name}" for who in ("cf1", "cf2") for name in ("cmd_position", "cmd_velocity_world", "cmd_hover")
    }
    assert set(room.node.topics) == streams | {f"{who}/cmd_full_state" for who in ("cf1", "cf2", "all")}


def test_a_script_flies_one_drone_and_then_all(room: Room) -> None:
    room.node.ask("cf1/takeoff", height=0.5, duration=Duration(sec=1))
    room.wait(2.5)
    assert room.places[:, 2] == pytest.approx([0.5, 0.0], abs=0.1)
    room.node.ask("all/go_to", goal=Point(x=0.3, z=0.4), relative=True, duration=Duration(sec=1))
    room.wait(5.0)
    assert room.places[:, 0] == pytest.approx([0.3, 1.3], abs=0.05)
    room.node.ask("all/land", height=0.02, duration=Duration(sec=1))
    room.wait(2.5)
    assert room.places[:, 2] == pytest.approx([0.0, 0.0], abs=0.01)
    assert room.advanced == 3, "each command acts at the time at which it came"


def test_an_uploaded_trajectory_is_flown_by_the_groups_asked_for(room: Room) -> None:
    rise = room.piece(2, z=[0.0, 0.25, *[0.0] * 6])
    room.node.ask("all/upload_trajectory", trajectory_id=7, piece_offset=0, pieces=[rise])
    room.fleet.firmware.high_level.group_mask[:] = 0b1, 0b10
    room.node.ask("all/start_trajectory", trajectory_id=7, timescale=0.5, relative=True, group_mask=0b10)
    room.wait(3.0)
    assert room.places[:, 2] == pytest.approx([0.0, 0.5], abs=0.1)
    room.node.ask("cf1/start_trajectory", trajectory_id=7, timescale=0.5, reversed=True)
    room.wait(0.02)
    assert room.fleet.firmware.high_level.goal[2, 0] == pytest.approx(0.5, abs=0.02), "from its end"


@pytest.mark.parametrize(
    ("pieces", "reason"),
    [
        ([{"z": [0.0] * 9}], "coefficients of a piece"),
        ([{**{axis: [0.0] * 9 for axis in ("x", "y", "z", "yaw")}}], r"shape of coefficients of a piece = (9, 4)"),
        ([{"z": [math.nan] * 8}], "an entry of coefficients of a piece = nan"),
        ([], "pieces of a trajectory = 0"),
    ],
)
def test_a_trajectory_that_is_none_is_refused_and_told(
    room: Room, pieces: list[dict[str, list[float]]], reason: str
) -> None:
    uploaded = [room.piece(1, **polynomials) for polynomials in pieces]
    room.node.ask("cf1/upload_trajectory", trajectory_id=0, piece_offset=0, pieces=uploaded)
    assert reason in room.node.told[-1]
    assert room.node.faults.count("cf1") == 1


def test_a_trajectory_that_a_real_drone_could_not_hold_is_told(room: Room) -> None:
    uploaded = [room.piece(1)] * 32
    room.node.ask("cf1/upload_trajectory", trajectory_id=0, piece_offset=0, pieces=uploaded)
    assert room.node.told == ["cf1/upload_trajectory: trajectory up to piece 32: a real drone holds 31"]
    assert not room.node.faults.counts


def test_set_points_mean_what_crazyswarm2s_server_makes_of_them(modules: dict[str, ModuleType]) -> None:
    """Yaw of cmd_position in degrees, yaw rates of cmd_velocity_world in deg/s and of cmd_hover in rad/s."""
    kinds = modules["crazyflie_interfaces.msg"]
    half = math.sqrt(0.5)
    turned = Pose(position=Point(x=1.0, y=2.0, z=3.0), orientation=Quaternion(z=half, w=half))
    expected = (
        (server_messages.full_state_from_message(kinds.FullState(pose=turned)), SetpointMode.FULL_STATE),
        (server_messages.position_from_message(kinds.Position(x=1.0, y=2.0, z=3.0, yaw=90.0)), SetpointMode.POSITION),
    )
    for setpoint, mode in expected:
        assert setpoint.mode is mode
        assert setpoint.place.tolist() == [1.0, 2.0, 3.0]
        assert setpoint.yaw == pytest.approx(math.pi / 2)
    velocity = server_messages.velocity_from_message(
        kinds.VelocityWorld(vel=Vector3(x=0.1, y=0.2, z=0.3), yaw_rate=180.0)
    )
    assert (velocity.mode, velocity.velocity.tolist(), velocity.yaw) == (
        SetpointMode.VELOCITY,
        [0.1, 0.2, 0.3],
        math.pi,
    )
    hover = server_messages.hover_from_message(kinds.Hover(vx=0.1, vy=-0.2, yaw_rate=0.5, z_distance=0.7))
    assert (hover.mode, hover.place[2], hover.velocity.tolist(), hover.yaw) == (
        SetpointMode.HOVER,
        0.7,
        [0.1, -0.2, 0.0],
        0.5,
    )


def test_a_set_point_flies_its_drone_and_one_that_is_no_number_is_counted(room: Room) -> None:
    for _ in range(100):
        room.node.send("cf2/cmd_position", x=1.0, z=0.4)
        room.wait(0.02)
    assert room.places[:, 2] == pytest.approx([0.0, 0.4], abs=0.15)
    room.node.send("cf2/cmd_hover", vx=math.nan)
    assert "cf2/cmd_hover: an entry of velocity = nan" in room.node.told[-1]
    room.node.send("all/cmd_full_state", pose=Pose(position=Point(z=1.0)))
    room.wait(0.02)
    assert (room.fleet.firmware.state > 0).all()


def test_all_are_armed_and_disarmed_together(modules: dict[str, ModuleType]) -> None:
    room = Room(modules, "brushless")
    room.node.ask("all/arm", arm=True)
    assert room.fleet.firmware.armed.all()
    room.node.ask("all/arm", arm=False)
    assert not room.fleet.firmware.armed.any()
    room.node.ask("cf1/emergency")
    room.wait(0.1)
    room.node.ask("all/arm", arm=True)
    assert "cf1: arming refused in state" in room.node.told[-1]
    assert room.fleet.firmware.armed.tolist() == [False, True]


def test_log_blocks_are_added_published_and_removed(room: Room) -> None:
    ServerLogging(room.node, room.drones)  # type: ignore[arg-type]
    block = {"topic_name": "mine", "frequency": 50, "vars": ["stateEstimate.x", "pm.vbatMV"]}
    assert room.node.ask("cf2/add_logging", **block).success
    (timer,) = room.node.timers
    assert timer.period == 0.02
    timer.callback()
    (message,) = room.node.published["cf2/mine"]
    assert list(message.values) == [1.0, 3800.0]
    assert (message.timestamp, message.header.stamp.sec) == (200, 5)
    assert not room.node.ask("cf2/add_logging", **block).success, "twice"
    assert room.node.ask("cf1/add_logging", topic_name="odom", frequency=10).success
    room.node.timers[-1].callback()
    assert room.node.published["cf1/odom"][0].child_frame_id == "cf1"
    assert room.node.ask("cf2/remove_logging", topic_name="mine").success
    assert "cf2/mine" not in room.node.published
    assert not room.node.ask("cf2/remove_logging", topic_name="mine").success


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        ({"topic_name": "pose", "frequency": 10}, "log topic pose: is published already"),
        ({"topic_name": "scan", "frequency": 10}, "has no Multi-ranger deck"),
        ({"topic_name": "mine", "frequency": 200, "vars": ["gyro.x"]}, "frequency of log topic mine = 200 Hz"),
        ({"topic_name": "mine", "frequency": 10}, "variables of log topic mine = 0"),
        ({"topic_name": "mine", "frequency": 10, "vars": ["gyro.w"]}, "the nearest is gyro."),
    ],
)
def test_a_log_block_that_cannot_be_is_refused_and_told(room: Room, block: dict[str, Any], reason: str) -> None:
    ServerLogging(room.node, room.drones)  # type: ignore[arg-type]
    assert not room.node.ask("cf1/add_logging", **block).success
    assert reason in room.node.told[-1]


def test_poses_and_transforms_of_all_drones_name_each(modules: dict[str, ModuleType]) -> None:
    named = [("cf1", np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0, 0.0])), ("cf2", np.zeros(3), np.eye(4)[3])]
    capture, transforms = (modules[f"{name}.msg"] for name in ("motion_capture_tracking_interfaces", "tf2_msgs"))
    poses = server_messages.named_poses_message(capture.NamedPoseArray, capture.NamedPose, 1, named)
    assert [pose.name for pose in poses.poses] == ["cf1", "cf2"]
    assert (poses.poses[0].pose.position.y, poses.poses[0].pose.orientation.z) == (2.0, 1.0)
    tree = server_messages.transforms_message(transforms.TFMessage, TransformStamped, 1, named)
    assert [(one.header.frame_id, one.child_frame_id) for one in tree.transforms] == [
        ("world", "cf1"),
        ("world", "cf2"),
    ]
    assert tree.transforms[0].transform.translation.z == 3.0
    assert interfaces.named_poses_qos(100.0).deadline.nanoseconds == 10_000_000


def test_without_crazyswarm2s_interfaces_there_are_arming_and_emergency_alone() -> None:
    with pytest.MonkeyPatch.context() as patch:
        for name in ("crazyflie_interfaces", "crazyflie_interfaces.srv", "crazyflie_interfaces.msg"):
            patch.setitem(sys.modules, name, None)
        room = Room({})
        ServerLogging(room.node, room.drones)  # type: ignore[arg-type]
    assert set(room.node.services) == {
        f"{who}/{name}" for who in ("cf1", "cf2", "all") for name in ("arm", "emergency")
    }
    assert not room.node.topics
    assert room.node.ask("all/arm", data=False).success


def test_a_refused_command_of_one_drone_leaves_the_others_theirs(room: Room) -> None:
    original = room.fleet.take_off

    def take_off(number: int, **rest: Any) -> None:
        if number == 0:
            raise FlatsatError("no")
        original(number, **rest)

    room.fleet.take_off = take_off  # type: ignore[method-assign]
    room.node.ask("all/takeoff", height=0.5, duration=Duration(sec=1))
    room.wait(2.0)
    assert room.places[:, 2] == pytest.approx([0.0, 0.5], abs=0.1)
