"""The console's web server: what it serves, whom it refuses, and how it ends."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import pytest

from flatsat_ros.base.errors import FlatsatError
from flatsat_ros.viewing.page import page_of_console
from flatsat_ros.viewing.server import ADDRESS, CONNECTIONS, VIEWERS, Broadcast, ConsoleServer, _Handler

PAGE = "<!doctype html><title>page</title>"


@dataclass
class Desk:
    """A server, and what was asked of it."""

    asked: list[dict[str, Any]] = field(default_factory=list)
    followed: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.stream = Broadcast(self.followed.append)
        self.server = ConsoleServer(0, PAGE, self.stream, self.command)
        self.server.serve()
        self.host = self.server.address.removeprefix("http://")

    def command(self, wanted: dict[str, Any]) -> Future[str]:
        self.asked.append(wanted)
        answer: Future[str] = Future()
        if wanted.get("do") == "fail":
            answer.set_exception(FlatsatError("do = 'fail': must be something else"))
        else:
            answer.set_result("well done")
        return answer

    def connect(self) -> http.client.HTTPConnection:
        return http.client.HTTPConnection(self.host, timeout=5.0)

    def request(self, method: str, path: str, body: str | None = None, **headers: str) -> tuple[int, str]:
        with closing(self.connect()) as connection:
            given = {"Host": self.host} | {name.replace("_", "-"): value for name, value in headers.items()}
            connection.putrequest(method, path, skip_host=True)
            for name, value in given.items():
                connection.putheader(name, value)
            if body is not None and "Content-Length" not in given:
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body.encode() if body is not None else None)
            answer = connection.getresponse()
            return answer.status, answer.read().decode()

    def post(self, body: str, **headers: str) -> tuple[int, str]:
        given = {"Origin": f"http://{self.host}", "Content_Type": "application/json"} | headers
        return self.request("POST", "/command", body, **given)

    def follow(self) -> http.client.HTTPResponse:
        connection = self.connect()
        connection.request("GET", "/events", headers={"Host": self.host})
        answer = connection.getresponse()
        assert answer.readline() == b"retry: 250\n"
        assert answer.readline() == b"\n"
        connection.sock = None  # the answer has it, and closes it
        return answer


@pytest.fixture
def desk() -> Iterator[Desk]:
    desk = Desk()
    yield desk
    desk.server.close()


def wait_for(condition: Any) -> None:
    end = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_it_listens_on_the_loopback_interface_alone(desk: Desk) -> None:
    assert ADDRESS == "127.0.0.1"
    assert desk.server.address.startswith("http://127.0.0.1:")


def test_a_browser_gets_the_page_and_its_commands_are_carried_out(desk: Desk) -> None:
    assert desk.request("GET", "/") == (200, PAGE)
    status, body = desk.post('{"do": "land", "who": "all"}')
    assert (status, json.loads(body)) == (200, {"done": True, "text": "well done"})
    assert desk.asked == [{"do": "land", "who": "all"}]


def test_why_a_command_was_refused_is_told(desk: Desk) -> None:
    status, body = desk.post('{"do": "fail"}')
    assert (status, json.loads(body)) == (200, {"done": False, "text": "do = 'fail': must be something else"})


@pytest.mark.parametrize(
    ("headers", "body", "status"),
    [
        ({"Host": "evil.example"}, "{}", 421),
        ({"Host": "127.0.0.1"}, "{}", 421),
        ({"Origin": "http://evil.example"}, "{}", 403),
        ({"Origin": "null"}, "{}", 403),
        ({"Origin": ""}, "{}", 403),
        ({"Content_Type": "text/plain"}, "{}", 415),
        ({"Content_Length": "4097"}, "{}", 413),
        ({"Content_Length": "-1"}, "{}", 413),
        ({"Content_Length": "1e3"}, "{}", 413),
        ({"Content_Length": "9" * 5000}, "{}", 413),
        ({}, "[]", 400),
        ({}, "{", 400),
        ({}, "[" * 4000, 400),
        ({}, '"land"', 400),
        ({}, "", 400),
    ],
)
def test_what_a_page_of_ours_would_not_send_is_refused(
    desk: Desk, headers: dict[str, str], body: str, status: int
) -> None:
    found, text = desk.post(body, **headers)
    assert found == status
    assert text.count("\n") == 1
    assert desk.asked == []


def test_other_paths_and_other_sites_get_nothing(desk: Desk) -> None:
    assert desk.request("GET", "/etc/passwd")[0] == 404
    assert desk.request("GET", "/../etc/passwd")[0] == 404
    assert desk.request("POST", "/", "{}", Origin=f"http://{desk.host}", Content_Type="application/json")[0] == 404
    for path in ("/", "/events"):
        assert desk.request("GET", path, Host="rebound.example:80")[0] == 421
    assert desk.request("PUT", "/command", "{}")[0] == 501


@pytest.mark.parametrize(("site", "status"), [("cross-site", 403), ("same-site", 403), ("none", 200)])
def test_pages_of_other_sites_cannot_take_the_room_of_viewers(desk: Desk, site: str, status: int) -> None:
    connection = desk.connect()
    connection.request("GET", "/events", headers={"Host": desk.host, "Sec-Fetch-Site": site})
    with closing(connection):
        assert connection.getresponse().status == status


def test_connections_on_which_nothing_comes_are_closed_and_never_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Handler, "timeout", 0.5)
    desk = Desk()
    port = int(desk.host.rpartition(":")[2])
    idle = [socket.create_connection((ADDRESS, port), 5.0) for _ in range(2 * CONNECTIONS)]
    for number, connection in enumerate(idle):
        connection.sendall(b"GET / HTTP/1.1\r\n"[: number % 16])  # not to the end
    wait_for(lambda: all(connection.recv(1) == b"" for connection in idle))
    assert desk.request("GET", "/") == (200, PAGE)
    for connection in idle:
        connection.close()
    desk.server.close()


def test_a_viewer_that_does_not_read_holds_up_nobody_and_is_sent_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Handler, "timeout", 2.0)
    desk = Desk()
    port = int(desk.host.rpartition(":")[2])
    with socket.create_connection((ADDRESS, port), 5.0) as deaf:
        deaf.sendall(f"GET /events HTTP/1.1\r\nHost: {desk.host}\r\n\r\n".encode())
        wait_for(lambda: desk.followed == [True])
        viewer = desk.follow()
        for number in range(12):
            text = b'{"number": %d, "long": "%s"}' % (number, b"x" * 1_000_000)
            desk.stream.publish(text)
            assert viewer.readline() == b"data: " + text + b"\n"
            assert viewer.readline() == b"\n"
        viewer.close()

        def gone() -> bool:
            desk.stream.publish(b"{}")
            return desk.followed == [True, False]

        wait_for(gone)
    desk.server.close()


def test_what_is_no_request_at_all_harms_nobody(desk: Desk) -> None:
    port = int(desk.host.rpartition(":")[2])
    for junk in (
        b"\0\xff" * 100,
        b"GET " + b"/" * 70000,
        b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 200 + b"\r\n",
        b"",
        b"\r\n",
    ):
        with socket.create_connection((ADDRESS, port), 5.0) as connection:
            connection.sendall(junk)
    assert desk.request("GET", "/") == (200, PAGE)


def test_all_viewers_see_the_news_and_the_first_and_the_last_are_told_of(desk: Desk) -> None:
    viewers = [desk.follow(), desk.follow()]
    wait_for(lambda: desk.followed == [True])
    for number in range(3):
        desk.stream.publish(b'{"number": %d}' % number)
        for viewer in viewers:
            assert viewer.readline() == b'data: {"number": %d}\n' % number
            assert viewer.readline() == b"\n"
    viewers[0].close()
    assert desk.followed == [True]
    viewers[1].close()

    def gone() -> bool:
        desk.stream.publish(b"{}")
        return desk.followed == [True, False]

    wait_for(gone)


def test_more_viewers_than_there_is_room_for_are_sent_away(desk: Desk) -> None:
    viewers = [desk.follow() for _ in range(VIEWERS)]
    wait_for(lambda: not desk.stream.enter())
    assert desk.request("GET", "/events")[0] == 503
    for viewer in viewers:
        viewer.close()


def test_at_its_end_nobody_is_left_waiting(desk: Desk) -> None:
    viewer = desk.follow()
    desk.server.close()
    assert viewer.read() == b""


def test_a_port_that_is_taken_is_refused_by_its_number(desk: Desk) -> None:
    port = int(desk.host.rpartition(":")[2])
    with pytest.raises(FlatsatError, match=rf"parameter port = {port}: must be one on which nobody listens"):
        ConsoleServer(port, PAGE, Broadcast(lambda _: None), desk.command)


def test_the_consoles_page_is_whole_and_speaks_to_its_own_server_only() -> None:
    page = page_of_console()
    assert "{{" not in page.partition("<script>")[0]
    assert "connect-src 'self'" in page
