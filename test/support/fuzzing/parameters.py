"""Files of parameters: a controller that starts with one commands what is finite, or it is refused in one line."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
from hypothesis import strategies as st

from flatsat_ros.nodes.controller_node import ControllerNode
from flatsat_ros.nodes.ros.runtime import run
from fuzzing.damage import NUMBERS, damaged
from fuzzing.kind import Attempt, Kind, rewrite
from fuzzing.nodes import arguments, own_context

EXAMPLE = """
/**:
  ros__parameters:
    robot_names: [cf1, cf2]
    certificate: cf21_50hz
    vehicle: cf21
    backend: cpp
    yaw_mode: rate
    goal_mode: path
    pose_timeout: 0.2
    speed_max: 1.0
    floor: 0.0
    ceiling: 3.0
    walls: [-5.0, -5.0, 5.0, 5.0]
    disturbance_max: 0.8
    thrust_error_max: 0.25
    takeoff_height: 0.5
    mu: 2.0
    v_inf: 0.05
    gamma_0: 1.0
    gamma_max: 2.0
    nu: 0.1
    restart_gain: true
    robots:
      cf1: {mu: 1.0, gamma_max: 3.0, vehicle: cf21}
"""
_NAMES = [line.partition(":")[0].strip() for line in EXAMPLE.splitlines()[7:-3]]


@st.composite
def _one_value(draw: st.DrawFn) -> bytes:
    """One or two parameters of another value."""
    values = {draw(st.sampled_from(_NAMES)): draw(st.sampled_from(NUMBERS)) for _ in range(draw(st.integers(1, 2)))}
    lines = [f"    {name}: {value}" for name, value in values.items()]
    return "\n".join(["/**:", "  ros__parameters:", "    robot_names: [cf1, cf2]", *lines, ""]).encode()


class _Brief(ControllerNode):
    """A controller that ends after two ticks in which its drones have poses."""

    def __init__(self) -> None:
        super().__init__()
        pilot, period = self._pilot, self._certificate.period
        self.last_resort, self.done = self._commands.last_resort, True
        for number in range(8):
            now = period * number
            for index in range(len(self.robots)):
                place = (float(index), 1e-5 * number, 0.0)
                pilot.measure(index, now, place, (0.0, 0.0, 0.0, 1.0), now)
            tick = pilot.tick(now)
            assert np.isfinite(tick.input).all()
            assert (tick.input[:, 0] <= self._certificate.limits.thrust_max * (1.0 + 1e-9)).all()
            if number == 3:
                with contextlib.suppress(ValueError):
                    pilot.set_goal(0, (0.0, 0.0, float(pilot.height[0]) + 0.5))
        self._pilot.retire()

    def is_shut_down(self) -> bool:
        return True


@contextmanager
def _open(folder: Path) -> Iterator[Attempt]:
    file = folder / "parameters.yaml"

    def attempt(data: bytes) -> bool:
        rewrite(file, data)
        said: list[str] = []
        with own_context(), mock.patch("flatsat_ros.nodes.ros.runtime._refuse", side_effect=said.append):
            code = run(
                _Brief, [*arguments("controller", "parameters"), "--log-level", "FATAL", "--params-file", str(file)]
            )
        if code == 0:
            return True
        (reason,) = said
        assert reason.isprintable(), reason
        assert 0 < len(reason) < 1000, reason
        return False

    yield attempt


PARAMETERS = Kind(st.one_of(damaged(EXAMPLE), _one_value()), _open)
