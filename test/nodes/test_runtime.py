"""The life of a program: exit codes, and signal handlers that are put back."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.ros.runtime import ProgramNode, run

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture
def handlers() -> Iterator[list[object]]:
    """Handlers of the test's own, and a check that they are back afterwards."""
    own = [lambda *_: None, lambda *_: None]
    before = [signal.signal(number, handler) for number, handler in zip(SIGNALS, own, strict=True)]
    yield own
    assert [signal.getsignal(number) for number in SIGNALS] == own
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)


class Signalled(ProgramNode):
    """A node that its process is told to end, and once more while it finishes."""

    def __init__(self) -> None:
        super().__init__("signalled")
        self.finished = False
        self.create_timer(0.01, lambda: os.kill(os.getpid(), signal.SIGINT))

    def finish(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        self.finished = True


class Finished(ProgramNode):
    """A node with nothing to do."""

    def __init__(self) -> None:
        super().__init__("finished")
        self.done, self.exit_code = True, 7


@pytest.mark.usefixtures("handlers")
def test_a_signal_ends_it_and_a_second_one_does_not_keep_it_from_finishing() -> None:
    made: list[Signalled] = []

    def make() -> Signalled:
        made.append(Signalled())
        return made[-1]

    assert run(make, []) == 0
    assert made[0].finished


@pytest.mark.usefixtures("handlers")
def test_a_node_that_is_done_ends_with_its_own_code() -> None:
    assert run(Finished, []) == 7


@pytest.mark.usefixtures("handlers")
def test_a_refusal_is_one_line_and_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    def refuse(error: Exception) -> ProgramNode:
        raise error

    assert run(lambda: refuse(FlatsatError("mu = -1.0: must be at least 0")), []) == 2
    assert run(lambda: refuse(PermissionError(13, "Permission denied", "/here")), []) == 2
    assert run(lambda: ProgramNode("1 drone"), []) == 2
    assert run(Finished, ["program", "--ros-args", "-p", "my drone:=1"]) == 2
    ours, system, name, arguments = capsys.readouterr().err.splitlines()
    assert ours == "error: mu = -1.0: must be at least 0"
    assert system == "error: [Errno 13] Permission denied: '/here'"
    assert name.startswith("error: Invalid node name")
    assert arguments.startswith("error: failed to initialize rcl: Couldn't parse")
