"""README, CONTRIBUTING and docs/*.md name only what there is: links, paths, modules, make targets and programs."""

from __future__ import annotations

import ast
import re
import runpy
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from source_tree import parsed

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "flatsat_ros"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
ROOMS = {folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").is_file()}
TOP = {"bench", "config", "docs", "examples", "flatsat_ros", "launch", "requirements", "test"}
BUILT = {"docs/api", "docs/api/index.html"}  # by make docs

_FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`([^`\n]+)`")
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_PATH = re.compile(r"(?<![\w./<>~:-])((?:\w[\w-]*/)+[\w.*-]*[\w*])")
_FILE = re.compile(r"(?<![\w./<>~:-])(\w+\.py)\b")
_MODULE = re.compile(rf"(?<![\w./-])(?:flatsat_ros\.)?((?:{'|'.join(sorted(ROOMS))})(?:\.\w+)+)(?![\w/])")
_MEMBER = re.compile(r"(?<![\w.])([A-Z]+[a-z]\w*)\.([a-z_]\w*)")


def prose(page: str) -> str:
    """The page without its blocks of code."""
    return _FENCE.sub("", page)


def code(page: str) -> str:
    """Code spans and blocks of the page, one a line or more."""
    return "\n".join([*_FENCE.findall(page), *_SPAN.findall(prose(page))])


def anchors(page: str) -> set[str]:
    """The anchors that GitHub gives to the headings of a page."""
    found: list[str] = []
    for heading in re.findall(r"^#+ +(.+?) *$", prose(page), re.MULTILINE):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        found.append(slug if slug not in found else f"{slug}-{found.count(slug)}")
    return set(found)


def dead_links(file: Path, page: str) -> list[str]:
    """Links of a page to files or headings that are not there; other sites are not asked."""
    dead = []
    for target in _LINK.findall(prose(page)):
        if re.match(r"\w+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = file if not path else (file.parent / path)
        headed = not anchor or (there.suffix == ".md" and anchor in anchors(there.read_text(encoding="utf-8")))
        if not there.exists() or not headed:
            dead.append(target)
    return dead


def missing_paths(page: str) -> list[str]:
    """Paths below the project's folders or from inside the package, and names of Python files, that do not exist."""
    missing = []
    for path in {found for found in _PATH.findall(page) if found.partition("/")[0] in TOP | ROOMS}:
        base = ROOT if path.partition("/")[0] in TOP else PACKAGE
        written_as_path = path.partition("/")[0] in TOP or path.endswith(".py")
        if written_as_path and path not in BUILT and not any(base.glob(path)):
            missing.append(path)
    names = {file.name for folder in TOP for file in (ROOT / folder).rglob("*.py")} | {"setup.py"}
    spans = " ".join(_SPAN.findall(prose(page)))
    return sorted(missing + [name for name in set(_FILE.findall(spans)) if name not in names])


@cache
def members(file: Path) -> dict[str, set[str]]:
    """Names that a module defines, each with those that a class defines in turn."""

    def defined(body: list[ast.stmt]) -> Iterator[tuple[str, list[ast.stmt]]]:
        for node in body:
            match node:
                case ast.ClassDef(name=name):
                    yield name, node.body
                case ast.FunctionDef(name=name):
                    stores = [part for part in ast.walk(node) if isinstance(part, ast.Attribute)]
                    own = (
                        [part.attr for part in stores if isinstance(part.ctx, ast.Store)] if name == "__init__" else []
                    )
                    yield from ((attribute, []) for attribute in [name, *own])
                case ast.Assign(targets=targets):
                    names = [part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
                    yield from ((name, []) for name in names)
                case ast.AnnAssign(target=ast.Name(id=name)):
                    yield name, []
                case ast.ImportFrom(names=aliases):
                    yield from ((alias.asname or alias.name, []) for alias in aliases)

    tree = parsed(file.read_text(encoding="utf-8"))
    return {name: {inner for inner, _ in defined(body)} for name, body in defined(tree.body)}


def missing_modules(page: str) -> list[str]:
    """Dotted names below a room that lead nowhere."""

    def leads(name: str) -> bool:
        parts, place = name.split("."), PACKAGE
        while parts and (place / parts[0]).is_dir():
            place /= parts.pop(0)
        inside = bool(parts) and (place / f"{parts[0]}.py").is_file()
        file = place / (f"{parts.pop(0)}.py" if inside else "__init__.py")
        known = members(file)
        return not parts or (parts[0] in known and all(part in known[parts[0]] for part in parts[1:]))

    return sorted({name for name in _MODULE.findall(code(page)) if not leads(name)})


@cache
def classes() -> dict[str, set[str]]:
    """The members of all classes of the package, by name of the class."""
    found: dict[str, set[str]] = {}
    for file in PACKAGE.rglob("*.py"):
        for name, inner in members(file).items():
            found.setdefault(name, set()).update(inner)
    return found


def missing_members(page: str) -> list[str]:
    """`Class.member` in code where a class of the package has no such member, or there is no such class."""
    named = {(name, member) for name, member in _MEMBER.findall(code(page)) if member not in classes().get(name, ())}
    return sorted(f"{name}.{member}" for name, member in named)


def unknown_commands(page: str) -> list[str]:
    """`make x` without such a target, `ros2 run flatsat_ros x` without such a program."""
    targets = set(re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    programs = set(re.findall(r'"(\w+) = flatsat_ros\.', (ROOT / "setup.py").read_text(encoding="utf-8")))
    asked = {
        f"make {name}" for name in re.findall(r"^make ([a-z0-9-]+)", code(page), re.MULTILINE) if name not in targets
    }
    run = re.findall(r"(?:ros2 run flatsat_ros |lib/flatsat_ros/)(\w+)", code(page))
    return sorted(asked | {name for name in run if name not in programs})


CHECKS = {
    "paths": missing_paths,
    "modules": missing_modules,
    "members": missing_members,
    "commands": unknown_commands,
}


@pytest.mark.parametrize("file", PAGES, ids=lambda file: file.name)
def test_every_link_and_anchor_resolves(file: Path) -> None:
    assert dead_links(file, file.read_text(encoding="utf-8")) == []


def test_what_the_code_cites_of_the_documents_exists() -> None:
    files = [file for folder in sorted(TOP) for file in (ROOT / folder).rglob("*.py") if file != Path(__file__)]
    for file in files:
        for target, anchor in re.findall(r"docs/(\w+\.md)(?:#([\w-]+))?", file.read_text(encoding="utf-8")):
            document = ROOT / "docs" / target
            assert document.is_file(), f"{file}: docs/{target}"
            assert not anchor or anchor in anchors(document.read_text(encoding="utf-8")), f"{file}: {target}#{anchor}"


def test_docstrings_and_comments_name_only_what_there_is() -> None:
    for file in [*PACKAGE.rglob("*.py"), *(ROOT / "config").rglob("*.yaml")]:
        text = file.read_text(encoding="utf-8")
        named = missing_paths(text) + missing_modules(text) + missing_members(text)
        assert named == [], file


def test_python_in_the_readme_runs(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.M | re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
        assert capsys.readouterr().out.strip()


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("file", PAGES, ids=lambda file: file.name)
def test_a_page_names_only_what_there_is(file: Path, check: str) -> None:
    assert CHECKS[check](file.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("check", "text", "culprit"),
    [
        ("paths", "see `test/law/test_nothing.py`", "test/law/test_nothing.py"),
        ("paths", 'make test ARGS="test/core -k gauge"', "test/core"),
        ("paths", "in docs/nowhere.md", "docs/nowhere.md"),
        ("paths", "`law/nothing.py`", "law/nothing.py"),
        ("paths", "`test/test_layering.py` and `test_nothing.py`", "test_nothing.py"),
        ("modules", "Code: `law.nothing`", "law.nothing"),
        ("modules", "Code: `law.gain.nothing`", "law.gain.nothing"),
        ("modules", "`flatsat_ros.law.input_set.InputSet.nothing(v)`", "law.input_set.InputSet.nothing"),
        ("members", "`InputSet.nothing`", "InputSet.nothing"),
        ("members", "`Nothing.saturate`", "Nothing.saturate"),
        ("commands", "`make nothing`", "make nothing"),
        ("commands", "```sh\nros2 run flatsat_ros nothing\n```", "nothing"),
    ],
)
def test_what_is_not_there_is_found(check: str, text: str, culprit: str) -> None:
    assert CHECKS[check](text) == [culprit]


def test_the_readme_leads_to_every_page() -> None:
    links = set(_LINK.findall(prose((ROOT / "README.md").read_text(encoding="utf-8"))))
    assert {file.relative_to(ROOT).as_posix() for file in PAGES[1:]} - links == set()


def test_the_state_table_is_that_of_the_code() -> None:
    """Compare the page with what `make docs` prints."""
    builder = runpy.run_path(str(ROOT / "docs" / "build_flight_modes.py"))
    assert builder["PAGE"].read_text(encoding="utf-8") == builder["page"]()


def test_dead_links_are_found() -> None:
    page = "[a](CONTRIBUTING.md) [b](nothing.md) [c](#nothing) [d](CONTRIBUTING.md#nothing) [e](https://example.org/#x)"
    assert dead_links(ROOT / "README.md", page) == ["nothing.md", "#nothing", "CONTRIBUTING.md#nothing"]


def places() -> dict[str, list[tuple[str, list[str]]]]:
    """Of the table "to change, look in" of CONTRIBUTING: the files of each row, each with the names to look for."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Where to change what\n")[2]
    rows = [line.strip("| ").split(" | ") for line in page.partition("\n## ")[0].splitlines() if line.startswith("| ")]
    table = {}
    for change, where in rows[1:]:
        spans = [_SPAN.findall(part) for part in where.split("; ")]
        table[change] = [(file, names) for file, *names in filter(None, spans)]
    return table


def test_the_classes_of_the_architecture_are_there() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = {name for name in _SPAN.findall(page) if re.fullmatch(r"[A-Z]+[a-z]\w+", name)}
    assert "Pilot" in named
    assert named - set(classes()) == set()


def test_the_files_of_the_architecture_are_there() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    files = [path.relative_to(ROOT) for room in ("flatsat_ros", "test") for path in (ROOT / room).rglob("*.py")]
    named = [name for name in _SPAN.findall(page) if re.fullmatch(r"[\w/]+\.py", name)]
    assert len(named) > 5
    assert [name for name in named if not any(f"/{file}".endswith(f"/{name}") for file in files)] == []


def test_contributing_says_where_to_change_what() -> None:
    assert len(places()) > 10


@pytest.mark.parametrize("change", places())
def test_what_is_to_be_changed_is_where_contributing_says(change: str) -> None:
    assert places()[change]
    for file, names in places()[change]:
        text = (ROOT / file).read_text(encoding="utf-8")
        assert [name for name in names if not re.search(rf"\b{re.escape(name)}\b", text)] == [], file


def test_every_folder_and_file_of_tests_is_explained() -> None:
    page = (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    rows = {
        name for line in page.splitlines() if line.startswith("| `") for name in _SPAN.findall(line.split(" | ")[0])
    }
    folders = {f"test/{file.parent.name}" for file in (ROOT / "test").glob("*/test_*.py")}
    assert rows == folders | {f"test/{file.name}" for file in (ROOT / "test").glob("test_*.py")}
