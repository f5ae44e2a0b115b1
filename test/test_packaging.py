"""What colcon installed is complete and importable, and what the package says of itself agrees everywhere."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
from datetime import date
from importlib.metadata import EntryPoint, distribution
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import flatsat_ros
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.base.resources import config_path

EXECUTABLES = [
    "cflib_bridge",
    "console",
    "controller",
    "demo",
    "excitation",
    "falsify",
    "faults",
    "identify",
    "mocap_player",
    "plan",
    "record",
    "report",
    "reproduce",
    "sim_drone",
    "sim_server",
    "soak",
    "synthesize",
    "validate",
]


def entry_points() -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in distribution("flatsat_ros").entry_points if entry.group == "console_scripts"}


def configuration(root: Path) -> list[Path]:
    return sorted(file.relative_to(root) for file in (root / "config").rglob("*.yaml"))


def test_what_was_installed_is_what_is_tested(root: Path, prefix: Path) -> None:
    assert Path(flatsat_ros.__file__).parent != root / "flatsat_ros"
    assert (prefix / "share/ament_index/resource_index/packages/flatsat_ros").is_file()


def test_colcon_sees_an_ament_python_package(root: Path) -> None:
    colcon = shutil.which("colcon", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    assert colcon is not None
    command = [colcon, "--log-base", os.devnull, "list", "--base-paths", str(root)]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert listed.split("\t")[::2] == ["flatsat_ros", "(ros.ament_python)\n"]


def test_no_executable_is_missing_or_undocumented(executables: Path) -> None:
    assert sorted(entry_points()) == EXECUTABLES
    assert sorted(file.name for file in executables.iterdir() if os.access(file, os.X_OK)) == EXECUTABLES


@pytest.mark.parametrize("name", EXECUTABLES)
def test_entry_point_is_importable(name: str) -> None:
    assert callable(entry_points()[name].load())


def test_every_configuration_file_is_installed_and_found(root: Path, prefix: Path) -> None:
    files = configuration(root)
    assert Path("config/paper_experiment.yaml") in files
    assert Path("config/vehicles/cf21.yaml") in files
    share = prefix / "share/flatsat_ros"
    assert sorted(file.relative_to(share) for file in (share / "config").rglob("*.yaml")) == files
    for file in files:
        folder = str(file.parent.relative_to("config")).removeprefix(".")
        assert config_path(file.stem, folder).read_bytes() == (root / file).read_bytes()


def test_launch_files_and_the_marker_of_types_are_installed(root: Path, prefix: Path) -> None:
    launch = prefix / "share/flatsat_ros/launch"
    assert sorted(file.name for file in launch.iterdir()) == sorted(file.name for file in (root / "launch").iterdir())
    assert (Path(flatsat_ros.__file__).parent / "py.typed").is_file()


def test_a_path_of_the_users_is_taken_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = tmp_path / "cf21.yaml"
    own.touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert config_path(str(own)) == own
    assert config_path("cf21.yaml", "vehicles").samefile(own)
    assert config_path("./cf21.yaml").samefile(own)
    assert config_path("~/cf21.yaml") == own


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("paper_experimnt", "there is no"),
        ("", "there is no"),
        ("vehicles", "there is no"),
        ("..", "there is no"),
        ("nul\0", "there is no"),
        ("x" * 5000, "there is no"),
        ("paper_experimnt.yaml", "cannot be read: No such file"),
        ("./paper_experimnt", "cannot be read: No such file"),
        ("two\nlines.yaml", "cannot be read: No such file"),
        ("./" + "x" * 5000, "cannot be read: File name too long"),
        ("/dev/null/x.yaml", "cannot be read: Not a directory"),
    ],
)
def test_a_missing_configuration_is_refused_in_one_line_with_the_names_that_exist(name: str, why: str) -> None:
    with pytest.raises(FlatsatError, match=f"{why}.*paper_experiment, .*paper_simulation") as refused:
        config_path(name)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 900


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("~nobody_here/x.yaml", "must be a path whose home folder exists"),
        ("./nul\0", "must be the path of a file"),
        ("/dev/zero", "must be a regular file"),
        ("/", "it is a folder"),
    ],
)
def test_what_can_be_no_configuration_is_refused_in_one_line_that_says_why(name: str, why: str) -> None:
    with pytest.raises(FlatsatError, match=why) as refused:
        config_path(name)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 200


def test_versions_agree(root: Path) -> None:
    version = flatsat_ros.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert distribution("flatsat_ros").version == version
    assert ElementTree.parse(root / "package.xml").findtext("version") == version
    assert yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))["version"] == version


def test_the_newest_release_of_the_changelog_is_this_version(root: Path) -> None:
    lines = (root / "CHANGELOG.rst").read_text(encoding="utf-8").splitlines()
    headings = [line for line, below in itertools.pairwise(lines) if re.fullmatch("-+", below)]
    releases = [heading for heading in headings if heading != "Forthcoming"]
    assert headings[-len(releases) :] == releases  # what is not released yet stands first
    found = [re.fullmatch(r"(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)", release) for release in releases]
    assert None not in found, releases
    versions, dates = zip(*(match.groups() for match in found if match), strict=True)
    assert versions[0] == flatsat_ros.__version__
    assert [date.fromisoformat(day) for day in dates] == sorted(map(date.fromisoformat, dates), reverse=True)


def test_licences_agree(root: Path) -> None:
    assert ElementTree.parse(root / "package.xml").findtext("license") == "Apache-2.0"
    assert yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))["license"] == "Apache-2.0"
    assert distribution("flatsat_ros").metadata["License"] == "Apache-2.0"
    assert "Apache License" in (root / "LICENSE").read_text(encoding="utf-8")
