"""The choreography on a clock of the tests' own, and what a live stage makes of the controller's answers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from flatsat_ros.base.arrays import FloatArray
from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.demo import live
from flatsat_ros.demo.choreography import LANDING_LATEST, LATE, Stage, perform
from flatsat_ros.demo.scenario import Scenario, plan
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.trajectory import Trajectory


class Rehearsal(Stage):
    """A stage without drones, on a clock that each step moves on.

    Attributes:
        told: what the drones were told so far, and when, s.
    """

    def __init__(self, period: float = 0.1, gathered: float = 0.0, silent: float = 0.0) -> None:
        """Let drones arrive at their first way-points, and fall silent after landing, after such times, s."""
        super().__init__()
        self.told: list[tuple[str, float]] = []
        self._period, self._steps = period, 0
        self._gathered, self._silent = gathered, silent

    def now(self) -> float:
        return self._steps * self._period

    def step(self) -> None:
        self._steps += 1

    def arm(self) -> None:
        self.told.append(("arm", self.now()))

    def take_off(self) -> None:
        self.told.append(("take off", self.now()))

    def send_goals(self, places: FloatArray) -> None:
        self.told.append(("gather", self.now()))

    def send_trajectories(self, trajectories: Sequence[Trajectory], lead: float) -> float:
        self.told.append(("swap", self.now()))
        return self.now() + lead

    def land(self) -> None:
        self.told.append(("land", self.now()))

    def away(self, places: FloatArray, distance: float) -> list[str]:
        return [] if self.now() >= self._gathered else ["cf2"]

    def in_use(self) -> list[str]:
        return [] if self.now() >= self.told[-1][1] + self._silent else ["cf3"]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return plan(tmp_path_factory.mktemp("scenario"), paper=True)


@pytest.mark.parametrize("period", [0.1, 0.02, 0.3])
def test_everything_is_told_in_turn_and_in_time(period: float, scenario: Scenario) -> None:
    stage = Rehearsal(period)
    start = perform(scenario, stage)
    assert [what for what, _ in stage.told] == ["arm", "take off", "gather", "swap", "land"]
    times = [when for _, when in stage.told]
    for (before, after), gap in zip(pairwise(times), (1.0, 3.0, 2.5, 12.5), strict=True):
        assert gap - 1e-6 <= after - before <= gap + 2.0 * period
    assert start == times[3] + 0.5
    assert times[4] > start + scenario.duration - 1e-6
    assert stage.now() == times[4]


def test_the_swap_waits_for_drones_that_are_late(scenario: Scenario) -> None:
    assert perform(scenario, Rehearsal(gathered=9.0)) == pytest.approx(9.5)


def test_in_tubes_the_swap_begins_where_the_reference_rests(scenario: Scenario) -> None:
    assert perform(replace(scenario, paper=False), Rehearsal()) == pytest.approx(6.0 + 1.0 + 1.5)


def test_drones_that_do_not_gather_are_named(scenario: Scenario) -> None:
    with pytest.raises(FlatsatError, match=r"not within 0\.15 m of the first way-point, 20 s late: cf2"):
        perform(scenario, Rehearsal(gathered=6.6 + LATE))


def test_a_drone_that_does_not_land_is_not_waited_for_for_ever(scenario: Scenario) -> None:
    stage = Rehearsal(silent=1e9)
    perform(scenario, stage)
    assert stage.now() == pytest.approx(stage.told[-1][1] + LANDING_LATEST)


class Answer:
    """A controller's answer that is there."""

    def __init__(self, message: str) -> None:
        self.message = message

    def done(self) -> bool:
        return True


class Conductor:
    """Stands for the one that asks: gives the controller's answers in turn and notes who was asked for what."""

    def __init__(self, *answers: str, standing: tuple[str, ...] = ()) -> None:
        self.asked: list[tuple[str, ...]] = []
        self._answers = list(answers)
        self._standing = list(standing)

    def ask(self, *request: str) -> Answer:
        self.asked.append(request)
        return Answer(self._answers.pop(0))

    def refusal(self, answer: Answer) -> str:
        """An answer that begins with ok is none."""
        return "" if answer.message.startswith("ok") else answer.message

    def robots_in(self, *modes: Mode) -> list[str]:
        assert modes == (Mode.IDLE, Mode.UNLOCK)
        return self._standing

    def spin(self, seconds: float) -> None:
        time.sleep(seconds)

    def missing(self) -> list[str]:
        return [f"cf{k}/pose" for k in range(1, 41)]


def test_of_many_nodes_that_are_missing_a_few_are_named_and_the_others_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_DISCOVERY", 0.1)
    with pytest.raises(FlatsatError, match=r"after 0\.1 s: cf1/pose, cf2/pose, .*cf6/pose and 34 more$"):
        live.Live(Conductor(), {}, Path()).wait_for_nodes()


def test_only_drones_that_still_stand_are_asked_to_take_off_again() -> None:
    conductor = Conductor("cf2: no pose", "cf2: no pose", "ok", standing=("cf2",))
    live.Live(conductor, {}, Path()).take_off()
    assert conductor.asked == [("takeoff",), ("takeoff", "cf2"), ("takeoff", "cf2")]


def test_a_take_off_that_stays_refused_is_an_error_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_READY", 0.0)
    with pytest.raises(FlatsatError, match="cf2: takeoff refused: no pose"):
        live.Live(Conductor("cf2: takeoff refused: no pose"), {}, Path()).take_off()


def test_what_was_granted_may_come_with_a_remark() -> None:
    conductor = Conductor("ok, asked to arm")
    live.Live(conductor, {}, Path()).arm()
    assert conductor.asked == [("arm",)]


def test_a_refused_landing_is_an_error_with_the_reason() -> None:
    with pytest.raises(FlatsatError, match="cf1: land refused: the drone is in CUT"):
        live.Live(Conductor("cf1: land refused: the drone is in CUT"), {}, Path()).land()
