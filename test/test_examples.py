"""The examples run as they stand, from any folder, without arguments and display, and do what they say."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
LONGEST = {"quickstart.py": 15, "waypoints.py": 10, "your_own_drone.py": 30}  # lines of code


def run(program: str, folder: Path) -> str:
    """Run a Python file, or what follows -c, in a folder and return what it prints."""
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MPLBACKEND")}
    command = [sys.executable, *(["-c", program] if "\n" in program else [program])]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    return done.stdout


def example(name: str, folder: Path) -> list[float]:
    """Run an example, require that it writes the files that it names and no other, and return the figures it prints."""
    printed = run(str(EXAMPLES / name), folder)
    named = re.findall(r"[\w.]+\.(?:png|yaml)", printed)
    assert sorted(file.name for file in folder.iterdir()) == sorted(named)
    assert all((folder / name).stat().st_size > 0 for name in named)
    return [float(figure) for figure in re.findall(r"\d+\.\d+", printed)]


def test_quickstart_hovers_and_takes_a_step(tmp_path: Path) -> None:
    x, z = example("quickstart.py", tmp_path)
    assert (x, z) == pytest.approx((0.5, 1.0), abs=0.02)


def test_waypoints_are_flown_closely(tmp_path: Path) -> None:
    (farthest,) = example("waypoints.py", tmp_path)
    assert 0.0 < farthest < 0.1


def test_your_own_drone_gets_a_certificate_and_hovers(tmp_path: Path) -> None:
    *_, height = example("your_own_drone.py", tmp_path)
    assert height == pytest.approx(1.0, abs=0.02)


def test_the_notebook_runs_from_top_to_bottom_and_holds_no_output(tmp_path: Path) -> None:
    notebook = json.loads((EXAMPLES / "quickstart.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell for cell in cells if cell["outputs"] or cell["execution_count"] is not None] == []
    printed = run("\n".join("".join(cell["source"]) for cell in cells), tmp_path)
    x, z = map(float, re.findall(r"at x = (\S+) m, z = (\S+) m", printed)[0])
    assert (x, z) == pytest.approx((0.5, 1.0), abs=0.02)


@pytest.mark.parametrize("name", LONGEST)
def test_an_example_is_short(name: str) -> None:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    skipped = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.ENCODING, tokenize.ENDMARKER)
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in skipped]
    assert tokens[0].type == tokenize.STRING  # the docstring
    assert len({line for token in tokens[1:] for line in range(token.start[0], token.end[0] + 1)}) <= LONGEST[name]


def test_every_example_is_tested() -> None:
    assert {file.name for file in EXAMPLES.iterdir()} == {*LONGEST, "quickstart.ipynb"}


def test_after_make_setup_alone_the_source_is_imported_from_any_folder(root: Path, tmp_path: Path) -> None:
    python = root / ".venv" / "bin" / "python"
    if not python.is_file():
        pytest.skip("no .venv here: tested by another way of installation")
    program = """
import flatsat_ros
print(flatsat_ros.__file__, flatsat_ros.load_certificate("cf21_50hz").name, flatsat_ros.load_vehicle("cf21").name)
"""
    # nothing sourced
    environment = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    command = [str(python), "-c", program]
    found = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert found.stdout.split() == [str(root / "flatsat_ros" / "__init__.py"), "cf21_50hz", "cf21"]
