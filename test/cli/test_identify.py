"""The identify command line: from logs to a profile that loads, bags included; one clear line for what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown import fly, write
from numpy.testing import assert_allclose
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from flatsat_ros import load_certificate
from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.cli import excitation, validate
from flatsat_ros.cli.identify import bag_log, main
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.demo import headless
from flatsat_ros.demo.scenario import LEG_TIME, POSE_NOISE, plan
from flatsat_ros.flight import telemetry
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.identification.log import FlightLog, angles_of
from flatsat_ros.sim.sensor import NOISE_BOUND
from flatsat_ros.synthesis.flight_wishes import STILL, assumed

pytestmark = pytest.mark.in_process

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types


@pytest.fixture(scope="module")
def log() -> FlightLog:
    return fly(load_vehicle("cf2x_2025"), range(3, 4), seconds=8.0, noise=1e-4, weight=0.8)[0]


@pytest.fixture(scope="module")
def flight(log: FlightLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(log, tmp_path_factory.mktemp("logs") / "flight.csv")


def write_bag(
    log: FlightLog,
    folder: Path,
    drones: tuple[str, ...],
    ticks: Sequence[tuple[float, Sequence[float]]] = (),
    late: FloatArray | None = None,
) -> Path:
    """A bag in which drones fly alike, as crazyswarm2's cflib back end has them (pitch set-point negative).

    Of our controller there are ticks: times, s, and rows of telemetry. Poses are recorded so late (n,), s, after they
    were stamped, by a clock that is an hour behind; None: at once, without a stamp.
    """
    vector = T["geometry_msgs/msg/Vector3"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def put(topic: str, message: Any, time: float) -> None:
            for drone in drones:
                kind, name = message.__msgtype__, f"/{drone}/{topic}"
                if name not in connections:
                    connections[name] = writer.add_connection(name, kind, typestore=STORE)
                writer.write(connections[name], 10**9 + round(time * 1e9), STORE.serialize_cdr(message, kind))

        connections: dict[str, Any] = {}
        way = np.zeros(len(log.pose_time)) if late is None else late
        for time, place, (roll, pitch, _), after in zip(log.pose_time, log.position, log.angles, way, strict=True):
            stamp = divmod(3600 * 10**9 + round(time * 1e9), 10**9) if late is not None else (0, 0)
            header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](*stamp), "world")
            (cr, cp), (sr, sp) = np.cos([roll / 2, pitch / 2]), np.sin([roll / 2, pitch / 2])
            turn = T["geometry_msgs/msg/Quaternion"](sr * cp, cr * sp, -sr * sp, cr * cp)
            pose = T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](*place), turn)
            put("pose", T["geometry_msgs/msg/PoseStamped"](header, pose), time + after)
        for time, command in zip(log.command_time, log.command, strict=True):
            roll, pitch = np.rad2deg(command[:2])
            put("cmd_vel_legacy", T["geometry_msgs/msg/Twist"](vector(-pitch, roll, command[2]), vector(0, 0, 0)), time)
        for time, row in ticks:
            label = T["std_msgs/msg/MultiArrayDimension"](",".join(FIELDS), len(FIELDS), len(FIELDS))
            layout = T["std_msgs/msg/MultiArrayLayout"]([label], 0)
            put("flatsat/telemetry", T["std_msgs/msg/Float64MultiArray"](layout, np.array(row)), time)
    return folder


def test_a_log_becomes_a_profile_and_a_page(flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output, page = tmp_path / "mine.yaml", tmp_path / "mine.png"
    assert main([str(flight), "--base", "cf2x_2025", "--output", str(output), "--pictures", str(page)]) == 0
    printed = capsys.readouterr().out
    for text in (
        "flight: 7.4 s of flight usable",
        "thrust at pwm_max",
        "marker frame of flight: roll",
        "mass apart from force (the base's mass stays)",
        "one flight does not show how others of this drone differ",
        f"written to {output}",
    ):
        assert text in printed
    profile, base = load_vehicle(output), load_vehicle("cf2x_2025")
    assert profile.name == "mine"
    # the log is of a drone with 80 % of the force and, in its dynamics, 1.032 of that again
    assert profile.thrust_max == pytest.approx(0.8 * base.dynamics.thrust_gain * base.thrust_max, rel=0.03)
    assert profile.dynamics.attitude_gain == pytest.approx(base.dynamics.attitude_gain, rel=0.03)
    assert profile.intervals is not None
    assert profile.intervals.thrust_available is not None
    assert page.read_bytes().startswith(b"\x89PNG")


def test_a_bag_is_the_same_log(log: FlightLog, tmp_path: Path) -> None:
    bag = write_bag(log, tmp_path / "bag", ("cf1", "cf2"))
    read = bag_log(bag, "cf2", "cflib")
    assert_allclose(read.pose_time, log.pose_time, atol=1e-6)
    for name in ("position", "command"):
        assert_allclose(getattr(read, name), getattr(log, name), atol=1e-9, err_msg=name)
    assert_allclose(read.angles[:, :2], log.angles[:, :2], atol=1e-9)
    assert_allclose(bag_log(bag, "cf2", "cpp").command[:, 1], -log.command[:, 1], atol=1e-9)
    for drone, text in ((None, "--drone is not given: must be one"), ("cf3", "--drone = 'cf3': must be one")):
        with pytest.raises(FlatsatError, match=f"{text} that has both .*: cf1, cf2"):
            bag_log(bag, drone, "cpp")


def test_poses_are_where_their_stamps_are_unless_a_clock_was_set(log: FlightLog, tmp_path: Path) -> None:
    late = recorded_late(log.pose_time)
    read = bag_log(write_bag(log, tmp_path / "late", ("cf1",), late=late), None, "cflib")
    assert read.arrived is not None
    assert_allclose(read.arrived, log.pose_time + late, atol=1e-6)
    assert_allclose(read.pose_time, log.pose_time + late.min(), atol=1e-6)
    jumping = late + 3.0 * (log.pose_time > 4.0)  # recorded so much later than stamped: the stamps' clock was set back
    read = bag_log(write_bag(log, tmp_path / "jumping", ("cf1",), late=jumping), None, "cflib")
    assert_allclose(read.pose_time, log.pose_time + jumping, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["{log}", "--pictures", "mine.bmp"], "--pictures = 'mine.bmp': must be a .png, .pdf or .svg file"),
        (["{log}", "--drone", "cf1"], "--drone, --backend: they are for bags, of which there is none"),
        (["{log}", "--backend", "cpp"], "--drone, --backend: they are for bags, of which there is none"),
        (["bag.mcap", "--columns", "cflib"], "--columns: it is for CSV files, of which there is none"),
        (["{log}", "--output", "mine.yml"], "--output = 'mine.yml': must be a .yaml file"),
        (["{log}", "--output", "{taken}"], "it exists: give --force to overwrite it"),
        (["{log}", "--force"], "--force overwrites the output; without --output none is written"),
        (["{log}", "--base", "cf99"], "there is no packaged configuration 'cf99'"),
        (["{log}", "--columns", "vicon_100hz"], "must be also t, px, py"),
        (["{taken}"], "are none of a known form"),
        (["{log}", "{log}"], "log = 'flight': must be a flight of its own"),
        (["{wrong}"], "pitch answers with the opposite sign"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    options: list[str], text: str, log: FlightLog, flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (taken := tmp_path / "taken.yaml").write_text("name: x\n")
    wrong = write(replace(log, command=log.command * (1.0, -1.0, 1.0)), tmp_path / "wrong.csv")
    assert main([option.format(log=flight, taken=taken, wrong=wrong) for option in options]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("error: ")
    assert text in error
    assert taken.read_text() == "name: x\n"


def test_a_drone_too_weak_to_fly_is_said(log: FlightLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weak = replace(log, command=log.command * (1.0, 1.0, 1.0) + (0.0, 0.0, 61000.0 - log.command[:, 2].mean()))
    capped = replace(weak, command=np.minimum(weak.command, (1.0, 1.0, 65535.0)))
    assert main([str(write(capped, tmp_path / "weak.csv")), "--output", str(tmp_path / "weak.yaml")]) == 2
    assert "the drone of these flights makes no profile: mass" in capsys.readouterr().err
    assert list(tmp_path.glob("*.yaml")) == []


def test_flights_contradict_a_certificate_by_an_exit_code(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert validate.main([str(flight), "--base", "cf2x_2025", "--certificate", "paper_experiment"]) == 1
    printed = capsys.readouterr().out
    assert "contradicts  lag plus delay" in printed
    assert "paper_experiment: contradicted in thrust available, lag plus delay, thrust lag" in printed
    assert validate.main([str(flight), "--certificate", "no_such"]) == 2
    assert "no packaged configuration 'no_such'" in capsys.readouterr().err


def test_flights_say_what_a_certificate_for_their_drone_may_assume(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "assumptions.yaml"
    asked = [str(flight), "--vehicle", "cf2x_2025", "--certificate", "paper_experiment", "--write", str(written)]
    assert validate.main(asked) == 2
    assert "at least 1000 for a coverage of 0.999: more flights, or a smaller one" in capsys.readouterr().err
    assert not written.exists()
    assert validate.main([*asked, "--coverage", "0.99"]) == 1
    assert f"written to {written}" in capsys.readouterr().out
    taken, intervals = assumed(str(written))
    assert (taken.acceleration, taken.jerk, taken.snap) == (STILL.acceleration, STILL.jerk, STILL.snap)
    assert taken.pose_age == pytest.approx(0.01, rel=0.1)
    assert set(intervals) == {"lag", "delay", "gain", "frequency", "damping"}
    assert intervals["gain"][0] < 0.922 < intervals["gain"][1]
    for options, text in (
        (asked, "it exists: give --force to overwrite it"),
        ([*asked[:-2], "--coverage", "0.9"], "--coverage, --force: they go with --write"),
        ([*asked[:-1], "notes.txt"], "--write = 'notes.txt': must be a .yaml file"),
        ([*asked, "--base", "cf21"], "--base: --vehicle is the base"),
        *(
            ([*asked, "--force", "--coverage", each], f"--coverage = {float(each)}: must be above 0.5 and below 1")
            for each in "012"
        ),
    ):
        assert validate.main(options) == 2
        said = capsys.readouterr()
        assert text in said.err
        assert said.out == ""  # before anything is computed


@pytest.mark.parametrize(
    ("name", "acceleration"),
    [("cf21_adaptive_50hz", 0.9), ("cf21_flight_50hz", STILL.acceleration), ("paper_experiment", STILL.acceleration)],
)
def test_a_certificate_for_a_drone_with_drag_lets_references_accelerate(name: str, acceleration: float) -> None:
    assert validate.references_of(load_certificate(name)).acceleration == acceleration


def test_the_excitation_flight_is_written_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "excitation.yaml"
    assert excitation.main(["--output", str(output), "--at", "1,2,1.5"]) == 0
    assert (
        "ros2 topic pub --once /cf1/trajectory trajectory_msgs/msg/MultiDOFJointTrajectory" in capsys.readouterr().out
    )
    assert output.read_text().splitlines()[3].startswith("- {transforms: [{translation: {x: 1.0000000, y: 2.0000000")
    for options, text in (
        (["--output", str(output)], "it exists: give --force to overwrite it"),
        (["--output", str(tmp_path / "other.yaml"), "--at", "1,2"], "--at"),
    ):
        assert excitation.main(options) == 2
        assert text in capsys.readouterr().err


def test_what_our_controller_claimed_comes_with_its_bag(log: FlightLog, tmp_path: Path) -> None:
    flying = dict.fromkeys(FIELDS, 0.0) | {"mode": Mode.FLY.value, "tube": 0.1, "tube_z": 0.2}
    changes: list[dict[str, float]] = [{"mode": 0.0}, {"error_y": 3.0, "assumption": 9.0}, {"assumption": 3.0}]
    rows = [flying | change for change in changes + 6 * [{}]]
    bag = write_bag(log, tmp_path / "bag", ("cf1",), [(float(k), list(row.values())) for k, row in enumerate(rows)])
    flown = bag_log(bag, None, "cflib").flown
    assert flown is not None
    assert flown.error.tolist() == [[0.0, 3.0, 0.0]] + 7 * [[0.0, 0.0, 0.0]]
    assert flown.tube.tolist() == 8 * [[0.1, 0.2]]
    assert flown.claimed.tolist() == [True, False] + 6 * [True]
    assert bag_log(write_bag(log, tmp_path / "other", ("cf1",)), None, "cflib").flown is None


def recorded_late(stamps: FloatArray) -> FloatArray:
    """How late, s, a recorder on a busy machine has poses of these stamps: by 2 ms, and once a second by up to 20."""
    random = np.random.default_rng(11)
    came = stamps + 1e-3 + random.exponential(1e-3, len(stamps))
    stalled = (stamps % 1.0 < 0.02) & (stamps > 1.0)
    came[stalled] = np.maximum(came[stalled], np.ceil(stamps[stalled] / 0.02) * 0.02)
    late: FloatArray = np.maximum.accumulate(came) - stamps
    return late


def test_the_demo_supports_its_own_certificate_which_rough_poses_contradict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses, commands, ticks = [], [], []

    def observe(now: float, samples: Any, tick: Any, sent: dict[int, tuple[float, ...]]) -> None:
        poses.extend((each.stamp, *each.position, *each.quaternion) for each in samples)
        commands.extend((now, *sent[index]) for index in sent)
        ticks.append((now, telemetry.rows(tick)[0].tolist()))

    flown = plan(tmp_path, count=1, seconds=LEG_TIME)
    headless.fly(flown, observe)
    name = flown.certificate.name
    assert flown.certificate.flight is not None
    assert flown.certificate.flight.assumptions.noise >= NOISE_BOUND * POSE_NOISE
    pose, sent = np.array(poses, dtype=float), np.array(commands, dtype=float)
    command = np.column_stack([np.deg2rad(sent[:, 1:3]), sent[:, 4]])
    nothing, rough = np.empty(0), 1e-3 * np.random.default_rng(5).standard_normal((len(pose), 3))
    for code, position in enumerate((pose[:, 1:4], pose[:, 1:4] + rough)):
        log = FlightLog("flown", pose[:, 0], position, angles_of(pose[:, 4:].T), sent[:, 0], command, nothing, nothing)
        bag = write_bag(log, tmp_path / f"bag{code}", ("cf1",), ticks, recorded_late(log.pose_time))
        assert validate.main([str(bag), "--backend", "cflib", "--certificate", name]) == code
        said = capsys.readouterr().out
        assert "supports     tube of x and y            assumed: at most" in said
        assert "supports     tube of z" in said
        assert "of the flight\n" in said
        assert (f"{name}: nothing in these flights contradicts it", f"{name}: contradicted in pose noise")[code] in said
