"""The demo as a user starts it, live: it keeps its promises, and no process of it outlives it."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from demo_output import KEYS, PICTURES
from rosbags.highlevel import AnyReader

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.bag import read_flight


@pytest.fixture
def live(executables: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The installed demo, flying over DDS."""
    process = subprocess.Popen(
        # the ideal drone is the one that a busy machine throws off least
        [executables / "demo", "--paper", "--console", "--dynamics", "ideal", "--seconds", "4", "--output", tmp_path],
        stdin=subprocess.DEVNULL,  # nobody presses Enter: the end of the input is taken for that
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


def children(pid: int) -> list[tuple[str, int]]:
    """Module and process id of the nodes that a demo has started."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
        if parent == pid and b"flatsat_ros.demo.leashed" in words:
            found.append((words[words.index(b"flatsat_ros.demo.leashed") + 1].decode(), int(entry.name)))
    return found


def wait_for(process: subprocess.Popen[str], holds: Callable[[], bool]) -> None:
    """Wait until something holds of a demo that runs."""
    deadline = time.monotonic() + 60.0
    while not holds():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "not after 60 s"
        time.sleep(0.05)


def flying(process: subprocess.Popen[str], folder: Path) -> list[tuple[str, int]]:
    """Return the nodes of a live demo once the controller flies."""
    log = folder / "log" / "controller.log"
    wait_for(process, lambda: log.exists() and "flying" in log.read_text())
    return children(process.pid)


def end(nodes: list[tuple[str, int]]) -> bool:
    """Whether all nodes come to an end."""
    deadline = time.monotonic() + 20.0
    while any(Path(f"/proc/{pid}/cmdline").exists() and Path(f"/proc/{pid}/cmdline").read_bytes() for _, pid in nodes):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def test_the_live_demo_keeps_the_promises_and_its_bag_can_be_read(live: subprocess.Popen[str], tmp_path: Path) -> None:
    output, errors = live.communicate(timeout=120)
    assert live.returncode == 0, output + errors
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert set(summary) == KEYS
    assert summary["violations"] == 0
    assert all(robot["landed"] for robot in summary["robots"].values())
    assert all((tmp_path / name).stat().st_size > 10_000 for name in PICTURES)
    with AnyReader([tmp_path / "bag"]) as bag:
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        reports = [c for c in bag.connections if c.topic.endswith("telemetry")]
        rows = [(c.topic, bag.deserialize(data, c.msgtype).data) for c, _, data in bag.messages(reports)]
    for robot in summary["robots"]:
        assert counts[f"/demo/{robot}/pose"] > 1300  # 19 s at 100 Hz, best effort
        assert counts[f"/demo/{robot}/flatsat/telemetry"] > 130  # 19 s at 10 Hz
        assert counts[f"/demo/{robot}/cmd_vel_legacy"] > 130
        assert counts[f"/demo/{robot}/trajectory"] == counts[f"/demo/{robot}/goal_pose"] == 1
        flown = [row[FIELDS.index("mode")] for topic, row in rows if topic == f"/demo/{robot}/flatsat/telemetry"]
        modes = [Mode(int(mode)) for mode, _ in itertools.groupby(flown)]
        # to arm a drone opens its lock, too
        assert list(dict.fromkeys(modes))[:3] == [Mode.IDLE, Mode.UNLOCK, Mode.FLY]
        assert modes[-2:] == [Mode.REST, Mode.IDLE]
    assert "open http://127.0.0.1:" in output
    flight = read_flight(tmp_path / "bag")
    assert flight.setup["certificate"] == "paper_experiment"
    assert any("flying" in event.text for event in flight.events)
    assert (tmp_path / "report.html").stat().st_size > 500_000
    assert not [entry for entry in tmp_path.iterdir() if entry.name.startswith(".")]


def test_a_node_that_dies_in_flight_fails_the_demo_and_leaves_no_process(
    live: subprocess.Popen[str], tmp_path: Path
) -> None:
    nodes = flying(live, tmp_path)
    logs = [tmp_path / "log" / f"sim_drone_cf{number}.log" for number in (1, 2, 3)]
    wait_for(live, lambda: all("simulating cf" in log.read_text(encoding="utf-8") for log in logs))
    os.kill(dict(nodes)["flatsat_ros.nodes.sim_drone"], signal.SIGKILL)
    _, errors = live.communicate(timeout=60)
    assert live.returncode == 2
    (log,) = re.findall(r"error: node sim_drone_cf\d died in flight with exit code -9; see (.*)\n", errors)
    assert "simulating cf" in Path(log).read_text(encoding="utf-8")
    assert end(nodes)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_demo_stops_its_nodes(number: signal.Signals, live: subprocess.Popen[str]) -> None:
    wait_for(live, lambda: len(children(live.pid)) == 5)
    nodes = children(live.pid)
    live.send_signal(number)
    _, errors = live.communicate(timeout=60)
    assert live.returncode == 128 + number
    assert errors.endswith("stopped\n")
    assert "Traceback" not in errors
    assert not any(Path(f"/proc/{pid}").exists() for _, pid in nodes)


def test_no_node_outlives_a_demo_that_is_killed(live: subprocess.Popen[str]) -> None:
    wait_for(live, lambda: len(children(live.pid)) == 5)
    nodes = children(live.pid)
    live.kill()
    assert end(nodes)


def test_an_interrupt_is_raised_where_messages_are_let_in(ros_domain: int) -> None:
    from flatsat_ros.nodes.conductor import Conductor, conducting

    before = signal.getsignal(signal.SIGINT)
    with conducting(["cf1"], "/interrupted", Conductor) as conductor:
        signal.raise_signal(signal.SIGINT)  # not here, where it might be lost
        with pytest.raises(KeyboardInterrupt):
            conductor.spin(0.01)
    assert signal.getsignal(signal.SIGINT) is before
