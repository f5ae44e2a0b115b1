"""The layers: who imports whom, read from the source text. A wrong arrow fails here."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pytest
from source_tree import parsed

import flatsat_ros

PACKAGE = "flatsat_ros"


@dataclass(frozen=True)
class Room:
    """What the modules of one folder may import beside the standard library and their own folder."""

    rooms: frozenset[str]
    libraries: frozenset[str] | None  # None: any, ROS included


def _room(rooms: str = "", libraries: str | None = "") -> Room:
    """A room, from names separated by spaces."""
    return Room(frozenset(rooms.split()), None if libraries is None else frozenset(libraries.split()))


# bottom to top: a room may import only rooms above it in this table
_PROOFS = "base law certificate"
_FLOWN = f"{_PROOFS} flight crazyflie"
ROOMS = {
    "_lazy": _room(),
    "_version": _room(),
    "base": _room(libraries="numpy yaml"),
    "law": _room("base", libraries="numpy"),
    "certificate": _room("base law", libraries="numpy"),
    "flight": _room(_PROOFS, libraries="numpy"),
    "crazyflie": _room("base certificate", libraries="numpy"),
    "plans": _room(f"{_PROOFS} flight", libraries="numpy"),
    "planning": _room(f"{_PROOFS} flight plans", libraries="numpy scipy clarabel"),
    "synthesis": _room(f"{_FLOWN} planning", libraries="numpy scipy clarabel cvxpy matplotlib tqdm"),
    "identification": _room("base certificate flight crazyflie", libraries="numpy scipy matplotlib"),
    "sim": _room(_FLOWN, libraries="numpy"),
    "viewing": _room(f"{_FLOWN}", libraries="numpy rosbags"),
    "nodes": _room(f"{_FLOWN} plans identification sim viewing", libraries=None),
    "demo": _room(f"{_FLOWN} plans planning synthesis sim nodes", libraries="numpy matplotlib tqdm"),
    "falsification": _room(f"{_FLOWN} plans planning synthesis sim nodes demo", libraries="numpy tqdm"),
    "paper": _room(f"{_FLOWN} planning synthesis sim falsification demo", libraries="numpy matplotlib tqdm"),
    "cli": _room(
        f"{_FLOWN} plans planning synthesis identification sim viewing falsification demo paper",
        libraries="numpy scipy matplotlib rosbags tqdm",
    ),
    "__init__": _room(f"{_FLOWN} plans planning sim"),  # by name only: importing the package imports no room
}


@dataclass(frozen=True)
class Import:
    """One imported module: dotted name, line, and whether it happens only when a function is called."""

    module: str
    line: int
    lazy: bool


def imports_of(file: Path, module: str) -> Iterator[Import]:
    """Every import of a file with dotted name `module`: relative ones resolved, import_module("...") included."""
    package = module if file.stem == "__init__" else module.rpartition(".")[0]

    def walk(node: ast.AST, lazy: bool) -> Iterator[Import]:
        match node:
            case ast.Import(names=names):
                yield from (Import(alias.name, node.lineno, lazy) for alias in names)
            case ast.ImportFrom(module=base, names=names, level=level):
                above = package.split(".")[: len(package.split(".")) - level + 1] if level else []
                prefix = ".".join([*above, *([base] if base else [])])
                yield from (Import(f"{prefix}.{alias.name}", node.lineno, lazy) for alias in names)
            case ast.Call(
                func=ast.Name(id="import_module" | "__import__") | ast.Attribute(attr="import_module"),
                args=[ast.Constant(value=str(name)), *_],
            ):
                yield Import(name, node.lineno, lazy)
        lazy = lazy or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)) or _for_types_only(node)
        for child in ast.iter_child_nodes(node):
            yield from walk(child, lazy)

    yield from walk(parsed(file.read_text(encoding="utf-8")), lazy=False)


def _for_types_only(node: ast.AST) -> bool:
    """Whether what stands below the node is read by the type checker but never run."""
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def modules(tree: Path) -> Iterator[tuple[str, Path, str]]:
    """(room, file, dotted name) of every module of the package in folder `tree`."""
    for file in sorted(tree.rglob("*.py")):
        parts = file.relative_to(tree).with_suffix("").parts
        dotted = ".".join([PACKAGE, *(part for part in parts if part != "__init__")])
        yield parts[0], file, dotted


def violations(tree: Path) -> list[str]:
    """Every import in the package folder `tree` that its room may not have, as `file:line: why`."""
    found = []
    for room, file, dotted in modules(tree):
        if room not in ROOMS:
            found.append(f"{file.relative_to(tree)}:1: {room} is no room of the house")
            continue
        for imported in imports_of(file, dotted):
            if not _allowed(room, imported):
                found.append(f"{file.relative_to(tree)}:{imported.line}: {room} may not import {imported.module}")
    return found


def _allowed(room: str, imported: Import) -> bool:
    top, _, rest = imported.module.partition(".")
    if top == PACKAGE:
        target = rest.partition(".")[0]
        if target in ("", room) or target.startswith("_"):  # the version and the root's own modules serve everybody
            return True
        return target in ROOMS[room].rooms and (room != "__init__" or imported.lazy)
    libraries = ROOMS[room].libraries
    return top in sys.stdlib_module_names or libraries is None or top in libraries


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small package in which every arrow is right."""
    files = {
        "__init__.py": "from ._version import __version__\nif TYPE_CHECKING:\n    from .law import controller",
        "_version.py": '__version__ = "0"',
        "base/errors.py": "import numpy as np",
        "law/__init__.py": "",
        "law/controller.py": "import math\nimport numpy as np\nfrom flatsat_ros.base.errors import E",
        "synthesis/nominal.py": "import cvxpy as cp\nfrom flatsat_ros.law import controller",
        "sim/drone.py": "import numpy as np\nfrom flatsat_ros import __version__\nfrom ..law.controller import step",
        "nodes/controller.py": "import rclpy\nfrom std_msgs.msg import Header\nfrom flatsat_ros.sim import drone",
        "cli/demo.py": "import matplotlib\n\ndef main():\n    from flatsat_ros.demo import live",
    }
    for name, text in files.items():
        file = tmp_path / PACKAGE / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return tmp_path / PACKAGE


def test_right_arrows_are_accepted(tree: Path) -> None:
    assert violations(tree) == []


@pytest.mark.parametrize(
    ("module", "line", "culprit"),
    [
        ("law/bad.py", "import rclpy", "rclpy"),
        ("law/bad.py", "from geometry_msgs.msg import Twist", "geometry_msgs"),
        ("law/bad.py", "import scipy.linalg", "scipy"),
        ("law/bad.py", "def f():\n    import cvxpy", "cvxpy"),
        ("law/bad.py", "import importlib\nimportlib.import_module('rclpy')", "rclpy"),
        ("law/bad.py", "from flatsat_ros.sim.drone import Drone", "sim"),
        ("law/bad.py", "from flatsat_ros import sim", "sim"),
        ("law/bad.py", "from flatsat_ros import fly", "fly"),
        ("law/bad.py", "from .. import sim", "sim"),
        ("law/bad.py", "from ..nodes import controller", "nodes"),
        ("law/__init__.py", "from ..sim import drone", "sim"),
        ("base/bad.py", "from flatsat_ros import law", "law"),
        ("__init__.py", "from flatsat_ros.law import controller", "law"),
        ("__init__.py", "if TYPE_CHECKING:\n    from flatsat_ros.cli import demo", "cli"),
        ("sim/bad.py", "import rclpy", "rclpy"),
        ("sim/bad.py", "from flatsat_ros.synthesis import nominal", "synthesis"),
        ("synthesis/bad.py", "from flatsat_ros.sim import drone", "sim"),
        ("synthesis/bad.py", "from std_msgs.msg import Header", "std_msgs"),
        ("nodes/bad.py", "from flatsat_ros.cli import demo", "cli"),
        ("nodes/bad.py", "from flatsat_ros.synthesis import nominal", "synthesis"),
        ("cli/bad.py", "def main():\n    import rclpy", "rclpy"),
        ("attic/bad.py", "import math", "attic"),
    ],
)
def test_wrong_arrow_is_found(tree: Path, module: str, line: str, culprit: str) -> None:
    file = tree / module
    file.parent.mkdir(exist_ok=True)
    file.write_text(line, encoding="utf-8")
    assert [culprit in text and text.startswith(module) for text in violations(tree)] == [True]


def test_the_package_keeps_its_layers() -> None:
    package = Path(flatsat_ros.__file__).parent
    assert not violations(package), "\n".join(violations(package))
    assert {room for room, _, _ in modules(package)} == set(ROOMS)


def test_the_table_of_rooms_has_no_circles() -> None:
    order = list(ROOMS)
    for index, (name, entry) in enumerate(ROOMS.items()):
        assert entry.rooms <= set(order[:index]), f"{name} stands below a room that it imports"


def test_every_ros_package_the_nodes_need_is_declared(root: Path) -> None:
    declared = {depend.text for depend in ElementTree.parse(root / "package.xml").iter("depend")}
    needed = {
        imported.module.partition(".")[0]
        for room, file, dotted in modules(Path(flatsat_ros.__file__).parent)
        if room == "nodes"
        for imported in imports_of(file, dotted)
        if not imported.lazy  # what is imported lazily may be absent
    }
    assert needed - set(sys.stdlib_module_names) - {PACKAGE, "numpy", "yaml", "rosbags", "cflib", "tqdm"} <= declared


def test_cflib_which_is_gpl_is_loaded_by_one_executable_only() -> None:
    package = Path(flatsat_ros.__file__).parent
    users = {
        (dotted.rpartition(".")[2], imported.lazy)
        for _, file, dotted in modules(package)
        for imported in imports_of(file, dotted)
        if imported.module.partition(".")[0] == "cflib" or "cflib_" in imported.module
    }
    assert users == {
        ("cflib_link", False), ("cflib_sender", False), ("cflib_bridge", True), ("link_watch", True),
    }  # fmt: skip


def test_the_document_shows_these_rooms_and_arrows(root: Path) -> None:
    page = (
        (root / "docs" / "architecture.md").read_text(encoding="utf-8").partition("## Rooms\n")[2].partition("\n## ")[0]
    )
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("| `")
    ]
    shown = {
        room.strip("`"): Room(
            frozenset(re.findall(r"`(\w+)`", rooms)),
            None if libraries == "any" else frozenset(re.findall(r"`(\w+)`", libraries)),
        )
        for room, _, rooms, libraries in rows
    }
    assert shown == ROOMS
    assert len(rows) == len(ROOMS)
    assert [room for room, purpose in ((row[0], row[1]) for row in rows) if not purpose] == []
