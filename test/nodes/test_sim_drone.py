"""sim_drone over DDS: the firmware's rules are visible from outside, whatever happens it leaves with code 0."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rclpy.timer import Timer

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.ros import interfaces, messages

if TYPE_CHECKING:
    from conftest import Lab

HOVER = 38842.0  # PWM that carries 0.029 kg with 0.480 N at 65535
ZERO = WireSetpoint(0.0, 0.0, 0.0, 0.0)


def trace(poses: list[Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (s), heights (m) and tilts (rad) of poses."""
    stamps = [messages.nanoseconds_from_stamp(pose.header.stamp) * 1e-9 for pose in poses]
    tilts = [2.0 * np.arcsin(min(1.0, np.hypot(p.pose.orientation.x, p.pose.orientation.y))) for p in poses]
    return np.array(stamps), np.array([pose.pose.position.z for pose in poses]), np.array(tilts)


def values(status: list[Any]) -> dict[str, str]:
    """The values of the newest report."""
    return {pair.key: pair.value for pair in status[-1].values}


def take_off(lab: Lab, status: list[Any], command: WireSetpoint) -> Timer:
    """Unlock the thrust of cf1, then send a command over and over."""
    # the topic keeps only the newest message: one command without thrust could be lost to the next
    unlocking = lab.stream("cf1", ZERO)
    lab.wait(lambda: status and values(status)["thrust locked"] == "False", "the thrust lock to open")
    unlocking.cancel()
    return lab.stream("cf1", command)


def test_thrust_is_locked_until_a_command_without_thrust(lab: Lab) -> None:
    lab.start("sim_drone", robot_names=["cf1"])
    poses, status = lab.watch(interfaces.POSE, "cf1"), lab.watch_diagnostics("sim_drone: cf1")
    full = WireSetpoint(0.0, 0.0, 0.0, 50000.0)
    climbing = lab.stream("cf1", full)
    lab.wait(lambda: poses and len(status) >= 2, "poses and two reports")
    climbing.cancel()
    assert status[-1].message == "thrust locked"
    assert {pose.pose.position.z for pose in poses} == {0.0}
    take_off(lab, status, full)
    lab.wait(lambda: poses[-1].pose.position.z > 0.2, "the drone to climb")


def test_silence_levels_the_drone_out_after_half_a_second_and_cuts_the_motors_after_two(lab: Lab) -> None:
    lab.start("sim_drone", robot_names=["cf1"])
    poses, status = lab.watch(interfaces.POSE, "cf1"), lab.watch_diagnostics("sim_drone: cf1")
    flight = take_off(lab, status, WireSetpoint(15.0, 0.0, 0.0, 1.1 * HOVER))
    lab.wait(lambda: poses and trace(poses[-1:])[2][0] > np.deg2rad(14.0), "the drone to tilt")
    flight.cancel()
    silent = lab.node.get_clock().now().nanoseconds * 1e-9
    lab.wait(lambda: status[-1].message == "motors off until reboot", "the cut")
    lab.wait(lambda: poses[-1].pose.position.z == 0.0, "the drone to fall")
    assert "level-out" in [report.message for report in status]
    stamps, heights, tilts = trace(poses)
    # a drone can only be late, by its lags and by pauses of a busy machine
    after = stamps > silent
    assert stamps[after][np.argmax(tilts[after] < np.deg2rad(10.0))] >= silent + 0.5
    # thrust, above hover, is kept until the cut: the drone climbs until then, level
    top = stamps[np.argmax(heights)]
    assert top >= silent + 2.0
    assert tilts[stamps == top][0] < np.deg2rad(1.0)


def test_commands_that_no_packet_can_carry_are_ignored_and_counted(lab: Lab) -> None:
    lab.start("sim_drone", robot_names=["cf1"])
    status = lab.watch_diagnostics("sim_drone: cf1")
    take_off(lab, status, WireSetpoint(0.0, 0.0, 0.0, HOVER))
    ignored = [lab.stream("cf1", WireSetpoint(0.0, 0.0, 0.0, thrust)) for thrust in (np.nan, -1.0, 65536.0)]
    lab.wait(lambda: int(values(status)["commands ignored"]) >= 3, "ignored commands")
    for timer in ignored:
        timer.cancel()
    before = len(status)
    lab.wait(lambda: len(status) > before + 1, "another report")
    assert status[-1].message == "flying"


def test_an_angle_that_is_not_a_number_reaches_the_firmware_and_the_drone_tumbles(lab: Lab) -> None:
    lab.start("sim_drone", robot_names=["cf1"])
    poses, status = lab.watch(interfaces.POSE, "cf1"), lab.watch_diagnostics("sim_drone: cf1")
    flight = take_off(lab, status, WireSetpoint(0.0, 0.0, 0.0, 1.2 * HOVER))
    lab.wait(lambda: poses and poses[-1].pose.position.z > 1.0, "the drone to climb")
    flight.cancel()
    lab.stream("cf1", WireSetpoint(np.nan, 0.0, 0.0, HOVER))
    lab.wait(lambda: status[-1].message == "tumbled", "the drone to tumble")
    assert poses[-1].pose.position.z == 0.0
    assert np.isfinite(trace(poses)).all()


def test_a_stalled_simulator_pauses_its_room(lab: Lab) -> None:
    simulator = lab.start("sim_drone", robot_names=["cf1"])
    poses, status = lab.watch(interfaces.POSE, "cf1"), lab.watch_diagnostics("sim_drone: cf1")
    take_off(lab, status, WireSetpoint(0.0, 0.0, 0.0, 1.05 * HOVER))
    lab.wait(lambda: poses and poses[-1].pose.position.z > 0.5, "the drone to climb")
    before = len(status)
    simulator.send(signal.SIGSTOP)
    lab.listen(2.5)
    simulator.send(signal.SIGCONT)
    lab.wait(lambda: status and float(values(status)["paused s"]) >= 2.0, "a report after the stall")
    # longer than the silence that cuts the motors, and yet the drone flies on
    assert {report.message for report in status[before:]} == {"flying"}
    stamps, heights, _ = trace(poses)
    assert (np.diff(stamps) > 0.0).all()
    assert stamps[-1] <= lab.node.get_clock().now().nanoseconds * 1e-9
    stall = np.argmax(np.diff(stamps))
    assert abs(heights[stall + 1] - heights[stall]) < 0.5


def test_poses_have_the_rate_noise_delay_and_losses_asked_for(lab: Lab) -> None:
    lab.start(
        "sim_drone",
        robot_names=["cf1", "cf2"],
        start_positions=[0.0, 1.0, 0.0, 5.0, 0.0, 0.0],
        pose_rate=50.0,
        position_noise=0.01,
        drop_out=0.5,
        pose_delay=0.1,
    )
    late: list[float] = []

    def take(pose: Any) -> None:
        late.append(lab.node.get_clock().now().nanoseconds - messages.nanoseconds_from_stamp(pose.header.stamp))

    lab.node.create_subscription(interfaces.POSE.kind, "cf2/pose", take, 1000)
    poses = lab.watch(interfaces.POSE, "cf1")
    lab.wait(lambda: len(poses) >= 100, "a hundred poses")
    assert min(late) >= 0.1e9
    stamps, *_ = trace(poses)
    # most poses follow at once or after one that was lost; a busy machine may pause the room now and then
    steps = np.diff(stamps) / 0.02
    assert np.median(np.abs(steps - np.rint(steps))) < 0.01
    assert 0.3 < np.mean(np.rint(steps) == 1.0) < 0.7
    y = np.array([pose.pose.position.y for pose in poses])
    assert abs(y.mean() - 1.0) < 0.005
    assert 0.007 < y.std() < 0.013
    assert {pose.header.frame_id for pose in poses} == {"world"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_leaves_cleanly_when_told_to(lab: Lab, number: signal.Signals) -> None:
    simulator = lab.start("sim_drone", robot_names=["cf1", "cf2"])
    poses = lab.watch(interfaces.POSE, "cf2")
    lab.stream("cf1", ZERO)
    lab.wait(lambda: len(poses) > 10, "poses")
    assert simulator.stop(number) == 0
    assert "Traceback" not in simulator.output


def test_arguments_that_ros_itself_refuses_end_it_without_a_traceback(lab: Lab) -> None:
    simulator = lab.start("sim_drone", **{"my drone": 1.0})
    assert simulator.wait() == 2
    assert simulator.output.splitlines()[-1].startswith("error: Failed to parse ROS arguments: Couldn't parse")
    assert "Traceback" not in simulator.output
