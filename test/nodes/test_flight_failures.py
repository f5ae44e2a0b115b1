"""What goes wrong in flight: a drone comes late, one is lost and comes back, the controller is told to stop."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

import numpy as np

from flatsat_ros.flight.modes import Mode
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab

    Column = Any

HERE, THERE = (0.0, 0.0, 0.4), (0.0, 1.0, 0.4)


def heights(poses: list[Any]) -> np.ndarray:
    return np.array([pose.pose.position.z for pose in poses])


def test_one_drone_comes_late_is_lost_and_comes_back_and_a_stopped_controller_lands_all(
    lab: Lab, column: Column
) -> None:
    robots = ("cf1", "cf2")
    poses = {robot: lab.watch(interfaces.POSE, robot) for robot in robots}
    commands = {robot: lab.watch(interfaces.COMMAND, robot) for robot in robots}
    telemetry, idle = lab.watch(interfaces.TELEMETRY, "cf2"), lab.watch(interfaces.COMMAND, "cf3")

    def mode() -> int:
        return int(column(telemetry[-1:], "mode")[0])

    lab.start("sim_drone", robot_names=["cf1", "cf3"], start_positions=[0.0, 0.0, 0.0, 0.0, -1.0, 0.0])
    # on a busy machine the drone's poses can find their way some time before the commands find theirs
    controller = lab.fly(*robots, "cf3", unlock_time=1.0)
    lab.go_to("cf1", HERE)
    lab.go_to("cf2", THERE, linked=False)
    lab.wait_for_flight("cf1", poses["cf1"], HERE)
    assert not commands["cf2"], "no command without a pose"
    settled = len(poses["cf1"])

    # it appears late, flies and disturbs nobody
    doomed = lab.start("sim_drone", robot_names=["cf2"], start_positions=[0.0, 1.0, 0.0])
    lab.wait_for_flight("cf2", poses["cf2"], THERE)

    # its process is killed: it is given up, and flies again after a new goal
    assert doomed.stop(signal.SIGKILL) == -signal.SIGKILL
    lab.wait(lambda: mode() == Mode.LEVEL, "the level descent")
    lab.wait(lambda: mode() == Mode.CUT, "the cut")
    lab.start("sim_drone", robot_names=["cf2"], start_positions=[0.0, 1.0, 0.0])
    fresh = len(poses["cf2"])
    lab.wait(lambda: len(poses["cf2"]) > fresh + 100, "poses of the drone that came back")
    assert mode() == Mode.CUT
    assert heights(poses["cf2"][fresh:]).max() == 0.0

    # the killed process stays in the graph for a while; that it sends nothing is known after some looks
    def flies_after_a_goal() -> bool:
        lab.go_to("cf2", THERE)
        lab.listen(0.5)
        return mode() == Mode.FLY

    lab.wait(flies_after_a_goal, "a goal to be taken")
    lab.wait_for_flight("cf2", poses["cf2"], THERE)
    # soon after take-off the thrust is still being learnt
    assert np.abs(heights(poses["cf1"][settled:]) - HERE[2]).max() <= 2.0 * lab.near

    # a controller that is stopped lands its drones where they are
    lab.go_to("cf1", (0.5, 0.0, HERE[2]))
    lab.wait(lambda: poses["cf1"][-1].pose.position.x > 0.1, "the drone to be on its way")
    controller.expected = True
    controller.send(signal.SIGHUP)
    controller.send(signal.SIGTERM)  # it does not shorten the landing
    lab.wait(lambda: controller.returncode is not None, "the end of the controller")
    assert controller.returncode == 0
    moments = np.array([p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec for p in poses["cf1"]])
    fall = np.diff(heights(poses["cf1"])) / np.diff(moments)
    assert fall.min() > -1.0, "m/s: it is let down, not dropped"
    for robot in robots:
        assert poses[robot][-1].pose.position.z == 0.0
        assert commands[robot][-1].linear.z == 0.0
        lab.require_within_limits(commands[robot])
    assert "landing cf1 (z = " in controller.output
    assert not idle, "a drone that was never flown gets no last command"
    assert "Traceback" not in controller.output
