"""The gate runs what the README and CONTRIBUTING tell a person to run, and the hooks run the same."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import yaml
from source_tree import parsed

GATE = ["make lint", "make docs", "make test"]


def commands(text: str) -> list[str]:
    """The lines of a script that call make."""
    return re.findall(r"^make .*$", text, flags=re.MULTILINE)


def test_the_gate_calls_lint_and_the_readmes_test_command_by_name(root: Path) -> None:
    assert commands((root / ".ci" / "run").read_text(encoding="utf-8")) == GATE
    assert "make test" in commands((root / "README.md").read_text(encoding="utf-8"))
    contributing = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert [command for command in GATE if f"`{command}`" not in contributing] == []


def test_the_hooks_call_the_commands_of_the_gate_and_fetch_nothing(root: Path) -> None:
    configuration = yaml.safe_load((root / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    (local,) = configuration["repos"]
    assert local["repo"] == "local"
    assert [hook["entry"] for hook in local["hooks"]] == GATE
    assert {hook["language"] for hook in local["hooks"]} == {"system"}
    assert not any(hook["pass_filenames"] for hook in local["hooks"])


def test_lint_checks_style_format_and_the_types_of_the_whole_package(root: Path) -> None:
    (rule,) = re.findall(r"^lint:.*\n((?:\t.*\n)+)", (root / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert [line.strip().removeprefix("$(BIN)/") for line in rule.splitlines()] == [
        "ruff check .",
        "ruff format --check .",
        "mypy",
    ]
    settings = (root / "pyproject.toml").read_text(encoding="utf-8")
    assert 'files = ["flatsat_ros"]' in settings
    assert re.search(r"^strict = true$", settings, flags=re.MULTILINE)


def test_no_test_imports_the_benchmark(root: Path) -> None:
    bench = {file.stem for file in (root / "bench").glob("*.py")}
    for file in (root / "test").rglob("*.py"):
        nodes = list(ast.walk(parsed(file.read_text(encoding="utf-8"))))
        imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        imported |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
        assert not bench & {name.partition(".")[0] for name in imported}, file


def test_a_part_of_the_benchmark_that_fails_is_named_and_what_was_measured_is_kept(root: Path, tmp_path: Path) -> None:
    program, output, missions = root / "bench" / "run.py", tmp_path / "out", tmp_path / "none"
    command = [sys.executable, str(program), "--output", str(output), "--missions", str(missions)]
    ended = subprocess.run(command, text=True, capture_output=True, check=False)
    kept = json.loads((output / "bench.json").read_text(encoding="utf-8"))
    assert ended.returncode == 1
    (reason,) = re.findall("^error: plans: (.*)$", ended.stderr, re.MULTILINE)
    assert kept["failed"] == {"plans": reason}
    assert kept["machine"]["python"]
    assert "Targets" in ended.stdout
