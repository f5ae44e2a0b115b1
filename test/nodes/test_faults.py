"""Exceptions end where they happen: counted, told once in a while, with a traceback where the program is at fault."""

from __future__ import annotations

from typing import Any

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros.faults import Faults

pytestmark = pytest.mark.in_process


class Log:
    """Keeps what is told."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def error(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture
def log() -> Any:
    return Log()


def refuse(faults: Faults, name: str, reason: str = "x = 1: must be 2") -> None:
    with faults.contain(name):
        raise FlatsatError(reason)


def test_what_fails_inside_does_not_reach_what_stands_around(log: Any) -> None:
    faults = Faults(log)
    with faults.contain("cf1/goal_pose"):
        raise OverflowError("too large")
    with faults.contain("cf1/goal_pose"):
        reached = True
    assert reached
    assert faults.counts == {"cf1/goal_pose": 1}
    (said,) = log.lines
    assert said.startswith("cf1/goal_pose failed: OverflowError: too large\n")
    assert "Traceback" in said
    assert "test_faults.py" in said


def test_a_refusal_is_one_line(log: Any) -> None:
    faults = Faults(log)
    refuse(faults, "cf1/pose", "x =\n1: must be 2")
    assert log.lines == ["cf1/pose: x = 1: must be 2"]


def test_an_interrupt_is_not_taken(log: Any) -> None:
    with pytest.raises(KeyboardInterrupt), Faults(log).contain("tick"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(("error", "silence"), [(FlatsatError("x"), 1), (OverflowError("x"), 10)])
def test_the_same_fault_is_told_again_after_a_while_with_its_number(log: Any, error: Exception, silence: int) -> None:
    now = [0.0]
    faults = Faults(log, lambda: now[0])
    for tenth in range(10 * silence + 1):
        now[0] = tenth / 10.0
        with faults.contain("cf1/pose"):
            raise error
    first, again = log.lines
    assert "times" not in first
    assert f"({10 * silence} times)" in again


def test_one_name_does_not_silence_another(log: Any) -> None:
    faults = Faults(log, lambda: 0.0)
    for name in ("cf1/pose", "cf2/pose", "cf1/goal_pose", "cf10/pose", "cf1/pose"):
        refuse(faults, name)
    assert len(log.lines) == 4
    assert [faults.count(robot) for robot in ("cf1", "cf2", "cf")] == [3, 1, 0]
    assert faults.newest("cf1") == "cf1/pose: x = 1: must be 2"
    assert faults.newest("cf") == ""


def test_what_is_told_is_bounded(log: Any) -> None:
    def recurse() -> None:
        recurse()

    faults = Faults(log)
    with faults.contain("deep"):
        recurse()
    with faults.contain("long"):
        raise ValueError("x" * 1_000_000)
    assert all(len(line) < 6000 for line in log.lines)
