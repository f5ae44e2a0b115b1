"""launch/*.launch.py and config/params/*.yaml fit the nodes: executables, names, parameters, time to land at the end.

`launch` is on no package index, so its files are read here, not run.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.node import Node
from source_tree import parsed

from flatsat_ros.crazyflie.link import ZERO_TIME
from flatsat_ros.nodes.cflib_bridge import CflibBridge
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.sim_drone import SimDrone

pytestmark = pytest.mark.in_process

ROOT = Path(__file__).parents[2]
LAUNCH = sorted((ROOT / "launch").iterdir())
NODES: dict[str, type[Any]] = {"controller": ControllerNode, "sim_drone": SimDrone, "cflib_bridge": CflibBridge}
GIVEN = {"crazyflies_yaml", "backend"}  # by crazyswarm2.launch.py, from its own arguments


def started(file: Path) -> list[dict[str, ast.expr]]:
    """The keyword arguments of every Node(...) in a launch file."""
    calls = [node for node in ast.walk(parsed(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    nodes = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "Node"]
    return [{str(keyword.arg): keyword.value for keyword in call.keywords} for call in nodes]


def parameters_of(file: Path) -> dict[str, dict[str, object]]:
    """The parameters of each node in the file that belongs to a launch file."""
    path = ROOT / "config" / "params" / f"{file.name.removesuffix('.launch.py')}.yaml"
    assert f'"{path.name}"' in file.read_text(encoding="utf-8")
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {node: content["ros__parameters"] for node, content in document.items()}


@pytest.fixture
def made(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[Node]]:
    """The nodes of a launch file, made with its file of parameters."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file: Path = request.param
    path = ROOT / "config" / "params" / f"{file.name.removesuffix('.launch.py')}.yaml"
    rclpy.init(args=["--ros-args", "--params-file", str(path)])
    nodes = [NODES[ast.literal_eval(arguments["executable"])]() for arguments in started(file)]
    yield nodes
    for node in nodes:
        for link in getattr(node, "links", []):
            link.leave()
        node.destroy_node()
    rclpy.shutdown()


def test_there_is_a_launch_file_for_each_file_of_parameters() -> None:
    names = [file.name.removesuffix(".launch.py") for file in LAUNCH]
    assert names == sorted(file.stem for file in (ROOT / "config" / "params").iterdir())
    assert len(names) == 3


@pytest.mark.skipif(not find_spec("cflib"), reason="an extra")
@pytest.mark.parametrize(("made", "file"), [(file, file) for file in LAUNCH], indirect=["made"])
def test_the_nodes_of_a_launch_file_take_its_parameters(made: list[Node], file: Path) -> None:
    given = parameters_of(file)
    assert {node.get_name() for node in made} == set(given)
    for node in made:
        for name, value in given[node.get_name()].items():
            assert node.get_parameter(name).value == value, name
            assert type(node.get_parameter(name).value) is type(value), name
        assert not isinstance(node, ControllerNode) or all(map(node.has_parameter, GIVEN))


@pytest.mark.parametrize("file", LAUNCH, ids=lambda file: file.name)
def test_a_launch_file_starts_programs_of_ours_and_gives_them_time_to_land(file: Path) -> None:
    nodes = started(file)
    assert nodes
    landing = max(float(str(given.get("land_time", 0.0))) for given in parameters_of(file).values())
    for arguments in nodes:
        assert ast.literal_eval(arguments["package"]) == "flatsat_ros"
        assert ast.literal_eval(arguments["executable"]) in NODES
        assert {"parameters", "sigterm_timeout", "sigkill_timeout"} <= set(arguments)
        assert float(ast.literal_eval(arguments["sigterm_timeout"])) > 2.0 * (landing + ZERO_TIME)
        keys = [key for part in ast.walk(arguments["parameters"]) if isinstance(part, ast.Dict) for key in part.keys]
        assert {ast.literal_eval(key) for key in keys if key is not None} in (set(), GIVEN)
        assert "name" not in arguments  # a node's own name, by which the file of parameters speaks of it


@pytest.mark.parametrize("file", LAUNCH, ids=lambda file: file.name)
def test_a_launch_file_is_python_that_describes_a_launch(file: Path) -> None:
    code = compile(file.read_text(encoding="utf-8"), str(file), "exec")
    assert "generate_launch_description" in code.co_names
