"""Who sends is heard from the numbers of the messages: laws, with numbers as two publishers give them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.nodes import rivals
from flatsat_ros.nodes.pose_sources import Source
from flatsat_ros.nodes.rivals import _HOLD, Ear, Heard, Rivals

pytestmark = pytest.mark.in_process


class Queue:
    """Takes the place of a subscription: hands out what has come.

    Attributes:
        numbers: of the messages.
        matched: publishers that are connected.
        data: of every message: the robots that it tells of.
    """

    msg_type = object

    def __init__(self, matched: int = 2) -> None:
        self.numbers: list[int | None] = []
        self.matched = matched
        self.data = b""
        self.handle = SimpleNamespace(take_message=self._take)

    def get_publisher_count(self) -> int:
        return self.matched

    def _take(self, _: Any, raw: bool) -> tuple[bytes, dict[str, int | None]] | None:
        assert raw
        return (self.data, {"publication_sequence_number": self.numbers.pop(0)}) if self.numbers else None


def ear_of(queue: Queue) -> Ear:
    return Ear(queue, 0.0, lambda data: data.decode().split())


def heard(ear: Ear, now: float, *numbers: int | None, silent: bool = False, about: str = "cf1") -> Heard:
    ear.subscription.numbers += numbers
    ear.subscription.data = about.encode()
    return ear.listen(now, 2, "cf1", silent=silent)


@given(st.lists(st.integers(1, 10**6), unique=True).map(sorted), st.integers(1, 5))
def test_one_sender_is_one_whatever_it_loses(numbers: list[int], looks: int) -> None:
    ear = ear_of(Queue())
    for look in range(looks):
        part = numbers[look * len(numbers) // looks : (look + 1) * len(numbers) // looks]
        assert heard(ear, 0.1 * look, *part) is Heard.UNKNOWN
    assert heard(ear, _HOLD) is Heard.ONE


@given(
    st.integers(1, 10**6),
    st.integers(1, 10**6),
    st.lists(st.booleans(), max_size=30),
    st.integers(0, 33),
    st.booleans(),
)
def test_two_senders_are_two_as_soon_as_one_sends_before_and_after_the_other(
    first: int, second: int, order: list[bool], cut: int, mirrored: bool
) -> None:
    """Each numbers its own messages one by one, from wherever it is; a look may fall between any two of them."""
    following = {False: first, True: second}
    numbers = []
    for sender in (*order, mirrored, not mirrored, mirrored):
        numbers.append(following[sender])
        following[sender] += 1
    ear = ear_of(Queue())
    heard(ear, 1.0, *numbers[:cut])
    assert heard(ear, 1.0 + 0.9 * _HOLD, *numbers[cut:]) is Heard.SEVERAL
    assert heard(ear, 1.0 + 2.0 * _HOLD) is Heard.ONE


def test_what_is_heard_while_we_are_silent_is_another() -> None:
    ear = ear_of(Queue())
    assert heard(ear, 0.0, 7, silent=True) is Heard.SEVERAL
    assert heard(ear, 1.0, 8, 9) is Heard.SEVERAL
    assert heard(ear, _HOLD, 10) is Heard.ONE


def test_until_all_that_are_listed_are_connected_nothing_is_known() -> None:
    queue = Queue(matched=1)
    ear = ear_of(queue)
    assert heard(ear, 10.0, 1, 2, 3) is Heard.UNKNOWN
    queue.matched = 2
    assert heard(ear, 11.0, 4) is Heard.UNKNOWN
    assert heard(ear, 10.0 + _HOLD, 5) is Heard.ONE


def test_without_numbers_every_message_counts() -> None:
    assert heard(ear_of(Queue()), 10.0, None) is Heard.SEVERAL


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=30), st.booleans())
def test_two_senders_that_share_a_topic_are_two_of_those_of_whom_both_tell(
    order: list[tuple[bool, bool]], both: bool
) -> None:
    """The first tells of cf1 and perhaps cf2, the second of cf2 and, if both do, of cf1."""
    following, ear, now = {False: 1, True: 1000}, ear_of(Queue()), 0.0
    for sender, other in [*order, *[(False, False), (True, False), (False, False)]]:
        first = "cf1 cf2" if other else "cf1"
        about = ("cf1 cf2" if both else "cf2") if sender else first
        answer = heard(ear, now, following[sender], about=about)
        following[sender] += 1
        now += 0.01
    assert (answer is Heard.SEVERAL) == both


def test_where_poses_of_all_come_from_is_listened_to_for_as_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for the node; the numbers of messages are those of two senders."""
    sources: dict[int, Source] = {0: Source("/poses", object, lambda data: data.decode().split())}
    queue, now = Queue(), [0.0]
    bars: dict[int, str] = {}
    told: list[str] = []
    queue.data = b"cf1"
    made = SimpleNamespace(
        create_subscription=lambda *_, **__: queue, destroy_subscription=lambda _: None, destroy_node=lambda: None
    )
    monkeypatch.setattr(rivals, "Node", lambda *_, **__: made)
    node: Any = SimpleNamespace(
        context=None,
        resolve_topic_name=lambda name: name if name.startswith("/") else f"/{name}",
        count_publishers=lambda name: 2 if name == "/poses" else 1,
        get_publishers_info_by_topic=lambda _: [SimpleNamespace(node_namespace="/", node_name="vicon")],
        get_logger=lambda: SimpleNamespace(error=told.append, info=told.append),
    )
    watch = Rivals(node, ["cf1", "cf2"], sources.get, bars.__setitem__, lambda: now[0])
    watch.look_around()
    assert "/poses has the publishers /vicon" in bars[0]
    assert bars[1] == "", "its poses come from a topic of its own"
    now[0] = _HOLD
    queue.numbers = [7, 3, 8]
    watch.look_around()
    assert told == ["cf1: no take-off: more than one sends /poses about cf1, of its publishers /vicon"]
    sources[1] = Source("/poses", object, sources[0].tells)
    watch.look_around()
    assert bars[0].endswith("stop all but one")
    assert bars[1] == ""
    sources.clear()
    watch.look_around()
    assert bars == {0: "", 1: ""}
    assert not watch._ears
    watch.close()
