"""The life of a program: exit codes, signals, a shutdown with callbacks going on, errors that end where they happen."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.clock_type import ClockType
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Empty, Trigger

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros.runtime import ProgramNode, run, spin_once

pytestmark = pytest.mark.in_process

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PERIOD = 0.01  # s


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Handlers of the test's own, and a check that they are back afterwards."""
    own = [lambda *_: None for _ in SIGNALS]
    before = [signal.signal(number, handler) for number, handler in zip(SIGNALS, own, strict=True)]
    yield
    left = [signal.getsignal(number) for number in SIGNALS]
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)
    assert left == own


class Landing(ProgramNode):
    """A node that is sent signals, one at each tick, and whose shutdown lasts some ticks or for ever."""

    def __init__(self, signals: list[int], ticks: float = 0) -> None:
        super().__init__("landing")
        self._signals, self._left = list(signals), ticks
        self.ticks, self.life = 0, []
        self.create_timer(PERIOD, self._on_tick)

    def _on_tick(self) -> None:
        if self._signals:
            os.kill(os.getpid(), self._signals.pop(0))
        elif not self.life:
            self.done = True
        if self.life:
            self.ticks += 1

    def begin_shutdown(self) -> None:
        self.life.append("begun")

    def is_shut_down(self) -> bool:
        return self.ticks >= self._left

    def shutdown_progress(self) -> str:
        self.life.append("said")
        return "one drone is in the air"

    def finish(self) -> None:
        self.life.append("finished")


def live(make: Callable[[], Any], arguments: list[str] | None = None) -> Any:
    """Run a node to its end, which shall come with exit code 0; return it."""
    made = []

    def remember() -> ProgramNode:
        made.append(make())
        return made[0]

    assert run(remember, arguments or ["program"]) == 0
    return made[0]


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_lets_the_node_shut_down_with_its_callbacks_going_on_and_finish(number: signal.Signals) -> None:
    node = live(lambda: Landing([number], 10))
    assert node.life == ["begun", "said", "finished"]
    assert node.ticks >= 10


def test_a_node_that_is_done_shuts_down_too() -> None:
    assert live(lambda: Landing([], 3)).life == ["begun", "said", "finished"]


@pytest.mark.parametrize("first", SIGNALS)
def test_a_sigint_after_the_first_signal_ends_the_shutdown(first: signal.Signals) -> None:
    node = live(lambda: Landing([first, signal.SIGINT], float("inf")))
    assert node.life == ["begun", "said", "finished"]


@pytest.mark.parametrize("later", [signal.SIGTERM, signal.SIGHUP])
def test_no_other_signal_shortens_it(later: signal.Signals) -> None:
    node = live(lambda: Landing([signal.SIGINT, later, later], 20))
    assert node.life == ["begun", "said", "finished"]
    assert node.ticks >= 20


def test_a_shutdown_takes_bounded_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Landing, "shutdown_time_max", 0.1)
    assert live(lambda: Landing([signal.SIGTERM], float("inf"))).life == ["begun", "said", "finished"]


@pytest.mark.parametrize("method", ["begin_shutdown", "is_shut_down", "shutdown_progress"])
def test_a_shutdown_that_fails_still_finishes(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: Landing) -> None:
        raise OverflowError

    monkeypatch.setattr(Landing, method, fail)
    assert live(lambda: Landing([signal.SIGTERM], 3)).life[-1] == "finished"


def test_a_hang_up_that_is_ignored_stays_so() -> None:
    mine = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    node = live(lambda: Landing([signal.SIGHUP, signal.SIGHUP, signal.SIGTERM], 3))
    assert signal.signal(signal.SIGHUP, mine) is signal.SIG_IGN
    assert not node._signals, "it lived on after the first signal"


class Finished(ProgramNode):
    """A node with nothing to do."""

    def __init__(self) -> None:
        super().__init__("finished")
        self.done, self.exit_code = True, 7


def test_a_node_that_is_done_ends_with_its_own_code() -> None:
    assert run(Finished, []) == 7


def test_a_refusal_is_one_line_and_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    def refuse(error: Exception) -> ProgramNode:
        raise error

    assert run(lambda: refuse(FlatsatError("mu = -1.0: must be at least 0")), []) == 2
    assert run(lambda: refuse(PermissionError(13, "Permission denied", "/here")), []) == 2
    assert run(lambda: ProgramNode("1 drone"), []) == 2
    assert run(Finished, ["program", "--ros-args", "-p", "my drone:=1"]) == 2
    ours, system, name, arguments = capsys.readouterr().err.splitlines()
    assert ours == "error: mu = -1.0: must be at least 0"
    assert system == "error: /here: Permission denied"
    assert name.startswith("error: Invalid node name")
    assert arguments.startswith("error: Failed to parse ROS arguments: Couldn't parse")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["mu:=1.0"], "argument 'mu:=1.0': must stand behind --ros-args: --ros-args -p mu:=1.0"),
        (["-p", "mu:=1.0"], "argument '-p': must be --help, or --ros-args and behind it what ROS takes"),
        (["--ros-arg"], "the nearest is --ros-args"),
        (["--ros-args", "-p", "mu:=1.0", "--", "x"], "argument 'x'"),
        (
            ["--ros-args", "--parms-file", "a"],
            "ROS does not take ['--parms-file', 'a']: must be --param,",
        ),
        (["--ros-args", "--params-file", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_arguments_that_ros_would_ignore_are_refused(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(Finished, ["program", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert reason in line
    assert not re.search(r"\.[ch]:\d", line), "where in the source of ROS it was found tells a user nothing"


def test_help_says_what_it_does_and_how_parameters_are_given(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(Finished, ["/somewhere/program", "--help"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("usage: program [--ros-args [-p NAME:=VALUE")
    assert "The life of a program" in said


@contextmanager
def spinning(node: ProgramNode) -> Iterator[Callable[[Callable[[], object]], None]]:
    """How to spin a node and its clients until a condition holds."""
    executor = EventsExecutor()
    executor.add_node(node)

    def until(condition: Callable[[], object]) -> None:
        for _ in range(2000):
            if condition():
                return
            spin_once(executor, node.faults, PERIOD)
        pytest.fail("does not come")

    try:
        yield until
    finally:
        executor.shutdown()
        node.destroy_node()


@pytest.fixture
def node() -> Iterator[ProgramNode]:
    rclpy.init(args=[])
    yield ProgramNode("careful")
    rclpy.shutdown()


def test_a_callback_that_fails_ends_alone(node: ProgramNode) -> None:
    def fail(*_: object) -> None:
        raise OverflowError("too large")

    node.create_timer(PERIOD, fail)
    node.create_subscription(PoseStamped, "cf1/pose", fail, 10)
    node.create_service(Trigger, "cf1/land", fail)
    node.create_service(Empty, "cf1/emergency", fail)
    pose = node.create_publisher(PoseStamped, "cf1/pose", 10)
    land, emergency = node.create_client(Trigger, "cf1/land"), node.create_client(Empty, "cf1/emergency")
    with spinning(node) as until:
        until(lambda: pose.get_subscription_count() and land.service_is_ready() and emergency.service_is_ready())
        pose.publish(PoseStamped())
        answers = [land.call_async(Trigger.Request()), emergency.call_async(Empty.Request())]
        until(lambda: all(answer.done() for answer in answers) and node.faults.counts["cf1/pose"])
        counts = node.faults.counts
        assert (counts["cf1/pose"], counts["cf1/land"], counts["cf1/emergency"]) == (1, 1, 1)
        ticks = counts["timer of 0.01 s"]
        until(lambda: counts["timer of 0.01 s"] > ticks + 1)
    refused = answers[0].result()
    assert not refused.success
    assert refused.message == "failed by an error of the program: see the log"


def test_what_ros_itself_raises_does_not_end_the_node(node: ProgramNode) -> None:
    garbage = SetParameters.Request(parameters=[ParameterMessage(name="mu", value=ParameterValue(type=77))])
    client = node.create_client(SetParameters, "careful/set_parameters")
    with spinning(node) as until:
        until(client.service_is_ready)
        answer = client.call_async(garbage)
        until(answer.done)
    assert node.faults.counts == {"careful/set_parameters": 1}


def test_what_a_future_calls_when_it_is_done_ends_alone(node: ProgramNode) -> None:
    """An exception that reached rclpy's executor from there would crash the process."""
    node.create_service(Trigger, "answer", lambda _, answer: answer)
    client = node.create_client(Trigger, "answer")

    def fail(_: object) -> None:
        raise OverflowError

    with spinning(node) as until:
        until(client.service_is_ready)
        client.call_async(Trigger.Request()).add_done_callback(node.faults.contained("asked", fail))
        until(lambda: node.faults.counts["asked"])
        until(client.call_async(Trigger.Request()).done)


def test_timers_stand_on_a_clock_that_nobody_sets(node: ProgramNode) -> None:
    timer = node.create_timer(PERIOD, lambda: None)
    assert timer.clock.clock_type is ClockType.STEADY_TIME


def test_it_starts_with_the_time_of_a_simulation() -> None:
    assert live(lambda: Landing([signal.SIGTERM]), ["program", "--ros-args", "-p", "use_sim_time:=true"]).life


def test_the_source_of_time_cannot_change(node: ProgramNode) -> None:
    (same, other) = node.set_parameters([Parameter("use_sim_time", value=value) for value in (False, True)])
    assert same.successful
    assert not other.successful
    assert other.reason == "use_sim_time = True: cannot change while the node runs; give it at the start"
    assert not node.get_clock().ros_time_is_active
    assert node.get_parameter("use_sim_time").value is False
