"""What the controller asks of a drone's link, with a stand-in for crazyswarm2's server: order, types, taking back."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from std_srvs.srv import SetBool

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes import crazyswarm
from flatsat_ros.nodes.crazyswarm import DroneLink
from flatsat_ros.nodes.ros.faults import Faults

pytestmark = pytest.mark.in_process

OFFERED = {
    "/cf1/arm": ["crazyflie_interfaces/srv/Arm"],
    "/cf1/notify_setpoints_stop": ["crazyflie_interfaces/srv/NotifySetpointsStop"],
    "/cf1/go_to": ["crazyflie_interfaces/srv/GoTo"],
    "/cf1/takeoff": ["crazyflie_interfaces/srv/Takeoff"],
}


class Answered:
    """The future of a request that is answered when the test says so."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer
        self._callbacks: list[Callable[[Any], None]] = []

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        self._callbacks.append(callback)

    def result(self) -> Any:
        return self._answer

    def arrive(self) -> None:
        for callback in self._callbacks:
            callback(self)


class Client:
    """A client that is always ready and notes what is asked for."""

    def __init__(self, node: Node, kind: Any, name: str) -> None:
        self._node, self.srv_type, self.service_name = node, kind, f"/{name}"

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, request: Any) -> Answered:
        self._node.asked.append((self.service_name, request))
        self._node.pending.append(Answered(self._node.answer))
        return self._node.pending[-1]


class Node:
    """As much of a node as a link needs."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.pending: list[Answered] = []
        self.timers: list[Callable[[], None]] = []
        self.said: list[str] = []
        self.answer: Any = SimpleNamespace()
        self.faults = Faults(self.get_logger())

    def resolve_service_name(self, name: str) -> str:
        return f"/{name}"

    def create_client(self, kind: Any, name: str) -> Client:
        return Client(self, kind, name)

    def create_timer(self, _period: float, callback: Callable[[], None]) -> Any:
        self.timers.append(callback)
        return SimpleNamespace(cancel=lambda: None)

    def destroy_timer(self, _timer: Any) -> None:
        pass

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.said.append, error=self.said.append)

    def let_pass(self) -> None:
        """Let the timers end and every answer arrive."""
        while self.timers or self.pending:
            timers, self.timers = self.timers, []
            for timer in timers:
                timer()
            pending, self.pending = self.pending, []
            for answer in pending:
                answer.arrive()


def kind(name: str, **fields: Any) -> Any:
    """A service type with a request of these fields."""

    def request(**values: Any) -> Any:
        assert set(values) <= set(fields)
        return SimpleNamespace(**{**fields, **values})

    return SimpleNamespace(Request=request, name=name)


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Node:
    """A node in an installation that has crazyflie_interfaces."""
    kinds = SimpleNamespace(
        Arm=kind("Arm", arm=False),
        NotifySetpointsStop=kind("NotifySetpointsStop", group_mask=0, remain_valid_millisecs=0),
        GoTo=kind("GoTo", relative=False, duration=SimpleNamespace(sec=0, nanosec=0)),
    )
    monkeypatch.setattr(crazyswarm, "services", lambda: kinds)
    return Node()


def link(node: Node, offered: dict[str, list[str]] | None = None) -> DroneLink:
    made = DroneLink(node, "cf1")
    made.find_services(OFFERED if offered is None else offered)
    return made


def names(node: Node) -> list[str]:
    return [name for name, _ in node.asked]


@pytest.mark.parametrize("wanted", [True, False])
def test_arming_goes_to_whoever_offers_it_in_its_own_type(node: Node, wanted: bool) -> None:
    link(node).arm(wanted)
    link(node, {"/cf1/arm": ["std_srvs/srv/SetBool"]}).arm(wanted)
    (_, crazyswarms), (_, ours) = node.asked
    assert crazyswarms.arm is wanted
    assert ours == SetBool.Request(data=wanted)


def test_a_refusal_to_arm_is_said_and_an_empty_answer_is_none(node: Node) -> None:
    node.answer = SimpleNamespace(success=False, message="arming refused in state CRASHED")
    link(node, {"/cf1/arm": ["std_srvs/srv/SetBool"]}).arm(True)
    node.let_pass()
    assert node.said == ["cf1: arming refused in state CRASHED"]
    node.answer = SimpleNamespace(success=False, message="cf1: arming refused in state LOCKED")
    link(node, {"/cf1/arm": ["std_srvs/srv/SetBool"]}).arm(True)
    node.let_pass()
    assert node.said.pop() == "cf1: arming refused in state LOCKED"
    node.answer = SimpleNamespace()
    link(node).arm(True)
    node.let_pass()
    assert len(node.said) == 1


def test_without_the_interfaces_crazyswarm2s_services_are_left_alone(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crazyswarm, "services", lambda: None)
    alone = link(node)
    assert alone.arm(True) == (
        "cf1: the drone itself was not asked: no service cf1/arm of a type that is installed here, "
        "only crazyflie_interfaces/srv/Arm"
    )
    alone.release(in_flight=True)
    node.let_pass()
    assert node.asked == []


def test_in_flight_the_notice_comes_first_and_its_answer_lets_the_go_to_follow(node: Node) -> None:
    link(node).release(in_flight=True)
    assert node.asked == [], "the last set-point may still be under way"
    node.timers.pop()()
    assert names(node) == ["/cf1/notify_setpoints_stop"]
    node.let_pass()
    assert names(node) == ["/cf1/notify_setpoints_stop", "/cf1/go_to"]
    request = node.asked[-1][1]
    assert request.relative
    assert request.duration.sec == 1


def test_on_the_ground_the_notice_is_all(node: Node) -> None:
    link(node).release(in_flight=False)
    node.let_pass()
    assert names(node) == ["/cf1/notify_setpoints_stop"]


def test_in_flight_nothing_is_said_without_a_go_to(node: Node) -> None:
    without = {name: kinds for name, kinds in OFFERED.items() if name != "/cf1/go_to"}
    link(node, without).release(in_flight=True)
    node.let_pass()
    assert node.asked == [], "the notice alone would cut the motors"


@pytest.mark.parametrize("told", [False, True])
def test_a_drone_taken_back_hears_nothing_more(node: Node, told: bool) -> None:
    flown = link(node)
    flown.release(in_flight=True)
    if told:
        node.timers.pop()()
    before = len(node.asked)
    flown.reclaim()
    node.let_pass()
    assert len(node.asked) == before


def test_an_answer_that_cannot_be_read_is_said_and_ends_there(node: Node) -> None:
    node.answer = SimpleNamespace(success=False)  # lacks its message
    link(node).arm(True)
    node.let_pass()
    assert node.faults.counts == {"/cf1/arm": 1}
    assert "AttributeError" in node.said[0]


def test_nobody_to_take_over_is_said_beforehand(node: Node) -> None:
    link(node).require_successor()
    without = {name: kinds for name, kinds in OFFERED.items() if not name.endswith("go_to")}
    with pytest.raises(FlatsatError, match=r"nobody is there to take over: there is no service cf1/go_to; if you"):
        link(node, without).require_successor()
