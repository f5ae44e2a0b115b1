"""The identify command line: from logs to a profile that loads, bags included; one clear line for what it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flown import fly, write
from numpy.testing import assert_allclose
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.cli import excitation, validate
from flatsat_ros.cli.identify import bag_log, main
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.identification.log import FlightLog
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


def write_bag(log: FlightLog, folder: Path, drones: tuple[str, ...], telemetry: bool = False) -> Path:
    """A bag in which drones fly alike, as crazyswarm2's cflib back end has them (pitch set-point negative).

    The telemetry has the position for the error, in FLY but for the first row.
    """
    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "world")
    vector = T["geometry_msgs/msg/Vector3"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def put(topic: str, message: Any, time: float) -> None:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], 10**9 + round(time * 1e9), STORE.serialize_cdr(message, kind))

        connections: dict[str, Any] = {}
        for time, place, (roll, pitch, _), command in zip(
            log.pose_time, log.position, log.angles, log.command, strict=True
        ):
            (cr, cp), (sr, sp) = np.cos([roll / 2, pitch / 2]), np.sin([roll / 2, pitch / 2])
            turn = T["geometry_msgs/msg/Quaternion"](sr * cp, cr * sp, -sr * sp, cr * cp)
            pose = T["geometry_msgs/msg/Pose"](T["geometry_msgs/msg/Point"](*place), turn)
            degrees = np.rad2deg(command[:2])
            twist = T["geometry_msgs/msg/Twist"](vector(-degrees[1], degrees[0], command[2]), vector(0.0, 0.0, 0.0))
            for drone in drones:
                put(f"/{drone}/pose", T["geometry_msgs/msg/PoseStamped"](header, pose), time)
                put(f"/{drone}/cmd_vel_legacy", twist, time)
                if telemetry:
                    row = dict.fromkeys(FIELDS, 0.0) | {"mode": Mode.FLY.value if time > 0.0 else Mode.IDLE.value}
                    row |= dict(zip(("error_x", "error_y", "error_z"), place, strict=True))
                    layout = T["std_msgs/msg/MultiArrayLayout"](
                        [T["std_msgs/msg/MultiArrayDimension"](",".join(FIELDS), len(FIELDS), len(FIELDS))], 0
                    )
                    array = T["std_msgs/msg/Float64MultiArray"](layout, np.array(list(row.values())))
                    put(f"/{drone}/flatsat/telemetry", array, time)
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
    for drone in (None, "cf3"):
        with pytest.raises(FlatsatError, match=f"--drone {drone}: drones with both .* are: cf1, cf2"):
            bag_log(bag, drone, "cpp")


@pytest.mark.parametrize(
    ("options", "text"),
    [
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
    ):
        assert validate.main(options) == 2
        assert text in capsys.readouterr().err


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


def test_the_errors_of_our_controller_come_with_its_bag(log: FlightLog, tmp_path: Path) -> None:
    bag = write_bag(log, tmp_path / "bag", ("cf1",), telemetry=True)
    errors = bag_log(bag, None, "cflib").errors
    assert_allclose(errors, np.stack([log.position[1:, axis] for axis in range(3)], axis=-1))
    assert len(bag_log(write_bag(log, tmp_path / "other", ("cf1",)), None, "cflib").errors) == 0
