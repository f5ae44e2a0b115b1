"""A flight: the controller and the simulated drones as processes of their own, over real DDS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.nodes.ros import interfaces, messages
from flatsat_ros.sim.firmware import SHUTDOWN_AGE
from flatsat_ros.sim.state_machine import State

if TYPE_CHECKING:
    from conftest import Lab

    Column = Any

SILENCE = SHUTDOWN_AGE / 1000.0 + 1.0  # reports, one a second, until the watchdogs have run out
STOPPED = {State.FREE_FALL.name, State.LOCKED.name, State.CRASHED.name}


def stamped(poses: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (s) and positions (M, 3), m, of poses."""
    stamps = [messages.nanoseconds_from_stamp(pose.header.stamp) / messages.NANOSECONDS for pose in poses]
    return np.array(stamps), np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in poses])


def test_test_1_of_the_paper_is_flown_from_the_floor_to_the_floor(lab: Lab, column: Column) -> None:
    rates = {"cf1": 1.0, "cf2": 2.0}  # mu, 1/s
    starts = np.array([[-0.6, -0.6, 0.0], [-0.6, 1.4, 0.0]])
    goals = starts + (1.2, 1.2, 0.8)
    poses, commands, telemetry = (
        {robot: lab.watch(topic, robot) for robot in rates}
        for topic in (interfaces.POSE, interfaces.COMMAND, interfaces.TELEMETRY)
    )
    drones = {robot: lab.watch_diagnostics(f"sim_drone: {robot}") for robot in rates}
    # the paper's law knows of no delay: on a link that has one the gain grows until the drones sway by 7 cm
    lab.start("sim_drone", robot_names=list(rates), start_positions=starts.ravel().tolist(), command_delay=0.0)
    # the goals come while the thrust locks open, so that the law begins with the error of the paper
    lab.fly(
        *rates, robots__cf1__mu=rates["cf1"], mu=rates["cf2"], unlock_time=4.0, goal_mode="step", thrust_error_max=0.0
    )
    lab.wait(lambda: all(poses[robot] and telemetry[robot] for robot in rates), "poses and telemetry")
    assert not any(commands.values()), "a controller without a goal must leave the drones to whoever flies them"
    lab.take_off(*rates)
    for robot, goal in zip(rates, goals, strict=True):
        lab.go_to(robot, goal)
    for robot, goal in zip(rates, goals, strict=True):
        lab.wait_for_flight(robot, poses[robot], goal)
    for robot, mu in rates.items():
        lab.require_within_limits(commands[robot])
        assert commands[robot][0].linear.z == 0.0, "the thrust lock opens on zero thrust"
        assert list(dict.fromkeys(column(telemetry[robot], "mode")))[:3] == [Mode.IDLE, Mode.UNLOCK, Mode.FLY]
        # far from the goal the law is at its limits, and the gain grows as long as V is above V_inf
        flown = [message for message in telemetry[robot] if message.data[FIELDS.index("mode")] == Mode.FLY]
        gamma, k, value = (column(flown, field) for field in ("gamma", "k", "V"))
        assert value[0] == pytest.approx(3.4375, rel=0.05)  # the paper's V(0)
        assert k[0] == pytest.approx(gamma[0])
        assert (k <= gamma).all()
        assert (np.diff(gamma) >= 0.0).all()
        growth = lab.certificate.period * mu * np.maximum(value - 0.05, 0.0)
        assert np.diff(gamma) == pytest.approx(growth[:-1], abs=1e-9)
        assert value[-1] < 0.05
    lab.land(*rates)
    rested = {robot: len(drones[robot]) for robot in rates}
    for robot, goal in zip(rates, goals, strict=True):
        assert stamped(poses[robot][-1:])[1][0] == pytest.approx((*goal[:2], 0.0), abs=lab.near)
        assert poses[robot][-1].pose.position.z < 0.02
        # nor does the firmware lock the drone in the silence that follows
        lab.wait(lambda seen=drones[robot], since=rested[robot]: len(seen) > since + SILENCE, f"reports about {robot}")
        reports = [{pair.key: pair.value for pair in status.values} for status in drones[robot][rested[robot] :]]
        assert not STOPPED & {report["state"] for report in reports}
        assert (reports[-1]["on the floor"], reports[-1]["thrust locked"]) == ("True", "False")
        lab.require_within_limits(commands[robot])
