"""The web server of the console: a page, a stream of what happens, and commands; for browsers on this machine alone.

It listens on the loopback interface. A request must name it as a browser on this machine does (`Host`), which another
site's name that resolves to it does not, and a command must come from its own page (`Origin`). For another machine
there is `ssh -L`.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NoAnswerError
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from flatsat_ros.base.errors import refusal

ADDRESS = "127.0.0.1"
VIEWERS, CONNECTIONS = 8, 64  # at once
_BODY = 4096  # bytes, of a command
_SILENCE = 10.0  # s, after which a connection on which nothing comes is closed
_PATIENCE = 5.0  # s, for what a command brought about
_KEEP_ALIVE = 2.0  # s: so often something is sent, to notice a browser that has left
_LOOK = 0.1  # s: so often it is seen whether to end
_AGAIN = 0.25  # s, after which a browser that has lost the stream asks for it again

Command = Callable[[dict[str, Any]], "Future[str]"]


class Broadcast:
    """The newest thing to show, handed to all viewers; viewers that are slow miss some."""

    def __init__(self, followed: Callable[[bool], None]) -> None:
        """Begin without viewers.

        Args:
            followed: called with True when the first viewer comes and False when the last one has left.
        """
        self._followed = followed
        self._news = threading.Condition()
        self._number, self._newest, self._viewers, self._closed = 0, b"", 0, False

    def publish(self, text: bytes) -> None:
        """Hand something new to all viewers."""
        with self._news:
            self._number, self._newest = self._number + 1, text
            self._news.notify_all()

    def close(self) -> None:
        """Send all viewers away."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    def enter(self) -> bool:
        """Count a viewer in, if there is room."""
        with self._news:
            if self._viewers >= VIEWERS or self._closed:
                return False
            self._viewers += 1
            first = self._viewers == 1
        if first:
            self._followed(True)
        return True

    def leave(self) -> None:
        """Count a viewer out."""
        with self._news:
            self._viewers -= 1
            last = self._viewers == 0
        if last:
            self._followed(False)

    def wait(self, seen: int) -> tuple[int, bytes] | None:
        """Wait for something newer than number `seen`; return both, no text after a while, None at the end."""
        with self._news:
            self._news.wait_for(lambda: self._closed or self._number > seen, _KEEP_ALIVE)
            if self._closed:
                return None
            return self._number, self._newest if self._number > seen else b""


class ConsoleServer:
    """Serves a page and a stream, and hands commands on."""

    def __init__(self, port: int, page: str, stream: Broadcast, command: Command) -> None:
        """Let connections come; `serve` answers them.

        Args:
            port: on the loopback interface.
            page: HTML.
            stream: what viewers are shown.
            command: does what a page asks for; the future gives an answer, or raises why it was refused.

        Raises:
            FlatsatError: the port is taken or must not be used.
        """
        handler = type("_Handler", (_Handler,), {"page": page.encode(), "stream": stream, "ask": staticmethod(command)})
        try:
            self._server = _Server((ADDRESS, port), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise refusal("parameter port", port, "", f"one on which nobody listens on {ADDRESS} ({reason})") from error
        self._stream = stream
        self._thread: threading.Thread | None = None

    def serve(self) -> None:
        """Begin to answer those who have connected so far and who come."""
        self._thread = threading.Thread(target=self._server.serve_forever, args=[_LOOK], name="console", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{ADDRESS}:{self._server.server_address[1]}"

    def close(self) -> None:
        """Stop listening and send all viewers away."""
        self._stream.close()
        if self._thread is not None:
            self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    """A thread for each connection, as long as there are not too many."""

    daemon_threads = True
    request_queue_size = CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._room = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection, or close it where there is no room."""
        if self._room.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection to its end."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()


class _Handler(BaseHTTPRequestHandler):
    """One connection of a browser."""

    page: bytes
    stream: Broadcast
    ask: Command
    timeout = _SILENCE
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "flatsat_ros", ""

    def do_GET(self) -> None:
        """Send the page, or the stream."""
        if not self._is_local():
            return
        if self.path == "/":
            self._send(HTTPStatus.OK, "text/html; charset=utf-8", self.page)
        elif self.path == "/events" and self.headers.get("Sec-Fetch-Site", "same-origin") not in (
            "same-origin",
            "none",
        ):
            # a picture or a script of another site's page that takes up the room of viewers
            self._refuse(HTTPStatus.FORBIDDEN, "the stream is for this console's own page only")
        elif self.path == "/events":
            self._stream_events()
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is only / and /events")

    def do_POST(self) -> None:
        """Take a command and send what came of it."""
        if not self._is_local():
            return
        origin, length = self.headers.get("Origin"), self.headers.get("Content-Length", "")
        if origin != f"http://{self.headers.get('Host')}":
            self._refuse(HTTPStatus.FORBIDDEN, "commands are taken from this console's own page only")
        elif self.path != "/command":
            self._refuse(HTTPStatus.NOT_FOUND, "there is only /command")
        elif self.headers.get("Content-Type", "").partition(";")[0] != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "a command is application/json")
        elif not (length.isascii() and length.isdigit() and int(length[:9]) <= _BODY and len(length) < 9):
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a command has a length of at most {_BODY} bytes")
        else:
            self._answer(self.rfile.read(int(length)))

    def _answer(self, body: bytes) -> None:
        try:
            wanted = json.loads(body)
        except (ValueError, RecursionError):
            wanted = None
        if not isinstance(wanted, dict):
            self._refuse(HTTPStatus.BAD_REQUEST, "a command is an object in JSON")
            return
        try:
            done, text = True, type(self).ask(wanted).result(_PATIENCE)
        except NoAnswerError:
            done, text = False, f"no answer within {_PATIENCE:g} s: is the controller running?"
        except ValueError as error:  # a FlatsatError
            done, text = False, str(error)
        self._send(HTTPStatus.OK, "application/json", json.dumps({"done": done, "text": text}).encode())

    def _stream_events(self) -> None:
        if not self.stream.enter():
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, f"at most {VIEWERS} pages are served at once")
            return
        try:
            self.close_connection = True
            self.send_response(HTTPStatus.OK)
            self._send_headers("text/event-stream")
            self.end_headers()
            self.wfile.write(b"retry: %d\n\n" % round(1000.0 * _AGAIN))
            seen = 0
            while (news := self.stream.wait(seen)) is not None:
                seen, text = news
                self.wfile.write(b"data: " + text + b"\n\n" if text else b": still here\n\n")
        except OSError:
            pass  # the browser has left
        finally:
            self.stream.leave()

    def _is_local(self) -> bool:
        """Tell whether the request names this server as a browser of this machine does; refuse it if not."""
        port = self.connection.getsockname()[1]
        if self.headers.get("Host") in (f"{ADDRESS}:{port}", f"localhost:{port}"):
            return True
        self._refuse(HTTPStatus.MISDIRECTED_REQUEST, f"this is {ADDRESS}:{port}; from elsewhere, use ssh -L")
        return False

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self.close_connection = True
        self._send(status, "text/plain; charset=utf-8", f"{text}\n".encode())

    def _send(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        self._send_headers(kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _send_headers(self, kind: str) -> None:
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("X-Frame-Options", "DENY")
        if self.close_connection:
            self.send_header("Connection", "close")

    def log_message(self, *_: object) -> None:
        """Say nothing of each request."""

    def handle(self) -> None:
        """Serve requests; a browser that leaves in the middle is no error."""
        try:
            super().handle()
        except OSError:
            self.close_connection = True
