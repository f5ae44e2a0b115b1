"""The bridge, the real cflib and UDP, with simulated drones behind: flights, and what goes wrong on a link."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from crtp_endpoint import Endpoint, heights, setpoints, state
from geometry_msgs.msg import PoseStamped
from rclpy.timer import Timer
from std_srvs.srv import Empty, SetBool

from flatsat_ros.crazyflie.link import ZERO_TIME
from flatsat_ros.crazyflie.vehicle import load_vehicle
from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.demo.record import RMS_LIMIT
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.interfaces import Topic
from flatsat_ros.sim.firmware import SHUTDOWN_AGE
from flatsat_ros.sim.fleet import SimulatedFleet
from flatsat_ros.sim.state_machine import State

if TYPE_CHECKING:
    from conftest import Lab, Process

pytest.importorskip("cflib", reason="the bridge is an extra")

HOVER = 38842.0  # PWM
ZERO = WireSetpoint(0.0, 0.0, 0.0, 0.0)
# three drones share two cores with everybody else: a second without an answer is no lost link
PATIENT = 10.0  # s
DEADLINE = 40.0  # s
Simulate = Callable[..., Endpoint]


@pytest.fixture
def simulate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Simulate]:
    """Put simulated drones behind UDP ports, switched on unless told otherwise."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    endpoints: list[Endpoint] = []

    def make(*start: Sequence[float], vehicle: str = "cf21", on: bool = True) -> Endpoint:
        places = start or ((0.0, 0.0, 0.0),)
        profile = load_vehicle(vehicle)
        endpoints.append(Endpoint(SimulatedFleet(profile, len(places), start=places)))
        if on:
            endpoints[-1].switch_on()
        return endpoints[-1]

    yield make
    for endpoint in endpoints:
        endpoint.close()


def bridge(lab: Lab, drones: Endpoint, **parameters: object) -> Process:
    """Start the bridge for cf1, cf2, ...; with the on-board estimate as pose."""
    settings: dict[str, object] = {"pose_rate": 100.0, "link_timeout": PATIENT, **parameters}
    return lab.start("cflib_bridge", robot_names=robots(drones), uris=json.dumps(drones.uris), **settings)


def robots(drones: Endpoint) -> list[str]:
    return [f"cf{number + 1}" for number in range(len(drones.drones))]


def require_landed(lab: Lab, drones: Endpoint, places: Sequence[Sequence[float]]) -> None:
    """Require that the drones stand near their places and that the silence after a flight locks none of them."""
    silent_since = drones.fleet.time
    stopped = {State.FREE_FALL, State.LOCKED, State.CRASHED}

    def is_over() -> bool:
        assert not stopped & {state(drones, index) for index in range(drones.fleet.count)}
        return drones.fleet.time > silent_since + 1.5 * SHUTDOWN_AGE / 1000.0

    lab.wait(is_over, "the watchdogs to run out")
    off = np.abs(drones.fleet.bodies.position - np.array(places) * (1.0, 1.0, 0.0))
    assert (off < (lab.near, lab.near, 0.02)).all()
    assert not drones.fleet.firmware.thrust_locked.any()


def values(status: list[Any]) -> dict[str, str]:
    """The values of the newest report."""
    return {pair.key: pair.value for pair in status[-1].values}


def lift(lab: Lab, drones: Endpoint, robot: str = "cf1", height: float = 0.3) -> Timer:
    """Unlock a drone and bring it to a height, m; return what streams a little more than hover."""
    index = robots(drones).index(robot)
    unlocking = lab.stream(robot, ZERO)
    lab.wait(lambda: not drones.fleet.firmware.thrust_locked[index], "the thrust lock to open")
    unlocking.cancel()
    flight = lab.stream(robot, WireSetpoint(0.0, 0.0, 0.0, 1.1 * HOVER))
    lab.wait(lambda: heights(drones)[index] > height, "the drone to climb")
    return flight


def test_the_bytes_on_the_wire_are_those_of_crazyswarm2s_cpp_back_end(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    bridge(lab, drones)
    sent = lab.stream("cf1", WireSetpoint(roll=5.0, pitch=3.0, yaw=20.0, thrust=40000.7))
    lab.wait(lambda: drones.drones[0].of(3, 0), "a set-point")
    sent.cancel()
    packet = drones.drones[0].of(3, 0)[-1]
    # crazyflie_server.cpp: roll = linear.y, pitch = -linear.x, yaw rate = angular.z, thrust cut to uint16_t; all <fffH
    assert packet.data.hex() == "0000a040000040c00000a041409c"
    assert packet.header & 0xF3 == 0x30  # the two bits between port and channel mean nothing


def test_what_no_packet_may_carry_is_clipped_or_refused_and_counted(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    bridge(lab, drones)
    status = lab.watch_diagnostics("cflib_bridge: cf1")
    for bad in (np.nan, np.inf):
        streams = [lab.stream("cf1", ZERO._replace(**{name: bad})) for name in WireSetpoint._fields]
        lab.wait(lambda: status and int(values(status)["refused"]) >= 4, "refusals")
        for stream in streams:
            stream.cancel()
        status.clear()
    lab.listen(0.5)
    assert not setpoints(drones)
    for thrust, expected in ((-5.0, 0), (1e6, 60000)):
        stream = lab.stream("cf1", ZERO._replace(thrust=thrust))
        lab.wait(lambda expected=expected: (setpoints(drones) or [(None,)])[-1][-1] == expected, f"thrust {expected}")
        stream.cancel()


def test_three_drones_take_off_swap_places_and_land_over_the_whole_chain(simulate: Simulate, lab: Lab) -> None:
    places = np.array([[0.0, -0.6, 1.0], [0.6, 0.6, 1.0], [-0.6, 0.6, 1.0]])
    drones = simulate(*(places * (1.0, 1.0, 0.0)))
    names = robots(drones)
    poses = [lab.watch(interfaces.POSE, robot) for robot in names]
    commands = [lab.watch(interfaces.COMMAND, robot) for robot in names]
    bridge(lab, drones)
    lab.fly(*names, takeoff_height=1.0)
    lab.take_off(*names)
    for robot, place in zip(names, places, strict=True):
        lab.go_to(robot, place)
    for robot, seen, place in zip(names, poses, places, strict=True):
        lab.wait_for_flight(robot, seen, place)
    flown = [len(seen) for seen in poses]
    # nobody was cheated: the pose is the simulated drone's, and what it flew on came by radio
    assert drones.fleet.bodies.position == pytest.approx(places, abs=lab.near)
    for index, seen in enumerate(commands):
        assert lab.require_within_limits(seen)[0, 0] == 0.0, "the thrust lock opens on zero thrust"
        sent = np.array([(c.linear.y, -c.linear.x, int(c.linear.z)) for c in seen])
        for roll, pitch, _, thrust in setpoints(drones, index)[-5:]:
            assert np.isclose(sent, (roll, pitch, thrust), rtol=1e-6).all(axis=1).any()

    duration, rest = 4.0, np.zeros((2, 3))
    start = lab.node.get_clock().now().nanoseconds + messages.NANOSECONDS // 2
    goals = np.roll(places, -1, axis=0)
    paths = [Trajectory.through([0.0, duration], legs, rest, rest) for legs in zip(places, goals, strict=True)]
    for robot, path in zip(names, paths, strict=True):
        lab.publish(interfaces.TRAJECTORY, robot, messages.message_from_trajectory(path, start))
    for robot, seen, goal in zip(names, poses, goals, strict=True):
        lab.wait_for_flight(robot, seen, goal)
    lab.land(*names)
    require_landed(lab, drones, goals)
    for seen in commands:
        lab.require_within_limits(seen)
    tracks = [
        {messages.nanoseconds_from_stamp(pose.header.stamp) // 10_000_000: place_of(pose) for pose in seen[begin:]}
        for seen, begin in zip(poses, flown, strict=True)
    ]
    for one, other in combinations(tracks, 2):
        assert min(np.linalg.norm(one[k] - other[k]) for k in one.keys() & other.keys()) > 0.4
    for track, path in zip(tracks, paths, strict=True):
        flown_at = {k * 0.01 - start * 1e-9: place for k, place in track.items()}
        errors = [place - path.sample(t)[:3] for t, place in flown_at.items() if 0.0 <= t <= duration]
        assert len(errors) > 100
        assert np.sqrt(np.mean(np.sum(np.square(errors), axis=1))) < RMS_LIMIT


def place_of(pose: PoseStamped) -> np.ndarray:
    p = pose.pose.position
    return np.array([p.x, p.y, p.z])


def test_set_points_are_limited_to_the_rate_and_the_newest_wins(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    bridge(lab, drones, rate=10.0)
    status = lab.watch_diagnostics("cflib_bridge: cf1")
    begun = lab.node.get_clock().now()
    lab.stream("cf1", ZERO, frequency=100.0)
    lab.wait(lambda: len(setpoints(drones)) >= 20, "set-points")
    lab.wait(lambda: status and int(values(status)["overtaken"]) > 20, "a report")
    seconds = (lab.node.get_clock().now() - begun).nanoseconds * 1e-9
    assert len(setpoints(drones)) <= 10.0 * seconds + 1


@pytest.mark.parametrize(
    ("kind", "channel", "expected"),
    [("position", 0, "0000803f" "00000040" "00004040"),
     ("pose", 1, "08" "0000803f" "00000040" "00004040" "00000000" "00000000" "9a99193f" "cdcc4c3f")],
)  # fmt: skip
def test_external_poses_reach_the_drone(simulate: Simulate, lab: Lab, kind: str, channel: int, expected: str) -> None:
    drones = simulate()
    bridge(lab, drones, external_pose=kind)
    mocap = Topic("mocap_pose", *(getattr(interfaces.POSE, name) for name in ("kind", "publish", "subscribe")))
    message, poses = PoseStamped(), lab.watch(interfaces.POSE, "cf1")
    messages.fill_pose(message, 1, (np.nan, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
    lab.publish(mocap, "cf1", message)
    messages.fill_pose(message, 1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
    lab.wait(lambda: poses, "a connection")

    def arrived() -> bool:  # one pose of a motion capture may be lost on its way
        lab.publish(mocap, "cf1", message)
        return bool(drones.drones[0].of(6, channel))

    lab.wait(arrived, "an external pose")
    assert {packet.data.hex() for packet in drones.drones[0].of(6, channel)} == {expected}


def test_console_battery_and_link_are_reported(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    process = bridge(lab, drones)
    status, batteries = lab.watch_diagnostics("cflib_bridge: cf1"), lab.watch(interfaces.BATTERY, "cf1")
    lab.wait(lambda: status and batteries and "pm.vbat" in values(status), "the battery's voltage")
    drones.print(0, "SYS: a line longer than one packet can carry\nDECK: half a li")
    drones.print(0, "ne\n")
    lab.wait(lambda: "half a line" in values(status)["console"], "the console")
    told = values(status)
    assert told["console"].splitlines() == ["SYS: a line longer than one packet can carry", "DECK: half a line"]
    assert "cf1: DECK: half a line" in process.output
    assert float(told["pm.vbat"]) == pytest.approx(float(drones.fleet.power.voltage[0]), abs=0.01)
    assert batteries[-1].voltage == pytest.approx(float(told["pm.vbat"]), abs=0.01)
    assert float(told["latency ms"]) > 0.0
    assert status[-1].message == "connected"


@pytest.mark.parametrize("end", ["stop", "land"])
def test_a_flown_drone_is_left_as_configured_and_never_locked(simulate: Simulate, lab: Lab, end: str) -> None:
    drones = simulate((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    process = bridge(lab, drones, on_shutdown=end, land_time=1.0)
    lab.stream("cf2", ZERO)
    lab.wait(lambda: setpoints(drones, 1), "a set-point without thrust for cf2")
    lift(lab, drones).cancel()
    flown, told = len(setpoints(drones)), time.monotonic()
    assert process.stop() == 0
    # the endpoint may read late on a busy machine, but the bridge cannot leave before its time
    assert time.monotonic() - told > ZERO_TIME
    assert "Traceback" not in process.output
    sent = setpoints(drones)[flown:]
    thrusts = [thrust for *_, thrust in sent if thrust != int(1.1 * HOVER)]
    if end == "land":
        assert 0.9 * HOVER < thrusts[0] < HOVER
        assert all(np.abs(angles).max() == 0.0 for *angles, thrust in sent if thrust == thrusts[0]), "level"
    assert set(thrusts) == {thrusts[0], 0}
    assert thrusts == sorted(thrusts, reverse=True), "once zero, zero for good"
    spoken = [packet.port for packet in drones.drones[0].received if packet.port[0] != 15]  # 15 is the link's own
    assert spoken[-1] == (7, 1), "the last word is that no set-point follows"
    lab.wait(lambda: state(drones) in (State.LANDED, State.RESET, State.READY_TO_FLY), "the drone to rest, unlocked")
    # one that stood on the ground got no thrust, one that was never flown is nobody's business
    assert {thrust for *_, thrust in setpoints(drones, 1)} == {0}
    assert not drones.drones[2].of(3, 0)
    assert not drones.drones[2].of(7, 1)


def test_an_emergency_stop_works_while_the_bridge_lands_its_drones(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    process = bridge(lab, drones, on_shutdown="land", land_time=60.0)
    flight = lift(lab, drones)
    process.send(signal.SIGTERM)
    flight.cancel()
    lab.ask(Empty, "all/emergency")
    lab.wait(lambda: state(drones) == State.LOCKED, "the drone to stop")
    assert process.wait() == 0
    assert len(drones.drones[0].of(9, 1)) >= 5, "one packet alone may be lost"


def test_an_emergency_stop_is_for_one_or_for_all_and_for_good(simulate: Simulate, lab: Lab) -> None:
    drones = simulate((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    process = bridge(lab, drones)
    status = lab.watch_diagnostics("cflib_bridge: cf1")
    lift(lab, drones, "cf1")
    lift(lab, drones, "cf2")
    lab.ask(Empty, "cf1/emergency")
    lab.wait(lambda: state(drones, 0) == State.LOCKED, "cf1 to stop")
    lab.wait(lambda: status[-1].message == "emergency stop", "a report")
    assert state(drones, 1) == State.FLYING
    lab.ask(Empty, "all/emergency")
    lab.wait(lambda: state(drones, 1) == State.LOCKED, "cf2 to stop")
    # commands are still coming in, but none goes out
    before = len(setpoints(drones))
    lab.listen(1.0)
    assert len(setpoints(drones)) == before
    # nor does a reboot help while the bridge runs
    drones.switch_off(0)
    lab.listen(1.0)
    drones.switch_on(0)
    lab.wait(lambda: state(drones) == State.LOCKED, "cf1 to stop again")
    assert process.stop() == 0


def test_arming_goes_to_the_drone_whose_refusal_is_told(simulate: Simulate, lab: Lab) -> None:
    drones = simulate(vehicle="brushless")
    process = bridge(lab, drones, vehicle="brushless")
    poses = lab.watch(interfaces.POSE, "cf1")
    lab.wait(lambda: poses, "a connection")
    assert not drones.fleet.firmware.armed[0]
    for wanted in (True, False):
        assert lab.ask(SetBool, "cf1/arm", data=wanted).success
        lab.wait(lambda wanted=wanted: drones.fleet.firmware.armed[0] == wanted, f"armed to be {wanted}")
    assert "refuses" not in process.output
    with drones.lock:
        drones.fleet.firmware.request_emergency(0)
    lab.wait(lambda: state(drones) == State.LOCKED, "the drone to be locked")
    assert lab.ask(SetBool, "cf1/arm", data=True).message == "sent"
    lab.wait(lambda: "cf1: the drone refuses to arm" in process.output, "its refusal")


def test_a_flight_survives_lost_packets(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    drones.drones[0].loss = 0.2
    poses = lab.watch(interfaces.POSE, "cf1")
    # of its first two questions cflib repeats none: the bridge does, after a second of silence
    bridge(lab, drones, link_timeout=1.0)
    lab.wait(lambda: len(poses) > 50, "poses")
    lab.fly("cf1")
    lab.go_to("cf1", (0.3, 0.0, 0.6))
    lab.wait_for_flight("cf1", poses, (0.3, 0.0, 0.6))


def test_a_dead_link_ends_as_the_firmware_says_and_is_opened_again(simulate: Simulate, lab: Lab) -> None:
    drones = simulate((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    process = bridge(lab, drones, link_timeout=1.0)
    status = lab.watch_diagnostics("cflib_bridge: cf1")
    poses = lab.watch(interfaces.POSE, "cf2")
    lab.fly("cf2")
    lab.go_to("cf2", (1.0, 0.0, 0.5))
    lab.wait_for_flight("cf2", poses, (1.0, 0.0, 0.5))
    lift(lab, drones)
    drones.drones[0].deaf = True
    lab.wait(lambda: state(drones) == State.LOCKED, "the firmware to cut the motors")
    lab.wait(lambda: status[-1].message == "silent for 1 s", "a report")
    settled = len(poses)
    drones.drones[0].deaf = False
    lab.wait(lambda: status[-1].message == "locked until reboot", "the connection to be back")
    assert int(values(status)["connections"]) >= 2
    happened = ["connected", "silent for 1 s", "connected"]
    lab.wait(lambda: re.findall(r"cf1: (connected|silent for 1 s)", process.output) == happened, "the log to tell it")
    # the other drone never noticed
    lab.wait(lambda: len(poses) > settled + 100, "poses of the other drone")
    assert np.abs([pose.pose.position.z - 0.5 for pose in poses[settled:]]).max() < lab.near


def test_a_short_silence_of_the_link_costs_no_connection(simulate: Simulate, lab: Lab) -> None:
    drones = simulate()
    bridge(lab, drones)
    status = lab.watch_diagnostics("cflib_bridge: cf1")
    lift(lab, drones)
    drones.drones[0].deaf = True
    lab.wait(lambda: state(drones) == State.LEVEL_OUT, "the firmware to level out")
    drones.drones[0].deaf = False
    lab.wait(lambda: state(drones) == State.FLYING, "the flight to go on")
    lab.wait(lambda: status, "a report")
    assert values(status)["connections"] == "1"


def test_a_drone_that_comes_late_and_answers_late_flies(simulate: Simulate, lab: Lab) -> None:
    drones = simulate(on=False)
    drones.drones[0].delay = 0.1
    status, poses = lab.watch_diagnostics("cflib_bridge: cf1"), lab.watch(interfaces.POSE, "cf1")
    bridge(lab, drones)
    old = lab.stream("cf1", WireSetpoint(0.0, 0.0, 0.0, 50000.0))
    lab.wait(lambda: status and "refused" in status[-1].message, "a report that nobody answers")
    old.cancel()
    lab.withdraw(interfaces.COMMAND, "cf1")
    lab.listen(0.5)
    drones.switch_on()
    lab.wait(lambda: len(poses) > 10, "poses")
    assert not setpoints(drones), "a set-point of the past must not fly a drone"
    lab.fly("cf1")
    lab.go_to("cf1", (0.0, 0.0, 0.5))
    lab.wait(lambda: heights(drones)[0] > 0.3, "the drone to climb")


def test_a_second_bridge_to_the_same_drone_is_refused(simulate: Simulate, lab: Lab, executables: Path) -> None:
    drones = simulate()
    bridge(lab, drones)
    poses = lab.watch(interfaces.POSE, "cf1")
    lab.wait(lambda: poses, "a connection")
    uri = f'["udp://localhost:{drones.drones[0].port}"]'
    command = [executables / "cflib_bridge", "--ros-args", "-p", f"uris:={uri}", "-p", "robot_names:=[other]"]
    second = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE, check=False)
    assert second.returncode == 2
    assert "taken by another cflib_bridge" in second.stderr
    assert second.stderr.count("\n") == 1
    seen = len(poses)
    lab.wait(lambda: len(poses) > seen + 10, "the first one to go on")
