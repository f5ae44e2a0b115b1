"""Three files alone touch the fields of ROS messages: read from the source text of `nodes` and of `demo`."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from source_tree import parsed
from std_srvs.srv import SetBool, Trigger

import flatsat_ros
from flatsat_ros.nodes.ros import interfaces

pytestmark = pytest.mark.in_process

TOPICS = (interfaces.POSE, interfaces.TRAJECTORY, interfaces.COMMAND, interfaces.BATTERY, interfaces.TELEMETRY)
KINDS = [
    *(topic.kind for topic in TOPICS),
    interfaces.DIAGNOSTICS_KIND,
    *(kind for service in (SetBool, Trigger) for kind in (service.Request, service.Response)),
    ParameterDescriptor,
    SetParametersResult,
]
# of crazyflie_interfaces' requests and status, which is not installed everywhere
CRAZYFLIE_FIELDS = {"arm", "height", "duration", "goal", "yaw", "relative", "battery_voltage", "pm_state"}
# Fields whose names our own classes, enumerations and rclpy's parameters use as well. They count where they are taken
# from something that is called what messages are called.
SHARED = {
    "arm",
    "duration",
    "height",
    "level",
    "name",
    "position",
    "relative",
    "stamp",
    "value",
    "values",
    "voltage",
    "yaw",
}
CALLED = {"answer", "descriptor", "message", "msg", "request", "response", "result", "status"}


def fields_of(kind: Any) -> set[str]:
    """Names of the fields of a message, and of those within."""
    found = set()
    for name, described in kind.get_fields_and_field_types().items():
        found.add(name)
        if nested := re.search(r"(\w+)/(\w+)", described):
            found |= fields_of(getattr(import_module(f"{nested[1]}.msg"), nested[2]))
    return found


@pytest.fixture(scope="module")
def fields() -> set[str]:
    return CRAZYFLIE_FIELDS.union(*map(fields_of, KINDS))


def touched(source: str, fields: set[str]) -> Iterator[str]:
    """Every access to a field of a message in a source text, with its line; a method that is called is none."""
    tree = parsed(source)
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in fields and id(node) not in called:
            owner = ast.unparse(node.value).rpartition(".")[2].strip("_")
            if node.attr not in SHARED or owner in CALLED:
                yield f"{node.lineno}: {ast.unparse(node)}"


def test_no_other_file_touches_a_field(fields: set[str]) -> None:
    package = Path(flatsat_ros.__file__).parent
    files = [file for room in ("nodes", "demo") for file in (package / room).rglob("*.py")]
    assert len(files) > 10
    found = {file.name: list(touched(file.read_text(encoding="utf-8"), fields)) for file in files}
    assert all(found.pop(f"{name}messages.py") for name in ("", "server_", "marker_")), "the check sees nothing"
    assert not [f"{name}:{access}" for name, accesses in found.items() for access in accesses]


@pytest.mark.parametrize(
    "line",
    [
        "message.header.stamp = now",
        "p = pose.pose.position",
        "self._command.linear.x = 1.0",
        "diagnostics.status.append(entry)",
        "if request.data: pass",
        "answer.success, answer.message = True, ''",
        "request.duration.sec = 1",
        "rows.append(list(message.data))",
        "print(status.level)",
        "descriptor.floating_point_range = []",
        "self._answer.message",
        "x = request.yaw",
    ],
)
def test_an_access_is_found(line: str, fields: set[str]) -> None:
    assert list(touched(line, fields))


@pytest.mark.parametrize("line", ["robot.name", "mode.value", "counts.values()", "sample.position", "self._index"])
def test_what_is_ours_is_none(line: str, fields: set[str]) -> None:
    assert not list(touched(line, fields))
