"""What the console hears from nodes and is asked by browsers: each is shown, done, or refused in one line."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import rclpy
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.nodes.console import Console
from flatsat_ros.nodes.ros import interfaces
from fuzzing.cdr import poses
from fuzzing.damage import TOKENS, corrupted
from fuzzing.kind import Attempt, Kind, require_one_line
from fuzzing.nodes import arguments, own_context, refusals, silenced
from fuzzing.sequence import Item, decoded, sequences

_COMMAND, _SETUP, _POSE, _SHOW = range(4)

_WORDS = st.sampled_from(
    ["all", "cf1", "cf2", "takeoff", "land", "hold", "hand_over", "arm", "disarm", "emergency", "goal", "set", "mu",
     "gamma_max", "", "a b", "/", None, True, 0, -1, 1e308, 10**400, float("nan"), float("inf"), [], {}, [[]], ["cf1"]]
) | st.sampled_from(TOKENS[:40])  # fmt: skip
_COMMANDS = st.dictionaries(
    st.sampled_from(["do", "who", "position", "name", "value", "x"]),
    _WORDS | st.lists(_WORDS, max_size=4),
    max_size=5,
)
_LIKELY = st.builds(
    lambda what, who, place, name, value: {"do": what, "who": who, "position": place, "name": name, "value": value},
    st.sampled_from(["goal", "set", "land", "arm"]), st.sampled_from(["all", "cf1"]), st.lists(_WORDS, max_size=4),
    st.sampled_from(["mu", "nu"]) | _WORDS, st.floats() | _WORDS,
)  # fmt: skip
_SETUPS = st.sampled_from(
    ['{"robot_names": ["cf1", "cf2"]}', "[]", "null", "1", "", "{", '{"robot_names": null}', '{"robot_names": 7}',
     '{"robot_names": "cf1"}', '{"robot_names": [""]}', '{"robot_names": ["a b", "/"]}', '{"robot_names": [{}, null]}',
     '{"robot_names": ["cf1"], "x": NaN}', "[" * 5000, '{"x": ' * 900 + "1" + "}" * 900,
     '{"robot_names": ["all", "cf1"]}', '{"robot_names": ["cf1", "cf1"]}', "9" * 5000,
     json.dumps({"robot_names": [f"cf{number}" for number in range(3000)]})]
)  # fmt: skip


def _text(text: str) -> bytes:
    return serialize_message(String(data=text))


_ITEMS: st.SearchStrategy[Item] = st.one_of(
    st.tuples(st.just(_COMMAND), (_COMMANDS | _LIKELY).map(lambda command: json.dumps(command).encode())),
    st.tuples(st.just(_SETUP), _SETUPS.map(_text)),
    st.tuples(st.just(_SETUP), _SETUPS.map(_text).filter(lambda data: len(data) < 1000).flatmap(corrupted)),
    st.tuples(st.just(_POSE), poses()),
    st.tuples(st.just(_SHOW), st.just(b"")),
)


class _AtOnce(Console):
    """A console whose server's threads need not wait for an executor."""

    executor = property(  # type: ignore[assignment]
        lambda _: SimpleNamespace(create_task=lambda call: call(), wake=lambda: None), lambda *_: None
    )


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    with own_context():
        rclpy.init(args=arguments("console", "console", "port:=0"))
        node = _AtOnce()
    refused = refusals(node)
    seen: list[bytes] = []
    node._stream.publish = seen.append  # type: ignore[method-assign]

    def hear(topic: str) -> Callable[[bytes], None]:
        return next(s.callback for s in node.subscriptions if s.topic_name == f"/console/{topic}")

    setup = hear(interfaces.SETUP.suffix)

    def deliver(code: int, content: bytes) -> None:
        if code == _COMMAND:
            try:
                wanted = json.loads(content)
            except (ValueError, RecursionError):
                return
            if isinstance(wanted, dict):
                answer = node._command(wanted)
                error = answer.exception() if answer.done() else None
                if error is not None:
                    assert isinstance(error, FlatsatError)
                    require_one_line(error)
                    refused.append("command")
        elif code == _SETUP:
            setup(content)
        elif code == _POSE and "cf1" in node._robots:
            hear("cf1/pose")(content)
        else:
            node._show()

    def attempt(data: bytes) -> bool:
        with own_context(node.context):
            return attempt_there(data)

    def attempt_there(data: bytes) -> bool:
        refused.clear()
        node._close()
        node._robots, node._setup = [], {}
        setup(_text('{"robot_names": ["cf1"]}'))
        node._open()
        for code, content in decoded(data):
            deliver(code % 4, content)
            node._waiting.clear()
        assert len(node._robots) <= 200
        seen.clear()
        node._show()
        (picture,) = seen
        shown: dict[str, Any] = json.loads(picture)
        assert len(shown["drones"]) == len(node._robots)
        return not refused

    with silenced(node):
        try:
            yield attempt
        finally:
            node.finish()


CONSOLE = Kind(sequences(_ITEMS, 4), _open)
