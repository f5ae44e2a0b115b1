"""Scripts of crazyswarm2, as they are: `make test-crazyswarm2 SOURCE=<checkout of crazyswarm2>`.

They run with sim_server, and with crazyswarm2's own Python server and simulated drones behind that.
"""

from __future__ import annotations

import ast
import os
import pty
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from crazyflie_interfaces.msg import LogDataGeneric, Status
from crazyflie_interfaces.srv import AddLogging, RemoveLogging
from geometry_msgs.msg import Twist
from numpy.polynomial.polynomial import polyval
from udp_server import STANDINS, Server

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.nodes.ros import interfaces, messages

if TYPE_CHECKING:
    from conftest import Lab, Process

SOURCE = Path(os.environ["CRAZYSWARM2"])
PYTHON = os.environ["CRAZYSWARM2_PYTHON"]
DATA = SOURCE / "crazyflie_examples" / "crazyflie_examples" / "data"
# the order in which scripts get them is that of their names; swap.py knows their last bytes, 231 and 5
PLACES = {"cf231": (0.0, 0.5, 0.0), "cf5": (0.0, -0.5, 0.0)}
URIS = {"cf231": "radio://0/80/2M/E7E7E7E7E7", "cf5": "radio://0/80/2M/E7E7E7E705"}
LONGEST = 150.0  # s, that a script takes
DOWN = 0.02  # m
# the PID controller follows a moving goal half a second late (position_controller.py), and cuts corners by 3 to 5 cm
FOLLOWED = 0.1  # m, RMS


class Flight:
    """A script that flies simulated drones, and where they were.

    Attributes:
        server: between them.
        output: of the script.
    """

    def __init__(self, lab: Lab, folder: Path, start: Callable[[], Process]) -> None:
        """Start the server."""
        self._lab, self._poses = lab, {name: lab.watch(interfaces.POSE, name) for name in PLACES}
        self.server = start()
        lab.wait(lambda: all(len(poses) > 100 for poses in self._poses.values()), "the drones to have booted")
        self._log = folder / "script.log"
        self.output = ""

    def fly(self, script: str | Path, keys: bytes = b"", until: Callable[[], bool] = lambda: False) -> None:
        """Run a script, an example's name or a file, to its end, or until something holds; press keys if it asks."""
        program = [str(script)] if isinstance(script, Path) else ["-m", f"crazyflie_examples.{script}"]
        asks, answers = pty.openpty()
        # another environment than that of the tests: its libraries are its own
        environment = {**os.environ, "LD_LIBRARY_PATH": os.environ["CRAZYSWARM2_LIBRARIES"]}
        environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
        with self._log.open("wb") as log:
            running = subprocess.Popen(
                [PYTHON, "-u", *program],
                stdin=answers,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
            )
        try:

            def over() -> bool:
                nonlocal keys
                self.output = self._log.read_text(encoding="utf-8", errors="replace")
                if keys and "press button" in self.output:
                    self._lab.listen(2.0)
                    os.write(asks, keys)
                    keys = b""
                return running.poll() is not None or until()

            self._lab.wait(over, f"the end of {script}", LONGEST)
        finally:
            code = running.poll()
            running.kill()
            running.wait()
            os.close(asks)
            os.close(answers)
            print(f"--- {script}\n{self.output}")
        assert code in (0, None), self.output
        assert "Traceback" not in self.output

    def track(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return times, s, and places (M, 3), m, of a drone."""
        stamps = [messages.nanoseconds_from_stamp(pose.header.stamp) * 1e-9 for pose in self._poses[name]]
        where = [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in self._poses[name]]
        return np.array(stamps), np.array(where)

    def require_landed(self, *names: str) -> None:
        """Wait until drones are on the floor."""
        self._lab.wait(lambda: all(self.track(name)[1][-1, 2] < DOWN for name in names or PLACES), "the landing")

    def passes(self, name: str, place: tuple[float, float, float], distance: float = 0.1) -> bool:
        """Whether a drone came near a place."""
        return bool((np.linalg.norm(self.track(name)[1] - place, axis=1) < distance).any())


def simulated(lab: Lab, folder: Path, **parameters: object) -> Flight:
    """Start sim_server."""
    lines = [
        f"  {name}: {{enabled: true, uri: {URIS[name]}, initial_position: {list(place)}, type: cf21}}"
        for name, place in PLACES.items()
    ]
    robots = "\n".join(lines)
    (folder / "crazyflies.yaml").write_text(f"fileversion: 3\nrobots:\n{robots}\n", encoding="utf-8")
    given = {"crazyflies_yaml": str(folder / "crazyflies.yaml"), **parameters}
    return Flight(lab, folder, lambda: lab.start("sim_server", **given))


@pytest.fixture
def over_udp(lab: Lab, tmp_path: Path) -> Iterator[Callable[..., Flight]]:
    """How to start crazyswarm2's own server."""
    pytest.importorskip("motion_capture_tracking_interfaces", reason="PACKAGES: the server needs them")
    servers: list[Server] = []

    def make(**settings: Any) -> Flight:
        marks = {name: f"?id={uri[-2:]}" for name, uri in URIS.items()}
        servers.append(Server(lab, tmp_path, PLACES, marks=marks, rate=50, **settings))
        return Flight(lab, tmp_path, lambda: servers[-1].running)

    yield make
    for server in servers:
        server.drones.close()


@pytest.fixture(params=["sim_server", "crazyflie_server"])
def flight(lab: Lab, tmp_path: Path, request: pytest.FixtureRequest) -> Flight:
    """With one server and with the other."""
    if request.param == "sim_server":
        return simulated(lab, tmp_path)
    made: Flight = request.getfixturevalue("over_udp")()
    return made


@pytest.fixture
def simulation(lab: Lab, tmp_path: Path) -> Flight:
    """With ours: what the other cannot do."""
    return simulated(lab, tmp_path)


def curve(file: Path) -> tuple[FloatArray, FloatArray]:
    """Return times and places (M, 3) of a trajectory of polynomials, 50 times a second."""
    rows = np.loadtxt(file, delimiter=",", skiprows=1, usecols=range(33))
    times, places, begin = [], [], 0.0
    for row in rows:
        t = np.arange(0.0, row[0], 0.02)
        times.append(begin + t)
        places.append(np.stack([polyval(t, row[1 + 8 * axis : 9 + 8 * axis]) for axis in range(3)], axis=-1))
        begin += row[0]
    return np.concatenate(times), np.concatenate(places)


def error(track: tuple[FloatArray, FloatArray], reference: tuple[FloatArray, FloatArray], start: FloatArray) -> float:
    """Return by how much, RMS, m, a flight misses a curve from a start on, at the best time to begin it."""
    (stamps, where), (times, places) = track, reference
    found = []
    for begin in np.arange(stamps[0], stamps[-1] - times[-1], 0.05):
        at = np.stack([np.interp(begin + times, stamps, where[:, axis]) for axis in range(3)], axis=-1)
        found.append(float(np.sqrt(((at - places - start) ** 2).sum(axis=1).mean())))
    return min(found)


def test_hello_world(flight: Flight) -> None:
    flight.fly("hello_world")
    flight.require_landed()
    assert flight.passes("cf231", (0.0, 0.5, 1.0))
    assert flight.track("cf5")[1][:, 2].max() < DOWN


def test_nice_hover(flight: Flight) -> None:
    flight.fly("nice_hover", keys=b"x")
    flight.require_landed()
    assert all(flight.passes(name, (x, y, 1.0)) for name, (x, y, _) in PLACES.items())


def test_goto_unicast(flight: Flight) -> None:
    flight.fly("goto_unicast")
    flight.require_landed()
    for name, (x, y, _) in PLACES.items():
        corners = [(x, y), (x + 0.5, y), (x + 0.5, y + 0.5), (x, y + 0.5)]
        assert all(flight.passes(name, (*corner, 0.5)) for corner in corners)


@pytest.mark.parametrize("server", ["sim_server", "crazyflie_server"])
def test_arming(lab: Lab, tmp_path: Path, request: pytest.FixtureRequest, server: str) -> None:
    if server == "sim_server":
        flight = simulated(lab, tmp_path, vehicle="brushless")
    else:
        flight = request.getfixturevalue("over_udp")(vehicle="brushless")
    told: list[Any] = lab.watch(interfaces.status_topic(Status), "cf231")
    flight.fly("arming")
    armed = [bool(status.supervisor_info & Status.SUPERVISOR_INFO_IS_ARMED) for status in told]
    changes = [now for before, now in zip([None, *armed], armed, strict=False) if now != before]
    assert changes == [False, True, False]


@pytest.mark.parametrize("script", ["figure8", "cmd_full_state"])
def test_a_figure_of_eight(flight: Flight, script: str) -> None:
    flight.fly(script)
    flight.require_landed()
    reference = curve(DATA / "figure8.csv")
    height = 1.0 if script == "figure8" else 0.5
    for name, place in PLACES.items() if script == "figure8" else [("cf231", PLACES["cf231"])]:
        missed = error(flight.track(name), reference, np.array(place) + (0.0, 0.0, height))
        print(f"{script}: {name} misses the trajectory by {missed:.3f} m RMS")
        assert missed < FOLLOWED


def test_multi_trajectory(simulation: Flight) -> None:
    simulation.fly("multi_trajectory")
    simulation.require_landed()
    for number, (name, place) in enumerate(PLACES.items()):
        reference = curve(DATA / "multi_trajectory" / f"traj{number}.csv")
        missed = error(simulation.track(name), reference, np.array(place) + (0.0, 0.0, 1.0) - reference[1][0])
        print(f"multi_trajectory: {name} misses the trajectory by {missed:.3f} m RMS")
        assert missed < FOLLOWED
    assert "cf231/upload_trajectory: trajectory up to piece 32: a real drone holds 31" in simulation.server.output


def test_multi_trajectory_ends_crazyswarm2s_server(over_udp: Callable[..., Flight]) -> None:
    """The memory of a drone, and of the simulated one here, is too small for its first trajectory."""
    flight = over_udp()
    flight.server.expected = True
    flight.fly("multi_trajectory", until=lambda: flight.server.returncode is not None)
    assert flight.server.returncode == 1
    assert "[cf231] Upload failed" in flight.server.output
    assert "'UploadTrajectory_Response' object has no attribute 'success'" in flight.server.output


def test_group_mask(simulation: Flight) -> None:
    simulation.fly("group_mask")
    simulation.require_landed()
    for name in PLACES:
        stamps, where = simulation.track(name)
        climbed = stamps[where[:, 2] > 0.3]
        assert 0.0 < climbed[-1] - climbed[0] < 4.5, "once, not in the first three seconds"


def test_group_mask_takes_everybody_off_with_crazyswarm2s_server(over_udp: Callable[..., Flight]) -> None:
    """It hands the mask on for every command but this one."""
    flight = over_udp()
    flight.fly("group_mask")
    flight.require_landed()
    for name in PLACES:
        stamps, where = flight.track(name)
        climbed = stamps[where[:, 2] > 0.3]
        assert climbed[-1] - climbed[0] > 4.5, "from the first three seconds on"


def test_set_param(flight: Flight, lab: Lab) -> None:
    flight.fly("set_param")
    assert "not disabled" not in flight.output
    assert "keyError" not in flight.output


def test_swap(flight: Flight) -> None:
    flight.fly("swap")
    flight.require_landed()
    assert flight.passes("cf5", (0.0, -0.2, 0.4))
    assert flight.passes("cf5", (0.0, 0.2, 0.4))
    assert flight.passes("cf231", (0.0, 0.2, 0.5))
    assert flight.passes("cf231", (0.0, -0.2, 0.5))


def test_vel_mux(flight: Flight, lab: Lab) -> None:
    """It runs until it is stopped: here when the drone has flown ahead and landed."""
    publisher = lab.node.create_publisher(Twist, "/cmd_vel", 10)
    wanted = Twist()
    wanted.linear.x = 0.3
    timer = lab.node.create_timer(0.1, lambda: publisher.publish(wanted))

    def over() -> bool:
        where = flight.track("cf231")[1]
        if where[-1, 0] > 0.5:
            wanted.linear.x, wanted.linear.z = 0.0, -1.0
        return bool(wanted.linear.z < 0.0 and where[-1, 2] < DOWN)

    flight.fly("vel_mux", until=over)
    timer.cancel()
    assert flight.track("cf231")[1][:, 2].max() == pytest.approx(0.5, abs=0.15)


def test_calls_that_no_example_makes(simulation: Flight) -> None:
    simulation.fly(STANDINS / "calls.py")
    for told in (
        "numbers = [5, 231]",
        "mask = 4",
        "position = [0.3, 0.5, 0.5]",
        "pose = 0.5, battery = 4.0",
        "heights = [0.5, 0.0]",
    ):
        assert told in simulation.output
    assert simulation.passes("cf231", (0.0, 0.5, 0.9))
    assert simulation.passes("cf231", (0.4, 0.5, 0.9))
    assert simulation.passes("cf5", (0.0, -0.5, 0.5))
    simulation.require_landed()


def test_every_call_and_launch_argument_of_crazyswarm2_has_its_row() -> None:
    page = (Path(__file__).parents[2] / "docs" / "crazyswarm2.md").read_text(encoding="utf-8")
    _, _, after = page.partition("## What serves scripts and launch arguments")
    rows = [line.split("|")[1] for line in after.partition("\n## ")[0].splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`(?:\w+\.)*(\w+)`", row)}
    api = ast.parse((SOURCE / "crazyflie_py" / "crazyflie_py" / "crazyflie.py").read_text(encoding="utf-8"))
    classes = [node for node in api.body if isinstance(node, ast.ClassDef)]
    calls = {each.name for node in classes for each in node.body if isinstance(each, ast.FunctionDef)}
    launch = (SOURCE / "crazyflie" / "launch" / "launch.py").read_text(encoding="utf-8")
    arguments = set(re.findall(r"DeclareLaunchArgument\('(\w+)'", launch))
    assert named == arguments | {name for name in calls if not name.startswith("_") and "callback" not in name}


def test_a_log_block_is_added_and_removed(simulation: Flight, lab: Lab) -> None:
    block = interfaces.Topic("attitude", LogDataGeneric, interfaces.LOG_BLOCK, interfaces.LOG_BLOCK)
    logged = lab.watch(block, "cf231")
    wanted = {"topic_name": "attitude", "frequency": 20, "vars": ["stabilizer.yaw", "pm.vbat"]}
    assert lab.ask(AddLogging, "cf231/add_logging", **wanted).success
    lab.wait(lambda: len(logged) > 20, "log messages")
    assert list(logged[-1].values) == pytest.approx([0.0, 4.0])
    assert logged[-1].timestamp - logged[-11].timestamp == pytest.approx(500, abs=100)
    assert not lab.ask(AddLogging, "cf231/add_logging", **wanted).success
    assert not lab.ask(AddLogging, "cf5/add_logging", **{**wanted, "vars": ["range.front"]}).success
    assert lab.ask(RemoveLogging, "cf231/remove_logging", topic_name="attitude").success
    lab.listen(0.5)
    before = len(logged)
    lab.listen(0.5)
    assert len(logged) == before
    assert not lab.ask(RemoveLogging, "cf231/remove_logging", topic_name="attitude").success


def test_motion_capture_of_all_drones_reaches_the_servers_kind_of_subscriber(simulation: Flight, lab: Lab) -> None:
    capture = pytest.importorskip("motion_capture_tracking_interfaces.msg")
    came: list[Any] = []
    # as both of crazyswarm2's servers ask for it: late poses are to be told
    qos = interfaces.named_poses_qos(100.0)
    lab.node.create_subscription(capture.NamedPoseArray, interfaces.NAMED_POSES, came.append, qos)
    lab.wait(lambda: len(came) > 20, "poses of all drones")
    assert [pose.name for pose in came[-1].poses] == list(PLACES)
    assert came[-1].poses[1].pose.position.y == pytest.approx(-0.5, abs=0.01)


def test_transforms_lead_from_the_world_to_each_drone(simulation: Flight, lab: Lab) -> None:
    transforms = pytest.importorskip("tf2_msgs.msg")
    came: list[Any] = []
    lab.node.create_subscription(transforms.TFMessage, interfaces.TF, came.append, interfaces.TF_QOS)
    lab.wait(lambda: len(came) > 20, "transforms")
    assert [one.child_frame_id for one in came[-1].transforms] == list(PLACES)
    assert came[-1].transforms[0].transform.translation.y == pytest.approx(0.5, abs=0.01)
