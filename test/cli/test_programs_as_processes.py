"""The command lines as processes: full disks, readers that leave, Ctrl-C while they import, and their workers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from ctrl_c import ctrl_c_at

from flatsat_ros.certificate.certificate import Certificate

pytestmark = pytest.mark.beside_flights

CERTIFY = ["synthesize", "--thrust-max", "14"]
HEADLESS = ["demo", "--headless", "--paper", "--robots", "1", "--seconds", "4"]


def start(program: str, *arguments: str, before: str = "pass", **options: object) -> subprocess.Popen[str]:
    """Start a program as a process group of its own, after a line of Python."""
    line = f"import sys; {before}; from flatsat_ros.cli.{program} import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", line, *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    return subprocess.Popen(command, text=True, start_new_session=True, **streams)  # type: ignore[call-overload]


def alive(group: int) -> list[int]:
    """The processes of a group that still run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, leader = (entry / "stat").read_text().rpartition(") ")[2].split()[:3]
            if int(leader) == group and state not in "ZX":
                found.append(int(entry.name))
    return found


@pytest.fixture
def group() -> Iterator[list[subprocess.Popen[str]]]:
    """Processes that are ended with their group, whatever becomes of the test."""
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_an_unknown_backend_of_matplotlib_does_not_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: list[subprocess.Popen[str]]
) -> None:
    monkeypatch.setenv("MPLBACKEND", "no such backend")
    group.append(start(*HEADLESS, "--output", str(tmp_path)))
    _, errors = group[-1].communicate(timeout=120)
    assert group[-1].returncode == 0, errors
    assert (tmp_path / "paths.png").stat().st_size > 10_000


@pytest.mark.parametrize("arguments", [["--help"], ["--thrust-max", "14"]])
def test_a_full_disk_behind_stdout_is_one_line(arguments: list[str], group: list[subprocess.Popen[str]]) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        group.append(start("synthesize", *arguments, stdout=full))
    _, errors = group[-1].communicate(timeout=120)
    assert errors == "error: [Errno 28] No space left on device\n"
    assert group[-1].returncode == 2


def test_a_reader_that_leaves_is_one_line(group: list[subprocess.Popen[str]]) -> None:
    group.append(start(*CERTIFY))
    process = group[-1]
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    _, errors = process.communicate(timeout=120)
    assert (process.returncode, errors) == (2, "error: [Errno 32] Broken pipe\n")


def test_without_ros_the_live_demo_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: list[subprocess.Popen[str]]
) -> None:
    group.append(start("demo", "--output", str(tmp_path / "out"), before="sys.modules['rclpy'] = None"))
    output, errors = group[-1].communicate(timeout=120)
    assert group[-1].returncode == 2
    assert output == ""
    assert errors.startswith("error: flying live needs ROS 2 (import of rclpy halted")
    assert errors.endswith("source its setup, or give --headless\n")
    assert errors.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_certificate_is_made_where_ros_is_not_installed(tmp_path: Path, group: list[subprocess.Popen[str]]) -> None:
    target = tmp_path / "x.yaml"
    group.append(start(*CERTIFY, "--output", str(target), before="sys.modules['rclpy'] = None"))
    _, errors = group[-1].communicate(timeout=120)
    assert group[-1].returncode == 0, errors
    assert Certificate.load(target).limits.thrust_max == 14.0


@pytest.mark.parametrize("module", ["numpy.linalg", "scipy.sparse.linalg", "cvxpy", "cvxpy.reductions.solvers.defines"])
def test_ctrl_c_while_imports_run_is_130_without_a_traceback(module: str, group: list[subprocess.Popen[str]]) -> None:
    group.append(start(*CERTIFY, before=f"exec({ctrl_c_at(module)!r})"))
    assert group[-1].communicate(timeout=120) == ("", "stopped\n")
    assert group[-1].returncode == 130


def attacked(group: list[subprocess.Popen[str]]) -> subprocess.Popen[str]:
    """A falsify with two workers that has worked through a batch."""
    group.append(start("falsify", "--campaign", "hold", "--workers", "2", "--runs", "10000000"))
    stderr = group[-1].stderr
    assert stderr is not None
    seen = ""
    while "violations=0" not in seen:
        seen += stderr.read(1)
        assert "Traceback" not in seen
    assert len(alive(group[-1].pid)) >= 3
    return group[-1]


def none_left(process: subprocess.Popen[str]) -> bool:
    """Whether its group comes to an end."""
    deadline = time.monotonic() + 30.0
    while alive(process.pid):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_workers_end_with_a_stopped_program_without_a_word(
    number: signal.Signals, group: list[subprocess.Popen[str]]
) -> None:
    process = attacked(group)
    if number is signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does
    else:
        process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert errors.rpartition("\n")[0].endswith("stopped")
    assert "Traceback" not in errors
    assert none_left(process)


def test_workers_end_with_a_program_that_is_killed(group: list[subprocess.Popen[str]]) -> None:
    process = attacked(group)
    process.kill()
    assert none_left(process)


def test_a_worker_that_dies_is_one_line(group: list[subprocess.Popen[str]]) -> None:
    process = attacked(group)
    worker = next(pid for pid in alive(process.pid) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes())
    os.kill(worker, signal.SIGKILL)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert errors.splitlines()[-1].startswith("error: a worker process died")
    assert "Traceback" not in errors
