"""What the package defines is there for its programs, nodes and scripts: code that only tests reach is not kept."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from source_tree import parsed

ROOT = Path(__file__).parents[1]
# Where a name may be used; setup.py and launch/ name programs, bench/ measures.
USERS = ("flatsat_ros", "bench", "examples", "launch", "setup.py")
# Methods that the standard library calls.
OVERRIDES = {"do_GET", "do_POST", "print_help", "repr_int"}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def defined(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of every function, class and method, apart from those with names of Python's own."""
    for node in ast.walk(tree):
        if isinstance(node, DEFINITIONS) and not re.fullmatch("__.*__", node.name):
            yield node.lineno, node.name


def used(tree: ast.Module) -> Iterator[str]:
    """Every name that is read, and every word of text that is no docstring, from which names are looked up."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield from re.findall(r"\w+", node.value)


def unreached(package: Path, users: list[Path]) -> list[str]:
    """What is defined in a folder and used nowhere, as `file:line: name`."""
    found = set(OVERRIDES)
    for file in users:
        found.update(used(parsed(file.read_text(encoding="utf-8"))))
    return [
        f"{file.relative_to(package)}:{line}: {name}"
        for file in sorted(package.rglob("*.py"))
        for line, name in defined(parsed(file.read_text(encoding="utf-8")))
        if name not in found
    ]


def test_nothing_is_there_for_tests_only() -> None:
    users = [
        file for name in USERS for file in ([ROOT / name] if name.endswith(".py") else (ROOT / name).rglob("*.py"))
    ]
    assert unreached(ROOT / "flatsat_ros", users) == []


@pytest.mark.parametrize(
    ("text", "unused"),
    [
        ("def f():\n    'Calls g.'\n\nf()", []),
        ("def f():\n    'Is f.'", ["1: f"]),
        ("class C:\n    def m(self):\n        self.n()\n\nC()", ["2: m"]),
        ("def f(): ...\n\nprograms = {'f': 'package:f'}", []),
        ("from x import f\n\ndef f(): ...", ["3: f"]),
    ],
)
def test_what_counts_as_used(text: str, unused: list[str], tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(text, encoding="utf-8")
    assert unreached(tmp_path, [tmp_path / "a.py"]) == [f"a.py:{entry}" for entry in unused]
