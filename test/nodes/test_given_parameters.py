"""What is given at the start: nothing meant for a node is ignored, and what `ros2 param dump` wrote loads again."""

from __future__ import annotations

import os
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.crazyflie.wire import Backend, WireSetpoint
from flatsat_ros.identification.recording import COLUMNS
from flatsat_ros.nodes.cflib_bridge import CflibBridge
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.mocap_player import MocapPlayer
from flatsat_ros.nodes.recorder import RecorderNode
from flatsat_ros.nodes.ros import messages
from flatsat_ros.nodes.ros.given import giving, read_given
from flatsat_ros.nodes.ros.runtime import ProgramNode, run
from flatsat_ros.nodes.sim_drone import SimDrone
from flatsat_ros.nodes.sim_server import SimServer

pytestmark = pytest.mark.in_process


def given(**values: object) -> list[str]:
    """Command line that gives parameters; `__` in a name stands for a dot."""
    pairs = [("-p", f"{name.replace('__', '.')}:={value}") for name, value in values.items()]
    return ["program", "--ros-args", *(word for pair in pairs for word in pair)]


@pytest.fixture
def needed(tmp_path: Path) -> dict[type[ProgramNode], dict[str, object]]:
    """Parameters without which a node does not start."""
    recording = tmp_path / "recording.csv"
    recording.write_text(",".join(COLUMNS) + "\n0,0,0,0,0,0,0,1\n", encoding="utf-8")
    return {MocapPlayer: {"file": recording}, RecorderNode: {"output": tmp_path / "bag"}}


@pytest.fixture
def started() -> Iterator[Callable[..., Any]]:
    """How to make a node with arguments; all are gone after the test."""
    made: list[ProgramNode] = []

    def start(make: type[ProgramNode], arguments: list[str]) -> ProgramNode:
        while made:
            made.pop().destroy_node()
            rclpy.shutdown()
        rclpy.init(args=arguments)
        made.append(make())
        return made[0]

    yield start
    for node in made:
        node.destroy_node()
    rclpy.try_shutdown()


NEEDS_CFLIB = pytest.mark.skipif(not find_spec("cflib"), reason="an extra")
NODES = [
    (ControllerNode, "certifcate", "certificate"),
    (SimDrone, "robot_name", "robot_names"),
    (MocapPlayer, "Rate", "rate"),
    (MocapPlayer, "robot_names", "robot_name"),
    pytest.param(CflibBridge, "link_time_out", "link_timeout", marks=NEEDS_CFLIB),
]


@pytest.mark.parametrize(("make", "misspelt", "meant"), NODES)
def test_a_misspelt_name_is_refused_with_the_nearest(
    make: type[ProgramNode],
    misspelt: str,
    meant: str,
    needed: dict[type[ProgramNode], dict[str, object]],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    extra: dict[str, object] = {"uris": "['udp://127.0.0.1:19750']"} if make is CflibBridge else {}
    assert run(make, given(**{misspelt: "x", **needed.get(make, {}), **extra})) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == f"error: parameter {misspelt}: not known here; the nearest is {meant}"


@NEEDS_CFLIB
@pytest.mark.parametrize(
    ("wrong", "first", "taken", "text"),
    [({"link_time_out": 1.0}, 19750, (), "not known here"), ({}, 19752, (19752,), "is taken by another cflib_bridge")],
)
def test_a_bridge_that_is_refused_leaves_its_drones_to_others(
    wrong: dict[str, object],
    first: int,
    taken: tuple[int, ...],
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def take(port: int) -> socket.socket:
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        claim.bind(f"\0flatsat_ros cflib_bridge udp 127.0.0.1 {port}")
        return claim

    others = [take(port) for port in taken]
    uris = f"['udp://127.0.0.1:{first + 1}', 'udp://127.0.0.1:{first}']"
    rclpy.init(args=given(robot_names="[a, b]", uris=uris, **wrong))
    try:
        with pytest.raises(FlatsatError) as refused:
            CflibBridge()
    finally:
        rclpy.shutdown()
    for other in others:
        other.close()
    for port in (first, first + 1):  # `refused` keeps whatever the bridge had made
        take(port).close()
    assert text in str(refused.value)


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("robots.cf2.mu", "robots.cf1.mu"),
        ("robots.cf1.my", "robots.cf1.mu"),
        ("robots.cf1", "robots.cf1.nu"),
        ("robot_types.big.vehicle", "robots.cf1.vehicle"),
        ("gama_max", "gamma_max"),
        ("GAMMA_MAX", "gamma_max"),
        ("thrust_max_error", "thrust_error_max"),
    ],
)
def test_what_the_controller_does_not_know_is_refused(
    name: str, nearest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(ControllerNode, given(**{name: 1.0})) == 2
    assert f"parameter {name}: not known here; the nearest is {nearest}" in capsys.readouterr().err


def test_a_parameter_that_lost_its_meaning_is_refused_with_its_successor(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(ControllerNode, given(ground_height=0.15)) == 2
    assert "error: parameter ground_height: there is none any more; give floor" in capsys.readouterr().err


def test_in_a_file_for_several_nodes_what_belongs_to_others_does_not_disturb(
    started: Callable[..., Any], tmp_path: Path
) -> None:
    both = {"robot_names": ["cf1", "cf2"], "takeoff_height": 1.0, "mu": 1.0, "wind": [0.0, 0.0, 1.0], "drop_out": 0.1}
    file = tmp_path / "both.yaml"
    file.write_text(yaml.dump({"/**": {"ros__parameters": both}}), encoding="utf-8")
    arguments = ["program", "--ros-args", "--params-file", str(file)]
    for make in (ControllerNode, SimDrone):
        node = started(make, arguments)
        assert node.robots == ["cf1", "cf2"]


SECTIONS = [
    ("/", "flatsat_controller", True),
    ("/", "/flatsat_controller", True),
    ("/", "/**", True),
    ("/", "/*", True),
    ("/", "**/flatsat_controller", True),
    ("/", "controller", False),
    ("/", "/flatsat_control", False),
    ("/", "/flatsat_controller_2", False),
    ("/", "/lab/flatsat_controller", False),
    ("/", "/*/flatsat_controller", False),
    ("/lab", "/lab/flatsat_controller", True),
    ("/lab", "lab/flatsat_controller", True),
    ("/lab", "/**", True),
    ("/lab", "/lab/*", True),
    ("/lab", "/lab/**", True),
    ("/lab", "/**/flatsat_controller", True),
    ("/lab", "/*/flatsat_controller", True),
    ("/lab", "flatsat_controller", False),
    ("/lab", "/*", False),
    ("/lab", "/lab", False),
]


@pytest.mark.parametrize(("namespace", "section", "applies"), SECTIONS)
def test_a_file_is_taken_where_ros_takes_it_for_this_node(
    namespace: str, section: str, applies: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What ROS takes shows in the refusal of a value."""
    file = tmp_path / "mine.yaml"
    both = {"/other": {"ros__parameters": {"a": {"b": [1, 2]}}}, section: {"ros__parameters": {"mu": -1.0}}}
    file.write_text(yaml.dump(both, sort_keys=False), encoding="utf-8")
    assert run(ControllerNode, ["program", "--ros-args", "-r", f"__ns:={namespace}", "--params-file", str(file)]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert ("parameter mu = -1.0 1/s: must be" in said) == applies
    assert said.startswith(f"error: {file}: its sections are /other, {section}: must have one for ") != applies


def test_a_file_for_other_nodes_alone_is_refused_with_the_nearest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad, none = tmp_path / "good.yaml", tmp_path / "bad.yaml", tmp_path / "none.yaml"
    good.write_text("# a file with nothing for it\nflatsat_controller:\n  ros__parameters: {}\n", encoding="utf-8")
    bad.write_text(  # a misspelt name, beside one that is known
        "lab:\n  flatsat_controler:\n    ros__parameters: {mu: 1.0}\n---\nsim_drone: {ros__parameters: {a: [[], b]}}\n",
        encoding="utf-8",
    )
    none.write_text("{}", encoding="utf-8")
    files = [word for file in (good, bad) for word in ("--params-file", str(file))]
    assert run(ControllerNode, ["program", "--ros-args", *files]) == 2
    assert run(ControllerNode, ["program", "--ros-args", "-r", "__node:=mine", "--params-file", str(none)]) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first == (
        f"error: {bad}: its sections are lab/flatsat_controler, sim_drone: must have one for /flatsat_controller, or "
        "for all nodes: /**; the nearest is /lab/flatsat_controler"
    )
    assert second == f"error: {none}: it has no section: must have one for /mine, or for all nodes: /**"


FOR_OTHERS = [
    # node, its name, sections, whether they are taken to be for others
    (ControllerNode, "flatsat_controller", ["sim_drone"], True),
    (SimDrone, "sim_drone", ["flatsat_controller", "vicon_bridge"], True),
    (MocapPlayer, "mocap_player", ["/lab/flatsat_controller", "/lab/**/sim_drone"], True),
    (ControllerNode, "flatsat_controller", ["flatsat_console"], True),
    (ControllerNode, "flatsat_controller", ["flatsat_console", "flatsat_controllr"], False),
    (ControllerNode, "flatsat_controller", ["sim_drone", "controller"], False),
    (ControllerNode, "flatsat_controller", ["sim_drone", "/lab/flatsat_controller"], False),
    (ControllerNode, "flatsat_controller", ["sim_drone", "/lab/**"], False),
    (ControllerNode, "mine", ["sim_drone", "flatsat_controller"], False),
    (SimDrone, "sim_drone", ["controller"], False),
    (SimDrone, "sim_drone", ["vicon_bridge", "rviz"], False),
    (SimDrone, "sim_drone", [], False),
    pytest.param(CflibBridge, "cflib_bridge", ["flatsat_controller", "vicon_bridge"], True, marks=NEEDS_CFLIB),
]


@pytest.mark.parametrize(("make", "name", "sections", "taken"), FOR_OTHERS)
def test_a_file_that_nodes_share_may_have_nothing_for_one_but_nothing_misspelt(
    make: type[ProgramNode],
    name: str,
    sections: list[str],
    taken: bool,
    needed: dict[type[ProgramNode], dict[str, object]],
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    started: Callable[..., Any],
) -> None:
    file = tmp_path / "shared.yaml"
    file.write_text(yaml.dump({section: {"ros__parameters": {"no": 1}} for section in sections}), encoding="utf-8")
    arguments = [*given(**needed.get(make, {})), "-r", f"__node:={name}", "--params-file", str(file)]
    found = f"its sections are {', '.join(sorted(sections))}" if sections else "it has no section"
    if taken:
        with giving(read_given(arguments)):
            started(make, arguments)
        said = capfd.readouterr().err
        assert said.count("[WARN]") == 1
        assert f"{file}: nothing in it is for /{name}: {found}" in said
    else:
        assert run(make, arguments) == 2
        said = capfd.readouterr().err.splitlines()[-1]
        assert said.startswith(f"error: {file}: {found}: must have one for /{name}, or for all nodes: /**")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "it is a device, pipe or socket, must be a regular file"),
        (b"#" * 200_000, "it has more than 131072 bytes"),
        (b"/**: {ros__parameters: {a: " + b"[" * 60_000, "more than 32 lists and mappings inside each other"),
        (b"/**: {ros__parameters: {a: [}}\n", "line 1"),
        ("/**: {ros__parameters: {a: \xe9}}\n".encode("latin-1"), "can't decode"),
    ],
)
def test_a_file_of_parameters_is_read_as_boundedly_as_others(
    content: bytes | None, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.yaml"
    if content is None:
        os.mkfifo(file)
    else:
        file.write_bytes(content)
    assert run(ControllerNode, ["program", "--ros-args", "--params-file", str(file)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {file}: cannot be read: ")
    assert reason in line


@pytest.mark.parametrize(
    ("namespace", "name", "taken"),
    [
        ("/", "flatsat_controller:mu", True),
        ("/", "controller:mu", False),
        ("/lab", "flatsat_controller:mu", False),
        ("/", "mu", True),
    ],
)
def test_a_parameter_for_another_node_is_refused(
    namespace: str, name: str, taken: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(ControllerNode, [*given(**{name: -1.0}), "-r", f"__ns:={namespace}"]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    node = name.partition(":")[0]
    other = (
        f"error: parameter '{name}:=-1.0' is for node /{node}: must be for {namespace.rstrip('/')}/flatsat_controller: "
        f"leave '{node}:' away"
    )
    assert said == ("error: parameter mu = -1.0 1/s: must be from 0.0 to 100.0" if taken else other)


def dumped(node: ProgramNode) -> str:
    """What `ros2 param dump` writes: what the parameter services answer, nested at the dots, with PyYAML's dump."""
    names = sorted(node.list_parameters([], 0).names)
    nested: dict[str, Any] = {}
    for parameter in node.get_parameters(names):
        *folders, last = parameter.name.split(".")
        place = nested
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = parameter_value_to_python(parameter.get_parameter_value())
    return yaml.dump({node.get_fully_qualified_name(): {"ros__parameters": nested}}, default_flow_style=False)


def test_a_lab_may_name_everything_as_it_likes(started: Callable[..., Any], tmp_path: Path) -> None:
    names = [f"CF_{number}" for number in range(1, 26)]
    named = ["-r", "__ns:=/Lab", "-r", "__node:=mine", "-r", "CF_1/pose:=/vicon/Drone_1/pose"]
    parameters = ["-p", f"robot_names:=[{', '.join(names)}]", "-p", "certificate:=paper_experiment"]
    node = started(ControllerNode, ["program", "--ros-args", *named, *parameters])
    heard, said = ({end.topic_name for end in ends} for ends in (node.subscriptions, node.publishers))
    assert {"/vicon/Drone_1/pose", "/Lab/CF_25/pose", "/Lab/CF_1/goal_pose"} <= heard
    assert {f"/Lab/{name}/cmd_vel_legacy" for name in names} <= said
    assert "/Lab/CF_25/flatsat/takeoff" in {service.service_name for service in node.services}
    # motion capture that promises nothing
    unreliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    capture = Node("capture", use_global_arguments=False)
    poses = capture.create_publisher(PoseStamped, "/vicon/Drone_1/pose", unreliable)
    executor, pose = SingleThreadedExecutor(), messages.pose_message()
    executor.add_node(node)
    end = time.monotonic() + 20.0
    while node._last is None or node._pilot.estimator.newest[0] == -np.inf:
        messages.fill_pose(pose, capture.get_clock().now().nanoseconds, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
        poses.publish(pose)
        executor.spin_once(timeout_sec=0.02)
        assert time.monotonic() < end
    executor.shutdown()
    capture.destroy_node()
    file = tmp_path / "dump.yaml"
    file.write_text(dumped(node), encoding="utf-8")
    again = started(ControllerNode, ["program", "--ros-args", *named, "--params-file", str(file)])
    assert again.robots == names


@pytest.mark.parametrize(
    "make",
    [ControllerNode, SimDrone, SimServer, MocapPlayer, RecorderNode, pytest.param(CflibBridge, marks=NEEDS_CFLIB)],
)
def test_what_param_dump_wrote_loads_again(
    make: type[ProgramNode],
    started: Callable[..., Any],
    needed: dict[type[ProgramNode], dict[str, object]],
    tmp_path: Path,
) -> None:
    first = started(make, given(**needed.get(make, {})))
    if make is ControllerNode:
        changed = {"robots.cf1.mu": 1.0, "v_inf": 1e-7, "gamma_0": 2.0}
        assert all(
            result.successful for result in first.set_parameters([Parameter(n, value=v) for n, v in changed.items()])
        )
    written = dumped(first)
    assert ("null" in written) == (make is ControllerNode), "unset values of its own are the point"
    file = tmp_path / "dump.yaml"
    file.write_text(written, encoding="utf-8")
    first.finish()
    shutil.rmtree(tmp_path / "bag", ignore_errors=True)
    again = started(make, ["program", "--ros-args", "--params-file", str(file)])
    assert dumped(again) == written
    again.finish()


def test_null_stands_for_an_unset_value_and_other_words_do_not(
    started: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    node = started(ControllerNode, given(robots__cf1__mu="null", robots__cf1__nu=0.1))
    assert [node.get_parameter(f"robots.cf1.{name}").value for name in ("mu", "nu")] == [None, 0.1]
    node.destroy_node()
    rclpy.shutdown()
    for word in ("none", "[]", "1"):
        assert run(ControllerNode, given(robots__cf1__mu=word)) == 2
        assert "parameter robots.cf1.mu = " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("robots", "node", "complaint"),
    [
        ("{cf-1: {}}", SimDrone, r"robot name = 'cf-1': must be letters, digits and underscores, the first a letter"),
        ("{1cf: {}}", SimDrone, r"robot name = '1cf': must be letters, .* as ROS wants names of topics"),
        ("{all: {}}", SimDrone, r"robot name = 'all': must be another"),
        pytest.param("{cf1: {}, cf2: {}}", CflibBridge, r"robots\.cf1 has no uri: must have one", marks=NEEDS_CFLIB),
    ],
)
def test_robots_of_a_file_that_cannot_be_linked_are_refused_with_its_name(
    started: Callable[..., Any], tmp_path: Path, robots: str, node: type[ProgramNode], complaint: str
) -> None:
    file = tmp_path / "crazyflies.yaml"
    file.write_text(f"fileversion: 3\nrobots: {robots}\n", encoding="utf-8")
    with pytest.raises(FlatsatError, match=rf"crazyflies\.yaml: {complaint}"):
        started(node, given(crazyflies_yaml=file))


def test_a_person_who_is_tracked_beside_the_drones_is_not_flown(started: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "crazyflies.yaml"
    file.write_text(
        "robots: {cf1: {type: cf21}, visitor: {type: marker}}\nrobot_types: {cf21: {}, marker: {connection: none}}\n",
        encoding="utf-8",
    )
    node = started(ControllerNode, given(crazyflies_yaml=file, certificate="paper_experiment"))
    assert node.robots == ["cf1"]


def test_a_recording_is_known_by_its_ending_in_any_letters(started: Callable[..., Any], tmp_path: Path) -> None:
    recording = tmp_path / "RECORDING.CSV"
    recording.write_text("\ufeff" + ",".join(COLUMNS) + "\n0,0,0,0,0,0,0,1\n", encoding="utf-8")
    assert not started(MocapPlayer, given(file=recording)).done
    with pytest.raises(FlatsatError, match="parameter body = 'cf1': must be empty for a CSV recording"):
        started(MocapPlayer, given(file=recording, body="cf1"))


def test_who_offers_logging_as_cflibs_server_does_takes_the_signs_of_its_set_points(
    started: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    node = started(SimServer, given())
    offers = any(service.service_name.endswith("/add_logging") for service in node.services)
    assert node.backend is (Backend.CFLIB if offers else Backend.CPP)
    message, taken = Twist(), []
    messages.fill_command(message, WireSetpoint(roll=1.0, pitch=2.0, yaw=3.0, thrust=4.0))
    monkeypatch.setattr(node.drones[0][1], "command", lambda *setpoint: taken.append(setpoint))
    for backend in Backend:
        monkeypatch.setattr(node, "backend", backend)
        node._on_command(0, message)
    assert taken == [(0, 1.0, 2.0, 3.0, 4.0), (0, 1.0, -2.0, 3.0, 4.0)]
