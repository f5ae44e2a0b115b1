"""The controller as a process among faults, in this process and on simulated time: what breaks ends where it broke.

Node, pilot and callbacks are the real ones; the clocks are the test's, the drones simulated, and the messages are
handed to the subscriptions as bytes, as rclpy would.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.serialization import deserialize_message, serialize_message
from room import EPOCH, Room, pose, rooms
from std_srvs.srv import SetBool

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.trajectory import Trajectory
from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.nodes.ros.diagnostics import Level
from flatsat_ros.nodes.ros.messages import NANOSECONDS

pytestmark = pytest.mark.in_process


@pytest.fixture
def room() -> Iterator[Callable[..., Room]]:
    """How to make a room; it is left after the test."""
    with rooms() as make:
        yield make


LATER = EPOCH + 7 * NANOSECONDS
UP = (0.0, 0.0, 0.0, 1.0)
PLACE = (0.0, 0.0, 1.0)
LONG = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + bytes(8) + struct.pack("<I", 100_000) + bytes(184 * 100_000)
HUGE = Trajectory.through([0.0, 1e-9], [[0.0, 0.0, 1.0], [1e4, 0.0, 1.0]], np.zeros((2, 3)), np.zeros((2, 3)))
# what comes, and whether it is an order that the drone itself may follow
BAD = {
    "8 odd bytes for a pose": ("pose", b"odd byte"),
    "nothing for a pose": ("pose", b""),
    "a pose that is not a number": (
        "pose",
        pose((math.nan, math.inf, 1.0), (math.nan,) * 4, stamp=LATER),
    ),
    "a pose as far as numbers go": ("pose", pose((1.7e308,) * 3, (1e200,) * 4, stamp=LATER)),
    "a pose of the last second": ("pose", pose(PLACE, UP, stamp=2**31 * NANOSECONDS - 1)),
    "a pose of another frame": ("pose", pose((5.0, 5.0, 5.0), UP, "map", stamp=LATER)),
    "a pose with a frame of 1 MB": ("pose", pose(PLACE, UP, "w" * 1_000_000)),
    "an orientation of 1e200": ("goal_pose", pose(PLACE, (0.0, 0.0, 0.0, 1e200))),
    "an orientation that is not a number": ("goal_pose", pose(PLACE, (math.nan,) * 4)),
    "a goal of 1.7e308": ("goal_pose", pose((1.7e308,) * 3, UP)),
    "a goal of NaN": ("goal_pose", pose((math.nan,) * 3, UP)),
    "a goal of another frame": ("goal_pose", pose((5.0, 5.0, 5.0), UP, "map")),
    "odd bytes for a goal": ("goal_pose", b"\0\1\0\0" + b"\xff" * 90),
    "100,000 points": ("trajectory", LONG),
    "odd bytes for a trajectory": ("trajectory", b"\0\1\0\0" + b"\1" * 500),
    "10 km in a nanosecond": ("trajectory", serialize_message(messages.message_from_trajectory(HUGE, 0))),
}


def test_what_one_drone_is_sent_does_not_touch_another(room: Callable[..., Room]) -> None:
    quiet = room()
    quiet.hover("cf1", "cf2")
    quiet.run(0.2 * len(BAD))
    quiet.node.destroy_node()
    rclpy.shutdown()
    lab = room()
    lab.hover("cf1", "cf2")
    for name, (topic, data) in BAD.items():
        before = lab.node.faults.counts["cf1/" + topic] + lab.node._pilot.estimator.rejected[0]
        for _ in range(20):
            lab.deliver(f"cf1/{topic}", data)
        lab.run(0.2)
        known = lab.node.faults.counts["cf1/" + topic] + lab.node._pilot.estimator.rejected[0] - before
        assert known == 20, name
        assert lab.modes == [Mode.FLY, Mode.FLY], name
        assert lab.fleet.bodies.position[0] == pytest.approx(PLACE, abs=0.1), name
        assert lab.wires[1].sent == quiet.wires[1].sent[: len(lab.wires[1].sent)], name
    assert [len(wire.sent) for wire in lab.wires] == [len(wire.sent) for wire in quiet.wires]
    assert not lab.node.faults.count("cf2")


def test_what_is_told_of_a_drone_is_counted_in_its_diagnostics_with_the_newest_text(room: Callable[..., Room]) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    before, others = (status.values["events"] for status in lab.node._report(0))
    lab.blind.add(0)
    while lab.modes[0] is not Mode.LEVEL:
        lab.run(lab.period)
    after, other = (status.values for status in lab.node._report(0))
    assert isinstance(before, int)
    assert after["events"] > before >= 2
    assert after["last event"] == "FLY -> LEVEL: no fresh pose: held level"
    assert other["events"] == others


def test_the_name_of_another_frame_is_told_and_may_be_made_ours(
    room: Callable[..., Room], capfd: pytest.CaptureFixture[str]
) -> None:
    lab = room("-p", "world_frame:=map")
    lab.run(1.0)
    assert "cf1/pose: frame_id = 'world': must be 'map' or empty" in capfd.readouterr().err
    (status, _) = lab.node._report(0)
    assert status.values["last refusal"] == "cf1/pose: frame_id = 'world': must be 'map' or empty"
    assert status.values["refused"] == lab.node.faults.counts["cf1/pose"] > 10
    lab.frame = "map"
    lab.hover("cf1")
    for frame in ("map", ""):
        lab.deliver("cf1/goal_pose", pose(PLACE, UP, frame))
    assert not lab.node.faults.counts["cf1/goal_pose"]


def fail(*_: object) -> None:
    raise OverflowError("34, numerical result out of range")


def test_when_the_common_step_fails_all_go_down_by_their_last_resort(
    room: Callable[..., Room], capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    before = [len(wire.sent) for wire in lab.wires]
    monkeypatch.setattr(lab.node._pilot, "tick", fail)
    monkeypatch.setattr(lab.node._pilot, "last_command", fail)
    speeds = lab.impact(6.0)
    assert max(speeds) < 1.2
    for wire, begin in zip(lab.wires, before, strict=True):
        down = wire.sent[begin:]
        assert len(down) == round(6.0 / lab.period), "one in every tick"
        assert all((s.roll, s.pitch, s.yaw) == (0.0, 0.0, 0.0) and s.thrust > 0.0 for s in down)
        assert all(later.thrust < earlier.thrust for earlier, later in pairwise(down))
    said = capfd.readouterr().err
    assert said.count("Traceback") == 1
    assert "control step failed: OverflowError: 34, numerical result out of range" in said
    assert "every drone in the air goes down level" in said
    for status in lab.node._report(0):
        assert status.level is Level.ERROR
        assert status.text.startswith("LAST RESORT: the control step failed")
    lab.goal("cf1", 0.0, 0.0, 1.0)
    assert "restart the controller" in lab.node.faults.newest("cf1")
    for name in ("cf1/flatsat/takeoff", "all/flatsat/land", "cf2/flatsat/hand_over"):
        answer = lab.ask(name)
        assert not answer.success
        assert "restart the controller" in answer.message
    lab.run(10.0)
    assert lab.wires[0].sent[-1].thrust == 0.0
    begin = len(lab.wires[0].sent)
    lab.run(1.0)
    assert len(lab.wires[0].sent) == begin, "silent in the end"


def test_a_step_that_fails_once_is_not_trusted_again(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    with monkeypatch.context() as once:
        once.setattr(lab.node._pilot, "tick", fail)
        lab.run(lab.period)
    assert max(lab.impact(6.0)) < 1.2


def test_idle_drones_are_left_alone_when_the_common_step_fails(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.hover("cf1")
    monkeypatch.setattr(lab.node._pilot, "tick", fail)
    lab.run(3.0)
    assert not lab.wires[1].sent


def test_one_drone_whose_command_fails_goes_down_alone(
    room: Callable[..., Room], capfd: pytest.CaptureFixture[str]
) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    lab.node._setup.vehicles[0] = None  # type: ignore[call-overload]
    heights = lab.run(5.0)
    assert lab.fleet.bodies.grounded.tolist() == [True, False]
    assert np.abs(heights[:, 1] - 1.0).max() < 0.1
    assert all(
        (s.roll, s.pitch) == (0.0, 0.0) and s.thrust > 0.0 for s in lab.wires[0].sent[-round(5.0 / lab.period) :]
    )
    assert len({len(wire.sent) for wire in lab.wires}) == 1, "none was left out"
    assert "cf1/command failed: AttributeError" in capfd.readouterr().err
    assert [status.level for status in lab.node._report(0)] == [Level.ERROR, Level.OK]


@pytest.mark.parametrize("broken", ["step", "farewell", "nothing"])
def test_the_last_set_point_is_level_whatever_failed(
    broken: str, room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    hover = lab.wires[0].sent[-1].thrust
    if broken == "step":
        monkeypatch.setattr(lab.node._pilot, "tick", fail)
        lab.run(lab.period)
    if broken != "nothing":
        monkeypatch.setattr(lab.node._pilot, "last_command", fail)
    lab.node.finish()
    for wire in lab.wires:
        last = wire.sent[-1]
        assert (last.roll, last.pitch, last.yaw) == (0.0, 0.0, 0.0)
        assert 0.85 * hover < last.thrust < hover


@pytest.mark.parametrize("first", [60.0, -0.3])
def test_a_clock_that_is_set_in_flight_moves_no_drone(
    first: float, room: Callable[..., Room], capfd: pytest.CaptureFixture[str]
) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    refused = lab.node._pilot.estimator.rejected.tolist()
    for seconds in (first, first, -first, -first):  # there, and there again
        sent = len(lab.wires[0].sent)
        lab.set_by += round(seconds * NANOSECONDS)
        heights = lab.run(1.0)
        assert np.abs(heights - 1.0).max() < 0.1
        assert lab.modes == [Mode.FLY, Mode.FLY]
        assert len(lab.wires[0].sent) == sent + round(1.0 / lab.period)
        assert lab.node._pilot.estimator.rejected.tolist() == refused
    assert f"the clock was set by {first:+.3f} s" in capfd.readouterr().err


def test_the_end_waits_for_drones_on_their_last_resort(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.hover("cf1", "cf2")
    monkeypatch.setattr(lab.node._pilot, "tick", fail)
    monkeypatch.setattr(lab.node._pilot, "retire", fail)
    lab.run(lab.period)
    lab.node.begin_shutdown()
    assert not lab.node.is_shut_down()
    assert lab.node.shutdown_progress() == "landing cf1 (last resort), cf2 (last resort)"
    lab.run(10.0)
    assert lab.fleet.bodies.grounded.all()
    lab.run(6.0)
    assert lab.node.is_shut_down()


def test_lines_about_a_drone_are_throttled(room: Callable[..., Room], capfd: pytest.CaptureFixture[str]) -> None:
    lab = room()
    lab.run(0.5)
    for _ in range(1000):
        lab.goal("cf1", math.nan, 0.0, 0.0)
        lab.ask("all/flatsat/land")
    said = capfd.readouterr().err
    assert 2 <= len(said.splitlines()) <= 20
    assert lab.node.faults.counts["cf1/goal_pose"] == 1000


def test_a_request_that_fails_for_one_drone_is_done_for_the_others(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = room()
    lab.run(0.5)
    arm = lab.node._links[0].arm
    monkeypatch.setattr(lab.node._links[0], "arm", lambda wanted: fail() if wanted else arm(wanted))
    answer = lab.ask("all/flatsat/arm", SetBool, data=True)
    assert not answer.success
    assert "cf1: arm failed by an error of the program: see the log" in answer.message
    assert "cf2: the drone itself was not asked" in answer.message


@pytest.mark.parametrize("periods", [0, 1, 3])
def test_what_takes_long_for_many_drones_does_not_keep_a_tick_from_coming(
    room: Callable[..., Room], monkeypatch: pytest.MonkeyPatch, periods: int
) -> None:
    lab, ticks = room(), []
    lab.run(0.5)

    def arm(_: bool) -> str:
        lab._ticks += periods
        return ""

    for link in lab.node._links:
        monkeypatch.setattr(link, "arm", arm)
    on_tick = lab.node._on_tick
    monkeypatch.setattr(lab.node, "_on_tick", lambda: ticks.append(on_tick()))
    assert lab.ask("all/flatsat/arm", SetBool, data=True).success
    assert len(ticks) == (periods > 0), "before the second drone is armed"


def test_ticks_go_on_while_the_time_of_a_simulation_jumps_or_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    from builtin_interfaces.msg import Time
    from rosgraph_msgs.msg import Clock

    rclpy.init(args=["controller", "--ros-args", "-p", "use_sim_time:=true"])
    node = ControllerNode()
    ticks: list[Any] = []
    node.create_subscription(
        interfaces.TELEMETRY.kind,
        "cf1/flatsat/telemetry",
        lambda data: ticks.append(deserialize_message(data, interfaces.TELEMETRY.kind)),
        10,
        raw=True,
    )
    clock = node.create_publisher(Clock, "/clock", 10)
    executor = EventsExecutor()
    executor.add_node(node)

    def until(condition: Callable[[], object]) -> None:
        for _ in range(500):
            if condition():
                return
            executor.spin_once(timeout_sec=0.02)
        pytest.fail("does not come")

    try:
        for seconds in (100, 160, 100, 101):
            clock.publish(Clock(clock=Time(sec=seconds)))
            until(lambda seconds=seconds: node.get_clock().now().nanoseconds == seconds * NANOSECONDS)  # type: ignore[misc]
            seen = len(ticks)
            until(lambda seen=seen: len(ticks) > seen + 3)  # type: ignore[misc]
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
