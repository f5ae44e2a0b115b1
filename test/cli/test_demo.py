"""The demo as a user starts it, live and on simulated time, and the figures it computes."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from tqdm import tqdm

from flatsat_ros.base.constants import GRAVITY
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.cli import demo
from flatsat_ros.demo import live as demo_live
from flatsat_ros.demo import record as demo_record
from flatsat_ros.demo.record import FlightRecord, RobotRecord
from flatsat_ros.flight.supervisor import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.law.input_set import InputSet

ROBOT_KEYS = {"rms_m", "rms_paper_m", "gamma_final", "tilt_max_rad", "thrust_min", "thrust_max", "landed"}
KEYS = {
    "robots", "violations", "separation_min_m", "tick_median_us", "tick_p99_us", "dynamics", "rate_hz", "seconds",
}  # fmt: skip
PICTURES = ("paths.png", "gain.png", "inputs.png")
LIMITS = InputSet(14.0, 0.2)


def fly(folder: Path, *arguments: str) -> dict[str, object]:
    """Fly headless and return summary.json."""
    assert demo.main(["--headless", "--output", str(folder), *arguments]) == 0
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert isinstance(summary, dict)
    return summary


def test_the_headless_swap_keeps_the_promises_and_writes_everything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = fly(tmp_path)
    assert set(summary) == KEYS
    robots = summary["robots"]
    assert isinstance(robots, dict)
    assert list(robots) == ["cf1", "cf2", "cf3"]
    assert all(set(robot) == ROBOT_KEYS for robot in robots.values())
    assert [robot["rms_paper_m"] for robot in robots.values()] == [0.0703, 0.0826, 0.0602]
    assert all(0.0 < robot["rms_m"] < 0.10 for robot in robots.values())
    assert all(robot["landed"] for robot in robots.values())
    assert all(GRAVITY < robot["thrust_max"] <= 1.45 * GRAVITY for robot in robots.values())
    assert (summary["violations"], summary["dynamics"], summary["rate_hz"], summary["seconds"]) == (
        0, "identified", 10.0, 12.0,
    )  # fmt: skip
    assert all((tmp_path / name).stat().st_size > 10_000 for name in PICTURES)
    printed = capsys.readouterr().out
    assert all(f"{100 * robot['rms_m']:.2f}" in printed for robot in robots.values())


def test_the_headless_flight_repeats_itself(tmp_path: Path) -> None:
    first, second = fly(tmp_path / "a", "--seconds", "4"), fly(tmp_path / "b", "--seconds", "4")
    assert first["robots"] == second["robots"]


def test_other_numbers_rates_and_dynamics_fly_too(tmp_path: Path) -> None:
    summary = fly(tmp_path, "--robots", "5", "--rate", "50", "--dynamics", "ideal", "--seconds", "5")
    robots = summary["robots"]
    assert isinstance(robots, dict)
    assert len(robots) == 5
    assert all(robot["rms_m"] < 0.02 and robot["rms_paper_m"] is None for robot in robots.values())
    assert (summary["rate_hz"], summary["seconds"], summary["dynamics"]) == (50.0, 8.0, "ideal")


def test_one_drone_has_no_separation(tmp_path: Path) -> None:
    assert fly(tmp_path, "--robots", "1", "--seconds", "4")["separation_min_m"] is None


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--robots", "0"], "--robots 0: must be from 1 to 64"),
        (["--seconds", "-1"], "--seconds -1.0: must lie in (0, 3600]"),
        (["--seconds", "nan"], "--seconds nan"),
        (["--rate", "0.2"], "--rate 0.2 Hz: must be from 1 to 500"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(
    arguments: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo.main(["--headless", "--output", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


def record(
    offset: float = 0.0,
    thrust: float = 10.0,
    roll: float = 0.0,
    second: float = 1.0,
    end: Mode = Mode.IDLE,
    height: float = 0.0,
) -> FlightRecord:
    """Two drones that hover `offset` off their references, `second` metres apart, and are at last at that height."""
    times = np.arange(0.0, 5.0, 0.1)
    row = np.zeros(1 + len(FIELDS))
    row[1 + FIELDS.index("T")], row[1 + FIELDS.index("mode")] = thrust, Mode.FLY
    robots = {}
    for name, x in (("a", 0.0), ("b", second)):
        poses = np.stack([times, np.full_like(times, x + offset), 0.0 * times, 0.0 * times + 1.0], axis=1)
        ticks = np.tile(row, (len(times), 1))
        ticks[:, 0] = ticks[:, 1 + FIELDS.index("gamma")] = times
        poses[-1, 3], ticks[-1, 1 + FIELDS.index("mode")] = height, end
        commands = np.tile([0.0, thrust, roll, 0.0, 0.0], (len(times), 1))
        robots[name] = RobotRecord(poses, ticks, commands, Trajectory.hold([x, 0.0, 1.0]))
    return FlightRecord(robots, LIMITS, 2.0, 0.05, 10.0, 10.0, "ideal", (1.0, 4.0))


def test_the_tracking_error_is_the_distance_to_the_reference() -> None:
    summary = record(offset=0.07).summary()
    assert [robot["rms_m"] for robot in summary["robots"].values()] == pytest.approx([0.07, 0.07])
    assert demo_record.failures(summary) == []


def test_ten_centimetres_break_the_promise() -> None:
    assert len(demo_record.failures(record(offset=0.1001).summary())) == 2


@pytest.mark.parametrize("wrong", [{"thrust": 14.001}, {"roll": -0.2001}, {"thrust": float("nan")}])
def test_every_command_outside_the_limits_is_counted(wrong: dict[str, float]) -> None:
    summary = record(**wrong).summary()
    assert summary["violations"] == 100
    assert any("100 commands outside the limits" in sentence for sentence in demo_record.failures(summary))


@pytest.mark.parametrize("right", [{"thrust": 14.0, "roll": 0.2}, {"thrust": 0.0}])
def test_commands_on_the_limits_and_resting_motors_are_within(right: dict[str, float]) -> None:
    assert record(**right).summary()["violations"] == 0


def test_the_final_gain_is_that_at_the_end_of_the_swap() -> None:
    assert [robot["gamma_final"] for robot in record().summary()["robots"].values()] == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize("state", [{"height": 0.051}, {"height": -0.051}, {"end": Mode.FLY}, {"end": Mode.CUT}])
def test_a_drone_that_does_not_rest_on_the_floor_breaks_the_promise(state: dict[str, Any]) -> None:
    summary = record(**state).summary()
    assert not any(robot["landed"] for robot in summary["robots"].values())
    assert demo_record.failures(summary) == [f"{name}: does not stand on the floor, promised to land" for name in "ab"]


@pytest.mark.parametrize("state", [{"height": 0.049, "end": Mode.REST}, {"height": -0.049}])
def test_a_drone_at_rest_on_the_floor_landed(state: dict[str, Any]) -> None:
    assert demo_record.failures(record(**state).summary()) == []


def test_the_separation_is_the_smallest_distance() -> None:
    assert record(second=0.8).summary()["separation_min_m"] == pytest.approx(0.8)


class Answered:
    """A controller's answer that is there; one that begins with ok is no refusal."""

    def __init__(self, message: str) -> None:
        self.message = message
        self.success = message.startswith("ok")

    def done(self) -> bool:
        return True

    def result(self) -> Answered:
        return self


class Conductor:
    """Stands for the one that asks: gives the controller's answers in turn and notes who was asked for what."""

    def __init__(self, *answers: str, standing: tuple[str, ...] = ()) -> None:
        self.asked: list[tuple[str, ...]] = []
        self._answers = list(answers)
        self._standing = list(standing)

    def ask(self, *request: str) -> Answered:
        self.asked.append(request)
        return Answered(self._answers.pop(0))

    def robots_in(self, *modes: Mode) -> list[str]:
        assert modes == (Mode.IDLE, Mode.UNLOCK)
        return self._standing

    def spin(self, seconds: float) -> None:
        time.sleep(seconds)


def watch(conductor: Conductor) -> demo_live._Watch:
    return demo_live._Watch(conductor, {}, tqdm(total=1.0, disable=True))


def test_only_drones_that_still_stand_are_asked_to_take_off_again() -> None:
    conductor = Conductor("cf2: no pose", "cf2: no pose", "ok", standing=("cf2",))
    demo_live._take_off(watch(conductor))
    assert conductor.asked == [("takeoff",), ("takeoff", "cf2"), ("takeoff", "cf2")]


def test_a_take_off_that_stays_refused_is_an_error_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_live, "_READY", 0.0)
    with pytest.raises(FlatsatError, match="cf2: takeoff refused: no pose"):
        demo_live._take_off(watch(Conductor("cf2: takeoff refused: no pose")))


def test_what_was_granted_may_come_with_a_remark() -> None:
    watch(Conductor("ok, asked to arm")).demand("arm")


def test_a_refused_landing_is_an_error_with_the_reason() -> None:
    with pytest.raises(FlatsatError, match="cf1: land refused: the drone is in CUT"):
        watch(Conductor("cf1: land refused: the drone is in CUT")).demand("land")


def test_who_did_not_land_in_time_is_named() -> None:
    with pytest.raises(FlatsatError, match=r"did not land after 0\.1 s: cf1, cf3"):
        watch(Conductor()).until_none(lambda: ["cf1", "cf3"], 0.1, "did not land")


@pytest.fixture
def live(executables: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The installed demo, flying over DDS."""
    process = subprocess.Popen(
        # the ideal drone is the one that a busy machine throws off least
        [executables / "demo", "--dynamics", "ideal", "--seconds", "4", "--output", tmp_path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


def children(pid: int) -> dict[str, int]:
    """Process ids of the nodes that a demo has started, by module."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
            if parent == pid and b"-m" in words:
                found[words[words.index(b"-m") + 1].decode()] = int(entry.name)
    return found


def wait_for_nodes(process: subprocess.Popen[str], folder: Path) -> dict[str, int]:
    """Return the nodes of a live demo once the controller flies."""
    log = folder / "log" / "controller.log"
    deadline = time.monotonic() + 60.0
    while not (log.exists() and "flying" in log.read_text()):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "no controller after 60 s"
        time.sleep(0.05)
    return children(process.pid)


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
    assert not [entry for entry in tmp_path.iterdir() if entry.name.startswith(".")]


def test_a_node_that_dies_in_flight_fails_the_demo_and_leaves_no_process(
    live: subprocess.Popen[str], tmp_path: Path
) -> None:
    nodes = wait_for_nodes(live, tmp_path)
    os.kill(nodes["flatsat_ros.nodes.sim_drone"], signal.SIGKILL)
    _, errors = live.communicate(timeout=60)
    assert live.returncode == 2
    assert "died in flight with exit code -9" in errors
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes.values())


def test_an_interrupted_demo_stops_its_nodes(live: subprocess.Popen[str], tmp_path: Path) -> None:
    nodes = wait_for_nodes(live, tmp_path)
    live.send_signal(signal.SIGINT)
    live.communicate(timeout=60)
    assert live.returncode == 130
    assert not any(Path(f"/proc/{pid}").exists() for pid in nodes.values())


def test_an_interrupt_is_raised_where_messages_are_let_in(ros_domain: int) -> None:
    from flatsat_ros.nodes.conductor import conducting

    before = signal.getsignal(signal.SIGINT)
    with conducting(["cf1"], "/interrupted") as conductor:
        signal.raise_signal(signal.SIGINT)  # not here, where it might be lost
        with pytest.raises(KeyboardInterrupt):
            conductor.spin(0.01)
    assert signal.getsignal(signal.SIGINT) is before
