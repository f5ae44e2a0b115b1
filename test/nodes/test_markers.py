"""The markers show where drones, references and tubes are, and nothing is made of them while nobody listens."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from room import Room, rooms
from visualization_msgs.msg import Marker, MarkerArray

from flatsat_ros.base.strict_yaml import read_yaml
from flatsat_ros.nodes.markers import Markers, _edges
from flatsat_ros.nodes.ros import interfaces

pytestmark = pytest.mark.in_process


@pytest.fixture
def room() -> Iterator[Room]:
    with rooms() as make:
        yield make()


def test_markers_are_where_drones_references_and_tubes_are(room: Room) -> None:
    room.hover("cf1")
    sent: list[MarkerArray] = []
    node = room.node
    markers = Markers(node, room.node.robots, "room", node._pilot._policy.box, node._newest)
    listeners = 0
    publisher = SimpleNamespace(get_subscription_count=lambda: listeners, publish=sent.append)
    markers._publisher = publisher  # type: ignore[assignment]
    markers._publish()
    assert sent == []
    listeners = 1
    markers._publish()
    (message,) = sent
    found = {(marker.ns, marker.id): marker for marker in message.markers}
    assert {marker.header.frame_id for marker in message.markers} == {"room"}
    assert {name for name, number in found if number == 1} == {"drone", "name"}  # it stands
    assert found["name", 1].text == "cf2"
    place = found["drone", 0].pose.position
    assert [place.x, place.y, place.z] == pytest.approx(room.fleet.bodies.position[0], abs=0.02)
    reference = found["reference", 0].pose.position
    assert [reference.x, reference.y, reference.z] == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    tube = node._last.assessment.tube  # type: ignore[union-attr]
    if tube is not None:
        assert found["tube", 0].scale.x == pytest.approx(2.0 * np.broadcast_to(tube, (2, 2))[0, 0])
        assert found["tube", 0].pose.position == reference
    assert all(marker.type != Marker.LINE_LIST or len(marker.points) == 24 for marker in message.markers)


def test_a_box_has_twelve_edges() -> None:
    corners = np.array([[0.0, 1.0, 2.0], [1.0, 3.0, 5.0]])
    ends = np.array(_edges(corners)).reshape(12, 2, 3)
    lengths = sorted(np.abs(ends[:, 1] - ends[:, 0]).sum(axis=1))
    assert lengths == [1.0] * 4 + [2.0] * 4 + [3.0] * 4
    assert len({tuple(sorted(map(tuple, edge))) for edge in ends.tolist()}) == 12


def test_the_set_up_for_rviz_listens_to_the_markers() -> None:
    path = Path(__file__).resolve().parents[2] / "config" / "viewer" / "flatsat.rviz"
    configuration: Any = read_yaml(path)
    manager: dict[str, Any] = configuration["Visualization Manager"]
    panels = configuration["Panels"]
    plugins = [*manager["Displays"], *manager["Tools"], manager["Views"]["Current"]]
    # as rviz_common and rviz_default_plugins of Jazzy call them; what they do not know is left out by RViz in silence
    assert {panel["Class"] for panel in panels} <= {"rviz_common/Displays", "rviz_common/Views"}
    assert {plugin["Class"].removeprefix("rviz_default_plugins/") for plugin in plugins} == {
        "Grid",
        "MarkerArray",
        "MoveCamera",
        "Orbit",
    }
    assert all(display["Enabled"] and display["Value"] for display in manager["Displays"])
    frames = [manager["Global Options"]["Fixed Frame"], manager["Views"]["Current"]["Target Frame"]]
    assert frames == ["world"] * 2
    (topic,) = [display["Topic"] for display in manager["Displays"] if "Topic" in display]
    offered = interfaces.MARKERS.publish
    words = {"Volatile": DurabilityPolicy.VOLATILE, "Reliable": ReliabilityPolicy.RELIABLE}
    assert topic["Value"] == f"/{interfaces.MARKERS.suffix}"
    assert words[topic["Durability Policy"]] == offered.durability
    assert words[topic["Reliability Policy"]] == offered.reliability
