"""The Python API: the names that a script imports are there, documented, and cost nothing until they are used."""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from inspect import Parameter, signature
from pathlib import Path
from types import ModuleType
from typing import get_origin

import pytest
from source_tree import parsed

import flatsat_ros
from flatsat_ros import (
    Certificate,
    FlatsatError,
    InputSet,
    acceleration_from_input,
    input_from_acceleration,
    load_certificate,
    load_vehicle,
)

PACKAGE = Path(flatsat_ros.__file__).parent
STABLE = (
    "Certificate", "FlatsatError", "InputSet", "acceleration_from_input", "input_from_acceleration",
    "load_certificate", "load_vehicle",
)  # fmt: skip
PROVISIONAL = (
    "Controller", "Pilot", "Plan", "Policy", "SimulatedFleet", "Trajectory", "Tuning", "fly", "plan", "read_mission",
)  # fmt: skip
ROOMS = sorted({file.parent.relative_to(PACKAGE.parent) for file in PACKAGE.glob("**/__init__.py")})
HEAVY = {"numpy", "scipy", "cvxpy", "matplotlib", "rclpy", "tqdm"}


def imported_by(*statements: str) -> list[set[str]]:
    """Which heavy packages are there after each of the statements, in a fresh interpreter."""
    program = ["import sys", f"seen = lambda: print(*({HEAVY!r} & set(sys.modules)))", "seen()"]
    for statement in statements:
        program += [statement, "seen()"]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(PACKAGE.parent), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-c", "\n".join(program)]
    output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    first, *seen = [set(line.split()) for line in output.split("\n")[:-1]]
    assert not first, "a fresh interpreter has them already: nothing could be told"
    return seen


def test_importing_the_package_imports_no_room_and_nothing_heavy() -> None:
    package, api, flown, offline = imported_by(
        "import flatsat_ros",
        "from flatsat_ros import *",
        "import flatsat_ros.identification, flatsat_ros.falsification",
        "import flatsat_ros.synthesis, flatsat_ros.paper, flatsat_ros.demo, flatsat_ros.cli, flatsat_ros.nodes",
    )
    assert package == set()
    assert api == flown == offline == {"numpy"}


@pytest.mark.parametrize("name", [".".join(room.parts) for room in ROOMS])
def test_every_room_offers_documented_names_of_its_own(name: str) -> None:
    room = importlib.import_module(name)
    assert room.__doc__
    assert set(room.__all__) <= set(dir(room))
    for public in room.__all__:
        value = getattr(room, public)
        alias = get_origin(value) is not None  # Python 3.10 takes Callable[...] for a class
        if inspect.isfunction(value) or (inspect.isclass(value) and not alias):
            assert value.__module__.startswith(f"{room.__name__}."), public
            assert value.__doc__, public


@pytest.mark.parametrize("name", ["flatsat_ros", "flatsat_ros.planning", "flatsat_ros.synthesis", "flatsat_ros.paper"])
def test_the_type_checker_and_the_interpreter_read_the_same_names(name: str) -> None:
    room = importlib.import_module(name)
    imports = {
        alias.name: importlib.import_module(str(node.module))
        for block in ast.walk(parsed(inspect.getsource(room)))
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert set(imports) == set(room.__all__) - {"__version__"}
    for public, home in imports.items():
        assert getattr(room, public) is getattr(home, public)


def test_what_is_stable_and_what_is_provisional_is_said() -> None:
    assert set(flatsat_ros.__all__) == {*STABLE, *PROVISIONAL, "__version__"}
    stable, provisional = str(flatsat_ros.__doc__).partition("Provisional")[::2]
    for names, text in ((STABLE, stable), (PROVISIONAL, provisional)):
        for name in names:
            assert f"`{name}`" in text


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (InputSet, "thrust_max, tilt_max, gravity=9.81"),
        (InputSet.contains, "v"),
        (InputSet.gauge, "v"),
        (InputSet.saturate, "v"),
        (InputSet.exit_factor, "base, v"),
        (input_from_acceleration, "v, yaw, gravity=9.81"),
        (acceleration_from_input, "u, yaw, gravity=9.81"),
        (Certificate.load, "path"),
        (Certificate.save, "path"),
        (Certificate.verify, ""),
        (load_certificate, "name_or_path"),
        (load_vehicle, "name_or_path"),
    ],
    ids=lambda value: getattr(value, "__qualname__", ""),
)
def test_what_is_to_be_scripted_against_keeps_its_arguments(
    function: Callable[..., object], arguments: str, root: Path
) -> None:
    page = (root / "docs" / "interfaces.md").read_text(encoding="utf-8").partition("## Names to script against\n")[2]
    assert f"{function.__name__}({arguments})" in page
    parameters = [entry for entry in signature(function).parameters.values() if entry.name != "self"]
    given = [str(entry.replace(annotation=Parameter.empty)) for entry in parameters]
    documented = arguments.split(", ") if arguments else []
    assert given[: len(documented)] == documented
    assert all(entry.default is not Parameter.empty for entry in parameters[len(documented) :])


@pytest.mark.parametrize("room", [flatsat_ros, importlib.import_module("flatsat_ros.synthesis")])
def test_an_unknown_name_is_no_attribute(room: ModuleType) -> None:
    with pytest.raises(AttributeError, match=rf"module '{room.__name__}' has no attribute 'InputSets'"):
        _ = room.InputSets


def test_packaged_certificates_and_vehicles_are_loaded_by_name_and_others_by_path(tmp_path: Path) -> None:
    certificate, vehicle = load_certificate("cf21_50hz"), load_vehicle("cf21")
    assert (certificate.name, vehicle.name) == ("cf21_50hz", "cf21")
    own = tmp_path / "own.yaml"
    certificate.save(own)
    assert load_certificate(own).to_document() == certificate.to_document()
    with pytest.raises(FlatsatError, match=r"no packaged configuration 'cf22'.*brushless, cf21"):
        load_vehicle("cf22")
    with pytest.raises(FlatsatError, match=r"no packaged configuration 'cf21'.*cf21_50hz"):
        load_certificate("cf21")


def offered() -> dict[str, tuple[Callable[..., object], str]]:
    """Public functions, and public methods of public classes, of all rooms, each with the text that explains it.

    What has no text of its own, as the arguments of a dataclass, is explained in that of the class.
    """
    found: dict[str, tuple[Callable[..., object], str]] = {}
    for room in ROOMS:
        module = importlib.import_module(".".join(room.parts))
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isfunction(value):
                found[f"{value.__module__}.{name}"] = value, inspect.getdoc(value) or ""
            elif inspect.isclass(value) and not getattr(value, "_is_protocol", False):
                for inner, member in vars(value).items():
                    function = getattr(member, "__func__", member)  # of class methods and static ones
                    if inspect.isfunction(function) and (inner.endswith("init__") or not inner.startswith("_")):
                        text = function.__doc__ if inner != "__post_init__" else None
                        found[f"{value.__module__}.{name}.{inner}"] = function, inspect.cleandoc(text or value.__doc__)
    return found


OFFERED = offered()


def test_every_argument_of_what_is_offered_is_explained() -> None:
    assert len(OFFERED) > 200
    unexplained = [
        f"{place}({name})"
        for place, (function, text) in OFFERED.items()
        if not re.search(r"arguments are (those of|as for)", text)
        for name in signature(function).parameters
        if name not in ("self", "cls") and not re.search(rf"\b{name}\b", text)
    ]
    assert unexplained == []


def refuses(function: Callable[..., object]) -> bool:
    """Whether a function raises an error, or calls what refuses, by the names of `base.errors` and `base.arrays`."""
    if function.__code__.co_filename == "<string>":  # type: ignore[attr-defined]  # made by dataclass
        return False
    for node in ast.walk(parsed(textwrap.dedent(inspect.getsource(function)))):
        called = ast.unparse(node.func).rpartition(".")[2] if isinstance(node, ast.Call) else ""
        if called in ("finite_array", "float_array") or called.startswith("require"):
            return True
        if isinstance(node, ast.Raise) and node.exc is not None:
            return True
    return False


def test_what_is_offered_and_refuses_something_says_so() -> None:
    refusing = {place: text for place, (function, text) in OFFERED.items() if refuses(function)}
    assert len(refusing) > 50
    assert [place for place, text in refusing.items() if not re.search(r"^Raises:$|[Rr]efus", text, re.MULTILINE)] == []
