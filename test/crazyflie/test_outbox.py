"""What a drone is sent, packet by packet on a clock of the test's own: order, emergency stop, and how it is left."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.crazyflie.link import REST, ZERO_TIME, PacketQueue, ShutdownSequence
from flatsat_ros.crazyflie.outbox import EMERGENCY_END, EMERGENCY_PERIOD, NOTICES, Outbox, Stream
from flatsat_ros.crazyflie.wire import WireSetpoint, YawMode

PERIOD = 0.01  # s, between two set-points
STEP = 0.001  # s
FLYING = WireSetpoint(1.0, 2.0, 30.0, 40000.0)
LANDING = ShutdownSequence(descent=1.0, thrust=36000.0, yaw_mode=YawMode.ANGLE)
DESCENT = REST._replace(thrust=36000.0, yaw=FLYING.yaw)


class Radio:
    """Notes what is sent, and when.

    Attributes:
        sent: (time s, what) in order.
        now: s.
    """

    def __init__(self) -> None:
        self.sent: list[tuple[float, Any]] = []
        self.now = 0.0

    def _note(self, what: Any) -> None:
        self.sent.append((self.now, what))

    def setpoint(self, setpoint: WireSetpoint) -> None:
        self._note(setpoint)

    def external_pose(self, position: tuple[float, ...], quaternion: tuple[float, ...] | None) -> None:
        self._note((position, quaternion))

    def arming(self, armed: bool) -> None:
        self._note(f"arm {armed}")

    def emergency_stop(self) -> None:
        self._note("stop")

    def no_more_setpoints(self) -> None:
        self._note("end")

    def said(self) -> list[Any]:
        """What was sent, each repetition left out."""
        words = [what for _, what in self.sent]
        return [word for index, word in enumerate(words) if index == 0 or words[index - 1] != word]


class Bench:
    """An outbox and its radio; time passes when it is told to."""

    def __init__(self, shutdown: ShutdownSequence = LANDING) -> None:
        self.radio = Radio()
        self.outbox = Outbox("cf1", PacketQueue(2, period=PERIOD, gap=0.0), shutdown)

    def let_pass(self, seconds: float, command: WireSetpoint | None = None) -> bool:
        """Go on, perhaps with a set-point at every step; tell whether the outbox still has something to send."""
        goes_on = True
        for _ in range(round(seconds / STEP)):
            if command is not None:
                self.outbox.command(command, self.radio.now)
            goes_on = goes_on and self.outbox.send(self.radio, self.radio.now)
            self.radio.now += STEP
        return goes_on

    def time_of(self, what: Any) -> tuple[float, float]:
        """When something was sent first and last, s."""
        times = [time for time, word in self.radio.sent if word == what]
        return times[0], times[-1]


def test_the_newest_set_point_goes_out_once_and_silence_stays_silence() -> None:
    bench = Bench()
    bench.outbox.command(FLYING, 0.0)
    bench.outbox.command(FLYING._replace(thrust=1.0), 0.0)
    bench.let_pass(1.0)
    assert bench.radio.said() == [FLYING._replace(thrust=1.0)]
    assert bench.outbox.sent[Stream.SETPOINT] == len(bench.radio.sent) == 1
    assert bench.outbox.overtaken == 1


def test_a_link_pulls_the_newest_and_sends_again_what_got_lost_until_all_is_over() -> None:
    bench = Bench()
    bench.outbox.pulled = True
    bench.let_pass(0.1, FLYING)
    assert bench.outbox.wait(bench.radio.now) == math.inf
    assert bench.radio.sent == []
    assert bench.outbox.pull(bench.radio, bench.radio.now)
    bench.outbox.lose()
    assert bench.outbox.pull(bench.radio, bench.radio.now)
    assert not bench.outbox.pull(bench.radio, bench.radio.now)
    bench.outbox.lose()
    bench.outbox.command(REST, bench.radio.now)
    assert bench.outbox.pull(bench.radio, bench.radio.now)
    assert [what for _, what in bench.radio.sent] == [FLYING, FLYING, REST]
    bench.outbox.leave()
    assert not bench.let_pass(ZERO_TIME + 0.1)
    assert not bench.outbox.pull(bench.radio, bench.radio.now), "after the notice no set-point follows"
    assert bench.radio.said() == [FLYING, REST, "end"]


def test_nothing_is_pulled_after_an_emergency_stop() -> None:
    bench = Bench()
    bench.outbox.pulled = True
    bench.let_pass(0.1, FLYING)
    bench.outbox.stop_motors()
    assert not bench.outbox.pull(bench.radio, bench.radio.now)


def test_requests_go_first_and_are_forgotten_with_the_connection() -> None:
    bench = Bench()
    bench.outbox.arm(False)
    bench.outbox.forget_requests()
    bench.outbox.locate((1.0, 2.0, 3.0), None, 0.0)
    bench.outbox.locate((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0), 0.0)
    bench.outbox.arm(True)
    bench.let_pass(0.1)
    assert bench.radio.said() == ["arm True", ((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))]


def test_a_drone_that_was_never_flown_is_left_alone() -> None:
    bench = Bench()
    bench.outbox.leave()
    assert not bench.let_pass(STEP)
    assert bench.radio.sent == []


@given(flown=st.floats(0.1, 1.0))
def test_a_flying_drone_descends_rests_and_hears_that_no_set_point_follows(flown: float) -> None:
    bench = Bench()
    bench.let_pass(flown, FLYING)
    left = bench.radio.now
    bench.outbox.leave()
    assert not bench.let_pass(LANDING.descent + ZERO_TIME + 0.1, FLYING), "commands come in and none goes out"
    assert bench.radio.said() == [FLYING, DESCENT, REST, "end"]
    assert bench.time_of(REST)[0] == pytest.approx(left + LANDING.descent, abs=2 * PERIOD)
    assert bench.time_of("end")[0] >= left + LANDING.descent + ZERO_TIME - STEP
    assert [what for _, what in bench.radio.sent].count("end") == NOTICES


@pytest.mark.parametrize(("last", "silence"), [(REST, 0.1), (FLYING, 2.1)])
def test_a_drone_whose_motors_rest_gets_no_thrust_any_more(last: WireSetpoint, silence: float) -> None:
    bench = Bench()
    bench.let_pass(0.1, FLYING)
    bench.let_pass(0.1, last)
    bench.let_pass(silence)
    before = len(bench.radio.sent)
    bench.outbox.leave()
    assert not bench.let_pass(ZERO_TIME + 0.1)
    assert {what for _, what in bench.radio.sent[before:]} == {REST, "end"}


def test_an_emergency_stop_is_repeated_for_ever_and_nothing_else_is_sent() -> None:
    bench = Bench()
    bench.let_pass(0.1, FLYING)
    before = len(bench.radio.sent)
    bench.outbox.stop_motors()
    bench.outbox.arm(True)
    assert bench.let_pass(2.0, FLYING)
    stops = bench.radio.sent[before:]
    assert {what for _, what in stops} == {"stop"}
    assert len(stops) == pytest.approx(2.0 / EMERGENCY_PERIOD, abs=2)


@pytest.mark.parametrize("begun", [0.0, 0.5])
def test_an_emergency_stop_works_during_the_shutdown_and_ends_soon_after(begun: float) -> None:
    bench = Bench()
    bench.let_pass(0.1, FLYING)
    bench.outbox.leave()
    bench.let_pass(begun)
    before, stopped = len(bench.radio.sent), bench.radio.now
    bench.outbox.stop_motors()
    assert not bench.let_pass(EMERGENCY_END + 0.1)
    stops = bench.radio.sent[before:]
    assert {what for _, what in stops} == {"stop"}
    assert len(stops) >= EMERGENCY_END / EMERGENCY_PERIOD, "one alone may be lost"
    assert bench.time_of("stop")[1] <= stopped + EMERGENCY_END + STEP
