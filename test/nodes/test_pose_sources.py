"""Which topic the poses of a drone come from, and which back end its set-points go to, with a stand-in for the node."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.wire import Backend
from flatsat_ros.nodes import backends, pose_sources
from flatsat_ros.nodes.backends import BackendChoice, Backends
from flatsat_ros.nodes.pose_sources import PoseSource, PoseSources
from flatsat_ros.nodes.ros import messages

pytestmark = pytest.mark.in_process


class Node:
    """As much of a node as both need.

    Attributes:
        takes: by topic, what takes its messages.
        publishers, subscribers, services: names of topics and services that are there.
        told: lines of the log.
    """

    def __init__(self) -> None:
        self.takes: dict[str, Callable[[Any], None]] = {}
        self.publishers: set[str] = set()
        self.subscribers: set[str] = set()
        self.services: set[str] = set()
        self.told: list[str] = []

    def create_subscription(self, _: Any, topic: str, take: Callable[[Any], None], *__: Any, **___: Any) -> None:
        self.takes[topic] = take

    def count_publishers(self, topic: str) -> int:
        return topic in self.publishers

    def count_subscribers(self, topic: str) -> int:
        return topic in self.subscribers

    def count_services(self, service: str) -> int:
        return service in self.services

    def resolve_service_name(self, name: str) -> str:
        return f"/lab/{name}"

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.told.append, error=self.told.append)


class Room:
    """Two drones; time passes when it is told to.

    Attributes:
        node, sources: what is tested.
        now: s.
        flying: numbers of the drones in the air.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, wanted: PoseSource, *, installed: bool = True) -> None:
        self.node, self.now, self.flying = Node(), 0.0, set[int]()
        kinds = SimpleNamespace(NamedPoseArray=object, TFMessage=object)

        def load(_: str) -> Any:
            if installed:
                return kinds
            raise ModuleNotFoundError

        monkeypatch.setattr(pose_sources, "import_module", load)
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        node: Any = self.node
        self.sources = PoseSources(node, ["cf1", "CF_2"], "world", self.flying.__contains__, wanted)

    def heard(self, index: int) -> list[float]:
        """Take what has come of a drone; return its x."""
        found = []
        while self.sources.queues[index]:
            found.append(self.sources.take(index).position[0])
        return found

    def let_pass(self, seconds: float) -> None:
        self.now += seconds
        self.sources.look()


def stamped(x: float, frame: str = "world") -> bytes:
    pose = PoseStamped()
    messages.fill_pose(pose, 5, (x, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    messages.set_frame(pose, frame)
    return bytes(serialize_message(pose))


def odometry(x: float) -> Odometry:
    message = Odometry()
    message.header.frame_id = "world"
    message.pose.pose.position.x = x
    return message


def seen(frame: str = "world", **bodies: float) -> Any:
    """Bodies by name with their x, as both of /poses and /tf have them."""
    header = SimpleNamespace(frame_id=frame, stamp=SimpleNamespace(sec=1, nanosec=0))
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=float("nan"))
    entries = [
        SimpleNamespace(
            header=header,
            name=name,
            child_frame_id=name,
            pose=SimpleNamespace(position=SimpleNamespace(x=x, y=2.0, z=3.0), orientation=turn),
            transform=SimpleNamespace(translation=SimpleNamespace(x=x, y=2.0, z=3.0), rotation=turn),
        )
        for name, x in bodies.items()
    ]
    return SimpleNamespace(header=header, poses=entries, transforms=entries)


@pytest.mark.parametrize(
    ("source", "topic", "message"),
    [
        (PoseSource.POSE, "cf1/pose", stamped(1.0)),
        (PoseSource.POSES, "/poses", seen(cf1=1.0, person=9.0)),
        (PoseSource.TF, "/tf", seen(cf1=1.0, person=9.0)),
        (PoseSource.TF, "/tf", seen(cf1_mocap=1.0, person_mocap=9.0)),
        (PoseSource.ODOM, "cf1/odom", odometry(1.0)),
    ],
    ids=["pose", "poses", "tf", "tf_mocap", "odom"],  # bytes are no names: padding in them is random
)
def test_poses_come_from_the_source_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, source: PoseSource, topic: str, message: Any
) -> None:
    room = Room(monkeypatch, source)
    monkeypatch.setattr(pose_sources, "deserialize_message", lambda data, _: data)
    assert room.sources.beside(0) is None
    room.node.takes[topic](message)
    beside = room.sources.beside(0)
    if source is PoseSource.POSE:
        assert beside is None
    else:
        assert beside is not None
        assert (beside.topic, list(beside.tells(message))) == (topic, ["cf1"])
    assert (room.heard(0), room.heard(1)) == ([1.0], [])
    room.node.publishers |= {"/poses", "/tf", "cf1/pose", "cf1/odom"}
    room.let_pass(5.0)
    assert set(room.node.takes) <= {topic, topic.replace("cf1", "CF_2")}
    assert room.node.told == [f"cf1: poses from {topic}"]


def test_what_is_found_first_stays_until_it_is_silent_and_the_drone_does_not_fly(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    room = Room(monkeypatch, PoseSource.AUTO)
    node = room.node
    node.publishers |= {"/poses", "/tf"}
    room.let_pass(0.9)
    assert set(node.takes) == {"cf1/pose", "CF_2/pose"}, "there may be poses of the drones' own topics yet"
    node.takes["CF_2/pose"](stamped(5.0))
    room.let_pass(0.5)
    assert "/poses" in node.takes, "for cf1"
    assert "cf1/odom" not in node.takes, "nobody publishes it"
    node.takes["/poses"](seen(cf1=1.0, CF_2=6.0))
    node.takes["/tf"](seen(cf1=2.0))
    assert (room.heard(0), room.heard(1)) == ([1.0], [5.0]), "one source for each"
    room.flying.add(0)
    room.let_pass(9.0)
    node.takes["/tf"](seen(cf1=2.0))
    assert room.heard(0) == [], "not in the air"
    room.flying.clear()
    room.let_pass(0.1)
    node.takes["/tf"](seen(cf1=2.0))
    assert room.heard(0) == [2.0]
    assert node.told == ["CF_2: poses from CF_2/pose", "cf1: poses from /poses", "cf1: poses from /tf"]


def test_other_frames_are_refused_and_on_tf_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    room = Room(monkeypatch, PoseSource.POSES)
    with pytest.raises(FlatsatError, match="frame_id = 'map': must be 'world' or empty"):
        room.node.takes["/poses"](seen("map", cf1=1.0))
    room = Room(monkeypatch, PoseSource.TF)
    room.node.takes["/tf"](seen("base_link", cf1=1.0))
    assert room.heard(0) == []
    room = Room(monkeypatch, PoseSource.POSE)
    room.node.takes["cf1/pose"](stamped(1.0, "map"))
    with pytest.raises(FlatsatError, match="frame_id = 'map'"):
        room.sources.take(0)
    assert not room.sources.queues[0]


def test_a_source_whose_type_is_not_installed_is_refused_or_not_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        FlatsatError, match="pose_source = 'poses': motion_capture_tracking_interfaces must be installed"
    ):
        Room(monkeypatch, PoseSource.POSES, installed=False)
    room = Room(monkeypatch, PoseSource.AUTO, installed=False)
    room.node.publishers |= {"/poses", "cf1/odom"}
    room.let_pass(2.0)
    assert set(room.node.takes) == {"cf1/pose", "CF_2/pose", "cf1/odom", "CF_2/odom"}


COMMAND, LOGGING = "cf1/cmd_vel_legacy", "/lab/cf1/add_logging"


def backend_room(monkeypatch: pytest.MonkeyPatch, choice: BackendChoice) -> tuple[Node, Backends, set[int]]:
    node, flying = Node(), set[int]()
    monkeypatch.setattr(backends, "declare_choice", lambda *_: choice)
    stand_in: Any = node
    return node, Backends(stand_in, ["cf1"], flying.__contains__), flying


def test_the_back_end_is_known_by_its_services_and_does_not_change_in_the_air(monkeypatch: pytest.MonkeyPatch) -> None:
    node, found, flying = backend_room(monkeypatch, BackendChoice.AUTO)
    found.look(0)
    assert node.told == []
    node.subscribers.add(COMMAND)
    found.look(0)
    found.look(0)
    assert node.told == ["cf1: backend cpp: cf1/add_logging is not offered"]
    flying.add(0)
    node.services.add(LOGGING)
    found.look(0)
    found.look(0)
    assert found.of(0) is Backend.CPP
    assert node.told[1:] == ["cf1: cf1/add_logging is offered, but it flies with backend cpp: land it"]
    flying.clear()
    found.look(0)
    assert found.of(0) is Backend.CFLIB


def test_a_link_that_ends_and_comes_back_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    node, found, _ = backend_room(monkeypatch, BackendChoice.AUTO)
    node.subscribers.add(COMMAND)
    node.services.add(LOGGING)
    found.look(0)
    node.subscribers.clear()
    node.services.clear()
    found.look(0)
    assert found.of(0) is Backend.CFLIB, "nobody there says nothing about who comes back"
    node.subscribers.add(COMMAND)
    node.services.add(LOGGING)
    found.look(0)
    said = "cf1: backend cflib: cf1/add_logging is offered"
    assert node.told == [said, "cf1: nobody takes its set-points any more: its link has ended", said]


def test_a_given_back_end_is_not_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    node, found, _ = backend_room(monkeypatch, BackendChoice.CPP)
    node.subscribers.add(COMMAND)
    node.services.add(LOGGING)
    found.look(0)
    assert found.of(0) is Backend.CPP
    assert node.told == []
