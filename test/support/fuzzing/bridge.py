"""Both sides of cflib_bridge: the packets of a drone, and what the topics ask to be sent to it."""

from __future__ import annotations

import logging
import math
import os
import struct
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from typing import Any
from unittest import mock

import rclpy
from cflib.crazyflie.log import LogTocElement
from cflib.crazyflie.toc import Toc
from cflib.crtp.crtpstack import CRTPPacket
from geometry_msgs.msg import Twist
from hypothesis import strategies as st

from flatsat_ros.crazyflie.wire import WireSetpoint
from flatsat_ros.nodes.cflib_bridge import CflibBridge
from flatsat_ros.nodes.cflib_link import (
    CONSOLE_CHARACTERS,
    POSITION,
    QUATERNION,
    SUPERVISOR,
    VOLTAGE,
    Link,
    _Crazyflie,
)
from flatsat_ros.nodes.cflib_sender import CflibSender
from flatsat_ros.nodes.ros import messages
from fuzzing.cdr import poses
from fuzzing.damage import FLOATS
from fuzzing.kind import Attempt, Kind
from fuzzing.nodes import arguments, own_context, refusals, silenced
from fuzzing.sequence import Item, decoded, sequences

_LOG, _LOG_DATA = 5, 2
_HEADER = _LOG << 4 | _LOG_DATA
_SETPOINT, _EXTERNAL = 0, 1


@st.composite
def _packets(draw: st.DrawFn) -> Item:
    """A packet: its header is the code; of the log, the console, the parameters or anything."""
    kind = draw(st.integers(0, 5))
    if kind <= 1:
        block, stamp = draw(st.integers(0, 3)), draw(st.binary(min_size=3, max_size=3))
        numbers = [draw(st.floats(width=32)) for _ in range(draw(st.integers(0, 5)))]
        return _HEADER, bytes([block]) + stamp + struct.pack(f"<{len(numbers)}f", *numbers) + draw(
            st.binary(max_size=8)
        )
    if kind == 2:
        return 0, draw(st.text(max_size=10).map(str.encode) | st.binary(max_size=30))
    ports = st.sampled_from([0, 2, 4, 5, 7, 9, 13, 15]) if kind < 5 else st.integers(0, 15)
    command = draw(st.integers(0, 9) | st.integers(0, 255))
    return draw(ports) << 4 | draw(st.integers(0, 3)), bytes([command]) + draw(st.binary(max_size=29))


class _Driver:
    """Takes the place of cflib's driver of a radio: hands out the packets that are waiting, keeps what was sent."""

    needs_resending = False

    def __init__(self) -> None:
        self.waiting: deque[CRTPPacket] = deque()
        self.sent: deque[CRTPPacket] = deque(maxlen=100)
        self.at_end: Any = None

    def receive_packet(self, _: float = 0) -> CRTPPacket | None:
        if self.waiting:
            return self.waiting.popleft()
        self.at_end()
        return None

    def send_packet(self, packet: CRTPPacket) -> bool:
        self.sent.append(packet)
        return True

    def close(self) -> None:
        pass


class _Complaints(logging.Handler):
    """What cflib says about callbacks that raised."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.ours: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if "flatsat_ros" in text:
            self.ours.append(text)


def _connected(link: Link) -> tuple[_Crazyflie, _Driver]:
    """Return a link's Crazyflie as it is once connected, with its threads not running."""
    cf, driver = _Crazyflie(rw_cache=None), _Driver()
    cf.link, cf.log.toc, driver.at_end = driver, Toc(), cf.incoming.stop
    for number, name in enumerate((VOLTAGE, SUPERVISOR, *POSITION, *QUATERNION)):
        element = LogTocElement(number, b"\x07" + "\0".join(name.split(".")).encode() + b"\0")
        cf.log.toc.add_element(element)
    link._attach(cf)
    link._listen(cf)
    return cf, driver


_numbers = count(os.getpid())


@contextmanager
def _bridge(folder: Path) -> Iterator[CflibBridge]:
    """A bridge whose links do not open."""
    # no other bridge of this machine has claimed it
    uri = f"udp://127.0.0.1:{1024 + next(_numbers) * 7919 % 64000}"
    with ExitStack() as stack:
        stack.enter_context(mock.patch.dict(os.environ, XDG_CACHE_HOME=str(folder)))
        stack.enter_context(mock.patch.object(Link, "start"))
        parameters = ("pose_rate:=100.0", "external_pose:=pose", f"uris:=['{uri}']")
        with own_context():
            rclpy.init(args=arguments("cflib_bridge", f"bridge{next(_numbers)}", *parameters))
            node = CflibBridge()
        stack.enter_context(silenced(node))
        for claim in node._claims:
            stack.callback(claim.close)
        yield node


@contextmanager
def _open_packets(folder: Path) -> Iterator[Attempt]:
    """What a drone sends: nothing of it may break us, and what it says next is still heard."""
    complaints, library = _Complaints(), logging.getLogger("cflib")
    with _bridge(folder) as node:
        level = library.level
        library.addHandler(complaints)
        library.setLevel(logging.ERROR)
        (link,) = node.links
        heard: list[Any] = []
        link._on_pose = lambda position, quaternion: heard.append((position, quaternion))

        def attempt(data: bytes) -> bool:
            complaints.ours.clear()
            heard.clear()
            cf, driver = _connected(link)
            for header, content in decoded(data):
                driver.waiting.append(CRTPPacket(header, content))
            _hear(cf)
            taken = bool(heard or link.values or link.console or link._line)
            assert not complaints.ours, complaints.ours[0]
            assert len(link._line) <= CONSOLE_CHARACTERS
            assert len(link.console) <= 5
            assert len(link.values) < 10
            (report,) = node._watch._report(0)
            assert len(report.text) < 100
            heard.clear()
            block = max(cf.log.log_blocks, key=lambda block: len(block.variables))
            numbers = struct.pack("<3f4e", 0.5, 1.0, 1.5, 0.0, 0.0, 0.0, 1.0)
            driver.waiting.append(CRTPPacket(_HEADER, bytes([block.id, 0, 0, 0]) + numbers))
            _hear(cf)
            assert heard == [((0.5, 1.0, 1.5), (0.0, 0.0, 0.0, 1.0))], "a sound packet is still heard"
            link._line, link.values = "", {}
            link.console.clear()
            return taken

        try:
            yield attempt
        finally:
            library.removeHandler(complaints)
            library.setLevel(level)


def _hear(cf: _Crazyflie) -> None:
    """Let cflib handle what is waiting, in this thread."""
    cf.incoming._stop_event.clear()
    cf.incoming.run()


_SOUND = (*[st.floats(-30.0, 30.0)] * 3, st.floats(0.0, 65535.0))
_ITEMS: st.SearchStrategy[Item] = st.one_of(
    st.tuples(st.just(_SETPOINT), st.lists(FLOATS, min_size=4, max_size=4).map(lambda v: struct.pack("<4d", *v))),
    st.tuples(st.just(_SETPOINT), st.tuples(*_SOUND).map(lambda v: struct.pack("<4d", *v))),
    st.tuples(st.just(_EXTERNAL), poses()),
    st.tuples(st.just(_EXTERNAL), st.binary(max_size=100)),
)


@contextmanager
def _open_topics(folder: Path) -> Iterator[Attempt]:
    """What is asked for on the topics: each packet that goes out has finite numbers, and nothing ends the link."""
    with _bridge(folder) as node:
        (link,) = node.links
        commands = {s.topic_name.rpartition("/")[2]: s.callback for s in node.subscriptions}
        refused = refusals(node)
        cf, driver = _connected(link)

        def attempt(data: bytes) -> bool:
            refused.clear()
            items = decoded(data)
            for code, content in items:
                driver.sent.clear()
                if code % 2 == _SETPOINT:
                    message = Twist()
                    messages.fill_command(message, WireSetpoint(*struct.unpack("<4d", content[:32].ljust(32, b"\0"))))
                    commands["cmd_vel_legacy"](message)
                else:
                    commands["mocap_pose"](content)
                link.outbox._queue._sent.clear()
                link.outbox._queue._last = -math.inf  # nothing has to wait
                link.outbox.send(CflibSender(cf), time.monotonic())
                for packet in driver.sent:
                    _require_finite(packet)
            return not refused

        yield attempt


def _require_finite(packet: CRTPPacket) -> None:
    """Require of a set-point or an external pose that its numbers are finite."""
    form = {3: "<fffH", 6: "<Bfffffff"}[packet.port]
    values = struct.unpack(form, packet.data)
    assert all(math.isfinite(value) for value in values), values


CRTP = Kind(sequences(_packets(), 10), _open_packets)
BRIDGE = Kind(sequences(_ITEMS), _open_topics)
