"""What browsers, and whatever else reaches its port, send to the console: bytes of HTTP, one or more requests."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.viewing.server import ADDRESS, Broadcast, _Handler
from fuzzing.damage import corrupted
from fuzzing.kind import Attempt, Kind

_PORT = 8765
_HERE = f"{ADDRESS}:{_PORT}"

_ORIGIN = re.compile(rb"\norigin:\s*http://(127\.0\.0\.1|localhost):8765", re.IGNORECASE)

_METHODS = st.sampled_from([*["POST"] * 6, "GET", "HEAD", "PUT", "OPTIONS", "get", "", "P\xd6ST", "X" * 70000])
_PATHS = st.sampled_from([*["/command"] * 6, "/", "/events", "//", "*", "", "/../etc", "/%00", "/command?x=1", "\x7f"])
_VERSIONS = st.sampled_from([*["HTTP/1.1"] * 6, "HTTP/1.0", "HTTP/0.9", "HTTP/2.0", "HTTP/9" * 9, "HTTP/-1.\xb2", ""])
_HOSTS = st.sampled_from([*[_HERE] * 8, f"localhost:{_PORT}", "example.org", "", ADDRESS, f"[::1]:{_PORT}", "\xff"])
_ORIGINS = st.sampled_from([*[f"http://{_HERE}"] * 8, f"http://localhost:{_PORT}", "null", "http://example.org", ""])
_KINDS = st.sampled_from([*["application/json"] * 8, "application/json; charset=utf-8", "text/plain", "", ";"])
_VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-(10**30), 10**30) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=6,
)
_BODIES = st.one_of(
    st.dictionaries(st.sampled_from(["do", "who", "position", "x"]), _VALUES, max_size=4).map(json.dumps),
    _VALUES.map(json.dumps),
    st.sampled_from(["", "{", "[" * 4000, '{"x":' * 800, '{"do": "\\ud800"}', "9" * 4000, "{}" + " " * 5000, "\xff"]),
)
_EXTRA = st.sampled_from(
    [*[""] * 6, "Connection: close\r\n", "Expect: 100-continue\r\n", "Transfer-Encoding: chunked\r\n", "x" * 70000,
     ": \r\n", "A: b\r\n" * 120, " folded\r\n", "Host: example.org\r\n", "\0: \0\r\n"]
)  # fmt: skip


@st.composite
def _requests(draw: st.DrawFn) -> bytes:
    body = draw(_BODIES)
    lengths = st.sampled_from([*[str(len(body))] * 6, "0", "-1", "4097", "9" * 30, "1e3", "\xb2", "+5", " 5", "0x10"])
    text = (
        f"{draw(_METHODS)} {draw(_PATHS)} {draw(_VERSIONS)}\r\nHost: {draw(_HOSTS)}\r\nOrigin: {draw(_ORIGINS)}\r\n"
        f"Content-Type: {draw(_KINDS)}\r\nContent-Length: {draw(lengths)}\r\n{draw(_EXTRA)}\r\n{body}"
    )
    data = text.encode("latin-1", "replace")
    return draw(corrupted(data)) if draw(st.integers(0, 9)) == 9 and len(data) < 1000 else data


class _Connection:
    """Takes the place of a socket: what comes is there at once, what is sent is kept."""

    def __init__(self, data: bytes) -> None:
        self._data, self.sent = data, bytearray()

    def makefile(self, *_: object) -> io.BytesIO:
        return io.BytesIO(self._data)

    def sendall(self, data: bytes) -> None:
        self.sent += data

    def getsockname(self) -> tuple[str, int]:
        return ADDRESS, _PORT

    def settimeout(self, _: float) -> None:
        pass


class _Ended(Broadcast):
    """A stream that ends after its first news."""

    def wait(self, seen: int) -> tuple[int, bytes] | None:
        return None if seen else (1, b"{}")


@contextmanager
def _open(_: Path) -> Iterator[Attempt]:
    asked: list[dict[str, Any]] = []
    stream = _Ended(lambda _: None)

    def ask(wanted: dict[str, Any]) -> Future[str]:
        assert isinstance(wanted, dict)
        asked.append(wanted)
        answer: Future[str] = Future()
        if "x" in wanted:
            answer.set_exception(FlatsatError("x is refused"))
        else:
            answer.set_result("done")
        return answer

    handler = type("_Tried", (_Handler,), {"page": b"<page>", "stream": stream, "ask": staticmethod(ask)})

    def attempt(data: bytes) -> bool:
        asked.clear()
        connection = _Connection(data)
        handler(connection, (ADDRESS, 1), None)
        sent = bytes(connection.sent)
        if asked:
            assert _ORIGIN.search(data), "commands come from the console's own page"
        assert stream._viewers == 0, "who has left is counted out"
        return b'"done": true' in sent

    yield attempt


BROWSER = Kind(st.lists(_requests(), min_size=1, max_size=3).map(b"".join), _open)
