"""docs/interfaces.md says what the nodes offer, no more and no less."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import rclpy

from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.cflib_bridge import CflibBridge
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.ros import interfaces
from flatsat_ros.nodes.sim_drone import SimDrone

# what rclpy declares by itself
OWN = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*")


@pytest.fixture
def ros() -> Iterator[None]:
    rclpy.init(args=[])
    yield
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


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("make", "title"),
    [
        (ControllerNode, "`controller`"),
        (SimDrone, "`sim_drone`"),
        pytest.param(
            CflibBridge, "`cflib_bridge`", marks=pytest.mark.skipif(not find_spec("cflib"), reason="an extra")
        ),
    ],
)
def test_every_parameter_is_documented_with_its_default(
    make: type[Any], title: str, page: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    node = make()
    for link in getattr(node, "links", []):
        link.leave()
    declared = {name: value.value for name, value in node._parameters.items() if not OWN.fullmatch(name)}
    node.destroy_node()
    text = section(page, f"## Parameters of {title}")
    common = {name for name in declared if not name.startswith("robots.")}
    assert first_columns(text) == common
    for name in {name.rpartition(".")[2] for name in declared} - common:
        assert f"`.{name}`" in text or f"`robots.<name>.{name}`" in text
    for name, documented in defaults(text).items():
        if isinstance(declared[name], (int, float)) and not isinstance(declared[name], bool):
            assert float(documented) == declared[name], name


def test_every_telemetry_entry_is_documented(page: str) -> None:
    table = page.partition("**telemetry.**")[2].partition("## ")[0]
    assert first_columns(table) == set(FIELDS)


def test_every_topic_is_documented(page: str) -> None:
    table = first_columns(section(page, "## Topics"))
    topics = (interfaces.POSE, interfaces.GOAL, interfaces.TRAJECTORY, interfaces.COMMAND, interfaces.TELEMETRY)
    assert {topic.of("<robot>") for topic in topics} | {interfaces.DIAGNOSTICS} <= table


def test_every_service_is_documented(page: str) -> None:
    robots = ("<robot>", interfaces.ALL)
    drone = {interfaces.drone_service_of("<robot>", name) for name in (interfaces.ARM, interfaces.REBOOT)}
    together = (interfaces.EMERGENCY, interfaces.TAKEOFF, interfaces.LAND, interfaces.GO_TO, interfaces.NOTIFY)
    both = {interfaces.drone_service_of(robot, name) for robot in robots for name in together}
    assert first_columns(section(page, "## Services")) == {*interfaces.TRIGGERS, interfaces.ARM} | drone | both
