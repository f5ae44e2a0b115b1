"""A name means one thing in the package, so that a reader who meets it in another room knows what it is."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import pytest
from source_tree import parsed

PACKAGE = Path(__file__).parents[1] / "flatsat_ros"
# What several rooms do in the same sense, each with its own thing.
VERBS = {"attack", "draw", "end", "fly", "lines", "main", "plan", "read", "report", "run", "summary", "table", "trade"}
VERBS |= {"write", "written"}


def several(package: Path) -> dict[str, list[str]]:
    """The classes and the functions for others that more than one module defines, with these modules."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in sorted(package.rglob("*.py")):
        for node in parsed(path.read_text()).body:
            if isinstance(node, ast.ClassDef) or (isinstance(node, ast.FunctionDef) and node.name[0] != "_"):
                places[node.name].append(str(path.relative_to(package)))
    return {name: modules for name, modules in places.items() if len(modules) > 1}


def test_classes_and_functions_have_names_of_their_own() -> None:
    """A name that two rooms use for two things sends a reader to the wrong one."""
    found = {name: modules for name, modules in several(PACKAGE).items() if name not in VERBS}
    assert not found, "\n".join(f"{name}: {', '.join(modules)}" for name, modules in found.items())


def test_names_of_several_things_are_found(tmp_path: Path) -> None:
    """The test above can fail."""
    (tmp_path / "a.py").write_text("class Flight:\n    pass\n\ndef plan(): ...\n\ndef _own(): ...\n")
    (tmp_path / "b.py").write_text("class Flight:\n    pass\n\ndef _own(): ...\n")
    assert several(tmp_path) == {"Flight": ["a.py", "b.py"]}


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_exceptions_are_needed(verb: str) -> None:
    """A verb that one room alone uses is no exception."""
    assert verb in several(PACKAGE)
