"""docs/interfaces.md says what the nodes offer, no more and no less."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.qos import QoSProfile

from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.identification.recording import COLUMNS
from flatsat_ros.nodes.calibrate_hover import CalibrateHover
from flatsat_ros.nodes.cflib_bridge import CflibBridge
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.mocap_player import MocapPlayer
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.nodes.sim_drone import SimDrone

# defaults that are put into words
COMPUTED = {"start_positions", "uris"}
# what rclpy declares by itself
OWN = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")


# what a node does not start without
GIVEN = {MocapPlayer: ("file", "recording.csv"), CalibrateHover: ("output", "mine.yaml")}


@contextmanager
def started(make: type[Any], folder: Path) -> Iterator[Any]:
    """A node, with files of its own in a folder."""
    (folder / "recording.csv").write_text(f"{','.join(COLUMNS)}\n0,0,0,1,0,0,0,1\n", encoding="utf-8")
    given = [f"{name}:={folder / file}" for kind, (name, file) in GIVEN.items() if kind is make]
    rclpy.init(args=["--ros-args", *(part for value in given for part in ("-p", value))])
    try:
        node = make()
        yield node
        for link in getattr(node, "links", []):
            link.leave()
        node.destroy_node()
    finally:
        rclpy.shutdown()


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / "docs" / "interfaces.md").read_text(encoding="utf-8")


def section(page: str, title: str) -> str:
    """The part below one heading."""
    _, found, rest = page.partition(f"{title}\n")
    assert found, title
    return re.split(r"^#", rest, flags=re.MULTILINE)[0]


def first_columns(text: str) -> set[str]:
    """Names in the first column of the tables."""
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("|")]
    return {name for row in rows for name in re.findall(r"`([^`]+)`", row)}


def defaults(text: str) -> dict[str, str]:
    """Default by parameter, for rows with one name."""
    rows = [[cell.strip(" `") for cell in line.split("|")] for line in text.splitlines() if line.startswith("| `")]
    return {row[1]: row[3] for row in rows if "," not in row[1]}


@pytest.mark.parametrize(
    ("make", "title"),
    [
        (ControllerNode, "`controller`"),
        (SimDrone, "`sim_drone`"),
        (MocapPlayer, "`mocap_player`"),
        (CalibrateHover, "`calibrate_hover`"),
        pytest.param(
            CflibBridge, "`cflib_bridge`", marks=pytest.mark.skipif(not find_spec("cflib"), reason="an extra")
        ),
    ],
)
def test_every_parameter_is_documented_with_its_default(
    make: type[Any], title: str, page: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with started(make, tmp_path) as node:
        declared = {name: value.value for name, value in node._parameters.items() if not OWN.fullmatch(name)}
    text = section(page, f"## Parameters of {title}")
    common = {name for name in declared if not name.startswith("robots.")}
    assert first_columns(text) == common
    for name in {name.rpartition(".")[2] for name in declared} - common:
        assert f"`.{name}`" in text or f"`robots.<name>.{name}`" in text
    for name, documented in defaults(text).items():
        assert yaml.safe_load(documented or "''") == declared[name] or name in {*COMPUTED, *GIVEN.get(make, ())}, name


def test_every_telemetry_entry_is_documented(page: str) -> None:
    table = page.partition("**telemetry.**")[2].partition("## ")[0]
    assert first_columns(table) == set(FIELDS)


def quality(profile: QoSProfile) -> str:
    """A quality of service as the table writes it."""
    reliability = profile.reliability.name.lower().replace("_", " ")
    return f"{reliability}, depth {profile.depth}"


def test_every_topic_is_documented_with_type_and_quality(page: str) -> None:
    first = section(page, "## Topics").strip().split("\n\n")[1]  # behind one sentence
    rows = [[cell.strip(" `") for cell in line.split("|")] for line in first.splitlines() if line.startswith("| `")]
    table = {name: (kind, qos) for _, name, kind, _, qos, _ in rows}
    topics = [topic for topic in vars(interfaces).values() if isinstance(topic, interfaces.Topic)]
    pose = interfaces.POSE
    expected = {
        topic.of("<robot>"): (topic.kind, f"published {quality(topic.publish)}; subscribed {quality(topic.subscribe)}")
        if topic is pose
        else (topic.kind, quality(topic.subscribe))
        for topic in topics
    }
    expected["<robot>/mocap_pose"] = (pose.kind, quality(pose.subscribe))
    expected[interfaces.DIAGNOSTICS] = (interfaces.DIAGNOSTICS_KIND, quality(interfaces.DIAGNOSTICS_QOS))
    assert table == {
        name: (f"{kind.__module__.partition('.')[0]}/{kind.__name__}", qos) for name, (kind, qos) in expected.items()
    }
    assert [topic for topic in topics if topic is not pose and quality(topic.publish) != quality(topic.subscribe)] == []


def test_every_service_is_documented(page: str) -> None:
    robots = ("<robot>", interfaces.ALL)
    drone = {interfaces.drone_service_of("<robot>", name) for name in (interfaces.ARM, interfaces.REBOOT)}
    together = (interfaces.EMERGENCY, interfaces.TAKEOFF, interfaces.LAND, interfaces.GO_TO, interfaces.NOTIFY)
    both = {interfaces.drone_service_of(robot, name) for robot in robots for name in together}
    assert first_columns(section(page, "## Services")) == {*interfaces.TRIGGERS, interfaces.ARM} | drone | both
