"""Remappings: each is used by what it names, also by what is only looked for; one that nothing uses is told."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from flatsat_ros.nodes.backends import Backends
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.pose_sources import PoseSource, PoseSources
from flatsat_ros.nodes.ros import interfaces, runtime
from flatsat_ros.nodes.ros.runtime import ProgramNode, run
from flatsat_ros.nodes.sim_drone import SimDrone

pytestmark = pytest.mark.in_process


class Small(ProgramNode):
    """A node with one of each that ends at once."""

    def __init__(self) -> None:
        super().__init__("small")
        self.create_publisher(PoseStamped, "cf1/goal_pose", 1)
        self.create_subscription(PoseStamped, "cf1/pose", print, 1)
        self.create_service(Trigger, "cf1/land", lambda _, answer: answer)
        self.create_client(Trigger, "cf1/hold")
        self.count_publishers("/poses")
        self.count_subscribers("cf1/cmd_vel_legacy")
        self.resolve_service_name("cf1/arm")
        self.done = True


@pytest.fixture
def told(capfd: pytest.CaptureFixture[str]) -> Callable[..., list[str]]:
    """How to run a node with remappings; returns what it tells of them."""

    def tell(*rules: str, make: Callable[[], ProgramNode] = Small) -> list[str]:
        capfd.readouterr()
        assert run(make, ["program", "--ros-args", *(word for rule in rules for word in ("-r", rule))]) == 0
        lines = capfd.readouterr().err.splitlines()
        return [line[line.index("remapping") :] for line in lines if "[WARN]" in line and "remapping" in line]

    return tell


@pytest.mark.parametrize(
    "rule",
    [
        "cf1/goal_pose:=/x",
        "/cf1/pose:=/x",
        "rostopic://cf1/pose:=/x",
        "cf1/land:=/x",
        "rosservice://cf1/land:=/x",
        "cf1/hold:=/x",
        "small:cf1/hold:=/x",
        "small:rosservice://cf1/hold:=/x",
        "/poses:=/x",
        "cf1/cmd_vel_legacy:=/x",
        "cf1/arm:=/x",
        "/rosout:=/x",
        "~/set_parameters:=/x",
        "__node:=mine",
        "__name:=mine",
        "small:__node:=mine",
        "__ns:=/lab",
        "small:__ns:=/lab",
    ],
)
def test_a_remapping_that_is_used_is_not_told(rule: str, told: Callable[..., list[str]]) -> None:
    assert told(rule) == []


def test_where_the_node_has_another_name_rules_are_for_that(told: Callable[..., list[str]]) -> None:
    assert told("small:__node:=mine", "mine:__ns:=/lab", "mine:cf1/pose:=/x", "/lab/cf1/land:=/y") == []
    (line,) = told("small:__node:=mine", "small:cf1/pose:=/x")
    assert line == "remapping 'small:cf1/pose:=/x' changes nothing: it is for node small, this is mine"


@pytest.mark.parametrize(
    ("rule", "what"),
    [
        ("cf1/pos:=/x", "no topic or service here is /lab/cf1/pos; the nearest is /lab/cf1/pose"),
        ("/cf1/pose:=/x", "no topic or service here is /cf1/pose; the nearest is /lab/cf1/pose"),
        ("rosservice://cf1/pose:=/x", "no service here is /lab/cf1/pose; the nearest is"),
        ("rostopic://cf1/hold:=/x", "no topic here is /lab/cf1/hold"),
        ("small:cf1/lan:=/x", "no topic or service here is /lab/cf1/lan; the nearest is /lab/cf1/land"),
    ],
)
def test_a_remapping_that_nothing_uses_is_told_with_the_nearest(
    rule: str, what: str, told: Callable[..., list[str]]
) -> None:
    (line,) = told(rule, "__ns:=/lab")
    assert line.startswith(f"remapping '{rule}' has changed nothing so far: {what}")


def test_it_is_told_once_while_the_node_lives(told: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "_SETTLED", 0.05)

    class Living(SimDrone):
        def __init__(self) -> None:
            super().__init__()
            self.create_timer(0.3, lambda: setattr(self, "done", True))

    (line,) = told("cf1/cmd_vel:=/x", "cf1/pose:=/y", make=Living)
    assert line.endswith("no topic or service here is /cf1/cmd_vel; the nearest is /cf1/cmd_vel_legacy")


def test_the_controller_uses_what_may_be_there_later(
    told: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runtime, "_SETTLED", 3.5)  # s; it looks once a second, for sources after one of silence

    class Living(ControllerNode):
        def __init__(self) -> None:
            super().__init__()
            self.create_timer(3.6, lambda: setattr(self, "done", True))

    names = [
        *(topic.of("cf1") for topic in (interfaces.POSE, interfaces.ODOMETRY, interfaces.COMMAND)),
        *(f"cf1/{name}" for name in (interfaces.ARM, interfaces.NOTIFY, interfaces.GO_TO, interfaces.ADD_LOGGING)),
        *(*interfaces.PLAN_TRIGGERS, interfaces.SETUP.suffix, interfaces.DIAGNOSTICS),
    ]
    rules = [f"{name}:=/elsewhere/number_{number}" for number, name in enumerate(names)]
    assert told(*rules, make=Living) == []


@pytest.fixture
def swapped() -> Iterator[tuple[ProgramNode, Node]]:
    """A node whose names are remapped, and another that takes all names as they are."""
    rules = ["cf1/odom:=/vicon/one", "cf1/cmd_vel_legacy:=/link/command", "cf1/pose:=cf2/pose", "cf2/pose:=cf1/pose"]
    rclpy.init(args=["--ros-args", *(word for rule in rules for word in ("-r", rule))])
    nodes = ProgramNode("remapped"), Node("plain", use_global_arguments=False)
    yield nodes
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


def until(holds: Callable[[], object]) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_poses_are_looked_for_where_their_topic_is_remapped_to(swapped: tuple[ProgramNode, Node]) -> None:
    node, plain = swapped
    sources = PoseSources(node, ["cf1"], "world", lambda _: False, PoseSource.AUTO)
    topic = interfaces.ODOMETRY
    publisher = plain.create_publisher(topic.kind, "/vicon/one", topic.publish)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def heard() -> bool:
        sources.look()
        publisher.publish(topic.kind())
        executor.spin_once(timeout_sec=0.02)
        return bool(sources.queues[0])

    until(heard)
    executor.shutdown()


def test_a_link_is_looked_for_where_its_topic_is_remapped_to(swapped: tuple[ProgramNode, Node]) -> None:
    node, plain = swapped
    backends = Backends(node, ["cf1"], lambda _: False)
    plain.create_subscription(interfaces.COMMAND.kind, "/link/command", print, 1)

    def linked() -> bool:
        backends.look(0)
        return backends._linked[0]

    until(linked)


def test_names_that_are_exchanged_are_counted_where_each_leads(swapped: tuple[ProgramNode, Node]) -> None:
    node, plain = swapped
    plain.create_publisher(PoseStamped, "/cf2/pose", 1)
    until(lambda: node.count_publishers("cf1/pose") == 1)
    assert node.count_publishers("cf2/pose") == 0
