"""Parameters changed in flight, through the services that `ros2 param set` uses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab

    Column = Any

V_INF = 1e-3


def test_tuning_acts_on_the_next_tick_and_a_robots_own_value_goes_over_the_common_one(lab: Lab, column: Column) -> None:
    robots = ["cf1", "cf2"]
    telemetry = {robot: lab.watch(interfaces.TELEMETRY, robot) for robot in robots}
    commands = {robot: lab.watch(interfaces.COMMAND, robot) for robot in robots}
    lab.start("sim_drone", robot_names=robots, start_positions=[0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    lab.fly(*robots, mu=0.0, v_inf=V_INF)
    for robot, y in zip(robots, (0.0, 1.0), strict=True):
        lab.go_to(robot, (6.0, y, 1.0))  # far away: V stays large

    def rates(robot: str) -> np.ndarray:
        """The adaptation rate in force at each tick: what gamma grew over h (V - V_inf)."""
        gamma, value = column(telemetry[robot], "gamma"), column(telemetry[robot], "V")
        return np.diff(gamma) / (lab.certificate.period * np.maximum(value[:-1] - V_INF, 1e-9))

    def in_force(robot: str, mu: float) -> bool:
        return len(telemetry[robot]) > 3 and bool(np.allclose(rates(robot)[-2:], mu, atol=1e-9))

    def wait_for(**expected: float) -> None:
        for robot, mu in expected.items():
            lab.wait(lambda r=robot, m=mu: in_force(r, m), f"mu = {mu} of {robot} in the telemetry")  # type: ignore[misc]

    lab.wait(lambda: all(len(commands[robot]) > 10 for robot in robots), "both drones to fly")
    wait_for(cf1=0.0, cf2=0.0)
    assert column(telemetry["cf1"], "gamma")[-1] == 1.0
    assert lab.set_parameters({"mu": 0.02}) == [(True, "")]
    wait_for(cf1=0.02, cf2=0.02)
    assert lab.set_parameters({"robots.cf1.mu": 0.04}, atomically=True) == [(True, "")]
    wait_for(cf1=0.04, cf2=0.02)
    assert lab.set_parameters({"mu": 0.01}) == [(True, "")]
    wait_for(cf1=0.04, cf2=0.01)
    assert lab.set_parameters({"v_inf": 1e6}) == [(True, "")]
    wait_for(cf1=0.0, cf2=0.0)
    # the change of a rate is seen whole at a tick, never in between
    assert set(np.round(rates("cf1"), 6)) <= {0.0, 0.02, 0.04}
    assert set(np.round(rates("cf2"), 6)) <= {0.0, 0.02, 0.01}
    for robot in robots:
        lab.require_within_limits(commands[robot])


BAD = [
    ({"mu": -1.0}, "out of range"),
    ({"mu": math.nan}, "out of range"),
    ({"mu": 1}, "DOUBLE"),
    ({"v_inf": 0.0}, "out of range"),
    ({"gamma_max": 99.0}, "gamma_max refused: gain_max = 99.0: must be at most the certificate's"),
    ({"robots.cf1.mu": -1.0}, "must be from 0 to"),
    ({"robots.cf1.mu": math.nan}, "robots.cf1.mu refused: an entry of adaptation_rate = nan: must be a finite"),
    ({"robots.cf1.mu": "fast"}, "must be a floating-point number"),
    ({"robots.cf1.v_inf": 0.0}, "must be above 0"),
    ({"robots.cf1.mu": None}, "cannot be deleted"),
    ({"robots.cf9.mu": 1.0}, "parameter robots.cf9.mu: not known here; the nearest is robots.cf1.mu"),
    ({"certificate": "paper_simulation"}, "read-only"),
    ({"robot_names": ["cf1", "cf2"]}, "read-only"),
]


def test_bad_values_are_refused_with_a_reason_and_change_nothing(lab: Lab, column: Column) -> None:
    telemetry = lab.watch(interfaces.TELEMETRY, "cf1")
    controller = lab.fly("cf1", mu=0.5)
    lab.wait(lambda: telemetry, "telemetry")
    for values, reason in BAD:
        ((accepted, why),) = lab.set_parameters(values)
        assert not accepted, values
        assert reason in why, (values, why)
    # one bad value refuses its companions
    ((accepted, why),) = lab.set_parameters({"mu": 3.0, "v_inf": -1.0}, atomically=True)
    assert not accepted
    assert "out of range" in why
    ((accepted, why),) = lab.set_parameters({"mu": 3.0, "robots.cf1.v_inf": -1.0}, atomically=True)
    assert not accepted
    assert "must be above 0" in why
    assert lab.get_parameters("mu", "v_inf", "robots.cf1.mu") == [0.5, 0.05, None]
    before = len(telemetry)
    lab.wait(lambda: len(telemetry) > before + 2, "ticks after all that")
    assert controller.stop() == 0
